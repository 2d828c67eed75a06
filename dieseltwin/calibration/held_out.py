"""What a machine foretells of the held-out third of the points, and whether another one foretells it better.

Next to a kink a point may be seven deviations off by a size that is a tenth too large, and say more than all others
together: a friction that foretold 44 of 47 points better was refused by two. So the few points that differ most, either
way, don't decide.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dieseltwin.arrays import Array
from dieseltwin.calibration.calibrate import Calibration, counted_rows
from dieseltwin.calibration.coefficients import Coefficient
from dieseltwin.calibration.likelihood import estimate, log_density
from dieseltwin.calibration.outlying import FEW

TRAIN_ITERATIONS = 4


@dataclass(frozen=True)
class Foretold:
    """The held-out points that are judged, by coefficients and errors of the balances of the others.

    Attributes:
        density: (m,) logarithms.
        trained: those coefficients, and all other values.
    """

    density: Array
    trained: Mapping[str, float]

    @property
    def nll(self) -> float:
        """Negative log-likelihood per point."""
        return float(-self.density.mean())

    def better_than(self, other: Foretold) -> bool:
        """Whether the points are foretold better than by another machine, one in twenty (`FEW`) left out either way."""
        apart = np.sort(self.density - other.density)
        few = round(FEW * apart.size)
        return bool(apart[few : apart.size - few].mean() > 0.0)


def foretold(here: Calibration, free: Sequence[Coefficient]) -> Foretold:
    """The held-out third by a machine with these free coefficients.

    Args:
        here: with all that was found.
        free: its coefficients, fitted to the other points.
    """
    points, mask = here.points, here.held_out
    found = estimate(here.model, points.take(~mask), free, here.start, iterations=TRAIN_ITERATIONS,
                     rows=counted_rows(here.model, free))
    trained = {**here.start, **found.values()}
    return Foretold(log_density(here.model, points.take(mask).judged, trained, found.discrepancy), trained)
