"""Faults of a sensor's channel that its own readings show, without any model: frozen, replayed, clipped, spiked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from dieseltwin.arrays import Array
from dieseltwin.notes import Note
from dieseltwin.recordings.held import number_step
from dieseltwin.recordings.noise import estimate_noise
from dieseltwin.recordings.reader import Recording
from dieseltwin.recordings.unread import STUCK_S, same_readings

Rows = NDArray[np.int_]

_BLOCK = 8  # readings that are compared at once; shorter repetitions aren't looked for
_SHORTEST_REPLAY_S = 10.0  # coarse channels repeat a second of coasting or idle now and then; and it does no harm
_SURE_BITS = 20.0  # odds of 1 in a million that chance repeats a block anywhere in the recording
_FEWEST_CLIPPED = 10  # readings at the very end of a range
_CLIPPED_SHARE = 0.005  # of all readings
_CLIPPED_OVER_NEXT = 4.0  # times the readings at any of the next numbers: a range that ends by itself thins out
_NEXT_NUMBERS = 3
_SPIKE_SIGMA = 10.0  # noise of the channel; a Gaussian's largest of a million is 4.9
_SPIKE_OVER_MOVES = 6.0  # times the median move from row to row in the seconds about it
_SPIKE_NEIGHBOURS = 10  # rows on either side
_SPIKE_OVER_RANGE = 1.0  # of the range of 98 % of the readings: a throttle that is thrown open makes half of it


def channel_notes(recording: Recording, names: Sequence[str]) -> list[Note]:
    """A note for each fault that a channel shows by itself while the engine runs.

    Args:
        recording: any recording.
        names: sensor columns; those that it hasn't are passed over.
    """
    running = np.zeros(recording.time_s.size, dtype=bool)
    for piece in recording.pieces():
        running[piece] = True
    found = {name: np.where(running, recording.columns[name], np.nan) for name in names if name in recording.columns}
    return series_notes(recording.time_s, found, recording.columns["n_e_rpm"])


def series_notes(time_s: Array, columns: Mapping[str, Array], speed: Array) -> list[Note]:
    """`channel_notes` of any columns.

    Args:
        time_s: (n,) [s].
        columns: of sensors, (n,) each, NaN where missing.
        speed: (n,) of the engine: a channel may stand still while it does.
    """
    notes = []
    for name, values in columns.items():
        rows = np.flatnonzero(np.isfinite(values))
        if rows.size < 4 * _BLOCK:
            continue
        still = (0.0, 0.0) if name == "w_egr_kg_s" else longest_standstill(time_s, values, speed)
        since, length = still  # no flow through a shut valve stands still rightly
        if length >= STUCK_S:
            notes.append(Note(f"{name} stands still for {length:.0f} s from {since:.0f} s on; a stuck sensor looks "
                              "like missing physics", "frozen_channel", (name,)))  # fmt: skip
        found = replayed(values[rows])
        time = time_s[rows]
        if found is not None and time[found[0] + found[2] - 1] - time[found[0]] >= _SHORTEST_REPLAY_S:
            first, again, count = found
            notes.append(Note(f"{name} repeats its readings of {time[first]:.5g} to {time[first + count - 1]:.5g} s "
                              f"from {time[again]:.5g} s on, digit by digit: a replayed block is no measurement",
                              "replayed_channel", (name,)))  # fmt: skip
        for side, count in (("highest", clipped(values[rows])), ("lowest", clipped(-values[rows]))):
            if count:
                notes.append(Note(f"{name} is at its {side} reading {count} times: clipped by its sensor or its "
                                  "message, the truth lies beyond", "clipped_channel", (name,)))  # fmt: skip
        count = spikes(values[rows]).size
        if count:
            notes.append(Note(f"{count} readings of {name} stick out for one row by more than its whole range; spikes "
                              "pull a fit", "spikes", (name,)))  # fmt: skip
    return notes


def longest_standstill(time: Array, values: Array, speed: Array) -> tuple[float, float]:
    """Start and length [s] of the longest stretch of one and the same reading while the engine's speed moves.

    Args:
        time: (n,) [s]; values: (n,) with two readings or more; speed: (n,) of the engine.
    """
    firsts, lasts = same_readings(values)
    lengths = time[lasts] - time[firsts]
    longest = int(np.argmax(lengths))
    first, last = firsts[longest], lasts[longest]
    if np.nanstd(speed[first : last + 1]) == 0.0:
        return 0.0, 0.0
    return float(time[first]), float(lengths[longest])


def replayed(values: Array) -> tuple[int, int, int] | None:
    """First row, first row of the repetition and length of the longest block that comes twice, None without one.

    How unlikely a repetition is follows from how often each step from reading to reading occurs: steps of a noisy
    channel with many digits are all different, those of a coarse one at idle are mostly zero.

    Args:
        values: (n,) readings, none missing.
    """
    steps = np.diff(values)
    _, kind, counts = np.unique(steps, return_inverse=True, return_counts=True)
    bits = np.where(steps == 0.0, 0.0, -np.log2(counts[kind] / steps.size))
    pairs = _equal_blocks(kind)
    if not len(pairs):
        return None
    told = np.concatenate([[0.0], np.cumsum(bits)])
    lag = pairs[:, 1] - pairs[:, 0]
    order = np.lexsort((pairs[:, 0], lag))
    first, lag = pairs[order, 0], lag[order]
    breaks = np.flatnonzero((np.diff(first) != 1) | (np.diff(lag) != 0))
    begins, ends = np.r_[0, breaks + 1], np.r_[breaks, first.size - 1]
    information = told[first[ends] + _BLOCK] - told[first[begins]]
    best = int(np.argmax(information))
    if information[best] < 2.0 * np.log2(steps.size) + _SURE_BITS:
        return None
    at = int(first[begins[best]])
    return at, at + int(lag[begins[best]]), int(first[ends[best]] - at) + _BLOCK + 1


def _equal_blocks(kind: Rows) -> Rows:
    """Pairs (k, 2) of rows, ascending, at which the same `_BLOCK` steps begin; each row with the next of its like."""
    if kind.size < 2 * _BLOCK:
        return np.zeros((0, 2), dtype=np.int_)
    factors = np.random.default_rng(0).integers(1, 2**63, _BLOCK, dtype=np.uint64) | np.uint64(1)
    blocks = np.lib.stride_tricks.sliding_window_view(kind.astype(np.uint64), _BLOCK)
    mixed = np.zeros(len(blocks), dtype=np.uint64)
    for column, factor in zip(blocks.T, factors, strict=True):  # wraps round, as a hash may
        mixed = (mixed ^ (column + np.uint64(1)) * factor) * np.uint64(0x9E3779B97F4A7C15)
    order = np.argsort(mixed, kind="stable")
    same = mixed[order[1:]] == mixed[order[:-1]]
    pairs = np.stack([order[:-1][same], order[1:][same]], axis=1)
    return pairs[pairs[:, 1] - pairs[:, 0] >= _BLOCK]


def clipped(values: Array) -> int:
    """How many readings are at the very highest number, where that is too many to be the end of a range; else 0.

    Zero is no clipping: a flow through a shut valve is nothing.

    Args:
        values: (n,) readings, none missing.
    """
    numbers, counts = np.unique(values, return_counts=True)
    if numbers.size <= 2 * _NEXT_NUMBERS or numbers[-1] == 0.0:
        return 0
    step = number_step(values)
    near = numbers[:-1] >= numbers[-1] - _NEXT_NUMBERS * max(step, 0.0) * 1.5
    beside = max(int(counts[:-1][near].max(initial=0)), int(counts[-1 - _NEXT_NUMBERS : -1].max()))
    enough = max(_FEWEST_CLIPPED, _CLIPPED_SHARE * values.size, _CLIPPED_OVER_NEXT * beside)
    return int(counts[-1]) if counts[-1] >= enough else 0


def spikes(values: Array) -> Rows:
    """Rows whose reading stands out from both of its neighbours the same way, far beyond noise, moves and range.

    Args:
        values: (n,) readings, none missing.
    """
    if values.size < 2 * _SPIKE_NEIGHBOURS:
        return np.zeros(0, dtype=np.int_)
    sigma = float(estimate_noise(values[:, None]).sigma[0])
    moves = np.abs(np.diff(values))
    padded = np.pad(moves, _SPIKE_NEIGHBOURS, mode="edge")
    about = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * _SPIKE_NEIGHBOURS), axis=1)[: values.size]
    up, down = values[1:-1] - values[:-2], values[1:-1] - values[2:]
    out = np.where(up * down > 0.0, np.minimum(np.abs(up), np.abs(down)), 0.0)
    low, high = np.quantile(values, [0.01, 0.99])
    least = max(_SPIKE_SIGMA * (sigma if np.isfinite(sigma) else 0.0), _SPIKE_OVER_RANGE * float(high - low))
    enough = np.maximum(least, _SPIKE_OVER_MOVES * about[1:-1])
    return np.flatnonzero((out > enough) & (out > 0.0)) + 1
