"""Figures encoded in two processes are the files that one process makes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import pytest
from matplotlib.figure import Figure

from dieseltwin.report.encoding import drawn_here, drawn_in_two, encode_all
from dieseltwin.report.style import ReportFigure


def _figures() -> list[ReportFigure]:
    made = []
    for k, kind in enumerate(("svg", "png", "svg", "svg", "png")):
        figure = Figure(figsize=(3.0, 2.0))
        figure.subplots().plot([0.0, 1.0, 2.0], [k, 1.0, -k])
        made.append(ReportFigure(f"figure_{k}", f"figure {k}", "", figure, kind))
    return made


def test_two_processes_make_the_files_that_one_makes(monkeypatch: pytest.MonkeyPatch) -> None:
    alone = {figure.name: figure.encode() for figure in _figures()}
    monkeypatch.setenv("DIESELTWIN_THREADS", "2")
    assert encode_all(_figures()) == alone
    monkeypatch.setenv("DIESELTWIN_THREADS", "1")
    assert encode_all(_figures()) == alone
    with ThreadPoolExecutor(1) as pool:  # a thread of a server doesn't fork
        assert pool.submit(encode_all, _figures()).result() == alone


def test_figures_are_drawn_by_two_processes_as_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    def drawing(number: int) -> ReportFigure | None:
        return None if number == 3 else _figures()[number]

    drawings = {f"drawing {number}": partial(drawing, number) for number in range(5)}
    alone = drawn_here(drawings)
    for threads in ("1", "2"):
        monkeypatch.setenv("DIESELTWIN_THREADS", threads)
        both = drawn_in_two(drawings)
        assert list(both) == list(alone) and both["drawing 3"] is None
        for name, figure in alone.items():
            finished = both[name]
            if figure is not None and finished is not None:
                assert finished.name == figure.name and finished.encode() == figure.encode()
    with pytest.raises(ValueError, match="figure_0 was drawn in another process"):
        both["drawing 0"].encode(60)  # type: ignore[union-attr]


def test_what_fails_in_one_of_two_processes_is_raised_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever takes it: what the second one can't draw is drawn here once more, and fails here."""
    monkeypatch.setenv("DIESELTWIN_THREADS", "2")
    drawings = {**{figure.name: partial(_same, figure) for figure in _figures()}, "none": partial(divmod, 1, 0)}
    with pytest.raises(ZeroDivisionError):
        drawn_in_two(drawings)  # type: ignore[arg-type]


def _same(figure: ReportFigure) -> ReportFigure:
    return figure


def test_what_the_second_process_can_not_send_is_drawn_here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DIESELTWIN_THREADS", "2")
    alone = {figure.name: figure.encode() for figure in _figures()}
    monkeypatch.setattr("dieseltwin.report.encoding._send", lambda sender, numbers, tasks: sender.close())
    assert encode_all(_figures()) == alone


def test_a_second_process_that_never_sends_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DIESELTWIN_THREADS", "2")
    alone = {figure.name: figure.encode() for figure in _figures()}
    monkeypatch.setattr("dieseltwin.report.encoding._PATIENCE_S", 0.2)
    monkeypatch.setattr("dieseltwin.report.encoding._send", lambda sender, numbers, tasks: time.sleep(600.0))
    begun = time.perf_counter()
    assert encode_all(_figures()) == alone
    assert time.perf_counter() - begun < 60.0


def test_a_process_with_another_thread_does_not_fork(monkeypatch: pytest.MonkeyPatch) -> None:
    """A worker of the flows has one that reads standard input and holds its lock: a fork of it hung for ever."""
    monkeypatch.setenv("DIESELTWIN_THREADS", "2")
    alone = {figure.name: figure.encode() for figure in _figures()}

    def forked(method: str) -> None:
        raise AssertionError(f"a {method} of a process with threads")

    monkeypatch.setattr("dieseltwin.report.encoding.get_context", forked)
    over = threading.Event()
    other = threading.Thread(target=over.wait)
    other.start()
    try:
        assert encode_all(_figures()) == alone
    finally:
        over.set()
        other.join()


KILLED_WHILE_DRAWING = """
import os, signal
from dieseltwin.report import encoding
first, (begun, begin) = os.getpid(), os.pipe()

def draw():
    if os.getpid() == first:
        os.write(begin, bytes(4))
        os.kill(first, signal.SIGKILL)
    os.read(begun, 1)  # else the fork might take all before the first process has taken one
    return bytes(1_000_000)

encoding._in_two([draw] * 4)
"""
"""More than a pipe holds, for a process that is gone."""


def test_the_fork_of_a_process_that_is_killed_ends_too() -> None:
    """It waited for ever for a reader, which it was itself, and held the standard streams that it had got."""
    done = subprocess.run([sys.executable, "-c", KILLED_WHILE_DRAWING], capture_output=True, text=True, check=False,
                          timeout=60, env={**os.environ, "DIESELTWIN_THREADS": "2"})  # fmt: skip
    assert done.returncode == -signal.SIGKILL and not done.stderr
