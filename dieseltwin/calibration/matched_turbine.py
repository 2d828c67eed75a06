"""What sizes hang on the turbine's efficiency over its blade speed ratio, where points beside a reference are judged.

Settled points of a well engine can't tell that slope. At steady power the ratio follows from the compressor's state and
both efficiencies, so that the compressor's map takes up whatever slope is believed. A fault moves the ratio at the same
state of the compressor, by 3 % where the turbine gives 6 % less power, and then the slope decides: one of 1 hides half
of the loss, one of 2 all of it. No turbine has that, as its torque falls with speed (dln eta/dln BSR < 1).

So the slope is held beside a reference, unless `t_c_k` tells the two efficiencies apart. The published engine and one
with an optimum of its own keep theirs. Of another engine it is that of a turbine that fits its engine, which works a
little below its best ratio: eta = eta_max (2 x - x^2), x = BSR/BSR_opt (Guzzella & Onder, Introduction to Modeling and
Control of Internal Combustion Engine Systems, 2010), and what another such slope makes of a size is in its deviation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dieseltwin.calibration.calibrate import Calibration, counted_rows
from dieseltwin.calibration.coefficients import Coefficient
from dieseltwin.calibration.likelihood import FULL_ITERATIONS, estimate
from dieseltwin.calibration.matched_values import BEST_AT, SLOPE_OF_RATIO, known_turbine, matched_values
from dieseltwin.recordings.steady_points import JUDGED


def beside_best_ratio(here: Calibration, free: Sequence[Coefficient], names: Sequence[str]) -> dict[str, float]:
    """What was found -> its size where the turbine works at its best ratio, the slope being nought [its unit].

    None where the slope is no belief, or nothing was found.

    Args:
        here: with what was found.
        free: its coefficients.
        names: of what was found.
    """
    held = not {c.name for c in free} & {*SLOPE_OF_RATIO}
    if not names or JUDGED not in here.points or not held or known_turbine(here.base, here.model.engine):
        return {}
    start: Mapping[str, float] = {**here.start, **matched_values(here.points, here.model.engine, BEST_AT)}
    found = estimate(here.model, here.points, free, start, iterations=FULL_ITERATIONS,
                     rows=counted_rows(here.model, free), inflate=True)  # fmt: skip
    values = found.values()
    return {name: values[name] for name in names if np.isfinite(values[name])}
