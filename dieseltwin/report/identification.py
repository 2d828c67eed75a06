"""Figures of one identification as files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.result import Identification
from dieseltwin.report.html import result_figures
from dieseltwin.report.inputs import results_of


def identification_figures(
    identification: Identification, problems: Sequence[SegmentProblem], out_dir: str | Path
) -> list[Path]:
    """Draw every figure that one identification has data for and write them as SVG (charts) and PNG (time series).

    Works without truth. The paper's printed run times stay out: they belong to the comparison of methods.

    Args:
        identification: result of any method.
        problems: the segments that it solved.
        out_dir: folder for the figures, made where missing.

    Returns:
        The paths written.
    """
    figures = result_figures(results_of(identification, problems))
    return [figure.save(Path(out_dir)) for figure in figures if figure.name != "run_times"]
