"""Panels over time on the page: their numbers are the readings, spikes stay, the page stays small and whole."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dieseltwin.errors import InputError
from dieseltwin.report import pdf
from dieseltwin.report.discovery_page import build_discovery_report
from dieseltwin.report.interactive import MOST_ROWS, discovery_series
from dieseltwin.report.law_cards import law_cards
from dieseltwin.report.over_time import extremes
from tests.report import synthetic_discovery

SMALLER_THAN = 3_000_000
"""Bytes that a report of ten minutes at 5 Hz may have."""


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_discovery_report(synthetic_discovery.discovery(), tmp_path_factory.mktemp("page") / "report.html")


def test_the_page_carries_the_readings(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert len(text.encode()) < SMALLER_THAN
    found = re.search(r'<script type="application/json" class="series">(.*?)</script>', text, re.DOTALL)
    assert found is not None
    panels = json.loads(found.group(1))["panels"]
    curves = synthetic_discovery.discovery().curves
    assert [panel["name"] for panel in panels] == list(curves.channels)
    pressure = panels[0]
    assert pressure["unit"] == "kPa" and len(pressure["x"]) == curves.time_s.size
    np.testing.assert_allclose(pressure["lines"][0]["y"], curves.measured[:, 0] / 1e3, rtol=1e-4)
    np.testing.assert_allclose(pressure["lines"][2]["y"], curves.after[:, 0] / 1e3, rtol=1e-4)


def test_the_page_loads_nothing_and_has_a_still_for_paper(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert 'id="readings" class="still"' in text
    assert not re.search(r'(?:src|href)="(?!data:|#)', text) and "@import" not in text and "url(http" not in text


def test_a_name_of_a_channel_can_not_end_the_script() -> None:
    found = synthetic_discovery.discovery()
    curves = replace(found.curves, channels=("</script><b>", *found.curves.channels[1:]))
    series = discovery_series(replace(found, curves=curves))
    titles = "".join(panel.title for panel in series.panels)
    assert "</script" not in series.data and "<b>" not in titles  # nor a heading
    assert json.loads(series.data)["panels"][0]["name"] == "</script><b>"


def test_long_series_keep_their_spikes() -> None:
    values = np.sin(np.arange(200_000) / 1e4)
    values[[17, 123_456]] = 40.0, -30.0
    values[5000:5100] = np.nan
    rows = extremes(values, MOST_ROWS)
    assert rows.size <= MOST_ROWS and {17, 123_456} <= set(rows.tolist()) and (np.diff(rows) > 0).all()
    assert extremes(values[:100], MOST_ROWS).size == 100


def test_a_law_is_told_in_words_with_its_size_and_how_sure_it_is() -> None:
    card = law_cards(synthetic_discovery.document())[0]
    assert card.title == "A boost leak of 41.0 ± 2.0 mm²"
    assert card.meaning.startswith("A hole between compressor and cylinders")
    assert "<math" in card.formula and "41.0 ± 2.0 mm²" in card.size
    assert card.sure.startswith("The likeliest name. ") and "compressor_efficiency_loss" in card.sure
    assert ("intake manifold pressure [Pa]") in dict((w, s) for s, w in card.symbols)


@pytest.mark.skipif(not any(map(pdf.shutil.which, pdf.BROWSERS)), reason="no browser that prints")
def test_the_page_is_printed(page: Path, tmp_path: Path) -> None:
    out = pdf.print_pdf(page, tmp_path / "report.pdf")
    content = out.read_bytes()
    assert content.startswith(b"%PDF") and 50_000 < len(content) < SMALLER_THAN
    assert [path.name for path in tmp_path.iterdir()] == ["report.pdf"]


def test_a_card_says_since_which_point() -> None:
    late = synthetic_discovery.document(effects=[{**synthetic_discovery.LEAK, "since_row": 61}])
    assert "It is there since data row 61." in str(law_cards(late)[0].meaning)
    assert "data row" not in str(law_cards(synthetic_discovery.document())[0].meaning)


def test_without_a_browser_it_is_said_what_to_do(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError, match=r"no browser that could print.*Chromium or Chrome"):
        pdf.print_pdf(page, tmp_path / "report.pdf")
