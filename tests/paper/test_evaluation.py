"""The evaluation's tables: printed values, cells, scores, calibration; the page holds them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dieseltwin.errors import InputError
from dieseltwin.paper import printed
from dieseltwin.paper.evaluation import tables as evaluation
from dieseltwin.paper.evaluation.page import build_page, headline
from dieseltwin.paper.evaluation.variants import variant_scores

PAPER = Path(__file__).parents[3] / "shared" / "paper" / "paper.tex"


def write_ensemble(
    root: Path, method: str, case: str, *, bias: float, spread: float, members: int = 30, variant: str = "",
    diverged: int = 0, bound: float = 0.01, seed: int = 0,
) -> None:  # fmt: skip
    folder = root / f"{method}-{case}-{variant}"
    folder.mkdir(parents=True)
    rng = np.random.default_rng(seed)
    rows = []
    for segment in range(5):
        for parameter in printed.PARAMETERS:
            # exact mean and deviation, so that a cell is known in closed form
            z = rng.standard_normal(members)
            z = (z - z.mean()) / z.std(ddof=1)
            for member in range(members):
                ratio = 1.0 + bias + spread * z[member]
                off = member < diverged and segment == 0
                rows.append(
                    {"segment": segment, "t0_s": 60.0 * segment, "t1_s": 60.0 * (segment + 1), "member": member,
                     "seed": 1, "parameter": parameter, "ratio": np.nan if off else ratio, "std": spread,
                     "low": ratio - 1.645 * spread, "high": ratio + 1.645 * spread,
                     "bound": np.inf if segment == 2 and parameter == "A_egrmax" else bound, "identifiable": True,
                     "converged": not off, "diverged": off, "chi2": 1.0}
                )  # fmt: skip
    pd.DataFrame(rows).to_parquet(folder / "members.parquet", index=False)
    about = {"method": method, "case": case, "variant": variant, "epochs": 30000}
    (folder / "ensemble.json").write_text(json.dumps(about), encoding="utf-8")
    (folder / "runtime.json").write_text(json.dumps({"seconds_per_run": [2.0] * 5}), encoding="utf-8")


@pytest.mark.skipif(not PAPER.exists(), reason=f"the paper's source is not at {PAPER}")
def test_printed_values_are_those_of_the_paper() -> None:
    text = PAPER.read_text(encoding="utf-8")
    plain = text.replace("\t", "").replace(" ", "").replace("$", "")
    for cases in printed.PARAMETER_TABLES.values():
        for minutes in cases.values():
            for cells in minutes:
                for mean, _ in cells:
                    assert f"{mean:.4f}" in plain or f"{mean:.3f}" in plain, mean
    for time in printed.TIMES.values():
        for mean, std in (time.clean_151, time.noisy_301):
            assert f"({mean:.2f},{std:.2f})" in plain
    for mean, std in (*printed.OPERATOR_ERRORS.values(), *printed.BODY_ERRORS.values()):
        assert any(f"{mean:.{d}f}\\pm{std:.{d}f}" in plain for d in (2, 3)), mean


def test_a_cell_is_bias_and_spread_and_its_t_test(tmp_path: Path) -> None:
    write_ensemble(tmp_path, "few-shot-adam", "noisy-301", bias=0.03, spread=0.04)
    table = evaluation.cells(evaluation.load_ensembles(tmp_path))
    cell = table.iloc[0]
    assert cell["mean"] == pytest.approx(1.03)
    assert cell["rmse"] == pytest.approx(0.05)
    assert cell["t"] == pytest.approx(0.03 / (0.04 / np.sqrt(30)))
    assert cell["p"] < 1e-3
    hidden = table[(table["minute"] == "2-3") & (table["parameter"] == "A_egrmax")].iloc[0]
    assert hidden["bound_class"] == "not identifiable"


def test_scores_count_the_cells_that_can_be_known(tmp_path: Path) -> None:
    write_ensemble(tmp_path, "classical", "noisy-301", bias=0.0, spread=1e-4)
    found = evaluation.load_ensembles(tmp_path)
    beside = evaluation.beside_paper(evaluation.cells(found))
    assert len(beside) == 2 * 20  # against both tables
    score = evaluation.scores(beside, found, 200).set_index(["table", "case"])
    row = score.loc[(printed.FEW_SHOT, "all")]
    assert row["cells"] == 19 and row["unscored"] == 1
    assert row["better"] == 1.0 and row["ratio"] < 0.05 and row["worse_beyond"] == 0
    assert row["low"] <= row["ratio"] <= row["high"]
    first = beside[(beside["table"] == printed.FEW_SHOT) & (beside["minute"] == "0-1")].set_index("parameter")
    assert first.loc["A_egrmax", "paper_rmse"] == pytest.approx(np.hypot(0.0301, 0.0653))


def test_a_diverged_member_is_counted_and_never_better(tmp_path: Path) -> None:
    write_ensemble(tmp_path, "few-shot-adam", "noisy-301", bias=0.0, spread=1e-4, diverged=1)
    found = evaluation.load_ensembles(tmp_path)
    beside = evaluation.beside_paper(evaluation.cells(found))
    first = beside[beside["minute"] == "0-1"]
    assert (first["diverged"] == 1).all() and not first["better"].any() and (first["members"] == 30).all()
    assert beside[beside["minute"] == "1-2"]["better"].all()
    assert evaluation.scores(beside, found, 50)["diverged"].iloc[0] == 4


def test_the_baseline_stands_for_the_first_minute_of_multi_stage(tmp_path: Path) -> None:
    write_ensemble(tmp_path, "baseline", "clean-151", bias=0.01, spread=0.01)
    beside = evaluation.beside_paper(evaluation.cells(evaluation.load_ensembles(tmp_path)))
    assert set(beside["method"]) == {"multi-stage"} and set(beside["table"]) == {printed.MULTI_STAGE}
    assert set(beside["minute"]) == {"0-1"}


def test_calibration_of_honest_deviations(tmp_path: Path) -> None:
    write_ensemble(tmp_path, "few-shot-newton", "noisy-301", bias=0.0, spread=0.02)
    table = evaluation.calibration(evaluation.load_ensembles(tmp_path))
    row = table[table["parameter"] == "h_tot"].iloc[0]
    assert row["stated_by"] == "method" and row["intervals"] == 150
    assert row["coverage"] == pytest.approx(0.9, abs=0.06)
    assert row["z_std"] == pytest.approx(1.0, abs=0.02) and row["z_mean"] == pytest.approx(0.0, abs=1e-9)


def test_without_a_stated_deviation_each_minute_has_one_interval_from_the_spread(tmp_path: Path) -> None:
    write_ensemble(tmp_path, "few-shot-adam", "noisy-301", bias=0.1, spread=0.02)
    path = next(tmp_path.glob("*/members.parquet"))
    pd.read_parquet(path).assign(std=np.nan, low=np.nan, high=np.nan).to_parquet(path)
    table = evaluation.calibration(evaluation.load_ensembles(tmp_path)).set_index("parameter")
    row = table.loc["h_tot"]
    assert row["stated_by"] == "spread of members" and row["intervals"] == 5 and row["coverage"] == 0.0
    assert row["z_mean"] == pytest.approx(5.0) and np.isnan(row["z_std"])
    assert table.loc["A_egrmax", "intervals"] == 4  # nobody can know it in the third minute


def test_the_interval_of_few_members_lies_around_their_rmse() -> None:
    rng = np.random.default_rng(2)
    truth = np.hypot(0.01, 0.02)
    lows, highs = [], []
    for _ in range(300):
        again = evaluation._resampled_rmse(1.01 + 0.02 * rng.standard_normal(6), 400, rng)
        low, high = np.quantile(again, [0.025, 0.975])
        lows.append(low <= truth)
        highs.append(truth <= high)
    assert np.mean(lows) > 0.93 and np.mean(highs) > 0.8  # a spread of six is often too small


def test_training_errors_stand_beside_the_printed_ones() -> None:
    document = {name: {"train": 0.1, "test": 0.2} for name in ("u_egr1", "u_egr2", "u_vgt")}
    bodies = [{name: {"train": 1.0 + k} for name in printed.BODY_ERRORS} for k in range(2)]
    operators, of_bodies = evaluation.training_errors({"clean": [document] * 6}, bodies)
    clean = operators[operators["labels"] == "clean"]
    assert (clean["trainings"] == 6).all()
    assert clean[(clean["output"] == "u_egr2") & (clean["recording"] == "test")]["paper"].iloc[0] == 3.64
    assert operators[operators["labels"] == "noisy"]["mean"].isna().all()
    assert of_bodies["mean"].tolist() == [1.5] * 5


def test_the_page_shows_the_tables_and_escapes_nothing_wrong(tmp_path: Path) -> None:
    for method in ("few-shot-adam", "few-shot-newton", "multi-stage", "baseline"):
        write_ensemble(tmp_path / "e", method, "noisy-301", bias=0.01, spread=0.02)
    write_ensemble(tmp_path / "e", "few-shot-adam", "noisy-301", bias=0.0, spread=0.02, variant="early stopping")
    found = evaluation.load_ensembles(tmp_path / "e")
    all_cells = evaluation.cells(found)
    beside = evaluation.beside_paper(all_cells)
    operators, bodies = evaluation.training_errors({}, [])
    scores = evaluation.scores(beside, found, 50)
    tables = {
        "cells": all_cells, "beside_paper": beside, "scores": scores, "run_times": evaluation.run_times(found),
        "operators": operators, "bodies": bodies, "maps": pd.DataFrame(columns=["kind", "map", "test_pct"]),
        "calibration": evaluation.calibration(found), "over_epochs": evaluation.over_epochs(found, {}),
        "identifiability": evaluation.identifiability(found), "variants": variant_scores(all_cells),
    }  # fmt: skip
    changed = tables["variants"].set_index("variant")
    assert set(changed["method"]) == {"few-shot-adam"} and (changed["cells"] == 19).all()
    assert changed.loc["early stopping", "ratio"] < changed.loc["", "ratio"]
    path = build_page(tables, {}, tmp_path / "page.html", figures_dir=tmp_path / "figures", about={"profile": "tiny"})
    page = path.read_text(encoding="utf-8")
    assert "0.9699 ± 0.0653" in page and "1.0100 ± 0.0200" in page
    assert "no information" in page and "early stopping" in page
    assert not re.search(r"\bnan\b", page.split("<img")[0].lower())
    assert any("of 19 cells" in line for line in headline(scores))
    assert list((tmp_path / "figures").rglob("*.svg"))
    metrics = evaluation.metrics(scores, tables["calibration"], all_cells)
    assert metrics["few-shot-adam"]["few_shot_table/better_pct"] is not None


def test_an_empty_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="ensemble"):
        evaluation.load_ensembles(tmp_path)
