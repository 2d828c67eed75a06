"""The main faults that a reference may have had, each fitted beside maps that are off by no more than usual.

An efficient score at the fit of a healthy engine says little of them: by then maps, health and sensors have taken most
of a fault up, and a few samples next to a kink (the EGR valve's flow begins where both pressures are equal) make its
linear standard deviation several times too small. A leak of 30 mm2 scored as 0.9 +- 0.9. So everything is fitted anew
with the fault in the engine, and the size is that about which these fits fall off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from dieseltwin.discovery.twins.interface import Hypothesis
from dieseltwin.learning.faults import FaultBeside

MAIN = ("exhaust_leak", "boost_leak", "back_pressure", "air_filter_restriction", "injector_drift")
"""Faults of an engine that a reference would hide best, as maps look like them."""

_TRIAL = 2.0  # tolerances; the first size that is fitted
_DOUBLINGS = 4  # of it, while the fit gets better
_NEAREST, _FARTHEST = 0.25, 3.0  # times the first size, of the second where the first was no better
_WORTH = 0.25  # of what further errors of maps gain, from which on a fault is fitted with sensitivities of its own


class FittedTogether(Protocol):
    """All recordings of a reference at their joint fit."""

    def beside(self, effect: str, size: float, anew: bool) -> FittedTogether:
        """Fitted from here on with an effect of a size in the engine, `anew`: with sensitivities taken there."""
        ...

    def cost(self) -> float:
        """-2 log posterior, up to a constant."""
        ...

    def hypotheses(self) -> dict[str, Hypothesis]:
        """The effects that its recordings can show."""
        ...


def main_faults(healthy: FittedTogether, told: float, rival: float = 0.0) -> tuple[FaultBeside, ...]:
    """Every main fault that the recordings can show, the likeliest first.

    Args:
        healthy: the fit without any; told: decrease of -2 log posterior from which on an effect is said.
        rival: the decrease that further errors of the maps promise; 0 where none are asked for. Faults that come near
            to it are fitted once more with sensitivities taken beside them, which takes five times as long.
    """
    found = _all_fitted(healthy, MAIN, told, False)
    near = [name for name, item in found.items() if 0.0 < _WORTH * rival < item.gain]
    found |= _all_fitted(healthy, near, told, True) if near else {}
    return tuple(replace(item, rival=rival) for item in sorted(found.values(), key=lambda item: -item.gain))


def _all_fitted(healthy: FittedTogether, names: Sequence[str], told: float, anew: bool) -> dict[str, FaultBeside]:
    """Those of some faults that the recordings can show, and whose fits fall off about a size."""
    known, settled = healthy.hypotheses(), healthy.beside(names[0], 0.0, anew)
    found = (_fitted(settled, known[name], told, anew) for name in names if name in known)
    return {item.name: item for item in found if item is not None}


def _fitted(healthy: FittedTogether, effect: Hypothesis, told: float, anew: bool) -> FaultBeside | None:
    """The likeliest size of an effect, by fits at some; None where they don't fall off about any."""
    low, high = effect.limits
    size = _TRIAL * effect.tolerance
    costs = {at: healthy.beside(effect.name, at, anew).cost() for at in (size, -size) if low <= at <= high}
    costs[0.0] = least = healthy.cost()
    best = min(costs, key=lambda at: costs[at])
    if best == 0.0 and len(costs) < 3:  # where it would just be said
        size *= float(np.clip((told / max(costs[size] - least, 1.0)) ** 0.5, _NEAREST, _FARTHEST))
        costs[size] = healthy.beside(effect.name, size, anew).cost()
    for _ in range(_DOUBLINGS):
        if best == 0.0 or not low <= 2.0 * best <= high:
            break
        costs[2.0 * best] = healthy.beside(effect.name, 2.0 * best, anew).cost()
        if costs[2.0 * best] >= costs[best]:
            break
        best *= 2.0
    return fitted_size(effect, {at: cost - least for at, cost in costs.items()})


def fitted_size(effect: Hypothesis, costs: Mapping[float, float]) -> FaultBeside | None:
    """A parabola through the costs of three sizes about the least; None where it isn't curved upwards.

    Args:
        effect: what was fitted.
        costs: -2 log posterior at sizes [unit], over that without it.
    """
    if len(costs) < 3:
        return None
    least = min(costs, key=lambda at: costs[at])
    near = sorted(costs, key=lambda at: (abs(at - least), at))[:3]
    curve, slope, _ = np.polyfit(np.array(near) / effect.tolerance, [costs[at] for at in near], 2)
    if not curve > 0.0:
        return None
    low, high = (limit / effect.tolerance for limit in effect.limits)
    size = float(np.clip(-0.5 * slope / curve, low, high)) if least != 0.0 else 0.0
    return FaultBeside(effect.name, effect.unit, effect.tolerance * size, effect.tolerance * float(curve) ** -0.5,
                       max(0.0, -costs[least]), effect.tolerance)  # fmt: skip
