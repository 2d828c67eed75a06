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
    "flows/test_chain.py": 118, "petrol/test_petrol_discover.py": 60,
    "surrogates/test_empirical.py": 53, "end_to_end/test_points.py": 40,
    "discovery/search/test_circumstances.py": 40, "engine/test_new_effect.py": 39, "end_to_end/test_diesel.py": 39,
    "discovery/search/test_search.py": 39, "test_core.py": 36, "paper/test_compiled_loss.py": 34,
    "petrol/test_petrol_commands.py": 33, "discovery/search/test_local_misfit.py": 32, "api/test_front_door.py": 30,
    "end_to_end/test_rigs.py": 27, "cli/test_learn_command.py": 27, "identification/test_classical.py": 26,
    "app/test_browser.py": 25,  # 43 before them: it runs what these compile
    "end_to_end/test_petrol.py": 26, "flows/test_prove.py": 25, "discovery/reference/test_conditions.py": 24,
    "paper/test_multistage.py": 23, "flows/test_discover.py": 23, "flows/test_interrupted_flow.py": 22,
    "calibration/test_imply.py": 22, "cli/test_discover_command.py": 22, "cli/test_app.py": 21,
    "cli/test_bad_input.py": 21, "discovery/search/test_standing.py": 20, "discovery/reference/test_learn.py": 19,
    "discovery/laws/test_law_search.py": 18, "calibration/test_recovery.py": 18, "flows/test_watch.py": 17,
    "recordings/guess/test_propose.py": 17, "paper/comparison/test_page.py": 17, "paper/test_fewshot_adam.py": 17,
    "engine/test_equations.py": 17, "app/test_pages.py": 15, "calibration/test_reference_engine.py": 15,
    "recordings/importers/test_nasty_files.py": 13, "report/test_encoding.py": 13, "codegen/test_c_engine.py": 13,
    "petrol/test_petrol_courses.py": 13, "paper/test_datasets.py": 13, "report/test_figures.py": 13,
    "examples/test_scripts.py": 12, "discovery/search/test_renewal.py": 12, "identification/test_term_model.py": 12,
    "flows/test_run_context.py": 12, "challenge/test_plant.py": 11, "rigs/test_rig_page.py": 11,
    "rigs/test_rig_discovery.py": 11, "api/test_api_learn.py": 11, "rigs/test_rig_onsets.py": 10,
    "identification/test_fewshot_newton.py": 10, "settings/test_methods.py": 10, "challenge/test_petrol_tier.py": 10,
    "surrogates/test_operators.py": 10, "calibration/test_sensor_errors.py": 10, "flows/test_registry.py": 9,
    "discovery/search/test_pauses.py": 9, "surrogates/test_bodies.py": 9, "discovery/test_fit_test.py": 9,
    "paper/test_network_loops.py": 9, "identification/test_acceptance.py": 8, "test_duty_cycles.py": 8,
    "report/test_interactive.py": 8, "rigs/test_rig_files.py": 8,
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
