"""Table of identified states: pooled estimate, everything that follows from it, and bands over runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dieseltwin.engine import HEALTH, quantities_frame
from dieseltwin.engine.extended_frame import lanes_along
from dieseltwin.identification.in_place import InPlace
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.least_squares import INTERVAL
from dieseltwin.symbols import INPUT_COLUMNS

FORMULAE = InPlace()
LOW, HIGH = "_lo", "_hi"
"""Suffixes of the columns that hold the 90 % band."""

_INPUTS = ("time_s", *INPUT_COLUMNS)
_ACTUATORS = ("u_egr1_pct", "u_egr2_pct", "u_vgt_act_pct")


@dataclass(frozen=True)
class StateSamples:
    """Runs, or draws from their uncertainty, behind the band of a segment.

    Attributes:
        states: (K, n, 5) p_im, p_em, omega_t, x_r, T_1 [Pa, Pa, rad/s, -, K].
        parameters: (K, 4) health parameters that belong to them, in the order of `HEALTH`.
    """

    states: NDArray[np.float64]
    parameters: NDArray[np.float64]


def segment_states(
    problem: SegmentProblem,
    states: NDArray[np.float64],
    health: Mapping[str, float],
    samples: StateSamples | None = None,
    learned: InPlace = FORMULAE,
) -> pd.DataFrame:
    """States and derived quantities of one segment, with bands.

    Args:
        problem: the segment.
        states: (n, 5) p_im, p_em, omega_t, x_r, T_1 of the pooled estimate [Pa, Pa, rad/s, -, K].
        health: health parameters of the pooled estimate [m2, m2, -, W/(m2 K)].
        samples: what the bands are read from; None leaves them out.
        learned: what the estimate was made with; everything that follows from the states is that of its nominal maps,
            and a sample of the bands has a member of them, or dropout realisation, of its own.

    Returns:
        One row for each sample: the columns of the reference traces in SI units (inputs, states, flows, temperatures,
        efficiencies), and `<column>_lo`, `<column>_hi` with samples: the 90 % band over runs and their uncertainty.
    """
    actuation = learned.actuation(problem)
    table = quantities_frame(states, actuation, problem.parameters.replace(**health), learned.model())
    table["time_s"] = problem.time_s
    if samples is None:
        return table
    columns = [c for c in table.columns if c not in _INPUTS + _ACTUATORS]
    health_of_draw = dict(zip(HEALTH, samples.parameters.T, strict=True))
    members = learned.model(range(1, len(samples.states) + 1))
    drawn = lanes_along(samples.states, actuation, problem.parameters, members, **health_of_draw)
    edges = [0.5 - INTERVAL / 2.0, 0.5 + INTERVAL / 2.0]
    limits = {name: np.quantile(drawn[name], edges, axis=0) for name in columns}
    bands = {f"{name}{LOW}": low for name, (low, _) in limits.items()}
    bands.update({f"{name}{HIGH}": high for name, (_, high) in limits.items()})
    return pd.concat([table, pd.DataFrame(bands)], axis=1)
