"""What begins in the middle of a rig's recording: since when, what, and that the repaired machine runs with it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import dieseltwin as dt
from dieseltwin.cli.app import main
from dieseltwin.discovery.likelihood.metric import covariance_of, std_of
from dieseltwin.discovery.verdict.explain import load_details
from dieseltwin.rigs.fitting import checked_rows
from dieseltwin.rigs.parameters import RigParameters, RigTerm, load_rig, save_rig
from dieseltwin.rigs.recording import read_rig
from dieseltwin.rigs.simulate import simulate_rig
from dieseltwin.rigs.twin import RigTwin
from tests.pages import without_pictures

K, LEAK, ONSET_S, NOISE = 0.5, 0.1, 23.0, 0.005

RIG = RigParameters.model_validate({
    "name": "tank", "states": {"h": {"scale": 0.2, "unit": "m", "nearest": "level"}}, "inputs": {"q": "m/s"},
    "parameters": {"k": {"value": 0.4, "prior_std": 0.4, "scale": 0.05, "unit": "1/s"}},
    "quantities": {
        "inflow": {"formula": "q*(1 + meter)", "unit": "m/s", "site": "inlet", "ports": ["q"]},
        "balance": {"formula": "inflow - (k + leak)*h - overflow*positive(h - 5)", "unit": "m/s", "site": "tank",
                    "relative": False, "ports": ["h"]},
        "shown": {"formula": "h + offset", "unit": "m", "site": "sensor:level", "relative": False, "ports": ["h"]}},
    "rates": {"h": "balance"}, "readings": {"level": "shown"}, "sub_steps": 2, "window_s": 10.0, "first_rows": 20,
    "effects": {
        "leak": {"site": "tank", "law": "c h lost", "unit": "1/s", "tolerance": 0.01, "limits": [0.0, 1.0]},
        "overflow": {"site": "tank", "law": "over the rim", "unit": "1/s", "tolerance": 0.01, "limits": [0.0, 1.0],
                     "sizes": [0.1]},
        "meter": {"site": "inlet", "law": "q (1 + x)", "unit": "-", "tolerance": 0.01, "limits": [-0.5, 0.5]},
        "offset": {"site": "sensor:level", "law": "h + b", "unit": "m", "tolerance": 0.01, "limits": [-1.0, 1.0],
                   "sensor": True}},
})  # fmt: skip
"""The tank never comes near its rim: `overflow` shows nothing."""


def recorded(leak: float, onset_s: float, seconds: float = 50.0) -> pd.DataFrame:
    """A tank of its own, in small steps."""
    rng, parts = np.random.default_rng(5), 50
    time = np.arange(0.0, seconds, 0.1)
    flow = 0.5 + 0.3 * np.sin(2.0 * np.pi * time / 7.0) + 0.15 * np.sin(2.0 * np.pi * time / 2.3 + 1.0)
    level, shown = 1.0, np.empty(time.size)
    for k in range(time.size):
        shown[k] = level + NOISE * rng.standard_normal()
        for part in range(parts):
            into = flow[k] + part / parts * (flow[min(k + 1, time.size - 1)] - flow[k])
            level += 0.1 / parts * (into - (K + leak * (time[k] >= onset_s)) * level)
    return pd.DataFrame({"time_s": time, "q": flow, "level": shown})


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of `discover` on the first 40 of 50 s, the leak begins at 23 s."""
    folder = tmp_path_factory.mktemp("onset")
    table = recorded(LEAK, ONSET_S)
    table[:400].to_csv(folder / "early.csv", index=False)
    table[400:].to_csv(folder / "late.csv", index=False)
    save_rig(RIG, folder / "rig.yaml")
    with without_pictures():
        assert main(["discover", str(folder / "early.csv"), "--engine", str(folder / "rig.yaml"), "--out",
                     str(folder / "found")]) == 0  # fmt: skip
    return folder


def test_a_leak_that_begins_has_its_name_its_size_and_its_time(found: Path) -> None:
    (term,) = load_rig(found / "found" / "engine.yaml").terms
    assert term.effect == "leak" and term.std is not None and term.std < 0.005
    assert term.magnitude == pytest.approx(LEAK, abs=4.0 * term.std)
    assert term.onset_s == pytest.approx(ONSET_S, abs=0.5)
    page = (found / "found" / "report.html").read_text(encoding="utf-8")
    assert "since 23 s" in page and "Each as it would be since 23 s" in page


def test_the_repaired_machine_runs_on_what_comes_later(found: Path) -> None:
    rig = load_rig(found / "found" / "engine.yaml")
    for name in ("early", "late"):  # another recording: the leak is there from its first row on
        recording = read_rig(found / f"{name}.csv", rig)
        error = simulate_rig(rig, recording)["level"] - recording.readings["level"]
        assert np.sqrt(np.mean(error**2)) < 1.3 * NOISE


