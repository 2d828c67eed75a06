"""Learning from minutes of driving of an engine whose maps are off by 2 %: the truth inside, order of no matter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dieseltwin.challenge.map_errors import MapErrors
from dieseltwin.challenge.plant import run_plant
from dieseltwin.challenge.plant_effects import Fault
from dieseltwin.challenge.routes import draw_driving
from dieseltwin.challenge.sensors import SensorSet, read
from dieseltwin.discovery.reference import part as part_module
from dieseltwin.discovery.reference.evidence import Learned, combined
from dieseltwin.discovery.reference.joint import Joint
from dieseltwin.discovery.reference.learn import learn, learn_engine
from dieseltwin.discovery.reference.part import Part
from dieseltwin.engine import HEALTH, we2011
from dieseltwin.errors import InputError
from dieseltwin.learning.belief import HEALTH_AT, MAPS_AT, NOTHING_FURTHER, prior_belief
from dieseltwin.learning.weather import of_own_weather
from dieseltwin.recordings.reader import Recording, recording
from dieseltwin.settings.defaults import default_learn

MAP_RMS = 0.02
SHARES = {"A_egrmax": 0.92, "A_vgtmax": 1.08, "eta_sc": 0.98, "h_tot": 1.1}
LABORATORY = we2011.PARAMETERS.model_dump()


def _recording(seed: int, *faults: Fault) -> Recording:
    maps = MapErrors.draw(MAP_RMS, np.random.default_rng(5))
    drawn = SensorSet.draw(np.random.default_rng(6))
    sensors = replace(drawn, rho=np.zeros(6))  # so few rows hardly tell correlated noise
    driving = draw_driving("random", 90.0, LABORATORY, np.random.default_rng(seed))
    healthy = LABORATORY | {name: LABORATORY[name] * share for name, share in SHARES.items()}
    rng = np.random.default_rng([seed, 1])
    return recording(read(run_plant(driving, healthy, faults, maps), driving, faults, sensors, 6, rng))


@pytest.fixture(scope="module")
def recordings() -> tuple[Recording, Recording]:
    return _recording(1), _recording(2)


@pytest.fixture(scope="module")
def learned(recordings) -> Learned:
    return learn(recordings, of_own_weather(we2011.PARAMETERS, recordings), MAP_RMS)


def test_what_is_left_is_noise(learned: Learned):
    assert learned.converged
    misfits = [part.misfit for part in learned.evidence]  # in 90 s noise is taken to be as correlated as it may be
    assert all(0.85 < misfit < 1.25 for misfit in misfits), misfits


def test_the_true_health_is_within_its_interval(learned: Learned):
    true = np.array([LABORATORY[name] * SHARES[name] for name in HEALTH])
    std = np.sqrt(np.diag(learned.belief.covariance)[HEALTH_AT])
    assert np.all(np.abs(learned.belief.health - true) < 3.0 * std)
    assert np.all(std < 0.1 * true)


def test_information_adds_and_only_narrows(learned: Learned, recordings):
    prior = prior_belief(we2011.PARAMETERS, MAP_RMS)
    scale = np.sqrt(np.diag(prior.covariance))
    one = combined(prior, learned.evidence[:1])
    for wide, narrow in ((prior, one), (one, learned.belief)):
        cut = (wide.covariance - narrow.covariance) / np.outer(scale, scale)
        assert np.linalg.eigvalsh(cut).min() > -1e-9


@pytest.mark.thorough
def test_neither_order_nor_repetition_matters(learned: Learned, recordings):
    first, second = recordings
    again, found = learn_engine([second, first, second], we2011.PARAMETERS, MAP_RMS)
    assert np.array_equal(found.belief.mean, learned.belief.mean)
    assert np.array_equal(found.belief.covariance, learned.belief.covariance)
    assert len(again.recordings) == 2


def test_what_maps_take_up_is_no_suspicion_before_a_fit_is_done(recordings):
    prior = prior_belief(we2011.PARAMETERS, MAP_RMS)
    begun = Joint([Part(recordings[0], we2011.PARAMETERS, prior, MAP_RMS)], prior)
    assert begun.suspicions(default_learn().suspicious_gain) == ()


@pytest.mark.thorough
def test_a_fault_in_one_recording_is_told_of_that_one():
    """It bought errors of all maps, five times as large as believed, and nobody was told."""
    sound, leaking = _recording(1), _recording(2, Fault("boost_leak", 4e-5))
    found = learn([sound, leaking], we2011.PARAMETERS, MAP_RMS)
    first = found.suspicions[0]
    assert (first.name, first.alone) == ("boost_leak", leaking.sha256)
    assert first.magnitude == pytest.approx(4e-5, rel=0.25) and found.further == NOTHING_FURTHER


def test_a_window_in_which_a_response_runs_away_says_nothing_of_finer_maps(recordings, monkeypatch):
    prior = prior_belief(we2011.PARAMETERS, MAP_RMS)
    part = Part(recordings[0], we2011.PARAMETERS, prior, MAP_RMS)
    x = np.zeros(prior.mean.size)
    here = part.linearised(x)
    window = slice(int(part.twin.starts[1]), int(part.twin.starts[2]))

    def running_away(twin, lanes, simulated, which):
        columns = np.tile(simulated, (int(which.sum()), 1, 1))
        columns[0, window] = 1e40
        return columns

    monkeypatch.setattr(part_module, "map_columns", running_away)
    rows = part.further(here, x)[MAPS_AT][~prior.free]
    assert np.any(rows != 0.0) and np.abs(rows).max() < 1e6


def test_windows_that_surge_on_the_way_steer_nothing(recordings, monkeypatch):
    """Next to a surging engine differences grow without bound: a step that heeds them leads nowhere."""
    calls = iter(range(1000))
    responses = part_module.map_columns

    def surging(twin, lanes, simulated, which):
        columns = responses(twin, lanes, simulated, which)
        if next(calls) in (1, 2):  # the sensitivities after the first steps
            columns[:, -40:] *= 1e38
        return columns

    monkeypatch.setattr(part_module, "map_columns", surging)
    found = learn(recordings[:1], we2011.PARAMETERS, MAP_RMS)
    true = np.array([LABORATORY[name] * SHARES[name] for name in HEALTH])
    std = np.sqrt(np.diag(found.belief.covariance)[HEALTH_AT])
    assert found.converged and np.all(np.abs(found.belief.health - true) < 3.0 * std)


@pytest.mark.thorough
def test_a_fault_that_no_map_takes_up_is_suspected():
    offset = Fault("p_im_offset", 1e4)
    first = learn([_recording(1, offset)], we2011.PARAMETERS, MAP_RMS).suspicions[0]
    assert first.name == offset.effect and abs(first.magnitude - offset.magnitude) < 3.0 * first.std


def test_readings_that_ask_for_no_engine_are_refused_by_the_recording(recordings):
    part = Part(recordings[0], we2011.PARAMETERS, prior_belief(we2011.PARAMETERS, MAP_RMS), MAP_RMS)
    far = np.zeros(part.scale.size)
    far[HEALTH_AT] = -100.0  # standard deviations of what is believed
    with pytest.raises(InputError, match=r"recording: got readings that ask for A_egrmax = -.*not idling alone"):
        part.linearised(far)
