"""Figures and page of a discovery: complete, self-contained, with the numbers of the document."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic_discovery as synthetic

from dieseltwin.discovery.discover import loud_channels
from dieseltwin.discovery.verdict.curves import Discovery
from dieseltwin.discovery.verdict.document import Discrepancy, with_warnings
from dieseltwin.notes import Note
from dieseltwin.report import discovery_figures, discovery_residuals, findings, over_recordings
from dieseltwin.report.discovery_page import build_discovery_report, caution, discovery_sections, of_curves
from dieseltwin.report.discovery_words import sentence
from dieseltwin.report.encoding import drawn_in_two
from dieseltwin.report.interactive import discovery_series
from dieseltwin.report.style import ReportFigure
from tests.pages import without_pictures

FIGURES = {"health", "law", "evidence_time", "evidence_map", "residual_time", "residual_map", "residual_map_actuators",
           "score", "candidates", "minimum_detectable"}  # fmt: skip


@pytest.fixture(scope="module")
def leak() -> Discovery:
    location = {**synthetic.LOCATION, "regions": [synthetic.REGION], "onset_s": 100.0}
    return synthetic.discovery(synthetic.document(location=location))


@pytest.fixture(scope="module")
def healthy() -> Discovery:
    return synthetic.discovery(Discrepancy.model_validate(synthetic.healthy_content()))


@pytest.fixture(scope="module")
def figures(leak: Discovery) -> dict[str, ReportFigure]:
    return {figure.name: figure for section in discovery_sections(leak) for figure in section.figures}


def test_every_figure_is_there_with_labels_and_units(figures: dict[str, ReportFigure]) -> None:
    assert set(figures) == FIGURES
    for figure in figures.values():
        assert len(figure.caption) > 60 and figure.title
        labels = [text for axes in figure.figure.axes for text in (axes.get_xlabel(), axes.get_ylabel()) if text]
        assert any("[" in label for label in labels), figure.name
        assert all("[" in label for label in labels), (figure.name, labels)


def test_evidence_of_an_onset_starts_there(leak: Discovery, figures: dict[str, ReportFigure]) -> None:
    middle, gain = leak.curves.evidence_over_time
    assert abs(gain[middle < 95.0].sum()) < 1e-9 < gain[middle > 105.0].sum()
    legend = figures["evidence_time"].figure.legends[0]
    assert "onset, 100 s" in [text.get_text() for text in legend.get_texts()]


def test_map_of_means_is_a_mean() -> None:
    x, y = np.array([0.1, 0.1, 0.9, 0.9]), np.array([0.1, 0.1, 0.9, 0.9])
    edges = (np.array([0.0, 0.5, 1.0]), np.array([0.0, 0.5, 1.0]))
    mean, count = discovery_figures.cell_means(x, y, np.array([1.0, 3.0, np.nan, 5.0]), edges, least=1)
    assert mean[0, 0] == 2.0 and mean[1, 1] == 5.0 and count[1, 1] == 1
    assert np.isnan(mean[0, 1]) and np.isnan(mean[1, 0])


def test_averages_show_what_single_residuals_hide(leak: Discovery) -> None:
    """The structure before is a fraction of the noise; averaged over the map it is beyond chance, after it is not."""
    curves = leak.curves
    widening = discovery_residuals.noise_of_means(curves)
    assert np.all((widening >= 1.0) & (widening < 1.3))  # the synthetic noise is white
    x, y = (curves.evidence_map[name] for name in discovery_figures.MAPS[0])
    edges = (discovery_figures.edges_of(x, 8), discovery_figures.edges_of(y, 8))
    sizes = []
    for fitted in (curves.before, curves.after):
        residual = ((curves.measured - fitted) / curves.sigma)[:, 0]
        grid = discovery_residuals.over_noise(*discovery_figures.cell_means(x, y, residual, edges, 10), 1.0)
        sizes.append(float(np.nanmean(grid**2)))
    assert sizes[0] > 1.4 > sizes[1]


@pytest.fixture(scope="module")
def plain(leak: Discovery, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a leak, beside its figures."""
    folder = tmp_path_factory.mktemp("new") / "plain"
    return build_discovery_report(leak, folder / "report.html", figures_dir=folder / "figures")


