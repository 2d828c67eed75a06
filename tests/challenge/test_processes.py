"""Cases are run with one thread each, however many there are."""

from __future__ import annotations

import os

import pytest

from dieseltwin.challenge.processes import in_processes


def told(name: str) -> tuple[str | None, int]:
    """What a case finds in its environment, and its process."""
    return os.environ.get(name), os.getpid()


@pytest.mark.parametrize("items", [["DIESELTWIN_THREADS"], ["DIESELTWIN_THREADS"] * 2])
def test_one_thread_in_this_process(items: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    monkeypatch.delenv("DIESELTWIN_THREADS", raising=False)
    assert [result for _, result in in_processes(told, items, 1)] == [("1", os.getpid())] * len(items)
    assert "DIESELTWIN_THREADS" not in os.environ


def test_a_process_of_its_own_where_libraries_may_use_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS")
    assert list(in_processes(os.getenv, ["OMP_NUM_THREADS"], 4)) == [(0, "1")]
    assert list(in_processes(os.getenv, [], 1)) == []
    assert "OMP_NUM_THREADS" not in os.environ
