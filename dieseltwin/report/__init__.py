"""Figures, tables and the self-contained HTML report, built from stored results.

`build_report` makes the page from a folder, `identification_figures` the figures of one identification,
`write_report_inputs` and `curves_table` the files that the page is rebuilt from, `summary_text` the table for a
terminal.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dieseltwin.identification.curves import curves_table
from dieseltwin.report.html import build_report, identification_page, render, result_figures
from dieseltwin.report.inputs import results_of, write_report_inputs
from dieseltwin.report.results import MethodResult, Results, load_method, load_results
from dieseltwin.report.tables import headline, segment_table, summary_table, summary_text

if TYPE_CHECKING:
    from dieseltwin.identification.problem import SegmentProblem
    from dieseltwin.identification.result import Identification

__all__ = [
    "MethodResult",
    "Results",
    "build_report",
    "curves_table",
    "headline",
    "identification_figures",
    "load_method",
    "load_results",
    "render",
    "result_figures",
    "results_of",
    "segment_table",
    "summary_table",
    "summary_text",
    "write_report_inputs",
]


def identification_figures(
    identification: Identification, problems: Sequence[SegmentProblem], out_dir: str | Path, page: str | Path,
    recording: str = "",
) -> list[Path]:  # fmt: skip
    """Draw every figure that one identification has data for, as SVG (charts) and PNG (time series), and its page.

    Works without truth. The paper's printed run times stay out: they belong to the comparison of methods.

    Args:
        identification: result of any method.
        problems: the segments that it solved.
        out_dir: folder for the figures, made where missing.
        page: HTML that holds them all.
        recording: its name, for the page.

    Returns:
        The figures' paths.
    """
    about = {"recording": recording} if recording else None
    return identification_page(results_of(identification, problems, about=about), page, out_dir)
