"""Figures and page of one identification as files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.result import Identification
from dieseltwin.report.encoding import drawn_in_two
from dieseltwin.report.html import identification_page, identification_sections
from dieseltwin.report.inputs import results_of
from dieseltwin.report.page import write_page


def identification_figures(
    identification: Identification, problems: Sequence[SegmentProblem], out_dir: str | Path, page: str | Path,
    recording: str = "",
) -> Path:  # fmt: skip
    """Draw every figure that one identification has data for, as SVG (charts) and PNG (time series), and its page.

    Works without truth. The paper's printed run times stay out: they belong to the comparison of methods.

    Args:
        identification: result of any method.
        problems: the segments that it solved.
        out_dir: folder for the figures, made where missing.
        page: HTML that holds them all.
        recording: its name, for the page.

    Returns:
        The path of the page.
    """
    results = results_of(identification, problems, about={"recording": recording} if recording else None)
    return write_page(identification_page(results, identification_sections(results, drawn_in_two)), page, out_dir)
