"""Settled points of a simulated engine through `calibrate`, `discover` and `imply`: a planted flap or nothing.

The engine has 10.8 l, other wheels and other maps than the base; the flap behind its turbine narrows as it closes. The
readings have 0.5 % noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import dieseltwin as dt
from dieseltwin.calibration import calibrate as calibration
from dieseltwin.calibration.calibrate import calibrate
from dieseltwin.calibration.discover import discover_points
from dieseltwin.calibration.saved import load_repaired
from dieseltwin.calibration.verdict import document
from dieseltwin.cli.app import main
from dieseltwin.discovery.verdict.document import Discrepancy, load_discrepancy
from dieseltwin.engine import load_engine, we2011
from dieseltwin.engine.terms import Term, effect_terms
from dieseltwin.recordings.steady_points import STATES, SteadyPoints
from dieseltwin.report.discovery_words import magnitude_words
from dieseltwin.report.points import sentence
from tests.calibration.simulated import FLAP, GEOMETRY, TRUTH, made_points
from tests.pages import check_page, groups_of, without_pictures

FLAP_K = FLAP["exhaust_flap"]
"""Back-pressure coefficient of the planted flap at 50 % [Pa/(kg/s)^2]."""


@dataclass(frozen=True)
class Calibrated:
    """Points in a file and the engine file that `calibrate` made of them."""

    points: Path
    engine: Path
    found: Path

    @property
    def document(self) -> Discrepancy:
        """What `discover` says of the points."""
        return load_discrepancy(self.found)


@pytest.fixture(scope="session")
def flap(tmp_path_factory: pytest.TempPathFactory) -> Calibrated:
    """An engine with a flap, through the commands."""
    folder = tmp_path_factory.mktemp("flap")
    machine = Calibrated(folder / "points.csv", folder / "engine.yaml", folder / "found")
    pd.DataFrame(dict(made_points(count=100, noise=0.005, effects=FLAP).columns)).to_csv(machine.points, index=False)
    shape = folder / "geometry.yaml"
    shape.write_text("".join(f"{name}: {getattr(GEOMETRY, name)}\n" for name in ("V_d", "r_c", "R_c", "R_t")))
    with without_pictures():
        assert main(["calibrate", str(machine.points), "--geometry", str(shape), "--out", str(machine.engine)]) == 0
    assert main(["discover", str(machine.points), "--engine", str(machine.engine), "--out", str(machine.found)]) == 0
    return machine


def test_a_flap_is_found_and_sized(flap: Calibrated) -> None:
    verdict = flap.document
    assert verdict.mismatch and verdict.recording.duration_s == 0.0
    assert verdict.location is not None and verdict.location.site == "turbine_flow"
    assert verdict.location.probability > 0.95
    (effect,) = verdict.effects
    assert effect.name == "exhaust_flap" and effect.std is not None and effect.magnitude is not None
    assert effect.magnitude == pytest.approx(FLAP_K, rel=0.15)
    assert abs(effect.magnitude - FLAP_K) < 2.0 * effect.std
    assert not verdict.more_is_missing


def test_the_size_is_one_everywhere(flap: Calibrated) -> None:
    (effect,) = flap.document.effects
    (term,) = effect_terms(load_engine(flap.found / "repaired.yaml").terms)
    assert isinstance(term, Term) and term.effect == "exhaust_flap"
    assert (term.magnitude, term.std) == (effect.magnitude, effect.std)
    assert magnitude_words(effect.name, effect.magnitude or 0.0, effect.std, effect.unit) in (
        flap.found / "report.html").read_text()  # fmt: skip


def test_the_page_shows_points_and_the_law_over_its_argument(flap: Calibrated) -> None:
    check_page(flap.found / "report.html", "pes=pamb+kexp(−my−qy2)Wt2Tem700K")
    check_page(flap.engine.with_suffix(".html"))
    by_point, by_flap, parity, implied = groups_of(flap.found / "report.html")
    assert by_point["linked"] and len(by_point["panels"]) == 6 and len(parity["panels"]) == 6
    assert "(u_flap_pct)" in by_flap["panels"][0]["axis"] and not by_flap["linked"] and len(implied["panels"]) == 4
    before, after = (np.array(line["y"]) for line in by_flap["panels"][0]["lines"])
    assert np.sqrt(np.mean(after**2)) < 0.5 * np.sqrt(np.mean(before**2))
    assert flap.document.fit.share_explained is not None and flap.document.fit.share_explained > 0.9


def test_simulate_foretells_settled_points_better_with_the_repaired_machine(flap: Calibrated, tmp_path: Path) -> None:
    points = pd.read_csv(flap.points).iloc[:6]
    hold = np.arange(0.0, 40.0, 1.0)
    inputs = pd.DataFrame({name: np.repeat(points[name], hold.size) for name in
                           ("n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct", "u_flap_pct")})
    inputs.insert(0, "time_s", np.arange(len(inputs), dtype=float))
    inputs.to_csv(tmp_path / "held.csv", index=False)
    error = {}
    for name, engine in (("before", flap.engine), ("after", flap.found / "repaired.yaml")):
        out = tmp_path / f"{name}.csv"
        assert main(["simulate", str(tmp_path / "held.csv"), "--engine", str(engine), "--out", str(out)]) == 0
        settled = pd.read_csv(out).iloc[hold.size - 1 :: hold.size]
        error[name] = np.log(settled["w_c_kg_s"].to_numpy() / points["w_c_kg_s"].to_numpy())
    assert np.sqrt(np.mean(error["after"] ** 2)) < 0.5 * np.sqrt(np.mean(error["before"] ** 2))


@pytest.mark.thorough
def test_the_repaired_machine_calls_for_nothing_more(flap: Calibrated, tmp_path: Path) -> None:
    again = tmp_path / "again"
    with without_pictures():
        repaired = str(flap.found / "repaired.yaml")
        assert main(["discover", str(flap.points), "--engine", repaired, "--out", str(again)]) == 0
    assert not load_discrepancy(again).mismatch


def test_the_held_out_third_is_met_better(flap: Calibrated) -> None:
    fit = flap.document.fit
    assert fit.held_out_nll_before is not None and fit.held_out_nll_after is not None
    assert fit.held_out_nll_before - fit.held_out_nll_after > 2.0
    assert fit.chi2_per_sample_before is not None and fit.chi2_per_sample_after is not None
    assert fit.chi2_per_sample_after < 0.8 * fit.chi2_per_sample_before


def test_the_calibrated_engine_is_the_planted_one(flap: Calibrated) -> None:
    engine = load_engine(flap.engine)
    assert (engine.V_d, engine.r_c) == (GEOMETRY.V_d, GEOMETRY.r_c)
    repaired = load_engine(flap.found / "repaired.yaml")
    assert repaired.A_vgtmax == pytest.approx(TRUTH.A_vgtmax, rel=0.1)
    assert repaired.c_vol[2] == pytest.approx(TRUTH.c_vol[2], rel=0.03)


def test_what_nobody_measured_is_implied(flap: Calibrated, tmp_path: Path) -> None:
    out = tmp_path / "implied.csv"
    assert main(["imply", str(flap.points), "--engine", str(flap.found / "repaired.yaml"), "--out", str(out)]) == 0
    implied, points = pd.read_csv(out), pd.read_csv(flap.points)
    assert len(implied) == len(points) and np.isfinite(implied["p_es_pa"]).all()
    assert (implied["p_es_pa"] > TRUTH.p_amb - 2.0 * implied["p_es_pa_std"]).all()
    shut = points["u_flap_pct"] < 40.0
    assert implied.loc[shut, "p_es_pa"].median() > implied.loc[~shut, "p_es_pa"].median()


@pytest.fixture
def one_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """`calibrate` from the nominal engine alone, where the calibrated engine isn't what is asked."""
    monkeypatch.setattr(calibration, "STARTS", 0)


