"""An effect that goes unseen moves health by what was foretold, and the words say which parameter and how far."""

from __future__ import annotations

import pytest

from dieseltwin.discovery.search.preparation import prepare
from dieseltwin.discovery.verdict.document import Discrepancy
from dieseltwin.discovery.verdict.unseen import health_bias, most_first
from dieseltwin.report.findings import visible
from dieseltwin.report.visible_words import bias_words, visible_table
from tests.discovery.toy import SETTINGS, Toy
from tests.report import synthetic_discovery as synthetic


@pytest.mark.parametrize("effect", ["leak", "drag", "x_offset"])
def test_a_fit_that_leaves_it_out_is_off_by_it(effect: str) -> None:
    """The same noise with and without the effect: what the gain changes by is the effect's doing alone."""
    without = prepare(Toy().record(gain=1.1), SETTINGS)
    gain = without.null.fit.parameters[0]
    foretold = health_bias(without, {"gain": (0, float(gain))})[effect]["gain"]
    (smallest,) = {item.std for item in without.scored if item.name == effect}
    size = smallest * SETTINGS.alarm_gain**0.5
    beside = prepare(Toy().record(gain=1.1, **{effect: size}), SETTINGS)
    assert foretold == pytest.approx(beside.null.fit.parameters[0] / gain - 1.0, rel=0.3)  # to first order
    assert abs(foretold) > 0.001


def test_what_moves_nothing_is_not_told() -> None:
    found = prepare(Toy().record(gain=1.1), SETTINGS)
    assert health_bias(found, {"gain": (0, 1e9)}) == {} and most_first({}, "leak") == []


def test_words_and_tables_name_what_moves_most() -> None:
    bias = {"boost_leak": {"A_egrmax": 0.002, "h_tot": -0.0311}}
    assert bias_words(bias, "boost_leak") == ["h_tot −3.1 %", "A_egrmax +0.2 %"] and bias_words(bias, "blow_by") == []
    head, line = visible_table({"boost_leak": 3.1e-6}, bias)
    assert head.index("unseen, it moves") == line.index("h_tot −3.1 %") and "A_egrmax" not in line
    document = synthetic.document(health_bias=bias)
    assert Discrepancy.model_validate(document.to_json()).health_bias == bias
    (moved,) = (row[2] for row in visible(document, {"boost_leak": "m2"}).rows if row[0] == "boost_leak")
    assert moved == "h_tot −3.1 %, A_egrmax +0.2 %"
    assert "health_bias" not in synthetic.document().to_json()
