"""What every test module shares: one thread, repeatable Hypothesis, the number of skips in the closing lines."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

for _name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy and torch are imported

import pytest
from hypothesis import HealthCheck, settings

if TYPE_CHECKING:
    from dieseltwin.report.results import Results
    from dieseltwin.report.style import ReportFigure

ROOT = Path(__file__).resolve().parents[1]

# Repeatable: a red run must be red again. No deadlines: two shared cores.
settings.register_profile(
    "repeatable", derandomize=True, deadline=None, max_examples=50, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("repeatable")


@pytest.fixture(scope="session")
def project_root() -> Path:
    """The checkout that holds pyproject.toml and params.yaml."""
    return ROOT


@pytest.fixture(scope="session")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as the pipeline leaves it: three methods, two segments, truth, measurements, pretraining errors."""
    import stored_results

    return stored_results.write_results(tmp_path_factory.mktemp("stored") / "results", segments=3)


@pytest.fixture(scope="session")
def results(stored: Path) -> Results:
    """What that folder holds."""
    from dieseltwin.report.results import load_results

    return load_results(stored)


@pytest.fixture(scope="session")
def figures(results: Results) -> dict[str, ReportFigure]:
    """Every figure of the page beside the paper by its name; drawing them is most of the time of these tests."""
    from dieseltwin.paper.comparison.page import sections

    return {figure.name: figure for section in sections(results) for figure in section.figures}


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    skips = len(terminalreporter.stats.get("skipped", []))
    terminalreporter.write_line(f"skipped: {skips}")
