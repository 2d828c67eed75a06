"""Errors and run times beside those that the paper prints."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import stored_results as synthetic

from dieseltwin.paper.cells import cell_rmse
from dieseltwin.paper.comparison.beside_paper import paper_table
from dieseltwin.report.results import Results
from dieseltwin.report.style import ReportFigure


def test_run_times_are_logarithmic_and_beside_the_paper(figures: dict[str, ReportFigure]) -> None:
    axes = figures["run_times"].figure.axes[0]
    assert axes.get_xscale() == "log"
    names = [label.get_text() for label in axes.get_yticklabels()]
    assert names[:3] == list(synthetic.METHODS) and "paper: few-shot transfer" in names
    said = "\n".join(text.get_text() for text in axes.texts)
    assert "0.071 s per run, 90 runs" in said
    assert "138 s per run" in said


def test_cells_beside_the_paper(results: Results) -> None:
    table = paper_table(results).set_index(["minute", "parameter"])
    assert table.loc[("0–1", "A_egrmax"), "paper"] == pytest.approx(math.hypot(0.9699 - 1, 0.0653))
    newton = next(m for m in results.methods if m.method == "few-shot-newton")
    values = newton.runs[(newton.runs["segment"] == 1) & (newton.runs["parameter"] == "h_tot")]["value"]
    relative = values.to_numpy() / synthetic.TRUTH["h_tot"]
    expected = math.hypot(relative.mean() - 1, relative.std(ddof=1))
    assert table.loc[("1–2", "h_tot"), "few-shot-newton"] == pytest.approx(expected)
    assert (
        not table.loc[("2–3", "A_egrmax"), "identifiable"] and table.loc[("0–1", "A_egrmax"), "identifiable"]
    )
    assert paper_table(replace(results, truth=None)).empty


def test_runs_that_did_not_converge_count_and_those_that_diverged_do_not(results: Results) -> None:
    newton = next(m for m in results.methods if m.method == "few-shot-newton")
    cell = (newton.runs["segment"] == 1) & (newton.runs["parameter"] == "h_tot")
    runs = newton.runs.copy()
    runs.loc[cell & (runs["run"] == 0), ["value", "converged"]] = (1.5 * synthetic.TRUTH["h_tot"], False)
    runs.loc[cell & (runs["run"] == 1), "value"] = 50.0 * synthetic.TRUTH["h_tot"]
    table = paper_table(replace(results, methods=(replace(newton, runs=runs),))).set_index(["minute", "parameter"])
    ratios = runs.loc[cell & (runs["run"] != 1), "value"].to_numpy() / synthetic.TRUTH["h_tot"]
    assert table.loc[("1–2", "h_tot"), "few-shot-newton"] == pytest.approx(cell_rmse(ratios))


def test_the_error_of_a_cell_is_its_bias_and_its_spread() -> None:
    assert cell_rmse(np.array([1.02, 1.06])) == pytest.approx(math.hypot(0.04, 0.04 / math.sqrt(2.0)))
    assert cell_rmse(np.array([0.97])) == pytest.approx(0.03) and math.isnan(cell_rmse(np.array([])))
