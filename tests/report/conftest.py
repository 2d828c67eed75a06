"""Stored results that were made up once a session, and the figures drawn from them."""

from __future__ import annotations

from pathlib import Path

import pytest
import synthetic_results as synthetic

from dieseltwin.paper.comparison.page import sections
from dieseltwin.report.results import Results, load_results
from dieseltwin.report.style import ReportFigure


@pytest.fixture(scope="session")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as the pipeline leaves it: three methods, two segments, truth, measurements, pretraining errors."""
    return synthetic.write_results(tmp_path_factory.mktemp("stored") / "results", segments=3)


@pytest.fixture(scope="session")
def results(stored: Path) -> Results:
    return load_results(stored)


@pytest.fixture(scope="session")
def figures(results: Results) -> dict[str, ReportFigure]:
    """Every figure of the full report by its name; drawing them is most of the time of these tests."""
    return {figure.name: figure for section in sections(results) for figure in section.figures}
