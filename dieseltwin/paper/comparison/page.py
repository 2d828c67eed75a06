"""The page that compares methods on one recording: what each shows by itself, and the paper's numbers beside it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from dieseltwin.paper.comparison.beside_paper import paper_rows, run_times
from dieseltwin.paper.comparison.driving import SET_TITLES
from dieseltwin.paper.comparison.pretraining import pretraining
from dieseltwin.report import style
from dieseltwin.report.html import identification_page, identification_sections
from dieseltwin.report.page import Section, kept, write_page
from dieseltwin.report.results import Results, load_results

SIZE_LIMIT_BYTES = 8 * 1024 * 1024


def sections(results: Results) -> list[Section]:
    """All sections of the page, in their order."""
    known = {section.id: section for section in identification_sections(results)}
    timed = any(math.isfinite(m.seconds_per_run) for m in results.methods)
    pictures = tuple(_picture(path) for path in results.pictures)
    learning = known["training"]
    return [
        known["readings-over-time"],
        known["doubts"],
        Section("driving", "Driving", words="The driving that the data sets are made of.", pictures=pictures),
        known["parameters"],
        replace(known["accuracy"], tables=paper_rows(results)),
        known["states"],
        known["residuals"],
        Section("times", "Run times", kept(run_times(results)) if timed else ()),
        replace(learning, figures=(*learning.figures, *kept(pretraining(results)))),
    ]


def _picture(path: Path) -> dict[str, str]:
    kind = path.suffix.removeprefix(".")
    plain = path.stem.replace("_", " ").replace("-", " ")
    # the picture carries its whole title itself
    title = SET_TITLES.get(path.stem, plain[:1].upper() + plain[1:]).partition(":")[0]
    return {"name": path.stem, "title": title, "caption": "", "uri": style.data_uri(path.read_bytes(), kind)}


def build_report(
    results_dir: str | Path, out_html: str | Path, *, figures_dir: str | Path | None = None
) -> Path:
    """Build the report from stored results and write it atomically.

    ``results_dir`` holds one folder per method as ``dieseltwin identify --out`` writes it, and optionally report.json,
    truth.json, truth.parquet, measured.parquet with measured.json, pretraining.json and driving/. Returns the path.
    ``figures_dir``: where to save the page's figures as files too (drawn once for both).

    Errors: InputError where there are no results or a file is broken.
    """
    results = load_results(Path(results_dir))
    page = replace(identification_page(results, sections(results)), most_bytes=SIZE_LIMIT_BYTES)
    return write_page(page, out_html, figures_dir)
