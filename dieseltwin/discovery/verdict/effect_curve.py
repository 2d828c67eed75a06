"""A named effect as a curve over its main argument, beside the same effect freed in bins of it.

A law of the catalogue is one number. Freed in bins, it is one number a bin: where the law is right they agree. Both are
shown as what the law stands for (a leak's flow, a pressure drop, a power), or as the number itself where nothing
smaller than the whole model says what it stands for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from dieseltwin.discovery.likelihood.fit import Linearisation
from dieseltwin.discovery.twins.interface import Array
from dieseltwin.discovery.verdict.curves import LawCurve
from dieseltwin.engine import EngineParameters, constants
from dieseltwin.engine.effect import Curve, Effect, unchanged
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.errors import DieselTwinError
from dieseltwin.least_squares import Z_90

BINS = 7
_DIFFERENCE = 0.02  # of the magnitude, for the response to a bin
_WEAK_STD = 3.0  # relative to the magnitude: bins that the recording says nothing about stay near the law
_GRID = 20
_QUANTILES = (0.02, 0.98)  # of the argument over which bins lie

Variables = Mapping[str, Array]


def change_by(effect: Effect, magnitude: float, variables: Variables, engine: EngineParameters) -> Array:
    """By how much an effect's law changes its quantity along a trajectory, (n,), from the published model's value."""
    if effect.change is None:
        raise DieselTwinError(f"effect {effect.name} has no law to draw")
    c = constants(engine)
    known = {**c._asdict(), **variables, "c": c}
    before = unchanged(effect.enters.name, c)
    after = effect.change(before, magnitude, *(known[name] for name in effect.arguments))
    return np.asarray(after - before)


def effect_curves(at: Linearisation, engine: EngineParameters) -> list[LawCurve]:
    """Curves of the fit's smooth effects with their bands, and the effects freed in bins.

    The bins are one linear step from the fit, in its metric: health parameters, other effects, local states and
    tolerances are free beside them.

    Args:
        at: the repaired fit; its twin is an engine's (variables as of `EngineTwin.variables`).
        engine: for the constants of the laws.
    """
    variables = at.twin.variables(at.fit.lanes())
    curves = []
    for index, name in enumerate(at.fit.candidate.names):
        effect = EFFECTS.get(name)
        magnitude = float(at.fit.magnitudes[index])
        if effect is None or effect.curve is None or magnitude == 0.0 or not at.twin.hypotheses[name].smooth:
            continue
        x = effect.curve.argument(variables)
        acts = _acting(at, name)
        if np.ptp(x[acts]) <= 1e-9 * max(1.0, float(np.abs(x[acts]).max())):
            continue
        knots, share, share_std = _freed(at, index, x, acts)
        std = float(at.fit.std[len(at.twin.parameters) + index])
        relative = 0.0 if not np.isfinite(std) else std / abs(magnitude)
        grid, curve = _averaged(effect, effect.curve, magnitude, variables, engine, x, acts)
        on_knots = np.interp(knots, grid, curve)
        half = Z_90 * relative * np.abs(curve)
        curves.append(
            LawCurve(
                name=name, x_name=effect.curve.over, x=grid, curve=curve, low=curve - half, high=curve + half,
                points_x=knots, points_y=on_knots * (1.0 + share), points_std=np.abs(on_knots) * share_std,
                unit=effect.curve.unit or effect.unit,
            )
        )  # fmt: skip
    return curves


def _acting(at: Linearisation, name: str) -> np.ndarray:
    """(n,) where the effect acts: everywhere, or after its onset or inside its region."""
    schedule = at.fit.candidate.schedules.get(name)
    return np.ones(at.twin.time_s.size, dtype=bool) if schedule is None else np.asarray(schedule) != 0.0


def _averaged(
    effect: Effect, drawn: Curve, magnitude: float, variables: Variables, engine: EngineParameters, x: Array,
    acts: np.ndarray,
) -> tuple[Array, Array]:  # fmt: skip
    """The law averaged over narrow bins of its argument, (g,) and (g,): it may depend on more than one variable."""
    if drawn.unit is None:
        low, high = np.quantile(x[acts], _QUANTILES)
        grid = np.linspace(low, high, 2)
        return grid, np.full(2, magnitude)
    y = np.broadcast_to(drawn.sign * change_by(effect, magnitude, variables, engine), x.shape)
    edges = np.unique(np.quantile(x[acts], np.linspace(0.0, 1.0, _GRID + 1)))
    place = np.clip(np.searchsorted(edges, x[acts], side="right") - 1, 0, edges.size - 2)
    used = np.unique(place)
    return (
        np.array([x[acts][place == k].mean() for k in used]),
        np.array([y[acts][place == k].mean() for k in used]),
    )


def _freed(at: Linearisation, index: int, x: Array, acts: np.ndarray) -> tuple[Array, Array, Array]:
    """Knots (k,), relative change of the magnitude at each (k,) and its standard deviation (k,)."""
    knots = np.unique(np.quantile(x[acts], np.linspace(*_QUANTILES, BINS)))
    name = at.fit.candidate.names[index]
    base = at.fit.candidate.schedules.get(name)
    schedule = np.ones(x.size) if base is None else np.asarray(base, dtype=np.float64)
    lane = at.fit.lanes()
    responses = []
    for row in np.eye(knots.size):
        hat = np.interp(x, knots, row)
        changed = {**at.fit.candidate.schedules, name: schedule * (1.0 + _DIFFERENCE * hat)}
        moved = at.twin.simulate(replace(lane, schedules=changed))[0]
        responses.append((moved - at.simulated) / _DIFFERENCE)
    bins = at.metric.project(np.stack(responses))
    P = len(at.twin.parameters)
    others = np.delete(at.projected, P + index, axis=0)  # the bins together are the magnitude itself
    design = np.vstack([others, bins])
    precision = np.concatenate([np.delete(at.precision, P + index), np.full(knots.size, _WEAK_STD**-2.0)])
    covariance = np.linalg.inv(design @ design.T + np.diag(precision))
    offset = np.zeros(precision.size)
    offset[:P] = np.array([p.value for p in at.twin.parameters]) - at.fit.parameters
    change = covariance @ (design @ at.projected_residual + precision * offset)
    k = knots.size
    return knots, change[-k:], np.sqrt(np.maximum(np.diag(covariance)[-k:], 0.0))
