"""Long runs in pieces side by side: few steps of many pieces in place of many steps of one run.

In numpy a step of the integration costs the same for one lane as for a hundred. So a run is cut into pieces whose first
states are guessed, all pieces are run at once, and the guesses are corrected until each piece ends where the next one
begins: multiple shooting by Newton's method (Bock and Plitt, IFAC World Congress 1984). What comes out is the run from
the first state on, to `CLOSED` of a state's scale.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dieseltwin.arrays import Array

STEPS = 12
"""Of a piece."""

CLOSED = 1e-9  # of a state's scale: ends and begins that are so near are the same
_DIFFERENCE = 1e-5  # of a state's scale
_ROUNDS = 8
_SHRUNK = 0.1  # of the gaps before: where a round leaves more, slopes are taken anew
_WORTH = 6.0  # rounds that are reckoned with
_STEP_COST = 2000.0  # numbers that cost as much as a step by itself

Run = Callable[[Array], Array]
"""First states of all lanes' pieces, several times over (B, k W P, S) -> states (STEPS + 1, S, B, k W P)."""


def worth_it(length: int, windows: int, lanes: int, states: int) -> bool:
    """Whether pieces are likely to be faster than runs of so many samples."""
    pieces = -(-(length - 1) // STEPS)
    whole = length * (_STEP_COST + windows * lanes)
    return pieces > 1 and _WORTH * STEPS * (_STEP_COST + (1 + states) * windows * pieces * lanes) < whole


def rows_of(rows: NDArray[np.int_]) -> NDArray[np.int_]:
    """Rows (L, W) of windows as those of their pieces (STEPS + 1, W P); the last one stands still at its end."""
    length, windows = rows.shape
    pieces = -(-(length - 1) // STEPS)
    at = np.minimum(STEPS * np.arange(pieces)[:, None] + np.arange(STEPS + 1), length - 1)  # (P, STEPS + 1)
    return rows[at].transpose(1, 2, 0).reshape(STEPS + 1, windows * pieces)


def begins(trajectory: Array) -> Array:
    """First states of the pieces (W, P, S) along lane 0 of states (L, S, B, W)."""
    return trajectory[: len(trajectory) - 1 : STEPS, :, 0].transpose(2, 0, 1)


def trajectory_of(run: Run, local: Array, guess: Array, scales: Array, length: int) -> Array | None:
    """States (L, S, B, W) of runs; None where Newton's method doesn't close the gaps.

    Args:
        run: the integration of pieces, `rows_of` the windows.
        local: (B, W, S) first states of the runs; guess: (W, P, S) of the pieces.
        scales: (S,) of the states; length: L.
    """
    lanes, windows, count = local.shape
    pieces = guess.shape[1]
    starts = np.repeat(guess[None], lanes, axis=0)
    starts[:, :, 0] = local
    slopes, before = None, np.inf
    for _ in range(_ROUNDS):
        moves = np.zeros((1 if slopes is not None else 1 + count, 1, 1, 1, count))
        moves[np.arange(1, len(moves)), 0, 0, 0, np.arange(len(moves) - 1)] = _DIFFERENCE * scales[: len(moves) - 1]
        first = (starts + moves).transpose(1, 0, 2, 3, 4).reshape(lanes, -1, count)
        out = run(first)
        ends = out[-1].reshape(count, lanes, len(moves), windows, pieces).transpose(2, 1, 3, 4, 0)
        gaps = ends[0][:, :, :-1] - starts[:, :, 1:]
        gap = float(np.max(np.abs(gaps) / scales)) if np.isfinite(ends).all() else np.inf
        if gap < CLOSED:
            whole = out[:-1, :, :, : windows * pieces].reshape(STEPS, count, lanes, windows, pieces)
            whole = whole.transpose(4, 0, 1, 2, 3).reshape(pieces * STEPS, count, lanes, windows)[:length]
            last = ends[0][:, :, -1].transpose(2, 0, 1)
            return np.concatenate([whole, last[None]])[:length]
        if not np.isfinite(gap):
            return None
        if len(moves) > 1:
            slopes = ((ends[1:] - ends[0]) / (_DIFFERENCE * scales[:, None, None, None, None])).transpose(1, 2, 3, 4, 0)
        moved = starts.copy()
        for p in range(pieces - 1):
            change = slopes[:, :, p] @ (moved[:, :, p] - starts[:, :, p])[..., None]  # type: ignore[index]
            moved[:, :, p + 1] = ends[0][:, :, p] + change[..., 0]
        if gap > _SHRUNK * before:
            slopes = None
        starts, before = moved, gap
    return None