@pytest.mark.thorough
def test_figures_drawn_ahead_are_those_of_the_page(leak: Discovery, plain: Path, tmp_path: Path) -> None:
    """They are drawn while health and the effects' sizes are still those of the search, and the page is the same."""
    before = leak.document.model_copy(update={
        "health": {name: item.model_copy(update={"value": 1.1 * item.value, "std": 1.0})
                   for name, item in leak.document.health.items()},
        "effects": tuple(effect.model_copy(update={"magnitude": 1.0, "std": None}) for effect in leak.document.effects),
        "circumstances": (),
    })  # fmt: skip
    ahead = drawn_in_two(of_curves(replace(leak, document=before)))
    names = {figure.name for figure in ahead.values() if figure is not None}
    assert names == FIGURES - {"health", "law"} | {"readings"}
    page = build_discovery_report(leak, tmp_path / "report.html", figures_dir=tmp_path / "figures", ahead=ahead)
    files = [{path.name: path.read_bytes() for path in sorted(made.parent.rglob("*.*"))} for made in (plain, page)]
    assert files[0] == files[1] and len(files[0]) == 1 + len(FIGURES)
    without_files = build_discovery_report(leak, tmp_path / "two.html", ahead=ahead)
    assert without_files.read_bytes() == plain.read_bytes()


def test_page_is_self_contained_and_says_the_sentence(leak: Discovery, plain: Path) -> None:
    text = plain.read_text(encoding="utf-8")
    scripts = re.findall(r"<script[^>]*>.*?</script>", text, re.DOTALL)
    assert len(scripts) == 2 and not re.search(r"<script[^>]* src|fetch\(|XMLHttpRequest|import\(", "".join(scripts))
    outside = re.sub(r'<script[^>]*>.*?</script>|src="data:[^"]*"', "", text, flags=re.DOTALL)
    assert not re.search(r"https?://|//[a-z]|@import|url\(|<script", outside)
    words = re.sub(r"<[^>]+>", "", outside)
    start = sentence(leak.document).split(";")[0].split("with")[0]
    assert start in words
    for expected in ("41.0 ± 2.0 mm²", "compressor_efficiency_loss", "+46.9 %", "2.8150", "beneath its tolerance",
                     "0" * 64, "W_leak = A p_im/sqrt(R_a T_im)"):  # fmt: skip
        assert expected in words
    assert {path.stem for path in (plain.parent / "figures").iterdir()} == FIGURES
    assert len(text.encode()) < 4 * 1024 * 1024


def test_healthy_page_has_no_law_no_candidates_and_no_alarm(healthy: Discovery, tmp_path: Path) -> None:
    with without_pictures():
        page = build_discovery_report(healthy, tmp_path / "report.html")
    text = page.read_text(encoding="utf-8")
    assert "Nothing left out that could be seen" in text and 'class="headline"' in text
    for name in ("law", "candidates", "evidence_time", "evidence_map"):
        assert f'id="{name}"' not in text
    assert 'id="minimum_detectable"' in text


@pytest.mark.parametrize(
    ("law", "label"),
    [("added to intake_balance: -0.007 kg/s p_im/p_amb", "added to intake_balance"), ("no colon", "none_of_these")],
)
def test_a_law_without_a_name_is_drawn_as_what_it_changes(leak: Discovery, law: str, label: str) -> None:
    document = synthetic.document(effects=[{**synthetic.UNNAMED, "law": law}])
    curves = replace(leak.curves, laws=[{**leak.curves.laws[0], "name": "none_of_these", "unit": "kg/s"}])
    figure = discovery_figures.law_curves(replace(leak, document=document, curves=curves))
    assert figure is not None and figure.figure.axes[0].get_ylabel() == f"{label} [kg/s]"


def test_doubts_about_the_fit_stand_above_the_findings(leak: Discovery) -> None:
    assert caution(leak.document) == ""
    notes = [Note("more than noise is left in omega_t_rad_s", "residuals"), Note("short", "short")]
    text = caution(with_warnings(leak.document, notes))
    assert text.startswith("More than noise is left in omega_t_rad_s. Look at the residual maps")
    assert "short" not in text


def test_what_tolerances_explain_is_no_doubt_and_what_they_do_not_is_one(leak: Discovery) -> None:
    """The turbo speed of a healthy engine had a rest of 1.9 times its noise, which the maps' tolerances explain."""
    assert loud_channels(leak) == []
    curves, more = leak.curves, np.zeros_like(leak.curves.measured)
    more[:, 2] = 2.0 * synthetic.SIGMA[2] * np.sin(np.arange(len(more)) / 40.0)
    for allowed, loud in ((None, ("omega_t_rad_s",)), (more, ())):
        found = replace(leak, curves=replace(curves, measured=curves.measured + more, allowed=allowed))
        notes = loud_channels(found)
        assert sum((note.affects for note in notes), ()) == loud
        for note in notes:
            assert note.code == "residuals" and "omega_t_rad_s (1.7 times its noise)" in note
            assert note.endswith("what is named may imitate something else")
    healthy = Discrepancy.model_validate(synthetic.healthy_content())
    found = replace(leak, document=healthy, curves=replace(curves, measured=curves.measured + more))
    assert "imitate" not in loud_channels(found)[0]


