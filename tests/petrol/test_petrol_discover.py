"""Faults in a made-up engine and in real recordings are found, named, sized and dated; healthy ones are left alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dieseltwin.api.petrol import recording_notes
from dieseltwin.challenge.petrol_plant import ONSET_S
from dieseltwin.discovery.likelihood.fit import Linearisation
from dieseltwin.discovery.likelihood.score import best_of_each, score
from dieseltwin.discovery.search.variants import redated
from dieseltwin.discovery.twins.interface import Lanes
from dieseltwin.discovery.verdict.document import NONE_OF_THESE, Discrepancy
from dieseltwin.discovery.verdict.reasons import candidate_rows
from dieseltwin.errors import InputError
from dieseltwin.petrol.blocks import blocks_of, make_grid
from dieseltwin.petrol.calibrate import fit_maps, pieces
from dieseltwin.petrol.discover import discover_petrol, judge, next_single
from dieseltwin.petrol.effects import HYPOTHESES, undo
from dieseltwin.petrol.parameters import PetrolParameters, load_petrol, save_petrol
from dieseltwin.petrol.recording import PetrolRecording, gaps, read_petrol
from dieseltwin.petrol.simulate import beyond_maps, simulate_petrol
from dieseltwin.petrol.twin import PetrolTwin
from dieseltwin.report.petrol import petrol_page

Recorder = Callable[..., PetrolRecording]
CASES = [
    ({"p_im_Pa": -0.10}, "p_im_gain", -0.10),
    ({"p_ic_Pa": 0.05}, "p_ic_gain", 0.05),
    ({"W_af_kg_s": 0.10}, "w_af_gain", 0.10),
    ({"W_af_kg_s": -0.08}, "w_af_gain", -0.08),
    ({"leak_m2": 1.5e-6}, "intake_leak", 1.5e-6),
    ({"leak_m2": 1.5e-5}, "intake_leak", 1.5e-5),
    ({"T_amb_K": 0.05}, "t_amb_offset", 14.9),
]


@pytest.mark.parametrize(("fault", "name", "size"), CASES, ids=[f"{n} {s:g}" for _, n, s in CASES])
def test_planted_fault(engine: PetrolParameters, record: Recorder, fault: dict, name: str, size: float) -> None:
    found = discover_petrol(record(2, 400.0, **fault), engine)
    d = found.document
    assert d.mismatch and d.location is not None
    assert d.effects[0].name == name and d.location.site == HYPOTHESES[name].site
    assert d.effects[0].magnitude == pytest.approx(size, rel=0.15)
    assert d.location.onset_s == pytest.approx(ONSET_S, abs=8.0)
    assert d.location.until_s is None and not d.location.grows  # one size since then
    assert not {"until_s", "grows"} & set(d.to_json()["location"])
    assert d.fit.held_out_nll_after is not None and d.fit.held_out_nll_before is not None
    assert d.fit.held_out_nll_after < d.fit.held_out_nll_before
    assert f"({name})" in found.sentence and "−0.0 %" not in found.sentence
    reading = d.location.site.removeprefix("sensor:")
    where = reading.replace("_", " ") if reading == d.location.site else f"reading {reading}"
    assert found.sentence.startswith(f"In the {where}: ")


@pytest.mark.parametrize(("column", "name"), [("W_af", "w_af_kg_s"), ("p_im", "p_im_pa")])
def test_a_reading_that_never_moves_is_refused(engine: PetrolParameters, record: Recorder, column: str,
                                               name: str) -> None:  # fmt: skip
    signals = record(3).signals
    dead = replace(signals, **{column: np.full_like(signals.p_im, np.median(getattr(signals, column)))})
    with pytest.raises(InputError, match=f"column {name}: got the same reading"):
        PetrolTwin(engine, dead)


def test_driving_that_never_idles_is_judged(engine: PetrolParameters, record: Recorder) -> None:
    whole = PetrolTwin(engine, record(3).signals)
    at_idle = np.isfinite(whole.measured[:, whole.channels.index("boost")])
    beside = np.convolve(at_idle, np.ones(9), "same") > 0.0
    rows = ~beside[whole.grid.index]
    driving = {name: values[rows] for name, values in vars(whole.signals).items() if values is not None}
    twin, found = judge(engine, replace(whole.signals, **driving))
    assert at_idle.any() and not np.isfinite(twin.measured[:, twin.channels.index("boost")]).any()
    assert found.kind == "healthy"


@pytest.mark.parametrize("seed", [3, 4])
def test_healthy(engine: PetrolParameters, record: Recorder, seed: int) -> None:
    found = discover_petrol(record(seed), engine)
    d = found.document
    assert not d.mismatch and d.effects == () and d.location is None
    assert d.minimum_detectable["p_ic_gain"] < 0.05
    page = petrol_page(found)
    words = " ".join(s.words + ("" if s.series is None else s.series.drawn.caption) for s in page.sections)
    assert "as read" in words and not any(word in words for word in ("repaired", "Orange", "it acts", "Dashed"))


def test_an_effect_that_strains_a_level_is_scored_as_its_refit_is(
    engine: PetrolParameters, record: Recorder
) -> None:
    """A level within a narrow prior takes up most of a wrong p_ic; what that costs counts in the linear scores too."""
    healthy = record(5, 300.0).signals
    _, found = judge(engine, replace(healthy, p_ic=1.05 * healthy.p_ic))
    refit = next(fit for fit in found.singles if fit.candidate.names == ("p_ic_gain",))
    scored = best_of_each([item for item in found.scored if item.name == "p_ic_gain"])[0]
    assert found.gain(refit) > 100.0 and scored.gain == pytest.approx(found.gain(refit), rel=0.1)
    since = redated(found.null, "p_ic_gain", 0.05, found.settings.least_share)
    assert since.gain == pytest.approx(score(found.null, [("p_ic_gain", 0.05)], since.response[None])[0].gain, rel=0.01)


def test_a_name_whose_size_goes_in_its_own_metric_makes_way(engine: PetrolParameters, record: Recorder) -> None:
    healthy = record(5, 300.0).signals
    _, found = judge(engine, replace(healthy, W_af=1.1 * healthy.W_af))
    wrong = replace(found.singles[1], magnitudes=np.zeros(1))
    found.singles, found.kind = [wrong, *found.singles], "single"
    found.best = Linearisation(found.twin, found.whitening, wrong, found.null)
    next_single(found)
    assert found.best is not None and found.best.fit.candidate.names == ("w_af_gain",)
    assert found.of_interest(found.best.fit) and wrong not in found.singles


def test_what_is_not_chosen_is_not_compared_with_a_choice(engine: PetrolParameters, record: Recorder) -> None:
    _, found = judge(engine, record(2, 400.0, W_af_kg_s=0.10).signals)
    found.kind, found.best, found.equivalent = "healthy", None, [("w_af_gain",), ("p_im_gain",)]
    assert not any("the chosen one" in row["reason"] for row in candidate_rows(found))


SENSORS = [("p_im_gain", "p_im", -0.1), ("p_ic_gain", "p_ic", 0.1), ("w_af_gain", "W_af", 0.2),
           ("throttle_gain", "alpha", 0.05), ("p_amb_gain", "p_amb", -0.05)]  # fmt: skip


@pytest.mark.parametrize(("name", "channel", "size"), SENSORS, ids=[s[0] for s in SENSORS])
def test_twin_foretells_the_misfit_of_a_faulty_sensor(
    record: Recorder, engine: PetrolParameters, name: str, channel: str, size: float
) -> None:
    healthy = record(5, 120.0).signals
    twin = PetrolTwin(engine, replace(healthy, **{channel: getattr(healthy, channel) * (1.0 + size)}))
    lane = Lanes(np.zeros((1, len(twin.parameters))), twin.first_local()[None], {name: np.array([size])})
    foretold, true = twin.simulate(lane)[0], PetrolTwin(engine, healthy).plain
    difference = np.abs(twin.plain - foretold - true)[np.isfinite(twin.measured)]
    assert np.median(difference) < 5e-4 and np.quantile(difference, 0.95) < 0.01
    assert np.abs(foretold).max() > 0.3 * abs(size)


def test_what_is_known_of_the_recording_changes_no_bit(record: Recorder, engine: PetrolParameters) -> None:
    """Blocks next to an effect are the same whether what it leaves as it is was worked out before or not."""
    twin = PetrolTwin(engine, record(5, 120.0).signals)
    for name, hypothesis in HYPOTHESES.items():
        signals = undo(name, hypothesis.tolerance, twin.signals)
        anew = blocks_of(signals, twin.grid, engine.volumes.geometry)
        for _ in range(2):
            known = blocks_of(signals, twin.grid, engine.volumes.geometry, once=twin.once)
            assert all(np.array_equal(a, b) for a, b in zip(vars(known).values(), vars(anew).values(), strict=True))
    same = twin.once("x", lambda: 2.0 * signals.p_im, twin.signals.p_im)
    assert twin.once("x", lambda: 3.0 * signals.p_im, twin.signals.p_im) is same
    assert twin.once("x", lambda: signals.p_ic, twin.signals.p_ic) is not same


def test_no_effect_leaves_no_misfit_to_be_expected(record: Recorder, engine: PetrolParameters) -> None:
    twin = PetrolTwin(engine, record(5, 120.0).signals)
    lanes = Lanes(np.zeros((1, len(twin.parameters))), twin.first_local()[None],
                  {name: np.zeros(1) for name in HYPOTHESES})  # fmt: skip
    assert np.all(twin.simulate(lanes) == 0.0)


def test_gaps_split_the_recording(engine: PetrolParameters, record: Recorder, tmp_path: Path) -> None:
    table = pd.read_csv(record(12, 300.0, onset_s=120.0, p_im_Pa=-0.1).path)
    holed = table[~table.time_s.between(60.3, 62.1) & ~table.time_s.between(220.0, 260.0)]
    holed.to_csv(tmp_path / "holed.csv", index=False)
    recording = read_petrol(tmp_path / "holed.csv")
    assert list(np.diff(gaps(recording.signals.time_s)) > 1000) == [True, True]
    d = discover_petrol(recording, engine).document
    assert d.effects[0].name == "p_im_gain" and d.location is not None
    assert d.location.onset_s == pytest.approx(120.0, abs=8.0)
    assert np.isfinite(simulate_petrol(engine, recording).to_numpy()).all()


def rms_errors(engine: PetrolParameters, recording: PetrolRecording) -> dict[str, float]:
    """Root mean square difference between simulated and measured p_im [Pa] and W_af [kg/s]."""
    table, s = simulate_petrol(engine, recording), recording.signals
    return {
        "p_im_pa": float(np.sqrt(np.mean((table.p_im_pa.to_numpy() - s.p_im) ** 2))),
        "w_af_kg_s": float(np.sqrt(np.mean((table.w_af_kg_s.to_numpy() - s.W_af) ** 2))),
    }


@pytest.mark.thorough
def test_repaired_engine_is_quiet_and_simulates_the_readings(engine: PetrolParameters, record: Recorder) -> None:
    first, later = record(13, 500.0, p_im_Pa=0.1), record(14, 300.0, onset_s=0.0, p_im_Pa=0.1)
    repaired = discover_petrol(first, engine).engine
    assert [t.effect for t in repaired.terms] == ["p_im_gain"]
    for recording in (first, later):  # the recording that it was found in, and another one with it all along
        assert not discover_petrol(recording, repaired).document.mismatch
        before, after = (rms_errors(e, recording) for e in (engine, repaired))
        assert after["p_im_pa"] < 0.5 * before["p_im_pa"]
        assert after["w_af_kg_s"] == pytest.approx(before["w_af_kg_s"], rel=0.01)


@pytest.mark.thorough
def test_a_late_channel_is_named_and_simulated(engine: PetrolParameters, record: Recorder, tmp_path: Path) -> None:
    """Half a second late from a moment on: told by name, size and onset, and the repaired engine foretells it."""
    table = pd.read_csv(record(16, 500.0).path)
    late = table.time_s.to_numpy() >= ONSET_S
    shifted = np.interp(table.time_s - 0.5, table.time_s, table.W_af_kg_s)
    table["W_af_kg_s"] = np.where(late, shifted, table.W_af_kg_s)
    table.to_csv(tmp_path / "late.csv", index=False)
    recording = read_petrol(tmp_path / "late.csv")
    found = discover_petrol(recording, engine)
    effect, location = found.document.effects[0], found.document.location
    assert effect.name == "w_af_late" and effect.magnitude == pytest.approx(0.5, abs=0.1)
    assert location is not None and location.onset_s == pytest.approx(ONSET_S, abs=30.0)  # an idle shows no delay
    assert not discover_petrol(recording, found.engine).document.mismatch
    before, after = (rms_errors(e, recording) for e in (engine, found.engine))
    assert after["w_af_kg_s"] < 0.8 * before["w_af_kg_s"]


def test_clocks_are_learned(record: Recorder, tmp_path: Path) -> None:
    """An air flow that was late on healthy days, too, is a property of the engine's logger and no finding."""
    table = pd.read_csv(record(17, 500.0).path)
    table["W_af_kg_s"] = np.interp(table.time_s - 0.08, table.time_s, table.W_af_kg_s)
    table.to_csv(tmp_path / "late.csv", index=False)
    signals = read_petrol(tmp_path / "late.csv").signals
    clocks = [fit_maps(s, PetrolParameters())[0].clocks["w_af_late"] for s in (signals, record(17, 500.0).signals)]
    assert clocks[0] - clocks[1] == pytest.approx(0.08, abs=0.01)


