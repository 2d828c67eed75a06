"""What acts in a part of the driving is said to act there alone, with its own size and gain."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dieseltwin.discovery.search import run as search
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.verdict.document import Discrepancy, Location
from dieseltwin.discovery.verdict.findings import location, valid_for
from dieseltwin.discovery.verdict.reasons import candidate_rows
from dieseltwin.discovery.verdict.when import when_words
from dieseltwin.report.discovery_words import sentence
from dieseltwin.report.findings import findings
from dieseltwin.report.law_cards import law_cards
from dieseltwin.report.quantities import with_symbols
from tests.discovery.toy import SETTINGS, Toy
from tests.report import synthetic_discovery as synthetic

WHERE = {"n_e_rpm": [947.35, 1722.2], "u_delta_mg": [None, 146.09]}
WORDS = "only at n_e 947 to 1720 rpm and u_delta up to 146 mg/cycle"


@pytest.fixture(scope="module")
def in_a_region() -> Search:
    toy = Toy()
    acts = ((toy.u > 1.2) & (toy.u < 2.2)).astype(float)
    return search.run(toy.record(gain=0.95, leak=(0.1, acts)), SETTINGS, laws=False)


@pytest.fixture(scope="module")
def since_an_onset() -> Search:
    toy = Toy()
    return search.run(toy.record(gain=0.95, x_offset=(0.2, (toy.time_s >= 100.0).astype(float))), SETTINGS, laws=False)


def _row(found: Search, name: str) -> dict[str, Any]:
    return next(dict(row) for row in candidate_rows(found) if row["name"] == name)


@pytest.mark.parametrize(("kind", "name", "size"), [("in_a_region", "leak", 0.1), ("since_an_onset", "x_offset", 0.2)])
def test_the_chosen_row_is_the_explanations_own(
    kind: str, name: str, size: float, request: pytest.FixtureRequest
) -> None:
    """The leak of a region stood in the table with the gain and the size of one that is there all along."""
    found: Search = request.getfixturevalue(kind)
    assert found.kind == "variant"
    row, best = _row(found, name), found.variants[0][1]
    assert row["magnitude"] == float(best.magnitudes[0]) == pytest.approx(size, rel=0.1)
    assert row["std"] == float(best.std[1])
    assert row["log_likelihood_gain"] == pytest.approx(0.5 * found.explained())
    assert row["reason"].startswith("chosen: it raises the log-likelihood by ") and ", acting " in row["reason"]
    gains = [entry["log_likelihood_gain"] for entry in candidate_rows(found)]
    assert row["log_likelihood_gain"] == max(gains)


def test_the_region_is_told_and_the_driving_behind_it_is_cut_to_it(in_a_region: Search) -> None:
    where = location(in_a_region, in_a_region.twin, np.zeros(in_a_region.twin.time_s.size))  # type: ignore[arg-type]
    assert set(where.only_in) == {"u"}
    low, high = where.only_in["u"]
    assert low == pytest.approx(1.2, abs=0.12) and high == pytest.approx(2.2, abs=0.12)
    first, last = map(float, valid_for(in_a_region).removeprefix("u ").split("-"))
    assert low - 1e-3 <= first < last <= high + 1e-3


def test_an_open_edge_is_none() -> None:
    toy = Toy()
    found = search.run(toy.record(gain=0.95, leak=(0.1, (toy.u > 1.75).astype(float))), SETTINGS, laws=False)
    assert found.kind == "variant"
    where = location(found, found.twin, np.zeros(toy.time_s.size))  # type: ignore[arg-type]
    assert where.only_in["u"] == (pytest.approx(1.75, abs=0.1), None)


def test_the_driving_behind_an_onset_is_that_since_then(since_an_onset: Search) -> None:
    toy, variant = since_an_onset.twin, since_an_onset.variant
    assert variant is not None and variant.onset_s is not None
    values = toy.conditions["u"][toy.time_s >= variant.onset_s]
    assert valid_for(since_an_onset) == f"u {values.min():.4g}-{values.max():.4g}"


def test_sentence_table_and_card_say_the_region() -> None:
    document = synthetic.document(location={**synthetic.LOCATION, "only_in": WHERE, "regions": [synthetic.REGION]})
    assert f"a boost leak of 41.0 ± 2.0 mm², {WORDS}; the fit" in sentence(document)
    table = findings(document)
    told = with_symbols(WORDS)
    assert table is not None and told in table.rows[0] and "<sub>" in told
    assert f"It acts {told}." in law_cards(document)[0].meaning
    assert Discrepancy.model_validate(document.to_json()).location == document.location
    assert "only_in" not in synthetic.document().to_json()["location"]


def test_a_range_that_is_open_above_is_said_so() -> None:
    where = Location(site="shaft_power", probability=1.0, only_in={"u_vgt_pct": (60.04, None)})
    assert when_words(where) == "only at u_vgt from 60 % on"
