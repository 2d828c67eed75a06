"""What the charts over segments share: the axis, the slots of the methods, the legend's entries."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from dieseltwin.report import style
from dieseltwin.report.results import MethodResult, Results, SegmentResult

WIDTH_IN = 11.0
LINE_HALF = 0.4  # half width of one segment's slot on the axis
MOST_NAMES = 24  # more segment names than this don't fit beside each other


def segment_axis(axes: Axes, results: Results) -> None:
    """Name the segments [min] below ``axes`` and separate them by dotted lines."""
    name_segments(axes, results.segments)
    axes.set_xlim(-0.5, len(results.segments) - 0.5)
    axes.grid(False, axis="x")
    for edge in range(1, len(results.segments)):
        axes.axvline(edge - 0.5, color=style.SEGMENT_LINE, linewidth=0.6, linestyle=":")


def name_segments(axes: Axes, segments: Sequence[SegmentResult]) -> None:
    """Name the segments [min] below ``axes``, as many of them as fit beside each other."""
    names = [segment.minutes for segment in segments]
    step = max(1, math.ceil(len(names) / MOST_NAMES))
    axes.set_xticks(range(0, len(names), step), names[::step])


def method_handles(methods: Sequence[MethodResult]) -> list[Line2D]:
    """Legend entries, one per method."""
    handles = []
    for method in methods:
        look = style.method_style(method.method)
        handles.append(Line2D([], [], color=look.colour, marker=look.marker, linestyle="none", label=look.label))
    return handles


def offsets_of(count: int) -> NDArray[np.float64]:
    """Centres of ``count`` slots inside one segment."""
    width = 2 * LINE_HALF / count
    return np.asarray(-LINE_HALF + width * (np.arange(count) + 0.5), dtype=np.float64)
