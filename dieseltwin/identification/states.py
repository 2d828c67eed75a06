"""Table of identified states: pooled estimate, everything that follows from it, and bands over runs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from dieseltwin.engine import HEALTH, actuate, quantities_frame
from dieseltwin.identification.result import INTERVAL

if TYPE_CHECKING:
    from dieseltwin.identification.problem import SegmentProblem
    from dieseltwin.identification.result import Identification, SegmentEstimate

LOW, HIGH = "_lo", "_hi"
"""Suffixes of the columns that hold the 90 % band."""

_INPUTS = ("time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct")
_ACTUATORS = ("u_egr1_pct", "u_egr2_pct", "u_vgt_act_pct")


def states_table(identification: Identification) -> pd.DataFrame:
    """States and derived quantities of every segment.

    Args:
        identification: result of any method.

    Returns:
        One row for each sample: `segment` (0, 1, ..), the columns of the reference traces in SI units
        (inputs, states, flows, temperatures, efficiencies), and `<column>_lo`, `<column>_hi` where the
        method kept
        samples: the 90 % band over runs and their uncertainty.
    """
    parts = []
    for i, (segment, problem) in enumerate(zip(identification.segments, identification.problems, strict=True)):
        table = segment_table(segment, problem)
        table.insert(0, "segment", i)
        parts.append(table)
    return pd.concat(parts, ignore_index=True)


def segment_table(segment: SegmentEstimate, problem: SegmentProblem) -> pd.DataFrame:
    """The table of one segment; see `states_table`.

    Args:
        segment: estimates of the segment.
        problem: the problem they solve.

    Returns:
        (n, columns) table.
    """
    actuation = actuate(problem.inputs, problem.parameters)
    summary = segment.summary()
    best = {name: summary[name].mean for name in HEALTH}
    table = quantities_frame(segment.states, actuation, problem.parameters.replace(**best))
    table["time_s"] = problem.time_s
    if segment.state_samples is None or segment.parameter_samples is None:
        return table
    columns = [c for c in table.columns if c not in _INPUTS + _ACTUATORS]
    samples = np.stack(
        [
            quantities_frame(
                states,
                actuation,
                problem.parameters.replace(**dict(zip(HEALTH, map(float, values), strict=True))),
            )[columns].to_numpy()
            for states, values in zip(segment.state_samples, segment.parameter_samples, strict=True)
        ]
    )
    low, high = np.quantile(samples, [0.5 - INTERVAL / 2.0, 0.5 + INTERVAL / 2.0], axis=0)
    bands = {f"{c}{LOW}": low[:, j] for j, c in enumerate(columns)}
    bands.update({f"{c}{HIGH}": high[:, j] for j, c in enumerate(columns)})
    return pd.concat([table, pd.DataFrame(bands)], axis=1)
