"""The page that compares methods on one recording: what each shows by itself, and the paper's numbers beside it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from dieseltwin.atomic import write_text
from dieseltwin.paper.comparison.beside_paper import paper_rows, run_times
from dieseltwin.paper.comparison.driving import SET_TITLES
from dieseltwin.paper.comparison.pretraining import pretraining
from dieseltwin.report import html, style
from dieseltwin.report.html import Section, kept, page
from dieseltwin.report.results import Results, load_results
from dieseltwin.report.style import ReportFigure

SIZE_LIMIT_BYTES = 8 * 1024 * 1024
_SMALLER_DPI = (110, 85, 60)  # the page is drawn again more coarsely rather than grow beyond the limit


def sections(results: Results) -> list[Section]:
    """All sections of the page, in their order."""
    known = {section.id: section for section in html.sections(results)}
    timed = any(math.isfinite(m.seconds_per_run) for m in results.methods)
    pictures = tuple(_picture(path) for path in results.pictures)
    learning = known["training"]
    return [
        known["summary"],
        Section("driving", "Driving", "The driving that the data sets are made of.", (), pictures),
        known["parameters"],
        replace(known["accuracy"], beside_paper=paper_rows(results)),
        known["states"],
        known["residuals"],
        Section("times", "Run times", "", kept(run_times(results)) if timed else ()),
        replace(learning, figures=(*learning.figures, *kept(pretraining(results)))),
    ]


def _picture(path: Path) -> dict[str, str]:
    kind = path.suffix.removeprefix(".")
    plain = path.stem.replace("_", " ").replace("-", " ")
    # the picture carries its whole title itself
    title = SET_TITLES.get(path.stem, plain[:1].upper() + plain[1:]).partition(":")[0]
    return {"name": path.stem, "title": title, "caption": "", "uri": style.data_uri(path.read_bytes(), kind)}


def _fitting_page(results: Results, chosen: Sequence[Section]) -> str:
    text = ""
    for dpi in _SMALLER_DPI:
        text = page(results, chosen, partial(ReportFigure.encode, dpi=dpi))
        if len(text.encode("utf-8")) < SIZE_LIMIT_BYTES:
            break
    return text


def render(results: Results) -> str:
    """The whole page as text; time series are drawn more coarsely where the page would exceed its size limit."""
    return _fitting_page(results, sections(results))


def build_report(
    results_dir: str | Path, out_html: str | Path, *, figures_dir: str | Path | None = None
) -> Path:
    """Build the report from stored results and write it atomically.

    ``results_dir`` holds one folder per method as ``dieseltwin identify --out`` writes it, and optionally report.json,
    truth.json, truth.parquet, measured.parquet with measured.json, pretraining.json and driving/. Returns the path.
    ``figures_dir``: where to save the page's figures as files too (drawn once for both).

    Errors: InputError where there are no results or a file is broken.
    """
    out = Path(out_html)
    results = load_results(Path(results_dir))
    chosen = sections(results)
    text = _fitting_page(results, chosen)
    out.parent.mkdir(parents=True, exist_ok=True)
    if figures_dir is not None:
        for figure in (figure for section in chosen for figure in section.figures):
            figure.save(Path(figures_dir))
    return write_text(out, text)
