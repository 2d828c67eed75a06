"""The baselines are honest: each does on an easy case what it is there for."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dieseltwin.challenge.baselines import baseline_rows, health_only, kalman, neural, run_baselines, runs
from dieseltwin.challenge.baselines.model import HIDDEN, NET_INPUTS, Bound, Net
from dieseltwin.challenge.make import make_challenge
from dieseltwin.challenge.plant import run_plant
from dieseltwin.challenge.plant_effects import Fault
from dieseltwin.challenge.records import CaseRow
from dieseltwin.challenge.routes import draw_driving
from dieseltwin.challenge.sensors import SensorSet, read
from dieseltwin.engine import HEALTH, we2011
from dieseltwin.sealed import read_json

LABORATORY = we2011.PARAMETERS.model_dump()
WORN = {**LABORATORY, "A_egrmax": LABORATORY["A_egrmax"] * 0.85, "eta_sc": LABORATORY["eta_sc"] * 1.04}


def recorded(*faults: Fault, seconds: float = 100.0) -> pd.DataFrame:
    driving = draw_driving("random", seconds, LABORATORY, np.random.default_rng(2))
    run = run_plant(driving, WORN, faults)
    return read(run, driving, faults, SensorSet.perfect(), 6, np.random.default_rng(3))


@pytest.fixture(scope="module")
def healthy() -> tuple[Bound, health_only.HealthFit]:
    bound = Bound.of(recorded(), LABORATORY)
    return bound, health_only.fit_health(bound)


@pytest.fixture(scope="module")
def leaking() -> tuple[Bound, health_only.HealthFit]:
    bound = Bound.of(recorded(Fault("boost_leak", 8e-5)), LABORATORY)
    return bound, health_only.fit_health(bound)


def test_health_parameters_are_found(healthy: tuple[Bound, health_only.HealthFit]) -> None:
    _, fit = healthy
    for name in HEALTH:
        assert fit.health[name] == pytest.approx(WORN[name], rel=0.15 if name == "h_tot" else 0.03)
    assert abs(health_only.statistics(fit)["chi2"]) < 25.0  # of 150 s the noise is known to 10 %


def test_the_twin_has_the_recordings_weather() -> None:
    low = Bound.of(recorded(seconds=60.0).assign(p_amb_pa=9.8e4, t_amb_k=285.0), LABORATORY)
    constants = low.constants({name: WORN[name] for name in HEALTH})
    assert (constants.p_amb, constants.T_amb) == (9.8e4, 285.0)
    assert Bound.of(recorded(seconds=60.0), LABORATORY).constants({}).p_amb == LABORATORY["p_amb"]


def test_a_leak_is_left_in_the_residuals(
    healthy: tuple[Bound, health_only.HealthFit], leaking: tuple[Bound, health_only.HealthFit]
) -> None:
    without, with_leak = (health_only.statistics(fit) for _, fit in (healthy, leaking))
    assert with_leak["whiteness"] > 3.0 * abs(without["whiteness"]) and with_leak["chi2"] > without["chi2"]


def test_the_filters_bias_is_the_leak(leaking: tuple[Bound, health_only.HealthFit]) -> None:
    bound, _ = leaking
    filtered = kalman.filter_biases(bound, {name: WORN[name] for name in HEALTH})
    driving = draw_driving("random", 100.0, LABORATORY, np.random.default_rng(2))
    leak = run_plant(driving, WORN, (Fault("boost_leak", 8e-5),))["w_leak_im_kg_s"]
    assert filtered[100:, 3].mean() == pytest.approx(-leak[100:].mean(), rel=0.25)
    assert abs(filtered[100:, 4].mean()) < 0.3 * leak[100:].mean()


def test_the_net_without_weights_is_the_twin(healthy: tuple[Bound, health_only.HealthFit]) -> None:
    bound, fit = healthy
    zero = Net(np.ones((HIDDEN, NET_INPUTS)), np.ones(HIDDEN), np.zeros((3, HIDDEN)), np.zeros(3),
               np.zeros(NET_INPUTS), np.ones(NET_INPUTS))  # fmt: skip
    assert (bound.simulate(fit.health, fit.local, zero) == bound.simulate(fit.health, fit.local)).all()
    constant = Net(zero.w1, zero.b1, zero.w2, np.array([-5e-3, 0.0, 0.0]), zero.middle, zero.spread)
    drawn, without = (bound.simulate(fit.health, fit.local, net)[:, 0].mean() for net in (constant, None))
    assert drawn < without


def test_the_net_learns_the_leak(leaking: tuple[Bound, health_only.HealthFit]) -> None:
    bound, fit = leaking
    net = neural.train(bound, fit, kalman.filter_biases(bound, fit.health))
    assert neural.gain_per_sample(bound, fit, net, 0) > 0.0


@pytest.mark.thorough
def test_rows_beside_the_tools(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs, "BAND_CASES", 1)
    out = tmp_path / "c"
    make_challenge(out, 2, 9, duration_s=60.0)
    hidden = out.with_name("hidden")
    shutil.move(out / "sealed", hidden)  # the baselines, too, see recordings alone
    assert run_baselines(out, limit=2) == 2
    shutil.move(hidden, out / "sealed")
    path = out / "baselines" / "case_0001.json"
    result = read_json(path, "", "")
    bands = read_json(out / "baselines" / "bands.json", "", "")
    result["statistics"] = dict.fromkeys(bands, -1.0) | {"bias shaft_power": 3.0 * bands["bias shaft_power"]}
    path.write_text(json.dumps(result))
    row = CaseRow("case_0001", "single", None, "random", (), ("blow_by",), nll_before=3.0)
    found = baseline_rows(out, [row])
    assert [found[name][0].mismatch for name in ("health only", "Kalman", "neural")] == [False, True, False]
    assert found["Kalman"][0].site == "shaft_power"
    assert found["neural"][0].nll_after == pytest.approx(3.0 - read_json(path, "", "")["later_gain"])
    assert baseline_rows(tmp_path, [row]) == {}
