"""One Prefect server and one run of the chain for all tests of the session, one toy library, temporary workspaces."""

from __future__ import annotations

import os
import shutil
import sqlite3
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest
import tiny_settings
from toy_library import fresh_context, write_toylib

from tasks import run_context, tracking
from tasks.progress import Display
from tasks.run_context import RunContext
from tasks.server import prefect_server
from tasks.workspace import PROJECT, Workspace, quiet_settings

FAKES = Path(__file__).parent / "fakes"


@pytest.fixture(autouse=True)
def no_context_left() -> Iterator[None]:
    """The run context of a test isn't the next one's."""
    yield
    run_context.use(None)


@pytest.fixture(scope="session", autouse=True)
def tables_made_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[Path], None]]:
    """MLflow's tables are made for the first workspace and copied for the others: migrations take seconds. Gives what
    makes them."""
    template, make = tmp_path_factory.mktemp("databases") / "mlflow.db", tracking._make_database

    def made(path: Path) -> None:
        if not template.exists():
            make(template)
            tiny_settings.FRESH[Path("mlruns") / "mlflow.db"] = template
        shutil.copy(template, path)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tracking, "_make_database", made)
        yield make


@pytest.fixture
def context(tmp_path: Path) -> Iterator[RunContext]:
    """A fresh workspace with the toy library, in use."""
    write_toylib(tmp_path)
    made = fresh_context(tmp_path)
    run_context.use(made)
    yield made
    run_context.use(None)


@pytest.fixture
def faked_discovery(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], RunContext]]:
    """A workspace in which the steps' processes find fakes for the fit and the oracle; call it for a fresh context."""
    tiny_settings.write_params(tmp_path)
    monkeypatch.setattr(sys, "path", [str(FAKES), *sys.path])

    codes: dict = {}  # the sources as they are when the test starts

    def fresh() -> RunContext:
        display = Display(tmp_path / ".cache" / "expected_seconds.json")
        display.console.quiet = True
        context = RunContext(Workspace(tmp_path), display, codes=codes)
        run_context.use(context)
        return context

    fresh()
    yield fresh
    run_context.use(None)


@pytest.fixture(scope="session")
def prefect(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A Prefect server as every run starts one, once a session, with a database in a temporary folder.

    (Prefect's own test harness imports the server here as well, four seconds.)
    """
    workspace, saved = Workspace(tmp_path_factory.mktemp("prefect")), dict(os.environ)
    os.environ.update(quiet_settings(workspace))
    with prefect_server(workspace):
        _keep_tables(workspace.prefect_home / "prefect.db", workspace.root / "tables.db")
        yield
    os.environ.clear()
    os.environ.update(saved)


def _keep_tables(database: Path, copy: Path) -> None:
    """Tables of Prefect's database, for servers that a test starts itself: `tiny_settings.write_params` copies them."""
    with closing(sqlite3.connect(database)) as made, closing(sqlite3.connect(copy)) as kept:
        made.backup(kept)
    tiny_settings.FRESH[Path(".prefect") / "prefect.db"] = copy


@pytest.fixture(scope="session")
def chain(tmp_path_factory: pytest.TempPathFactory, prefect: None) -> tuple[Path, set[str]]:
    """A workspace in which the chain ran once, and the steps that ran."""
    from flows.run import run

    root = tmp_path_factory.mktemp("chain")
    tiny_settings.write_params(root)
    context = tiny_settings.new_context(root)
    run("tiny")
    return root, set(context.timings)


@pytest.fixture
def project() -> Path:
    """The checkout."""
    return PROJECT
