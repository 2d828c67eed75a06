"""Figures encoded in two processes are the files that one process makes."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from matplotlib.figure import Figure

from dieseltwin.report.encoding import encode_all
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


def test_what_the_second_process_can_not_send_is_drawn_here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DIESELTWIN_THREADS", "2")
    alone = {figure.name: figure.encode() for figure in _figures()}
    monkeypatch.setattr("dieseltwin.report.encoding._send", lambda sender, figures: sender.close())
    assert encode_all(_figures()) == alone


def test_a_second_process_that_never_sends_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DIESELTWIN_THREADS", "2")
    alone = {figure.name: figure.encode() for figure in _figures()}
    monkeypatch.setattr("dieseltwin.report.encoding._PATIENCE_S", 0.2)
    monkeypatch.setattr("dieseltwin.report.encoding._send", lambda sender, figures: time.sleep(600.0))
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
