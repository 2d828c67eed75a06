"""What all test modules share: one thread, repeatable Hypothesis, long files first, and how many tests were skipped."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

for _name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy and torch are imported

import pytest
from hypothesis import HealthCheck, settings
from xdist.scheduler import LoadScopeScheduling

if TYPE_CHECKING:
    from dieseltwin.report.results import Results
    from dieseltwin.report.style import ReportFigure

ROOT = Path(__file__).resolve().parents[1]
TOGETHER = "tests/flows/"

# Seconds on two idle cores, kernels compiled anew (`pytest --durations=0`): what is long begins first, what isn't here
# is done in the end.
LONG = {
    "end_to_end/test_diesel.py": 150, "engine/test_new_column.py": 81, "app/test_browser.py": 69,
    "end_to_end/test_points.py": 60, "surrogates/test_empirical.py": 53, "end_to_end/test_rigs.py": 52,
    "api/test_api_discover.py": 43, "test_core.py": 41, "cli/test_learn_command.py": 25,
    "challenge/test_baselines.py": 24, "engine/test_equations.py": 23, "challenge/test_points_tier.py": 23,
    "petrol/test_petrol_commands.py": 19, "api/test_api_together.py": 18, "discovery/search/test_circumstances.py": 18,
    "cli/test_app.py": 17, "petrol/test_petrol_discover.py": 16, "examples/test_scripts.py": 13,
    "cli/test_bad_input.py": 13, "discovery/twins/test_diesel_between.py": 13, "app/test_pages.py": 13,
    "paper/test_network_loops.py": 13, "calibration/test_imply.py": 11, "rigs/test_rig_page.py": 11,
    "report/test_discovery_figures.py": 11,
}  # fmt: skip

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


class ByFile(LoadScopeScheduling):  # type: ignore[misc]
    """A process takes whole files, and one process all files of the flows, which share Prefect's server and the chain.

    (xdist's own groups, `--dist loadgroup`, are written into an identifier that pytest 9.2 doesn't read any more.)
    """

    def _split_scope(self, nodeid: str) -> str:
        return TOGETHER if nodeid.startswith(TOGETHER) else nodeid.partition("::")[0]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> ByFile:
    return ByFile(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long files first, so that no process waits for another one's at the end."""
    files = {item: Path(os.path.relpath(item.path, ROOT)).as_posix() for item in items}
    rank = {f"tests/{file}": -seconds for file, seconds in LONG.items()}
    items.sort(key=lambda item: (not files[item].startswith(TOGETHER), rank.get(files[item], 0.0)))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    skips = len(terminalreporter.stats.get("skipped", []))
    terminalreporter.write_line(f"skipped: {skips}")