def test_what_stands_still_is_not_judged(engine: PetrolParameters, record: Recorder, tmp_path: Path) -> None:
    table = pd.read_csv(record(15, 500.0).path)
    table.loc[table.time_s >= ONSET_S, "p_im_Pa"] = table.p_im_Pa[table.time_s >= ONSET_S].iloc[0]
    table.to_csv(tmp_path / "stuck.csv", index=False)
    stuck = read_petrol(tmp_path / "stuck.csv")
    assert not discover_petrol(stuck, engine).document.mismatch
    assert "p_im_pa stands still for 300 s from 200 s on" in recording_notes(stuck)[0]


@pytest.fixture(scope="module")
def gentle(record: Recorder, tmp_path_factory: pytest.TempPathFactory) -> PetrolParameters:
    """An engine that was learned from driving with the throttle less than half open."""
    file = tmp_path_factory.mktemp("gentle") / "gentle.csv"
    table = pd.read_csv(record(3, 900.0).path)
    table[table.alpha_th_pct < 8.0].to_csv(file, index=False)
    return fit_maps(read_petrol(file).signals, PetrolParameters())[0]


@pytest.mark.parametrize("fault", [{}, {"p_im_Pa": 0.06}], ids=["healthy", "p_im_gain"])
def test_driving_beyond_what_was_learned_is_no_finding(
    gentle: PetrolParameters, record: Recorder, fault: dict
) -> None:
    """Maps go straight on a little beyond what was learned, and what is further off isn't judged, with a note."""
    d = discover_petrol(record(8, 300.0, onset_s=100.0, **fault), gentle).document
    assert [e.name for e in d.effects] == (["p_im_gain"] if fault else [])
    assert [doubt.code for doubt in d.warnings] == ["extrapolated"] and "66 s of the throttle's" in d.warnings[0].text


