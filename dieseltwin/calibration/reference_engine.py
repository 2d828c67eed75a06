"""The engine as the points of a reference tell it alone.

Fitted together with the points that are judged, the coefficients bend towards a fault that no effect stands for yet: an
optimum of the compressor's map goes six deviations of its belief away, and about there the true effect gains nothing.
What came since a reference is therefore sought about the engine of the reference, which no fault has touched.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from dieseltwin.calibration.calibrate import Calibration, counted_rows
from dieseltwin.calibration.coefficients import FOUND, WEAR, Coefficient
from dieseltwin.calibration.likelihood import estimate
from dieseltwin.recordings.steady_points import JUDGED

ITERATIONS = 20


def told_by_reference(calibration: Calibration) -> Mapping[str, float]:
    """Values of all coefficients that were there before, by the points of the reference; none without one.

    Args:
        calibration: of both sets of points.
    """
    points = calibration.points
    if JUDGED not in points:
        return {}
    lasting = [c for c in calibration.estimate.coefficients if not _is_since(c)]
    found = estimate(
        calibration.model, points.take(points[JUDGED] < 0.5), lasting, calibration.start, iterations=ITERATIONS,
        rows=counted_rows(calibration.model, lasting), inflate=True,
    )  # fmt: skip
    return found.values()


def about_reference(here: Calibration, told: Mapping[str, float]) -> Calibration:
    """The calibration with the values that a reference tells; what came since is fitted to the judged points beside it.

    Args:
        here: with what was found so far.
        told: of `told_by_reference`; without any nothing changes.
    """
    if not told:
        return here
    free = here.estimate.coefficients
    since = [c for c in free if _is_since(c)]
    known = {**here.start, **told}
    found = estimate(here.model, here.points.judged, since, known, iterations=ITERATIONS,
                     rows=counted_rows(here.model, free))  # fmt: skip
    values = {**known, **found.values()}
    theta = np.array([values[c.name] for c in free])
    return replace(here, estimate=replace(here.estimate, theta=theta), start=values)


def _is_since(coefficient: Coefficient) -> bool:
    return coefficient.source == FOUND or coefficient.name in WEAR.values()
