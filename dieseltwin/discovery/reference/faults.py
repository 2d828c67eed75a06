"""The main faults that a reference may have had, each fitted beside maps that are off by no more than usual.

An efficient score at the fit of a healthy engine says little of them: by then maps, health and sensors have taken most
of a fault up, and a few samples next to a kink (the EGR valve's flow begins where both pressures are equal) make its
linear standard deviation several times too small. A leak of 30 mm2 scored as 0.9 +- 0.9. So everything is fitted anew
with the fault in the engine, and the size is that about which these fits fall off.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from dieseltwin.discovery.twins.interface import Hypothesis
from dieseltwin.learning.faults import FaultBeside

MAIN = ("exhaust_leak", "boost_leak", "back_pressure", "air_filter_restriction", "injector_drift")
"""Faults of an engine that a reference would hide best, as maps look like them."""

_TRIAL = 3.0  # tolerances; the first size that is fitted
_DOUBLINGS = 3  # of it, while the fit gets better


class FittedTogether(Protocol):
    """All recordings of a reference at their joint fit."""

    def beside(self, effect: str, size: float) -> FittedTogether:
        """Fitted from here on with an effect of a size in the engine."""
        ...

    def cost(self) -> float:
        """-2 log posterior, up to a constant."""
        ...

    def hypotheses(self) -> dict[str, Hypothesis]:
        """The effects that its recordings can show."""
        ...


def main_faults(healthy: FittedTogether) -> tuple[FaultBeside, ...]:
    """Every main fault that the recordings can show, the likeliest first."""
    known = healthy.hypotheses()
    settled = healthy.beside(MAIN[0], 0.0)
    found = (_fitted(settled, known[name]) for name in MAIN if name in known)
    return tuple(sorted((item for item in found if item is not None), key=lambda item: -item.gain))


def _fitted(healthy: FittedTogether, effect: Hypothesis) -> FaultBeside | None:
    """The likeliest size of an effect, by fits at some; None where they don't fall off about any."""
    low, high = effect.limits
    sizes, costs = [0.0], [healthy.cost()]
    size = _TRIAL * effect.tolerance
    for doubling in range(1 + _DOUBLINGS):
        tried = [size] if doubling or low >= 0.0 else [size, -size]
        fits = {at: healthy.beside(effect.name, at).cost() for at in tried if low <= at <= high}
        if not fits:
            break
        sizes += fits
        costs += fits.values()
        best = min(fits, key=lambda at: fits[at])
        if len(sizes) > 2 and fits[best] >= min(costs[: len(costs) - len(fits)]):
            break
        size = 2.0 * best
    return fitted_size(effect, np.array(sizes), np.array(costs))


def fitted_size(effect: Hypothesis, sizes: np.ndarray, costs: np.ndarray) -> FaultBeside | None:
    """A parabola through the costs of three sizes about the least; None where it isn't curved upwards.

    Args:
        effect: what was fitted.
        sizes: (n,) of it, nought first [unit]; costs: (n,) -2 log posterior.
    """
    if sizes.size < 3:
        return None
    near = np.argsort(np.abs(sizes - sizes[np.argmin(costs)]), kind="stable")[:3]
    curve, slope, level = np.polyfit(sizes[near] / effect.tolerance, costs[near] - costs[0], 2)
    if not curve > 0.0:
        return None
    best = float(np.clip(-0.5 * slope / curve, *(limit / effect.tolerance for limit in effect.limits)))
    gain = -float((curve * best + slope) * best + level)
    return FaultBeside(effect.name, effect.unit, effect.tolerance * best, effect.tolerance * float(curve) ** -0.5,
                       max(gain, 0.0), effect.tolerance)  # fmt: skip
