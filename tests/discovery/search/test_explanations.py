"""What may take a name away from what was found, and what may not."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dieseltwin.discovery.likelihood.fit import Linearisation
from dieseltwin.discovery.search import explanations
from dieseltwin.discovery.search import run as search
from dieseltwin.discovery.search.explanations import choose
from dieseltwin.discovery.search.state import Search
from tests.discovery.toy import SETTINGS, Toy


@pytest.mark.parametrize(("effect", "kind"), [("leak", "single"), ("drag", "law"), (None, "law")])
def test_what_a_name_s_own_law_leaves_takes_no_name_away(
    monkeypatch: pytest.MonkeyPatch, effect: str | None, kind: str
) -> None:
    found = search.run(Toy().record(gain=0.95, leak=0.1), SETTINGS, laws=False)
    assert found.kind == "single" and found.singles[0].candidate.names == ("leak",)
    some = found.structure[0]
    left = replace(some, feature=replace(some.feature, effect=effect), gain=900.0, held=900.0)

    def look(found: Search, best: Linearisation) -> float:
        found.left, found.left_local = [left], []
        return 0.0

    monkeypatch.setattr(explanations, "look_at_what_is_left", look)
    found.pairs, found.variants, found.structure, found.local = [], [], [], []
    choose(found, None)
    assert found.kind == kind and found.refused == ("" if kind == "single" else "single")


def test_an_explanation_that_was_refused_before_is_chosen_once_where_names_were_added() -> None:
    """With what was refused kept, pairs were tried and the choice was made twice: its intervals were widened twice."""
    found = search.run(Toy().record(gain=0.95, leak=0.1), SETTINGS, laws=False)
    assert found.best is not None
    std, pairs = found.best.fit.std.copy(), found.pairs
    found.refused, found.pairs = "single", [found.singles[0]]
    search._explain(found)
    assert found.kind == "single" and found.refused == "" and len(found.pairs) == len(pairs)
    assert found.best is not None and found.best.fit.std == pytest.approx(std)
