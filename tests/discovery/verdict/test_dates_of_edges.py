"""Sentence, table, page and document say between which dates an onset lies, and what wasn't used."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dieseltwin.discovery.verdict.document import Discrepancy, Location
from dieseltwin.discovery.verdict.findings import left_out
from dieseltwin.discovery.verdict.left_out import LeftOut, left_out_notes, left_out_words
from dieseltwin.discovery.verdict.when import when_words
from dieseltwin.report.discovery_words import sentence
from dieseltwin.report.findings import findings, provenance
from tests.report import synthetic_discovery as synthetic


@pytest.mark.parametrize(
    ("dates", "words"),
    [
        ({"onset_s": 288.0, "onset_range_s": (250.0, 289.6)}, "since 288 s (250 to 290 s)"),
        ({"onset_s": 288.0, "onset_range_s": (287.5, 289.0)}, "since 288 s"),
        ({"onset_s": 750.0, "onset_range_s": (740.0, 760.0)}, "since 750 s (12.5 min; 740 to 760 s)"),
        ({"until_s": 300.0, "until_range_s": (290.0, 301.0)}, "until 300 s (290 to 301 s), and gone since then"),
        (
            {"onset_s": 100.0, "onset_range_s": (90.0, 101.0), "until_s": 300.0, "until_range_s": (290.0, 301.0)},
            "from 100 to 300 s (begun at 90 to 101 s, gone at 290 to 301 s), and gone since then",
        ),
        (
            {"onset_s": 100.0, "onset_range_s": (60.0, 130.0), "grows": True},
            "at the end, grown evenly from nothing since 100 s (60 to 130 s)",
        ),
    ],
)
def test_words(dates: dict[str, Any], words: str) -> None:
    assert when_words(Location(site="shaft_power", probability=1.0, **dates)) == words


def test_document_sentence_and_table_have_the_range() -> None:
    where = {**synthetic.LOCATION, "onset_s": 288.0, "onset_range_s": [250.0, 290.0]}
    document = synthetic.document(location=where)
    assert "since 288 s (250 to 290 s)" in sentence(document)
    table = findings(document)
    assert table is not None and "since 288 s (250 to 290 s)" in table.rows[0]
    assert Discrepancy.model_validate(document.to_json()).location == document.location
    assert "onset_range_s" not in synthetic.document().to_json()["location"]


def _twin(windows: int) -> Any:
    time_s = 0.5 * np.arange(20.0 * windows)
    return SimpleNamespace(starts=20 * np.arange(windows), time_s=time_s, recording_time_s=time_s + 7.0, start_s=7.0)


def test_windows_side_by_side_are_one_span() -> None:
    out = np.zeros(30, dtype=bool)
    out[[2, 3, 10, 29]] = True
    found: Any = SimpleNamespace(left_out=out)
    told = left_out(found, _twin(30))
    assert told is not None and told.share == pytest.approx(4 / 30)
    assert told.spans_s == ((20.0, 40.0), (100.0, 110.0), (290.0, 299.5))
    assert left_out(SimpleNamespace(left_out=np.zeros(30, dtype=bool)), _twin(30)) is None  # type: ignore[arg-type]


def test_the_page_says_what_was_not_used_and_a_note_where_it_is_much() -> None:
    much = LeftOut(share=0.0833, spans_s=((90.0, 100.0), (250.0, 270.0)))
    words = "8.3 % of the recording (90 to 100 s and 250 to 270 s)"
    assert left_out_words(much) == words
    document = synthetic.document(left_out=much.model_dump(mode="json"))
    assert ("not used", words) in provenance(document)
    assert document.to_json()["left_out"]["share"] == 0.0833
    assert "left_out" not in synthetic.document().to_json()
    (note,) = left_out_notes(much)
    assert note.code == "left_out" and words in note
    assert left_out_notes(LeftOut(share=0.016)) == left_out_notes(None) == []
