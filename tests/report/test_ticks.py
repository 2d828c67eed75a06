"""Ticks that are worked out once give the pictures that matplotlib gives by itself."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pytest
from matplotlib.axis import Axis
from matplotlib.figure import Figure

from dieseltwin.report import ticks
from dieseltwin.report.style import ReportFigure


def _figure(kind: str) -> ReportFigure:
    figure = Figure(figsize=(5.0, 6.0))
    above, middle, below = figure.subplots(3, 1, sharex=True)
    above.plot([0.0, 1.0, 2.0], [1e5, 3e5, 2e5])
    above.set_title("$p_{im}$")
    above.set_title("right", loc="right")
    middle.semilogy([0.0, 1.0, 2.0], [1.0, 100.0, 3e4])
    image = below.imshow(np.eye(3), extent=(0.0, 2.0, 0.0, 1.0))
    below.set_xlabel("time [s]")
    figure.colorbar(image, ax=below, label="share [-]")
    figure.align_ylabels()
    return ReportFigure("figure", "figure", "", figure, kind)


@pytest.mark.parametrize("kind", ["svg", "png"])
def test_the_file_is_the_same(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    worked_out: list[Axis] = []
    plain = Axis._update_ticks  # type: ignore[attr-defined]

    def counted(axis: Axis) -> object:
        worked_out.append(axis)
        return plain(axis)

    monkeypatch.setattr(Axis, "_update_ticks", counted)
    once, few = _figure(kind).encode(), len(worked_out)
    monkeypatch.setattr("dieseltwin.report.style.ticks_known", lambda figure: nullcontext())
    assert _figure(kind).encode() == once
    assert 2 * few < len(worked_out) - few


def test_another_matplotlib_works_them_out_as_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    once = _figure("svg").encode()
    monkeypatch.setattr(ticks, "_BOXES", "_nothing_of_this_name")
    assert _figure("svg").encode() == once


def test_a_figure_is_left_as_it_was() -> None:
    made = _figure("svg")
    made.encode()
    assert not any("_update_ticks" in vars(axis) for axes in made.figure.axes for axis in (axes.xaxis, axes.yaxis))
