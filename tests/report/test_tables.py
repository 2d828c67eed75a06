"""The tables hold the numbers of the documents, and the headline says them right."""

from __future__ import annotations

import json
import math
from html import unescape
from pathlib import Path

import numpy as np
import pytest
import stored_results as synthetic

from dieseltwin.report import quantities
from dieseltwin.report.html import identification_page, identification_sections
from dieseltwin.report.results import PARAMETERS, Results, load_results, method_from_document
from dieseltwin.report.statistics import autocorrelation
from dieseltwin.report.tables import headline, segment_table, summary_table, summary_text


def test_summary_equals_the_documents(stored: Path, results: Results) -> None:
    table = summary_table(results).set_index(["method", "parameter"])
    for method in synthetic.METHODS:
        document = json.loads((stored / method / "identification.json").read_text())
        for parameter in PARAMETERS:
            row, entry = table.loc[(method, parameter)], document["parameters"][parameter]
            assert row["mean"] == entry["mean"] and row["std"] == entry["std"]
            assert [row["low"], row["high"]] == entry["interval_90"]
            assert row["error"] == pytest.approx(entry["mean"] / synthetic.TRUTH[parameter] - 1)
            flags = [s["parameters"][parameter]["identifiable"] for s in document["segments"]]
            assert (row["segments_identifiable"], row["segments"]) == (sum(flags), len(flags))
            assert row["runs"] == synthetic.METHODS[method][3]
            assert row["seconds_per_run"] == synthetic.METHODS[method][4]


def test_ratio_to_bound_by_hand(stored: Path, results: Results) -> None:
    document = json.loads((stored / "few-shot-newton" / "identification.json").read_text())
    squares = []
    for segment in document["segments"]:
        entry = segment["parameters"]["A_egrmax"]
        if entry["identifiable"]:
            values = [
                part["parameters"]["A_egrmax"]["value"]
                for run in document["runs"] for part in run["segments"] if part["t0_s"] == segment["t0_s"]
            ]  # fmt: skip
            squares.append(
                np.mean((np.array(values) - synthetic.TRUTH["A_egrmax"]) ** 2) / entry["bound"] ** 2
            )
    table = summary_table(results).set_index(["method", "parameter"])
    assert table.loc[("few-shot-newton", "A_egrmax"), "ratio_to_bound"] == pytest.approx(
        math.sqrt(np.mean(squares))
    )


def test_segment_table_has_every_cell(results: Results) -> None:
    table = segment_table(results)
    assert len(table) == len(results.methods) * len(results.segments) * len(PARAMETERS)
    row = table.iloc[0]
    assert row["truth_inside"] == (row["low"] <= synthetic.TRUTH[row["parameter"]] <= row["high"])


def test_headline_says_values_changes_blind_spots_and_time(results: Results) -> None:
    words = headline(results)
    estimate = results.methods[0].pooled["A_egrmax"]
    assert quantities.value_with_std("A_egrmax", estimate.mean, estimate.std) in words
    assert "25 % below nominal" in words and "14 % below nominal" in words
    flagged = results.methods[0].segments[synthetic.SHUT].parameters["A_egrmax"]
    bound = f"{100 * flagged.bound / flagged.mean:.0f} %"
    assert f"In minute 2–3, <i>A</i><sub>egrmax</sub> (best possible std {bound})" in words
    assert "0.071 s per run (90 runs" in words
    assert "few-shot-newton" in words and "few-shot-adam" in words


def test_headline_never_looks_at_the_truth_for_its_choice(results: Results) -> None:
    from dataclasses import replace

    assert headline(replace(results, truth=None)).split("finds")[0] == headline(results).split("finds")[0]
    chosen = replace(results, about={**results.about, "headline_method": "few-shot-adam"})
    assert "<b>few-shot-adam</b> finds" in headline(chosen)


def test_a_change_within_its_uncertainty_is_no_finding() -> None:
    document = synthetic.document("classical")
    entry = document["parameters"]["h_tot"]
    entry.update(mean=1.02 * synthetic.NOMINAL["h_tot"], std=0.02 * synthetic.NOMINAL["h_tot"])
    words = headline(Results(methods=(method_from_document(document),), nominal=synthetic.NOMINAL))
    assert "(as nominal, within its uncertainty)" in words


def test_headline_begins_with_health_beside_tolerances_where_it_was_fitted() -> None:
    document = synthetic.document("classical")
    entry = document["parameters"]["eta_sc"]
    document["with_tolerances"] = {"eta_sc": {**entry, "std": 5.0 * entry["std"]}}
    words = headline(Results(methods=(method_from_document(document),), nominal=synthetic.NOMINAL))
    beside, alone = words.split("With exact ones")
    text = quantities.value_with_std("eta_sc", entry["mean"], 5.0 * entry["std"])
    assert text in beside and "maps and sensors may be off by" in beside and "<i>h</i>" not in beside
    assert "<b>classical</b> finds" in alone