def test_what_has_no_name_and_begins_later_is_a_law_since_then(tmp_path: Path) -> None:
    """The leak's name is withheld: an offset and the meter explained 95 %, and were named."""
    table = recorded(LEAK, ONSET_S)
    table[:400].to_csv(tmp_path / "early.csv", index=False)
    result = dt.discover(tmp_path / "early.csv", engine=RIG, withhold=["leak"])
    assert [effect.name for effect in result.document.effects] == ["none_of_these"] and result.document.p_value < 1e-3
    location = result.document.location
    assert location is not None and location.site == "tank" and location.onset_s == pytest.approx(ONSET_S, abs=0.2)
    assert "none of the known effects: added to balance" in result.sentence and "since 23 s" in result.sentence
    smallest = result.document.minimum_detectable  # in the size of what the law leaves
    assert smallest["offset"] is not None and smallest["offset"] < 2.0 * NOISE
    result.save(tmp_path / "found")
    page = (tmp_path / "found" / "report.html").read_text(encoding="utf-8")
    assert "Each as it would be since 23 s" in page
    rig = load_rig(tmp_path / "found" / "engine.yaml")
    (law,) = rig.laws
    assert law.at == "balance" and law.onset_s == location.onset_s and not rig.terms
    for name, rows in (("early", slice(None, 400)), ("late", slice(400, None))):  # there from the first row on
        recording = read_rig(tmp_path / "early.csv" if name == "early" else table[rows], rig)
        error = simulate_rig(rig, recording)["level"] - recording.readings["level"]
        assert np.sqrt(np.mean(error**2)) < 1.3 * NOISE
    again = dt.discover(tmp_path / "early.csv", engine=rig, withhold=["leak"])
    assert not again.document.mismatch  # it is part of the machine now


@pytest.mark.parametrize("leak", [0.0, LEAK])
def test_a_machine_that_stays_as_it_is_has_no_onset(leak: float, tmp_path: Path) -> None:
    """A leak that was always there is the outlet's: no recording can tell them apart."""
    recorded(leak, 0.0, 40.0).to_csv(tmp_path / "a.csv", index=False)
    result = dt.discover(tmp_path / "a.csv", engine=RIG)
    assert result.engine.terms == () and not result.document.mismatch


def test_a_term_acts_since_its_onset_where_it_was_found_only(tmp_path: Path) -> None:
    recorded(0.0, 0.0, 20.0).to_csv(tmp_path / "a.csv", index=False)
    recording = read_rig(tmp_path / "a.csv", RIG)
    here = RigTerm(effect="offset", magnitude=0.3, onset_s=12.0, found_in=recording.sha256)
    levels = [simulate_rig(RIG.model_copy(update={"terms": terms}), recording)
              for terms in ((), (here,), (here.model_copy(update={"found_in": "another"}),))]  # fmt: skip
    shown = [frame["level"] - frame["h"] for frame in levels]
    assert not np.any(shown[0]) and np.allclose(shown[2], 0.3)
    assert np.allclose(shown[1], np.where(recording.time_s >= 12.0, 0.3, 0.0))


def test_a_fault_that_goes_again_has_both_its_times(tmp_path: Path) -> None:
    table = recorded(0.0, 0.0)
    table["level"] += 0.05 * ((table.time_s >= 20.0) & (table.time_s < 33.0))
    result = dt.discover(table, engine=RIG)
    (effect,), location = result.document.effects, result.document.location
    assert effect.name == "offset" and effect.magnitude == pytest.approx(0.05, abs=0.004) and location is not None
    assert location.onset_s == pytest.approx(20.0, abs=0.5) and location.until_s == pytest.approx(33.0, abs=0.5)
    result.save(tmp_path / "found")
    (term,) = load_rig(tmp_path / "found" / "engine.yaml").terms
    assert term.until_s == location.until_s and term.grown_s is None
    other = read_rig(recorded(0.0, 0.0, 20.0), result.engine)
    frame = simulate_rig(result.engine, other)
    assert not np.any(frame["level"] - frame["h"])  # gone again: in another recording it isn't there


def test_what_a_recording_says_nothing_of_stands_still() -> None:
    information = np.array([[4.0, 0.0, 2.0], [0.0, 0.0, 0.0], [2.0, 0.0, 9.0]])
    covariance = covariance_of(information)
    assert np.allclose(covariance[np.ix_([0, 2], [0, 2])], np.linalg.inv(information[np.ix_([0, 2], [0, 2])]))
    assert covariance[1, [0, 2]].tolist() == [0.0, 0.0] and std_of(9.0 * covariance)[1] == np.inf
    assert np.allclose(std_of(covariance)[[0, 2]], np.sqrt(np.diag(covariance)[[0, 2]]))


def test_of_an_effect_that_does_not_show_no_size_is_claimed(tmp_path: Path) -> None:
    recorded(0.0, 0.0, 40.0).to_csv(tmp_path / "a.csv", index=False)
    dt.discover(tmp_path / "a.csv", engine=RIG).save(tmp_path / "out")
    shown = {row["name"]: row["std"] for row in load_details(tmp_path / "out")["candidates"]}
    assert (shown["overflow"] or np.inf) > 1e6 > 1e3 * shown["offset"]


def test_the_date_of_a_law_is_moved_down_to_a_row() -> None:
    reaches = RigTwin(RIG, read_rig(recorded(0.0, 0.0, 40.0), RIG), 10.0).onset_reaches_s
    assert reaches[0] == pytest.approx(40.0 / 24.0) and reaches[-1] / 2.0 < 0.1 < reaches[-1]
    assert np.allclose(np.divide(reaches[:-1], reaches[1:]), 2.0)


def test_what_judges_an_onset_lies_behind_it(found: Path) -> None:
    recording = read_rig(found / "early.csv", RIG)
    assert checked_rows(recording, 0.4) == slice(240, None)
    assert checked_rows(recording, 0.4, 30.0) == slice(360, None)
