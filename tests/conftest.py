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
    import pandas as pd

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
    "flows/test_chain.py": 112, "discovery/reference/test_conditions.py": 58, "api/test_learn_points.py": 53,
    "discovery/search/test_circumstances.py": 49, "petrol/test_petrol_commands.py": 41, "api/test_api_learn.py": 38,
    "app/test_pages.py": 34, "cli/test_app.py": 34, "petrol/test_petrol_discover.py": 34, "cli/test_bad_input.py": 31,
    "end_to_end/test_later_laws.py": 31, "test_core.py": 31, "calibration/test_imply.py": 30,
    "discovery/reference/test_learn.py": 30, "end_to_end/test_rigs.py": 29, "flows/test_rollback.py": 29,
    "end_to_end/test_diesel.py": 28, "end_to_end/test_petrol.py": 28, "flows/test_prove.py": 28,
    "rigs/test_rig_discovery.py": 28, "surrogates/test_empirical.py": 28, "cli/test_discover_command.py": 26,
    "cli/test_learn_command.py": 26, "flows/test_watch.py": 25, "paper/comparison/test_page.py": 25,
    "paper/test_compiled_loss.py": 25,
    "app/test_browser.py": 25,  # 36 before them: it runs what these compile
    "engine/test_new_effect.py": 24, "petrol/test_petrol_meters.py": 24, "api/test_front_door.py": 23,
    "paper/test_fewshot_adam.py": 23, "end_to_end/test_quick_pedal.py": 22, "engine/test_equations.py": 22,
    "discovery/reference/test_further.py": 21, "discovery/search/test_search.py": 21, "calibration/test_onsets.py": 19,
    "discovery/search/test_standing.py": 19, "flows/test_discover.py": 19, "discovery/search/test_local_misfit.py": 18,
    "identification/test_classical.py": 18, "discovery/laws/test_law_search.py": 17, "end_to_end/test_points.py": 16,
    "petrol/test_petrol_renewal.py": 16, "calibration/test_rough_maps.py": 14, "examples/test_scripts.py": 13,
    "flows/test_databases.py": 13, "flows/test_run_context.py": 13, "paper/test_datasets.py": 13,
    "petrol/test_petrol_courses.py": 13, "discovery/test_fit_test.py": 12, "paper/test_network_loops.py": 12,
    "flows/test_registry.py": 11, "flows/test_step_code.py": 11, "paper/test_multistage.py": 11,
    "recordings/importers/test_nasty_files.py": 11, "report/test_discovery_figures.py": 11,
    "report/test_figures.py": 11, "rigs/test_rig_files.py": 11, "rigs/test_rig_onsets.py": 11,
    "codegen/test_c_engine.py": 10, "api/test_api_fleet.py": 9, "calibration/test_matched_turbine.py": 9,
    "calibration/test_reference_engine.py": 9, "challenge/test_plant.py": 9, "petrol/test_petrol_second.py": 9,
    "identification/test_term_model.py": 8,
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


@pytest.fixture(scope="module")
def trace() -> pd.DataFrame:
    """Five minutes of driving of `we2011.FIELD` at 5 Hz, every quantity without noise."""
    import pandas as pd

    return pd.read_csv(ROOT / "tests" / "reference" / "field_random_300s.csv")


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
