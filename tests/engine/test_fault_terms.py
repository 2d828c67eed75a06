"""Found faults of sensors and actuators as terms of an engine file: read, written, simulated, taken out of readings."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from pydantic import ValidationError

from dieseltwin.engine import Inputs, simulate, we2011
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.engine.engine_files import load_engine
from dieseltwin.engine.sensor_effects import slot_parts, undo_sensor_terms
from dieseltwin.engine.terms import SENSOR_SLOTS, ActuatorTerm, LawTerm, SensorTerm, Term
from dieseltwin.sensors import MEASURED

ENGINE = we2011.PARAMETERS


def _inputs() -> Inputs:
    time = np.arange(0.0, 12.01, 0.2)
    wave = np.sin(time)
    return Inputs(time, 1200.0 + 100.0 * wave, 80.0 + 20.0 * wave**2, 30.0 + 10.0 * wave, np.full(time.size, 45.0))


def _readings(*terms: Term | SensorTerm | ActuatorTerm) -> np.ndarray:
    frame = simulate(_inputs(), ENGINE.replace(terms=terms), oxygen=False, initial=np.array([1.5e5, 1.8e5, 5000.0]))
    return frame[list(MEASURED)].to_numpy()


def test_every_sensor_effect_has_a_slot_and_files_keep_the_terms(tmp_path) -> None:  # type: ignore[no-untyped-def]
    assert {name for name, effect in EFFECTS.items() if effect.enters.through == "reading"} <= set(SENSOR_SLOTS)
    assert len({slot_parts(slot) for slot in SENSOR_SLOTS}) == len(SENSOR_SLOTS) == 3 * len(MEASURED)
    terms = (
        SensorTerm(sensor="omega_t_rad_s", fault="gain", magnitude=0.02, std=1e-3),
        ActuatorTerm(actuator="egr", fault="backlash", magnitude=4.0), LawTerm(point="W_t", coefficient=0.02, unit="-"),
        Term(effect="boost_leak", magnitude=1e-5),
    )  # fmt: skip
    path = tmp_path / "engine.yaml"
    path.write_text(yaml.safe_dump(ENGINE.replace(terms=terms).model_dump(mode="json")))
    assert load_engine(path).terms == terms


@pytest.mark.parametrize(
    "wrong",
    [
        {"sensor": "torque", "fault": "gain", "magnitude": 0.1},
        {"sensor": "p_im_pa", "fault": "lag", "magnitude": -1.0},
        {"sensor": "p_im_pa", "fault": "gain", "magnitude": -1.5},
        {"actuator": "vgt", "fault": "lag", "magnitude": 1.0},
        {"actuator": "vgt", "fault": "dead_time", "magnitude": -0.1},
    ],
)  # fmt: skip
def test_impossible_faults_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        type(ENGINE).model_validate({**ENGINE.model_dump(), "terms": [wrong]})


def test_faults_of_sensors_act_on_readings_alone_and_can_be_undone() -> None:
    plain = _readings()
    terms = (
        SensorTerm(sensor="omega_t_rad_s", fault="offset", magnitude=50.0),
        SensorTerm(sensor="omega_t_rad_s", fault="gain", magnitude=-0.1),
        SensorTerm(sensor="p_im_pa", fault="gain", magnitude=0.05, onset_s=6.0),
    )
    faulty = _readings(*terms)
    late = np.arange(plain.shape[0]) >= 30
    np.testing.assert_allclose(faulty[:, 2], 0.9 * plain[:, 2] + 50.0, rtol=1e-12)
    np.testing.assert_allclose(faulty[:, 0], plain[:, 0] * (1.0 + 0.05 * late), rtol=1e-12)
    np.testing.assert_allclose(faulty[:, [1, 3, 4, 5]], plain[:, [1, 3, 4, 5]], rtol=1e-12)
    inputs = _inputs()
    conditions = {"n_e_rpm": inputs.n_e_rpm}
    readings, rest = undo_sensor_terms(faulty, inputs.time_s, 0.0, conditions, ENGINE.replace(terms=terms))
    np.testing.assert_allclose(readings, plain, rtol=1e-12)
    assert rest.terms == ()


def test_they_equal_the_effects_of_the_same_kind() -> None:
    pairs = (
        (SensorTerm(sensor="t_em_k", fault="lag", magnitude=0.8), Term(effect="thermocouple_lag", magnitude=0.8)),
        (SensorTerm(sensor="w_egr_kg_s", fault="gain", magnitude=0.1), Term(effect="w_egr_gain", magnitude=0.1)),
        (ActuatorTerm(actuator="egr", fault="dead_time", magnitude=0.3), Term(effect="egr_dead_time", magnitude=0.3)),
    )
    for found, named in pairs:
        assert (found.unit, found.law) == (named.unit, found.law)
        np.testing.assert_allclose(_readings(found), _readings(named), rtol=1e-12)


def test_an_engine_with_any_kind_of_term_can_be_changed() -> None:
    terms = (
        Term(effect="vgt_backlash", magnitude=2.0), SensorTerm(sensor="p_im_pa", fault="gain", magnitude=0.02),
        LawTerm(point="shaft_power", coefficient=-125.0, unit="W", factors=(("omega_t", 5000.0, 2.0),)),
    )  # fmt: skip
    assert ENGINE.replace(terms=terms).replace(V_d=0.013).terms == terms
