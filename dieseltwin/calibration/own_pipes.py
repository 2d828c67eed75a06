"""How large a back pressure is beside the pipes that the engine had behind its turbine already.

The published model has none, and the points of a reference can't tell: the turbine's map takes them up. But beside a
pressure behind the turbine the same flow needs more pressure before it, so that without pipes the same restriction is
found larger, by 19 % of one engine. What both ways to think disagree about counts as a deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dieseltwin.calibration.calibrate import Calibration, counted_rows
from dieseltwin.calibration.coefficients import BELIEFS, Coefficient
from dieseltwin.calibration.likelihood import estimate
from dieseltwin.engine.terms import Term, effect_terms
from dieseltwin.recordings.steady_points import JUDGED

BACK_PRESSURE = "back_pressure"
ITERATIONS = 20


def beside_own_pipes(here: Calibration, free: Sequence[Coefficient]) -> float | None:
    """What a back pressure that was found comes to where the engine has usual pipes [Pa/(kg/s)^2].

    None where none was found beside a reference, where the engine file has pipes, or the pressure behind the turbine
    was read.

    Args:
        here: with what was found.
        free: its coefficients.
    """
    engine = here.model.engine
    known = any(term.slot == BACK_PRESSURE for term in effect_terms(engine.terms)) or "p_es_pa" in here.model.extra
    if known or JUDGED not in here.points or BACK_PRESSURE not in {c.name for c in free}:
        return None
    usual = next(belief.mean for belief in BELIEFS if belief.name == BACK_PRESSURE)
    pipes = Term(effect=BACK_PRESSURE, magnitude=usual)
    model = replace(here.model, engine=engine.replace(terms=(pipes, *engine.terms)))
    start = {**here.start, BACK_PRESSURE: here.start[BACK_PRESSURE] + usual}
    found = estimate(model, here.points, free, start, iterations=ITERATIONS, rows=counted_rows(model, free),
                     inflate=True)  # fmt: skip
    return found.values()[BACK_PRESSURE] - usual
