"""A law isn't looked for where the search is made again with inputs that moved between the rows, whatever it finds."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from dieseltwin.discovery.search import quick_inputs as module
from dieseltwin.discovery.search import run
from dieseltwin.discovery.search.quick_inputs import is_made_again, with_inputs_between_rows


class _ToOpen:
    """A twin whose inputs may have moved between its rows, or one of fast rows."""

    states = ()

    def __init__(self, other: str | None) -> None:
        self.other = other

    def with_inputs_between_rows(self) -> str | None:
        return self.other


def _found(kind: str, twin: object) -> Any:
    return SimpleNamespace(kind=kind, twin=twin, standing=(), unfinished=(), singles=[], seconds={}, earlier=[])


@pytest.mark.parametrize(
    ("left", "other", "stands", "again"),
    [(0.8, True, True, True), (1.0, False, False, False), (1.2, True, False, False)],
)
def test_it_is_made_again_where_less_than_the_noise_is_left(
    monkeypatch: pytest.MonkeyPatch, left: float, other: bool, stands: bool, again: bool
) -> None:
    monkeypatch.setattr(module, "share_left", lambda found: left)
    found = _found("law", _ToOpen("open"))
    assert with_inputs_between_rows(found) == ("open" if other else None, stands)
    assert is_made_again(found) is again
    assert not is_made_again(_found("single", _ToOpen("open")))  # a name may leave as much as noise in its own weather
    assert not is_made_again(_found("law", _ToOpen(None)))  # rows that see the inputs move
    assert not is_made_again(_found("law", SimpleNamespace()))  # a twin that has no inputs


@pytest.mark.parametrize(("again", "time_s", "looked_for"), [(True, None, 0), (True, 60.0, 1), (False, None, 1)])
def test_a_law_that_would_be_thrown_away_is_not_looked_for(
    monkeypatch: pytest.MonkeyPatch, again: bool, time_s: float | None, looked_for: int
) -> None:
    """With a limit of time the second search may not be reached, and the law of the first is the answer."""
    laws: list[object] = []
    found = _found("law", _ToOpen("open"))
    monkeypatch.setattr(run, "with_names", lambda found, starts: found)
    monkeypatch.setattr(run, "_explain", lambda found, **_: None)
    monkeypatch.setattr(run, "refit_by_slopes", lambda found: False)
    monkeypatch.setattr(run, "_in_own_weather", lambda found: found)
    monkeypatch.setattr(run, "_with_law", lambda found: laws.append(found) or found)
    monkeypatch.setattr(run, "_with_reading_in_time", lambda found: found)
    monkeypatch.setattr(run, "date_edges", lambda found: None)
    monkeypatch.setattr(run, "_with_inputs_between_rows", lambda found, laws, time_s: found)
    monkeypatch.setattr(run, "is_made_again", lambda found: again)
    run.carry_on(cast(Any, found), time_s=time_s)
    assert len(laws) == looked_for