def test_time_shift_changes_nothing(engine: PetrolParameters, record: Recorder, tmp_path: Path) -> None:
    first = record(10, 150.0, onset_s=70.0, W_af_kg_s=0.12)
    table = pd.read_csv(first.path)
    table["time_s"] += 1000.0
    table.to_csv(tmp_path / "later.csv", index=False)
    before, after = (discover_petrol(r, engine).document for r in (first, read_petrol(tmp_path / "later.csv")))
    assert before.location is not None and after.location is not None
    assert after.location.onset_s == pytest.approx((before.location.onset_s or 0.0) + 1000.0, abs=1.5)
    assert after.effects[0].magnitude == pytest.approx(before.effects[0].magnitude, rel=0.02)


def test_engine_file_round_trip(engine: PetrolParameters, tmp_path: Path) -> None:
    again = load_petrol(save_petrol(engine, tmp_path / "engine.yaml"))
    assert again.cylinder is not None and engine.cylinder is not None
    np.testing.assert_allclose(again.cylinder.covariance, engine.cylinder.covariance, rtol=1e-3, atol=1e-6)


def test_pieces_cover_the_recording() -> None:
    spans = pieces(make_grid(np.arange(0.0, 1803.4, 0.1)))
    assert len(spans) == 6 and spans[0][0] == 0.0 and spans[-1][1] > 1803.4
    assert all(a[1] == b[0] for a, b in pairwise(spans))


