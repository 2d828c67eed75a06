"""Ways to think of what settled points don't see, each fitted to all of them: what they disagree about is not known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from dieseltwin.calibration.calibrate import Calibration, counted_rows
from dieseltwin.calibration.coefficients import BELIEFS, Coefficient
from dieseltwin.calibration.likelihood import FULL_ITERATIONS, Estimate, estimate
from dieseltwin.calibration.steady_model import COOLED_CHARGE, COOLED_EGR, WORK_ROW, SteadyModel
from dieseltwin.settings.search import SubmodelErrors

FORMULATIONS: Mapping[str, tuple[frozenset[str], frozenset[str]]] = {
    "coolers and wheel": (frozenset({COOLED_CHARGE, COOLED_EGR, WORK_ROW}), frozenset()),
    "coolers, efficiencies as believed": (frozenset({COOLED_CHARGE, COOLED_EGR}), frozenset({"work_0", "work_slope"})),
    "coolers and wheel, pipes as found": (
        frozenset({COOLED_CHARGE, COOLED_EGR, WORK_ROW}), frozenset({"back_pressure", "air_filter_restriction"})),
    "charge at a constant temperature, wheel": (
        frozenset({WORK_ROW}),
        frozenset({"charge_cooler_loss", "cooler_approach", "egr_heating", "egr_coolant", "vol_heating"})),
}  # fmt: skip
"""Ways to think of what settled points don't see: what is switched on, and which beliefs are left out."""


def formulations(
    here: Calibration, free: Sequence[Coefficient], errors: SubmodelErrors
) -> dict[str, tuple[SteadyModel, Estimate]]:
    """Every formulation of the unmeasured places, fitted to all points; what was found keeps no belief."""
    known = {c.name for c in free}
    out = {}
    for name, (active, without) in FORMULATIONS.items():
        beliefs = [c for c in BELIEFS if c.name not in known | without]
        model = replace(here.model, active=active, lasting=frozenset(c.name for c in beliefs))
        every = [*free, *beliefs]
        floors = {row: errors.error(row) for row in model.rows}
        start = {**{c.name: c.mean for c in beliefs}, **here.start}
        out[name] = (model, estimate(model, here.points, every, start, iterations=FULL_ITERATIONS, inflate=True,
                                     floors=floors, rows=counted_rows(model, every)))
    return out
