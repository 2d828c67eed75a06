"""What all test modules share: one thread, repeatable Hypothesis, long files first, and how many tests were skipped."""

from __future__ import annotations

import os
from collections.abc import Iterator
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
TOGETHER = {
    "tests/flows/": "tests/flows/",  # Prefect's server and the chain
    "tests/engine/test_new_": "tests/engine/test_new_",  # a library of its own, whose kernels are compiled
}
"""Begin of files that share what takes long -> the name of their scope: one process takes all of them."""

# Seconds in a fresh clone, on two busy cores: what is long begins first, what isn't here is done in the end. Of the
# flows these two stand beside each other as their steps are forked by one server, which others end.
LONG = {
    "flows/test_chain.py": 259, "flows/test_evaluate.py": 74, "end_to_end/test_diesel.py": 165,
    "app/test_browser.py": 150, "discovery/search/test_circumstances.py": 96, "engine/test_new_column.py": 79,
    "petrol/test_petrol_commands.py": 61, "petrol/test_petrol_discover.py": 48, "petrol/test_petrol_courses.py": 20,
    "petrol/test_petrol_second.py": 14,
    "end_to_end/test_points.py": 59, "surrogates/test_empirical.py": 59, "paper/test_compiled_loss.py": 47,
    "api/test_api_discover.py": 46, "cli/test_learn_command.py": 46, "challenge/test_baselines.py": 46,
    "api/test_api_together.py": 44, "end_to_end/test_withheld.py": 42, "paper/test_network_loops.py": 36,
    "discovery/search/test_search.py": 35, "test_core.py": 35, "end_to_end/test_rigs.py": 31,
    "discovery/reference/test_learn.py": 30, "discovery/reference/test_conditions.py": 29,
    "api/test_front_door.py": 28, "cli/test_app.py": 27, "app/test_pages.py": 26, "examples/test_scripts.py": 26,
    "challenge/test_points_tier.py": 25, "calibration/test_imply.py": 24,
    "discovery/search/test_local_misfit.py": 23, "paper/test_multistage.py": 21,
    "identification/test_acceptance.py": 19, "paper/comparison/test_page.py": 19, "cli/test_bad_input.py": 19,
    "calibration/test_lasting_errors.py": 17, "discovery/twins/test_diesel_between.py": 17,
    "engine/test_equations.py": 17, "end_to_end/test_petrol.py": 16, "identification/test_fewshot_newton.py": 16,
    "calibration/test_sensor_errors.py": 15, "report/test_discovery_figures.py": 14,
    "recordings/guess/test_propose.py": 14, "calibration/test_reference_engine.py": 14,
    "identification/test_classical.py": 13, "discovery/test_fit_test.py": 13, "cli/test_discover_command.py": 13,
    "surrogates/test_operators.py": 12, "codegen/test_c_engine.py": 12, "surrogates/test_bodies.py": 12,
    "paper/test_datasets.py": 12, "api/test_api_identify.py": 12, "identification/test_term_model.py": 10,
    "paper/test_fewshot_adam.py": 10, "report/test_figures.py": 9, "discovery/laws/test_law_search.py": 9,
    "engine/test_new_effect.py": 9, "rigs/test_rig_page.py": 9, "cli/test_fuzz.py": 9, "challenge/test_plant.py": 8,
    "report/test_interactive.py": 8, "discovery/search/test_renewal.py": 8, "app/test_lanes.py": 8,
}  # fmt: skip

# Repeatable: a red run must be red again. No deadlines: two shared cores.
settings.register_profile(
    "repeatable", derandomize=True, deadline=None, max_examples=50, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("repeatable")


@pytest.fixture(scope="module")
def no_pictures() -> Iterator[None]:
    """Pages without pictures in a file of tests that ask for other things (`pages.without_pictures`)."""
    from tests.pages import without_pictures

    with without_pictures():
        yield


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
    """A process takes whole files, and one process all files that are `TOGETHER`.

    (xdist's own groups, `--dist loadgroup`, are written into an identifier that pytest 9.2 doesn't read any more.)
    """

    def _split_scope(self, nodeid: str) -> str:
        return next((scope for begin, scope in TOGETHER.items() if nodeid.startswith(begin)), nodeid.partition("::")[0])


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> ByFile:
    return ByFile(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The flows and then long files first, so that no process waits for another one's at the end."""
    files = {item: Path(os.path.relpath(item.path, ROOT)).as_posix() for item in items}
    rank = {f"tests/{file}": -seconds for file, seconds in LONG.items()}
    items.sort(key=lambda item: (not files[item].startswith("tests/flows/"), rank.get(files[item], 0.0)))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    skips = len(terminalreporter.stats.get("skipped", []))
    terminalreporter.write_line(f"skipped: {skips}")
