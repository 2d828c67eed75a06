"""Ticks of a figure's axes worked out once for each place that the axes are given.

Matplotlib works them out, with their labels and the room that these take, about nine times for a picture: for the
layout, for the titles' and the labels' places, and to draw them. Between these nothing about them changes but the place
and the limits of their axes, and the renderer that measures.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from matplotlib.axis import Axis
from matplotlib.figure import Figure

R = TypeVar("R")

_TICKS, _BOXES = "_update_ticks", "_get_ticklabel_bboxes"  # matplotlib's; one that lacks them works as ever


@contextmanager
def ticks_known(figure: Figure) -> Iterator[None]:
    """While it lasts, no axis of a figure works out again what it knows."""
    axes = [axis for each in figure.axes for axis in (each.xaxis, each.yaxis)]
    axes = [axis for axis in axes if hasattr(axis, _TICKS) and hasattr(axis, _BOXES)]
    for axis in axes:
        vars(axis)[_TICKS] = _once(axis, getattr(axis, _TICKS))
        vars(axis)[_BOXES] = _once(axis, getattr(axis, _BOXES))
    try:
        yield
    finally:
        for axis in axes:
            del vars(axis)[_TICKS], vars(axis)[_BOXES]


def _once(axis: Axis, function: Callable[..., R]) -> Callable[..., R]:
    """A function of an axis that keeps its last answer for as long as the axis stays as it is."""
    known: list[tuple[Any, R]] = []

    def answer(*asked: Any) -> R:
        place = (axis.axes.bbox.bounds, tuple(axis.get_view_interval()), axis.axes.figure.dpi, asked)
        if not known or known[0][0] != place:
            known[:] = [(place, function(*asked))]
        return known[0][1]

    return answer