@pytest.mark.thorough
@pytest.mark.usefixtures("one_start")
def test_points_of_the_model_itself_call_for_nothing() -> None:
    found = discover_points(calibrate(made_points(count=100, noise=0.005), we2011.PARAMETERS, GEOMETRY))
    verdict = document(found)
    assert not verdict.mismatch and verdict.effects == () and verdict.location is None
    assert verdict.fit.held_out_nll_after == verdict.fit.held_out_nll_before
    assert sentence(found).startswith("The 100 points call for nothing") and "--reference" in sentence(found)
    assert 0.3 < verdict.fit.chi2_per_sample_after < 2.0  # small EGR flows tell little, and count as little
    assert verdict.warnings == ()


def test_withheld_channels_fall_into_their_intervals(flap: Calibrated) -> None:
    """Other points of the same engine, one state left out at a time."""
    fresh = made_points(count=60, noise=0.005, seed=11, effects=FLAP)
    answers = load_repaired(flap.found / "repaired.yaml").answers  # as `imply` does, but once for all of them
    inside = []
    for column in STATES:
        implied = answers(SteadyPoints({c: v for c, v in fresh.columns.items() if c != column}, fresh.row))
        inside.append(np.abs(implied[column] - fresh[column]) < 1.645 * implied[f"{column}_std"])
    assert 0.85 <= np.mean(inside) <= 0.99


@pytest.mark.thorough
@pytest.mark.usefixtures("one_start")
def test_a_flap_that_nobody_recorded_is_something_behind_the_turbine(flap: Calibrated, tmp_path: Path) -> None:
    points = pd.read_csv(flap.points).drop(columns="u_flap_pct").iloc[::2]
    points.to_csv(tmp_path / "points.csv", index=False)
    shape = flap.points.parent / "geometry.yaml"
    with without_pictures():
        dt.calibrate(tmp_path / "points.csv", geometry=shape).save(tmp_path / "engine.yaml")
    found = dt.discover(tmp_path / "points.csv", engine=tmp_path / "engine.yaml")
    assert found.document.more_is_missing
    assert found.document.location is not None and found.document.location.site == "turbine_flow"
    assert "relative change of W_t" in found.sentence
