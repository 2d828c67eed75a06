"""Signals that answer themselves: a law's signal changes the quantities that the law depends on."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from dieseltwin.engine.array_namespace import Array

Signals = dict[str, Array]
"""Name -> array or tensor."""

_LEAST_CHANGE = 1e-30
_LEAST_SIZE = 1e-300
_STEEPEST = 2.0 / 3.0  # slope of a law against its own signal that a secant step may use


def settled(
    answer: Callable[[Signals], Mapping[str, Array]], start: Mapping[str, Array], *, rounds: int,
    tolerance: float = 0.0, secant: bool = False,
) -> Signals:  # fmt: skip
    """Signals at which `answer` gives the signals that it is asked with.

    Args:
        answer: what the laws say where these signals act; names that it leaves out or adds count as 0 before.
        start: first signals.
        rounds: at most so many answers.
        tolerance: largest change of a signal relative to its size that ends the rounds; 0: all rounds are gone through.
        secant: step by the secant of each element: where a law's quantity answers its own signal strongly (a filter at
            high flow, W_c against p_bc) plain rounds swing about the solution.
    """
    now, last = dict(start), None
    for _ in range(rounds):
        new = dict(answer(now))
        if secant and last is not None:
            following = {name: by_secant(last[0].get(name, 0.0), last[1][name], now[name], new[name]) for name in new}
        else:
            following = new
        small = tolerance > 0.0 and unchanged(now, new, tolerance)
        last, now = (now, new), following
        if small:
            break
    return now


def by_secant(s_0: Array, f_0: Array, s_1: Array, f_1: Array) -> Array:
    """Next signal from two pairs of a signal and what its law then says; at most three times a plain step."""
    change = s_1 - s_0
    slope = np.minimum((f_1 - f_0) * change / (change * change + _LEAST_CHANGE), _STEEPEST)
    return s_1 + (f_1 - s_1) / (1.0 - slope)


def unchanged(before: Mapping[str, Array], now: Mapping[str, Array], tolerance: float) -> bool:
    """Whether every signal changed by less than a share of its size now; a name that `before` lacks counts as 0 there,
    and one that isn't a number as changed."""
    return all(_change(before.get(name, 0.0), signal) < tolerance for name, signal in now.items())


def _change(before: Array, now: Array) -> float:
    return float(np.max(np.abs(now - before))) / max(float(np.max(np.abs(now))), _LEAST_SIZE)