def test_times_stand_apart_so_that_equal_runs_give_equal_pages(leak: Discovery, tmp_path: Path) -> None:
    with without_pictures():
        pages = [build_discovery_report(replace(leak, runtime={"total_s": total}), tmp_path / f"{total}.html")
                 for total in (9.1, 12.345)]  # fmt: skip
    assert pages[0].read_bytes() == pages[1].read_bytes()


def test_little_is_enough(leak: Discovery) -> None:
    """No law, no candidates, nothing held out, a channel with holes: still a page."""
    curves = leak.curves
    measured = curves.measured.copy()
    measured[:700, 2] = np.nan
    document = synthetic.document(
        effects=[{**synthetic.UNNAMED, "law": None}],
        fit={**synthetic.content()["fit"], "held_out_nll_before": None, "held_out_nll_after": None},
        minimum_detectable={},
    )
    poor = replace(curves, measured=measured, laws=[], candidates=[], held_out=None, evidence_map={})
    names = {f.name for s in discovery_sections(replace(leak, document=document, curves=poor)) for f in s.figures}
    assert names == {"health", "evidence_time", "residual_time", "score"}


def test_several_recordings_have_a_table_their_beginnings_and_one_word_for_when(leak: Discovery) -> None:
    """A leak that "has grown since 2026-01-15" in the sentence was there "from the start" in the table above."""
    time_s, size = leak.curves.time_s, leak.curves.time_s.size // 2
    ends = [(time_s[0], time_s[size - 1]), (time_s[size], time_s[-1])]
    recordings = [
        {"path": f"{day}.csv", "sha256": 64 * "0", "duration_s": float(last - first), "date": f"{day}T00:00:00+00:00",
         "date_from": "file name", "p_amb_pa": 1e5, "t_amb_k": 268.15, "health": synthetic.content()["health"],
         "magnitudes": {"boost_leak": {"value": value, "std": 1e-6}}}
        for day, (first, last), value in zip(("2026-01-15", "2026-03-29"), ends, (0.0, 20e-6), strict=True)
    ]  # fmt: skip
    effects = [{**synthetic.LEAK, "over_recordings": "has grown to this size since 2026-01-15"}]
    document = synthetic.document(recordings=recordings, effects=effects,
                                  location={**synthetic.LOCATION, "onset_date": "2026-01-15"})  # fmt: skip
    apart = np.concatenate([time_s[:size], time_s[size:] + 1.0])  # as recordings follow each other
    found = replace(leak, document=document, curves=replace(leak.curves, time_s=apart))
    assert [(mark.words, mark.at) for mark in discovery_series(found).marks] == [
        ("the beginnings of 2026-01-15 (2026-01-15.csv)", apart[0]),
        ("2026-03-29 (2026-03-29.csv)", apart[size]),
    ]
    (table,) = over_recordings.tables(found)
    assert [row[:2] for row in table.rows] == [("2026-01-15", "2026-01-15.csv"), ("2026-03-29", "2026-03-29.csv")]
    assert table.rows[1][4] == "−5" and table.rows[1][5] == "20.0 ± 1.0 mm²"
    shown = findings.findings(document)
    assert shown is not None and shown.rows[0][5] == "has grown to this size since 2026-01-15"
    assert "where it has grown to this size since 2026-01-15" in sentence(document)
    undated = [one.model_copy(update={"date": f"recording {k}"}) for k, one in enumerate(document.recordings, 1)]
    without_days = document.model_copy(update={"recordings": tuple(undated)})
    drawn = over_recordings.trends(replace(found, document=without_days))
    assert drawn is not None and drawn.figure.axes[0].get_xlabel() == "recording [number]"  # was January 2000
    told = over_recordings.frame(document)
    assert told["size:boost_leak"].tolist() == [0.0, 20e-6] and told["recording"].tolist() == [
        "2026-01-15.csv", "2026-03-29.csv"]  # fmt: skip
    assert over_recordings.tables(leak) == () and over_recordings.frame(leak.document).empty