@pytest.fixture(scope="module")
def liu_engine(liu: Path) -> PetrolParameters:
    """Maps of the real engine."""
    return fit_maps(read_petrol(liu / "wltp_NF.csv").signals, PetrolParameters())[0]


REAL = [("wltp_f_pic_110.csv", "p_ic_gain", 0.10, 120.0), ("wltp_f_pim_090.csv", "p_im_gain", -0.10, 190.0),
        ("wltp_f_waf_110.csv", "w_af_gain", 0.10, 120.0)]  # fmt: skip


@pytest.mark.thorough
@pytest.mark.parametrize(("file", "name", "size", "onset_s"), REAL, ids=[r[1] for r in REAL])
def test_real_sensor_faults(
    liu: Path, liu_engine: PetrolParameters, file: str, name: str, size: float, onset_s: float
) -> None:
    d = discover_petrol(read_petrol(liu / file), liu_engine).document
    assert d.mismatch and d.location is not None
    _is_like(d, name, size)
    assert d.location.onset_s == pytest.approx(onset_s, abs=4.0)


def _is_like(d: Discrepancy, name: str, size: float, within: float = 0.005) -> None:
    """Named so; p_ic is known at rest alone, near 1e5 Pa, so that its gain and its offset are said to be alike."""
    effect = d.effects[0]
    if name == "p_ic_gain":
        assert set(effect.names) == {"p_ic_gain", "p_ic_offset"} and effect.split_by is not None
        assert effect.probability < 0.999 and effect.magnitude is not None
        assert effect.magnitude * (1e-5 if effect.unit == "Pa" else 1.0) == pytest.approx(size, abs=within)
        return
    assert effect.name == name and NONE_OF_THESE not in effect.names
    assert effect.magnitude == pytest.approx(size, abs=within)