def test_a_twin_that_does_not_fit_is_said_before_the_numbers() -> None:
    document = synthetic.document("classical")
    document["warnings"] = [{"code": "reading", "text": "read with decimal comma", "affects": []},
                            {"code": "misfit", "text": "the twin doesn't fit: see `discover`", "affects": []}]
    results = Results(methods=(method_from_document(document),), nominal=synthetic.NOMINAL)
    assert unescape(headline(results)).startswith("The twin doesn't fit: see <code>discover</code>. From ")
    page = identification_page(results, identification_sections(results))
    doubts = next(section for section in page.sections if section.id == "doubts")
    assert page.alarm and [row[0] for row in doubts.tables[0].rows] == ["reading", "misfit"]
    fits = Results(methods=(method_from_document(synthetic.document("classical")),), nominal=synthetic.NOMINAL)
    assert headline(fits).startswith("From ") and not identification_page(fits, []).alarm


def test_commands_stand_as_code_and_names_as_symbols_beside_them() -> None:
    said = quantities.with_symbols("h_tot < 1: `discover --engine h_tot.yaml`, then `x`")
    assert said == "<i>h</i><sub>tot</sub> &lt; 1: <code>discover --engine h_tot.yaml</code>, then <code>x</code>"


def test_disagreeing_method_is_named() -> None:
    one, other = synthetic.document("classical"), synthetic.document("few-shot-newton")
    other["parameters"]["eta_sc"]["mean"] *= 1.2
    words = headline(Results(methods=(method_from_document(one), method_from_document(other))))
    assert (
        "few-shot-newton differs by more than two combined standard deviations on <i>η</i><sub>sc</sub>"
        in words
    )


def test_diverged_runs_are_counted_and_left_out() -> None:
    method = method_from_document(synthetic.document("classical", diverged=True))
    results = Results(methods=(method,), truth=synthetic.TRUTH)
    table = summary_table(results)
    assert set(table["not_converged"]) == {10 * len(method.segments)}
    assert table["ratio_to_bound"].max() < 5  # the diverged runs are 30-300 % off: hundreds of bounds
    assert "50 of 150 runs did not converge" in headline(results)


def test_a_method_that_never_converged_is_told() -> None:
    document = synthetic.document("few-shot-adam")
    for run in document["runs"]:
        for part in run["segments"]:
            part["converged"] = False
    other = method_from_document(synthetic.document("classical"))
    words = headline(Results(methods=(other, method_from_document(document))))
    assert "few-shot-adam (none of whose runs had converged)" in words


def test_nothing_identifiable_is_said() -> None:
    method = method_from_document(synthetic.document("classical", nothing=True))
    results = Results(methods=(method,), truth=synthetic.TRUTH)
    assert "could not identify any health parameter" in headline(results)
    assert not summary_table(results)["identifiable"].any()
    assert "not identifiable" in summary_text(results)


def test_terminal_table_has_a_line_per_method_and_parameter(stored: Path) -> None:
    lines = summary_text(load_results(stored)).splitlines()
    assert len(lines) == 1 + len(synthetic.METHODS) * len(PARAMETERS)
    assert lines[0].split() == [
        "method",
        "parameter",
        "estimate",
        "±",
        "std",
        "error",
        "ratio",
        "to",
        "bound",
        "s",
        "per",
        "run",
    ]


@pytest.mark.parametrize(
    ("name", "mean", "std", "text"),
    [
        ("A_egrmax", 3.0012e-4, 7.1e-7, "300.12 ± 0.71 mm²"),
        ("eta_sc", 1.20054, 0.0012, "1.2005 ± 0.0012"),
        ("h_tot", 96.3, 24.0, "96 ± 24 W/(m² K)"),
        ("p_im_pa", 150000.0, math.nan, "150.0 kPa"),
        ("h_tot", math.nan, 1.0, "–"),
    ],
)
def test_values_are_rounded_by_their_std(name: str, mean: float, std: float, text: str) -> None:
    assert quantities.value_with_std(name, mean, std) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0041, "+0.41 %"), (-0.00001, "0.00 %"), (-0.251, "−25.1 %"), (3.2, "+320 %"), (math.nan, "–")],
)
def test_percentages(value: float, text: str) -> None:
    assert quantities.percent(value, signed=True) == text


def test_autocorrelation_of_known_series() -> None:
    alternating = np.array([1.0, -1.0] * 50)
    assert autocorrelation(alternating, 2) == pytest.approx([1.0, -0.99, 0.98])
    assert np.isnan(autocorrelation(np.ones(10), 3)).all()
