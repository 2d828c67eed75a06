"""From an identification in memory to figures and to the files that the report is rebuilt from."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dieseltwin.engine import Inputs, we2011
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.result import Identification, SegmentEstimate, curves_table
from dieseltwin.identification.unknowns import HEALTH
from dieseltwin.report.encoding import drawn_in_two
from dieseltwin.report.html import identification_page, identification_sections
from dieseltwin.report.inputs import results_of, write_report_inputs
from dieseltwin.report.page import write_page
from dieseltwin.report.results import load_results
from dieseltwin.report.statistics import odd_channels, residuals
from dieseltwin.report.tables import summary_table
from dieseltwin.report.timeseries import residual_figure
from dieseltwin.sensors import MEASURED

RUNS = 6
SIGMA = np.array([4500.0, 5000.0, 60.0, 0.002, 20.0, 0.006])
STATES = ["p_im_pa", "p_em_pa", "omega_t_rad_s", "x_r", "t_1_k"]


def made_up(trace: pd.DataFrame, truth: Mapping[str, float] | None) -> Identification:
    """Two segments of the reference trace with estimates drawn around the true values; nothing is identified."""
    rng = np.random.default_rng(8)
    field = np.array([getattr(we2011.FIELD, name) for name in HEALTH])
    bound = field * np.array([0.005, 0.0015, 0.002, 0.02])
    problems, segments = [], []
    for t0 in (0.0, 60.0):
        rows = trace[(trace["time_s"] >= t0) & (trace["time_s"] <= t0 + 60.0)]
        columns = [rows[c].to_numpy() for c in ("time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct")]
        measured = rows[list(MEASURED)].to_numpy() + SIGMA * rng.standard_normal((len(rows), 6))
        measured[:, 5] = np.nan  # five sensors
        problems.append(
            SegmentProblem(t0, t0 + 60.0, Inputs(*columns), measured, SIGMA, we2011.PARAMETERS, truth=truth)
        )
        values = field * np.exp(0.004 * rng.standard_normal((RUNS, 4)))
        epochs = np.array([0.0, 100.0, 200.0])
        losses = np.exp(-epochs / 50)[:, None] * np.ones((3, RUNS))
        curves = {"epoch": epochs, "loss_total": losses, "eta_sc": 1.2 + 0 * epochs}
        segments.append(
            SegmentEstimate(
                t0_s=t0, t1_s=t0 + 60.0, time_s=rows["time_s"].to_numpy(), parameters=values,
                std=np.tile(bound, (RUNS, 1)),
                interval_90=np.stack([values - 1.645 * bound, values + 1.645 * bound], axis=-1),
                states=rows[STATES].to_numpy(), bound=bound, identifiable=np.array([True, True, True, t0 == 0.0]),
                converged=np.ones(RUNS, dtype=bool), seconds_per_run=0.05, method="few-shot-adam", curves=curves,
            )
        )  # fmt: skip
    return Identification("few-shot-adam", tuple(segments), tuple(problems), seconds=0.6, threshold=0.25)


@pytest.fixture(scope="module")
def found(trace: pd.DataFrame) -> Identification:
    return made_up(trace, {name: getattr(we2011.FIELD, name) for name in HEALTH})


@pytest.mark.thorough
def test_figures_of_one_identification(trace: pd.DataFrame, tmp_path: Path) -> None:
    unknown = made_up(trace, None)
    page = tmp_path / "report.html"
    results = results_of(unknown, unknown.problems, about={"recording": "drive.csv"})
    content = identification_page(results, identification_sections(results, drawn_in_two))
    write_page(content, page, tmp_path / "figures")
    paths = list((tmp_path / "figures").iterdir())
    assert "Recording: drive.csv" in page.read_text(encoding="utf-8")
    names = {path.name for path in paths}
    assert {
        "violins.svg",
        "states.png",
        "residuals_few_shot_adam.png",
        "convergence_few_shot_adam.svg",
    } <= names
    assert "run_times.svg" not in names  # no comparison with the paper's computer in one identification
    for path in paths:
        start = path.read_bytes()[:8]
        assert start == b"\x89PNG\r\n\x1a\n" if path.suffix == ".png" else start.startswith(b"<?xml")


def test_files_give_the_same_results_as_memory(
    found: Identification, trace: pd.DataFrame, tmp_path: Path
) -> None:
    folder = tmp_path / "few-shot-adam"
    folder.mkdir()
    (folder / "identification.json").write_text(json.dumps(found.to_json(), allow_nan=False))
    (folder / "runtime.json").write_text(json.dumps(found.runtime()))
    found.states.to_parquet(folder / "states.parquet")
    curves = curves_table(found)
    assert curves is not None
    curves.to_parquet(folder / "curves.parquet")
    write_report_inputs(tmp_path, found.problems, truth_states=trace, about={"title": "t"})
    stored, memory = load_results(tmp_path), results_of(found, found.problems)
    drop = ["seconds_per_run"]
    pd.testing.assert_frame_equal(
        summary_table(stored).drop(columns=drop), summary_table(memory).drop(columns=drop)
    )
    assert stored.truth == memory.truth and stored.sigma == memory.sigma
    assert stored.nominal == {name: getattr(we2011.PARAMETERS, name) for name in HEALTH}
    pd.testing.assert_frame_equal(stored.methods[0].runs, memory.methods[0].runs)
    assert stored.measured is not None and not stored.measured["time_s"].duplicated().any()


def test_curves_in_long_form(found: Identification) -> None:
    curves = curves_table(found)
    assert curves is not None
    losses = curves[curves["quantity"] == "loss_total"]
    assert len(losses) == 2 * 3 * RUNS and set(losses["epoch"]) == {0.0, 100.0, 200.0}
    assert set(curves[curves["quantity"] == "eta_sc"]["run"]) == {0}
    assert "epoch" not in set(curves["quantity"])


def test_residuals_by_hand(found: Identification) -> None:
    results = results_of(found, found.problems)
    columns = residuals(results, results.methods[0])
    assert "w_c_kg_s" not in columns  # masked: nothing was measured
    time, values = columns["p_im_pa"]
    problem, segment = found.problems[0], found.segments[0]
    by_hand = (problem.measured[:, 0] - segment.states[:, 0]) / SIGMA[0]
    assert np.allclose(values[: len(by_hand)], by_hand) and np.allclose(time[: len(by_hand)], problem.time_s)
    assert 0.9 < values.std() < 1.1


def test_residuals_that_are_not_noise_are_named(found: Identification) -> None:
    results = results_of(found, found.problems)
    columns = residuals(results, results.methods[0])
    assert odd_channels(columns) == {"large": [], "small": [], "coloured": []}
    time, values = columns["t_em_k"]
    wave = values + 0.8 * np.sin(time / 3)
    odd = odd_channels({**columns, "t_em_k": (time, wave), "p_im_pa": (time, 0.5 * columns["p_im_pa"][1])})
    assert odd == {"large": ["t_em_k"], "small": ["p_im_pa"], "coloured": ["t_em_k"]}
    figure = residual_figure(results, results.methods[0])
    assert figure is not None and "look like the sensors' noise" in figure.caption