def test_real_fault_free(liu: Path, liu_engine: PetrolParameters) -> None:
    assert not discover_petrol(read_petrol(liu / "wltp_NF.csv"), liu_engine).document.mismatch


@pytest.mark.thorough
@pytest.mark.parametrize(("file", "name", "size", "_onset_s"), REAL, ids=[r[1] for r in REAL])
def test_real_sensor_faults_in_five_minutes(
    liu: Path, liu_engine: PetrolParameters, file: str, name: str, size: float, _onset_s: float
) -> None:
    """There from the first second on: the verdict is that of the whole run."""
    whole = read_petrol(liu / file)
    for start in (300.0, 1200.0):
        piece = replace(whole, signals=whole.signals.part(start, start + 300.0))
        _is_like(discover_petrol(piece, liu_engine).document, name, size, within=0.025)


@pytest.mark.thorough
def test_a_size_at_its_limit_is_no_name(engine: PetrolParameters, record: Recorder,
                                        monkeypatch: pytest.MonkeyPatch) -> None:  # fmt: skip
    """A leak of 40 mm2 was an air-flow offset of -1.2 g/s, the largest that is possible, +- 0.05 g/s."""
    signals = record(31, leak_m2=2e-5).signals
    _, found = judge(engine, signals)
    assert found.best is not None and found.best.fit.candidate.names == ("intake_leak",)
    leak = HYPOTHESES["intake_leak"]
    limited = {**HYPOTHESES, "intake_leak": replace(leak, limits=(0.0, 1.2e-5))}
    monkeypatch.setattr("dieseltwin.petrol.twin.HYPOTHESES", limited)
    _, found = judge(engine, signals)
    at_limit = found.best is not None and any(
        size >= 1.2e-5 for name, size in zip(found.best.fit.candidate.names, found.best.fit.magnitudes, strict=True)
        if name == "intake_leak"
    )  # fmt: skip
    assert found.kind == "law" and not at_limit


def test_a_simulation_beyond_the_maps_says_so(engine: PetrolParameters, record: Recorder) -> None:
    table = simulate_petrol(engine, record(1, 900.0))
    assert beyond_maps(engine, table) == []
    racing = table.assign(omega_e_rad_s=np.where(table["time_s"] < 60.0, 1200.0, table["omega_e_rad_s"]))
    (note,) = beyond_maps(engine, racing)
    assert note.code == "extrapolated" and str(note).startswith("note: 60 s lie too far beyond")
