"""A meter whose gain bends, a channel that becomes late, what began and did not end, how much a charge may vary."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from dieseltwin.discovery.likelihood.score import spread, without_parameters
from dieseltwin.discovery.search.preparation import prepare
from dieseltwin.petrol.calibrate import fit_maps
from dieseltwin.petrol.discover import PetrolOptions, discover_petrol
from dieseltwin.petrol.effects import MIDDLE_FLOW, later, metered, undo
from dieseltwin.petrol.parameters import PetrolParameters
from dieseltwin.petrol.recording import PetrolRecording, Signals
from dieseltwin.petrol.twin import PetrolTwin

Recorder = Callable[..., PetrolRecording]
SINCE_S, BEND, LATE_S = 150.0, 0.06, 0.5


def _with(drive: PetrolRecording, change: Callable[[Signals], dict]) -> PetrolRecording:
    return replace(drive, signals=replace(drive.signals, **change(drive.signals)))


def test_a_meter_whose_gain_bends_with_the_flow(engine: PetrolParameters, record: Recorder) -> None:
    def bent(s: Signals) -> dict:
        return {"W_af": np.where(s.time_s >= SINCE_S, s.W_af * (s.W_af / MIDDLE_FLOW) ** BEND, s.W_af)}

    found = discover_petrol(_with(record(2, 400.0), bent), engine).document
    (effect,), location = found.effects, found.location
    assert effect.name == "w_af_bend" and effect.magnitude == pytest.approx(BEND, abs=0.01) and location is not None
    assert location.onset_s == pytest.approx(SINCE_S, abs=8.0)


def test_what_a_bent_meter_reads_is_undone(record: Recorder) -> None:
    s = record(2, 400.0).signals
    read = metered({"w_af_bend": np.full(s.W_af.shape, BEND)}, s.W_af)
    np.testing.assert_allclose(undo("w_af_bend", BEND, replace(s, W_af=read)).W_af, s.W_af, rtol=1e-9)
    assert metered({"w_af_bend": np.array([BEND])}, np.array([MIDDLE_FLOW]))[0] == pytest.approx(MIDDLE_FLOW)


def test_a_channel_that_becomes_late_is_seen_though_it_jumps(engine: PetrolParameters, record: Recorder) -> None:
    """Seconds that jump weigh less, and a channel that is late shows in nothing else."""
    def late(s: Signals) -> dict:
        return {"p_im": np.where(s.time_s >= SINCE_S, later(s.time_s, s.p_im, LATE_S), s.p_im)}

    found = discover_petrol(_with(record(2, 400.0), late), engine).document
    (effect,), location = found.effects, found.location
    assert effect.name == "p_im_late" and effect.magnitude == pytest.approx(LATE_S, abs=0.05) and location is not None
    assert location.onset_s == pytest.approx(SINCE_S, abs=15.0)


def test_of_two_ways_that_levels_tell_apart_what_began_is_told(engine: PetrolParameters, record: Recorder) -> None:
    """3.5 % more since half of the time is 3.5 % less until then, but for the level that a recording may have."""
    def more(s: Signals) -> dict:
        return {"W_af": s.W_af * (1.0 + 0.035 * (s.time_s >= 200.0)) * 0.98}

    found = discover_petrol(_with(record(2, 400.0), more), engine).document
    (effect,), location = found.effects, found.location
    assert effect.name == "w_af_gain" and effect.magnitude == pytest.approx(0.035, abs=0.01) and location is not None
    assert location.until_s is None and location.onset_s == pytest.approx(200.0, abs=8.0)


def test_what_a_charge_varies_by_speaks_for_no_offset(engine: PetrolParameters, record: Recorder) -> None:
    """A charge that were 40 K warmer than read would vary by less of itself, fluctuation by fluctuation."""
    def waving(s: Signals) -> dict:
        return {"T_ic": s.T_ic + 6.0 * np.sin(s.time_s / 9.0)}

    twin = PetrolTwin(engine, _with(record(2, 400.0), waving).signals)
    offset = np.full(len(twin.time_s), -40.0)
    expected = (twin.expected_with({"t_ic_offset": offset}) - twin.expected_with({}))[:, twin.channels.index("cooler")]
    assert np.ptp(expected) < 1e-9 and expected[0] == pytest.approx(-np.log1p(40.0 / 298.0), abs=1e-3)


def test_a_charge_that_reads_too_warm_is_no_gain_of_the_air_meter(engine: PetrolParameters, record: Recorder) -> None:
    """It acts on three balances; until it is dated to the second, its end explains more than its beginning."""
    drive = record(2, 600.0)
    warm = drive.signals.T_ic + 12.0 * (drive.signals.time_s >= SINCE_S)
    found = discover_petrol(replace(drive, signals=replace(drive.signals, T_ic=warm)), engine).document
    (effect,), location = found.effects, found.location
    assert effect.name == "t_ic_offset" and effect.magnitude == pytest.approx(12.0, abs=1.0) and location is not None
    low, high = location.onset_range_s or (0.0, 0.0)
    assert low <= SINCE_S <= high <= low + 5.0


def test_a_jump_of_a_slow_reading_hangs_on_its_second_and_counts(engine: PetrolParameters, record: Recorder) -> None:
    """The cooler drifts slowly, so that most evidence of a jump is in the second in which it jumps."""
    drive, settings = record(2, 300.0), PetrolOptions().settings()
    since = drive.signals.time_s >= SINCE_S
    found = prepare(PetrolTwin(engine, replace(drive.signals, T_ic=drive.signals.T_ic + 15.0 * since)), settings)
    late = np.where(found.twin.time_s >= SINCE_S, 15.0, 0.0)
    jump = found.twin.expected_with({"t_ic_offset": late}) - found.twin.expected_with({})
    direction = without_parameters(found.null, found.null.metric.project(jump[None]))[0]
    # a real charge that wanders by its healthy scatter leaves 0.2 less
    assert settings.least_spread + 0.2 < spread(found.null, direction) < 0.7


def test_how_far_a_charge_varies_is_learned(record: Recorder) -> None:
    drive = record(1, 900.0)
    waving = replace(drive.signals, T_ic=drive.signals.T_ic + 6.0 * np.sin(drive.signals.time_s / 9.0))
    learned = fit_maps(waving, PetrolParameters())[0].cooler_spread.base
    assert learned == pytest.approx(6.0 / 298.0 / np.sqrt(2.0), rel=0.1)


def test_a_throttle_that_is_wide_open_beside_an_effect_is_not_judged(
    engine: PetrolParameters, record: Recorder
) -> None:
    """Where p_ic reads high, p_im seems well below it; beside that gain the throttle's equation is a straight line."""
    s = record(2, 400.0).signals
    wide = (s.time_s >= 200.0) & (s.time_s < 300.0)
    read = replace(s, p_im=np.where(wide, 0.97 * s.p_ic, s.p_im))
    twin = PetrolTwin(engine, read)
    j, seconds = twin.channels.index("throttle"), slice(210, 290)
    high = [{"p_ic_gain": 0.03 * np.ones(len(twin.time_s))}]
    beside = PetrolTwin(engine, read, explained=high).measured[seconds, j]
    assert np.isfinite(twin.robust_scales()[0][seconds, j]).any() and not np.isfinite(beside).any()


def test_an_offset_that_is_explained_is_no_noise(engine: PetrolParameters, record: Recorder) -> None:
    """The pressures' noise goes through the balances beside an offset of that pressure as beside a gain."""
    s = record(2, 400.0).signals
    low = replace(s, p_ic=0.97 * s.p_ic)
    ones = np.ones(len(PetrolTwin(engine, low).time_s))
    beside = [PetrolTwin(engine, low, explained=[{name: size * ones}]) for name, size in
              (("p_ic_gain", -0.03), ("p_ic_offset", -0.03 * float(s.p_ic.mean())))]  # fmt: skip
    gain, offset = (np.median(twin.whitening().scale, axis=0) for twin in beside)
    np.testing.assert_allclose(offset, gain, rtol=0.3)
