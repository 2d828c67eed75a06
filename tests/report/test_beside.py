"""A task of the process beside is done once, there or here, and its errors are heard."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from dieseltwin.errors import InputError
from dieseltwin.report.beside import begin_ahead, begin_beside, ready_beside


@pytest.fixture(autouse=True)
def _two_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DIESELTWIN_THREADS", "2")
    before = [thread for thread in threading.enumerate() if thread is not threading.main_thread()]  # of a test's worker
    seen = SimpleNamespace(
        enumerate=lambda: [thread for thread in threading.enumerate() if thread not in before],
        main_thread=threading.main_thread, current_thread=threading.current_thread,
    )  # fmt: skip
    monkeypatch.setattr("dieseltwin.report.beside.threading", seen)


def _load() -> None:
    os.environ["LOADED_BY"] = str(os.getpid())


def _write(out: Path, text: str) -> None:
    out.write_text(f"{text} {os.getpid()} {os.environ.get('LOADED_BY')}", encoding="utf-8")


def _refuse(out: Path) -> None:
    raise InputError(str(out), "nothing", "something", "choose another")


def _die(out: Path, here: int) -> None:
    if os.getpid() != here:
        os._exit(1)
    out.write_text("done here", encoding="utf-8")


def test_the_task_is_done_by_the_process_that_loaded(tmp_path: Path) -> None:
    with ready_beside(_load):
        finish = begin_beside(_write, tmp_path / "page", text="by")
        finish()
    words, writer, loader = (tmp_path / "page").read_text(encoding="utf-8").split()
    assert (words, writer) == ("by", loader)
    assert writer != str(os.getpid())


def test_without_a_process_beside_it_is_done_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begin_beside(_write, tmp_path / "alone", "by")()
    monkeypatch.setenv("DIESELTWIN_THREADS", "1")
    with ready_beside(_load):
        begin_beside(_write, tmp_path / "one_core", "by")()
    other = threading.Event()
    thread = threading.Thread(target=other.wait)
    thread.start()
    monkeypatch.setenv("DIESELTWIN_THREADS", "2")
    with ready_beside(_load):  # a process with threads isn't forked
        begin_beside(_write, tmp_path / "threads", "by")()
    other.set()
    thread.join()
    for name in ("alone", "one_core", "threads"):
        assert (tmp_path / name).read_text(encoding="utf-8") == f"by {os.getpid()} None"


def test_a_process_that_never_gets_ready_is_not_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dieseltwin.report.beside._LOADING_S", 0.1)
    with ready_beside(threading.Event().wait):
        begin_beside(_write, tmp_path / "page", "by")()
    assert (tmp_path / "page").read_text(encoding="utf-8") == f"by {os.getpid()} None"


def test_an_error_is_raised_here_and_a_task_that_died_is_done_here(tmp_path: Path) -> None:
    with ready_beside(_load), pytest.raises(InputError, match="choose another"):
        begin_beside(_refuse, tmp_path / "page")()
    with ready_beside(_load):
        begin_beside(_die, tmp_path / "died", os.getpid())()
    assert (tmp_path / "died").read_text(encoding="utf-8") == "done here"


def _ahead(wanted: Callable[[], bool], word: str) -> None:
    os.environ["LOADED_BY"] = word
    if word == "fails":
        raise ValueError(word)
    while word == "goes_on" and not wanted():
        time.sleep(0.01)


def _once_ready(*words: str) -> None:
    """As a search that takes longer than to load."""
    from dieseltwin.report.beside import _ready

    assert _ready[-1].is_ready(30.0)
    for word in words:
        begin_ahead(_ahead, word)


@pytest.mark.parametrize("words", [("first", "last"), ("goes_on",), ("first", "fails")])
def test_what_is_begun_ahead_is_there_for_the_task_and_makes_way_for_it(tmp_path: Path, words: tuple[str, ...]) -> None:
    with ready_beside(_load):
        _once_ready(*words)
        begin_beside(_write, tmp_path / "page", "by")()
    _, writer, ahead = (tmp_path / "page").read_text(encoding="utf-8").split()
    assert writer != str(os.getpid()) and ahead == words[-1]


def test_nothing_is_begun_ahead_where_no_process_is_ready(tmp_path: Path) -> None:
    begin_ahead(_ahead, "here")
    with ready_beside(lambda: time.sleep(0.5)):
        begin_ahead(_ahead, "too early")
        begin_beside(_write, tmp_path / "page", "by")()
    assert (tmp_path / "page").read_text(encoding="utf-8").endswith(" None")
