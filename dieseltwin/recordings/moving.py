"""Rows without a column of time: settled points, or a recording whose clock is missing."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
import pandas as pd

from dieseltwin.errors import InputError
from dieseltwin.recordings.channels import TIME
from dieseltwin.recordings.ranks import ranks

MOVING = ("n_e_rpm", "u_delta_mg", "p_im_pa")
FEWEST_MOVING = 30  # rows, to say that they are those of a recording
NEAR_BESIDE_COUNTER, NEAR, VERY_NEAR = 0.15, 0.03, 0.01
"""`roughness` of the roughest of `MOVING`: at 10 Hz below 0.01, at 5 and 1 Hz 0.03 to 0.14; of 145 points of a truck
engine 0.4 and more as they are or sorted by any column, and from 0.033 on in lines over a map, to and fro."""
MOST_TURNS, LONGEST_CURVE = 2, 60  # turns of speed, and rows: a full-load curve up and down is smooth as well
_COUNTER = re.compile(r"sample|tick|scan|count|frame|z(ae|ä)hler", re.IGNORECASE)


def refuse_moving(columns: Mapping[str, np.ndarray], where: str) -> list[str]:
    """Refuse rows that are those of a recording whose time is missing; a note where that isn't sure.

    A moving engine's rows are near to the row before in speed and in fuel and in boost. Points sorted by one of them,
    or in lines over a map, jump in another; a line that goes through a map to and fro has larger steps.

    Args:
        columns: our column names -> (n,).
        where: name of the file, for messages.

    Raises:
        InputError: rows of a moving engine, without a clock.
    """
    moving = [np.asarray(pd.to_numeric(pd.Series(columns[name]), errors="coerce"), dtype=np.float64)
              for name in MOVING if name in columns]  # fmt: skip
    if len(moving) < len(MOVING) or moving[0].size < FEWEST_MOVING:
        return []
    roughest = max(map(roughness, moving))
    turns = np.count_nonzero(np.diff(np.sign(np.diff(moving[0]))))
    curve = turns <= MOST_TURNS and moving[0].size < LONGEST_CURVE
    counter = next((name for name, values in columns.items() if _counts(name, values)), None)
    if curve or roughest > (NEAR if counter is None else NEAR_BESIDE_COUNTER):
        return []
    clock = f"map column {counter} to {TIME} with its step as scale" if counter else f"add {TIME}"
    if roughest < VERY_NEAR:
        raise InputError(where, "no column of time, and rows that follow each other as those of a moving engine do",
                         "settled points, or a recording with its time",
                         f"{clock} (in a channel map), or average stretches that stand still")  # fmt: skip
    return ["taken as settled points for want of a column of time, though speed, fuel and boost go on from row to row "
            f"as in a recording: if it is one, {clock}, else transients look like faults"]  # fmt: skip


def roughness(values: np.ndarray) -> float:
    """Half the squared step from row to row over the variance, both of ranks (n,): 1 by chance, 0 where rows go on."""
    there = values[np.isfinite(values)]
    if there.size < 3 or np.ptp(there) == 0.0:
        return 1.0
    order = ranks(there)
    return float(np.mean(np.diff(order) ** 2) / (2.0 * np.var(order)))


def _counts(name: str, values: np.ndarray) -> bool:
    """Whether a column is a logger's count of rows; points have numbers as well, but aren't called samples."""
    if not _COUNTER.search(name) or not np.issubdtype(np.asarray(values).dtype, np.number):
        return False
    steps = np.diff(np.asarray(values, dtype=np.float64))
    return bool(steps.size and steps[0] > 0.0 and (steps == steps[0]).all())
