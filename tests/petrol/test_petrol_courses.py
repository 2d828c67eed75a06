"""Effects that grow, or that come and go: told as such, and the repaired engine has them only when they were there."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import dieseltwin as dt
from dieseltwin.petrol.calibrate import fit_maps
from dieseltwin.petrol.discover import discover_petrol
from dieseltwin.petrol.maps import tensor_value
from dieseltwin.petrol.parameters import PetrolParameters, PetrolTerm, load_petrol
from dieseltwin.petrol.recording import PetrolRecording, read_petrol
from dieseltwin.petrol.simulate import simulate_petrol
from dieseltwin.petrol.terms import active_sizes
from dieseltwin.report.findings import levels

Recorder = Callable[..., PetrolRecording]
FIRST_S, LENGTH_S, SINCE_S, UNTIL_S = 1000.0, 460.0, 160.0, 300.0
GROWN_SINCE_S = 80.0


def _bent(record: Recorder, tmp_path: Path, column: str, factor: Callable[[np.ndarray], np.ndarray]) -> Path:
    """A healthy drive in a file that begins at `FIRST_S`, one column times a factor over its own time."""
    table = pd.read_csv(record(31, LENGTH_S).path)
    table[column] *= factor(table.time_s.to_numpy())
    table["time_s"] += FIRST_S
    path = tmp_path / f"{column}.csv"
    table.to_csv(path, index=False)
    return path


@pytest.mark.thorough
@pytest.mark.parametrize(("column", "name", "size"), [("W_af_kg_s", "w_af_gain", 0.1), ("p_im_Pa", "p_im_gain", -0.06)])
def test_a_fault_that_goes_again(
    engine: PetrolParameters, record: Recorder, tmp_path: Path, column: str, name: str, size: float
) -> None:
    path = _bent(record, tmp_path, column, lambda t: 1.0 + size * ((t >= SINCE_S) & (t < UNTIL_S)))
    found = dt.discover(path, engine)
    effect, location = found.document.effects[0], found.document.location
    assert effect.name == name and effect.magnitude == pytest.approx(size, abs=0.01) and location is not None
    assert location.onset_s == pytest.approx(FIRST_S + SINCE_S, abs=3.0)
    assert location.until_s == pytest.approx(FIRST_S + UNTIL_S, abs=3.0)
    minutes = f"({location.onset_s / 60:.1f} to {location.until_s / 60:.1f} min)"
    assert f"from {location.onset_s:.0f} to {location.until_s:.0f} s {minutes}" in found.sentence
    for _, fitted, unrepaired in levels(found.document, "level", shift=False).rows:
        assert len(fitted.split(" ")[0].partition(".")[2]) == len(unrepaired.partition(".")[2])
    found.save(tmp_path / "out")
    assert json.loads((tmp_path / "out" / "discrepancy.json").read_text())["location"]["until_s"] == location.until_s
    repaired = load_petrol(tmp_path / "out" / "engine.yaml")
    assert not dt.discover(path, repaired).document.mismatch
    size_then = active_sizes(repaired, read_petrol(path))[name]
    assert size_then[0] == size_then[-1] == 0.0 and np.max(np.abs(size_then)) == pytest.approx(abs(size), abs=0.01)
    simulated, before = (dt.simulate(path, e).table() for e in (repaired, engine))
    read = pd.read_csv(path)
    then = (read.time_s >= FIRST_S + SINCE_S) & (read.time_s < FIRST_S + UNTIL_S)
    off = [float(np.median(np.abs(t[column.lower()] - read[column])[then])) for t in (simulated, before)]
    assert off[0] < 0.5 * off[1]


def test_a_fault_that_is_repaired_in_the_middle(engine: PetrolParameters, record: Recorder, tmp_path: Path) -> None:
    """There from the start and gone later: not the same with its sign reversed since then."""
    path = _bent(record, tmp_path, "W_af_kg_s", lambda t: 1.0 + 0.1 * (t < UNTIL_S))
    found = dt.discover(path, engine)
    effect, location = found.document.effects[0], found.document.location
    assert effect.name == "w_af_gain" and effect.magnitude == pytest.approx(0.1, abs=0.01) and location is not None
    assert location.onset_s is None and location.until_s == pytest.approx(FIRST_S + UNTIL_S, abs=3.0)
    assert "gone since then" in found.sentence


def test_a_fault_that_grows(engine: PetrolParameters, record: Recorder, tmp_path: Path) -> None:
    def grown(t: np.ndarray) -> np.ndarray:
        return 1.0 - 0.1 * np.clip((t - GROWN_SINCE_S) / (t[-1] - GROWN_SINCE_S), 0.0, 1.0)

    path = _bent(record, tmp_path, "W_af_kg_s", grown)
    found = dt.discover(path, engine)
    effect, location = found.document.effects[0], found.document.location
    assert effect.name == "w_af_gain" and effect.magnitude == pytest.approx(-0.1, abs=0.015) and location is not None
    assert location.grows and location.onset_s == pytest.approx(FIRST_S + GROWN_SINCE_S, abs=60.0)
    assert "grown evenly from nothing since" in found.sentence
    found.save(tmp_path / "out")
    assert json.loads((tmp_path / "out" / "discrepancy.json").read_text())["location"]["grows"] is True
    assert not dt.discover(path, load_petrol(tmp_path / "out" / "engine.yaml")).document.mismatch


def test_a_large_offset_since_an_onset_does_not_end(liu: Path) -> None:
    """Five minutes of a real drive with the air flow read 0.5 g/s high for good: no end is found."""
    whole = read_petrol(liu / "wltp_NF.csv")
    real = fit_maps(whole.signals, PetrolParameters(), without=(900.0, 1803.5))[0]
    piece = whole.signals.part(900.0, 1200.0)
    faulty = replace(piece, W_af=piece.W_af + 5e-4 * (piece.time_s >= 100.0))
    location = discover_petrol(replace(whole, signals=faulty), real).document.location
    assert location is not None and location.until_s is None
    assert location.onset_s == pytest.approx(whole.time0_s + 100.0, abs=3.0)


def test_what_drifts_and_levels_hide_is_said(engine: PetrolParameters, record: Recorder) -> None:
    """The drift that every balance is allowed takes up what grows slowly, the recording's own level what was there from
    the first row on: each is seen from larger sizes on, and one above what is said is found."""
    drive = record(3)
    said = discover_petrol(drive, engine).sentence.split("a gain error of the W_af reading of ")[1]
    begun, grown, always = (float(number) for number in re.findall(r"([\d.]+) %", said)[:3])
    assert grown > 1.5 * begun and always > 1.5 * begun
    s = drive.signals
    faulty = replace(drive, signals=replace(s, W_af=s.W_af * (1.0 + 1.3 * always / 100.0)))
    assert discover_petrol(faulty, engine).document.effects[0].name == "w_af_gain"


def test_simulated_beside_the_readings(engine: PetrolParameters, record: Recorder) -> None:
    term = PetrolTerm(effect="w_af_gain", magnitude=0.1)
    found = dt.simulate(record(33, 120.0), engine.model_copy(update={"terms": (term,)}))
    assert "with 1 term." in found.sentence
    assert "$W_{af}$ [kg/s]" in [axes.get_ylabel() for axes in found.plot().axes]


def test_simulated_beyond_what_was_learned(engine: PetrolParameters, record: Recorder) -> None:
    """The maps go straight on there, as they do where a recording is judged."""
    drive, (cylinder, _) = record(33, 120.0), engine.maps
    knots_x, knots_y, theta = (np.array(v) for v in (cylinder.knots_x, cylinder.knots_y, cylinder.coefficients))
    step = knots_x[1] - knots_x[0]
    times = (knots_x[-1] + 0.8 * step) / drive.signals.omega_e.max()
    faster = replace(drive, signals=replace(drive.signals, omega_e=times * drive.signals.omega_e))
    table = simulate_petrol(engine, faster)
    assert (table.omega_e_rad_s > knots_x[-1] + 0.3 * step).sum() > 20
    log_p = np.log(table.p_im_true_pa.to_numpy())
    known = np.exp(tensor_value(table.omega_e_rad_s.to_numpy(), log_p, knots_x, knots_y, theta))
    np.testing.assert_allclose(table.eta_vol, known, rtol=2e-3)


def test_terms_in_another_recording(engine: PetrolParameters, record: Recorder) -> None:
    """What went again isn't there in another recording; what had grown is, with its whole size."""
    gone = PetrolTerm(effect="w_af_gain", magnitude=0.1, onset_s=100.0, until_s=200.0, found_in="another")
    grown = PetrolTerm(effect="p_im_gain", magnitude=0.05, onset_s=100.0, grown_s=600.0, found_in="another")
    sizes = active_sizes(engine.model_copy(update={"terms": (gone, grown)}), record(33, 120.0))
    assert not sizes["w_af_gain"].any() and np.all(sizes["p_im_gain"] == 0.05)
