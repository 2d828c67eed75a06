"""The equations with terms over torch: equal to the engine's, and right in their derivatives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

from dieseltwin.engine import (
    HEALTH,
    INPUT_COLUMNS,
    Inputs,
    actuate,
    constants,
    parameter_batch,
    simulate_states,
    we2011,
)
from dieseltwin.engine.effects import EFFECTS, STATE_EFFECTS
from dieseltwin.engine.extended_terms import along
from dieseltwin.engine.sensor_effects import undo_sensor_terms
from dieseltwin.engine.terms import LawTerm, Term
from dieseltwin.identification.few_shot.residuals import PointModel, driven_inputs
from dieseltwin.identification.few_shot.term_model import TermModel

TRACE = pd.read_csv(Path(__file__).parents[1] / "reference" / "field_random_300s.csv").iloc[290:341]
INPUTS = Inputs(*(TRACE[name].to_numpy() for name in ("time_s", *INPUT_COLUMNS)), n_history=10,
                u_flap_pct=np.full(len(TRACE), 40.0))
START = np.array([1.3e5, 1.5e5, 5000.0])
TERMS = [(Term(effect=name, magnitude=3.0 * EFFECTS[name].tolerance),) for name in STATE_EFFECTS]
LAW = LawTerm(point="shaft_power", coefficient=-300.0, unit="W", factors=(("omega_t", 5000.0, 2.0), ("W_t", 0.2, 1.0)))
TERMS += [
    (LAW,), (TERMS[0][0].model_copy(update={"onset_s": 5.0}), TERMS[2][0]),
    (Term(effect="thermocouple_lag", magnitude=1.0),),
]  # fmt: skip
IDS = [*STATE_EFFECTS, "law", "onset", "thermocouple_lag"]
INERTIA = STATE_EFFECTS.index("exhaust_thermal_inertia")
LAGS = ("exhaust_thermal_inertia", "thermocouple_lag")


def _trajectory(parameters):  # type: ignore[no-untyped-def]
    actuation = actuate(INPUTS, parameters)
    return actuation, simulate_states(actuation, parameter_batch(parameters), START)


@pytest.mark.parametrize("terms", TERMS, ids=IDS)
def test_quantities_equal_the_engine_s(terms: tuple) -> None:
    parameters = we2011.PARAMETERS.replace(terms=terms)
    actuation, observed = _trajectory(parameters)
    expected, _ = along(observed.states[0], actuation, parameters.terms, constants(parameters))
    model = TermModel(None, parameters, [actuation, actuation])
    states = [torch.tensor(np.stack([v, v])) for v in observed.states[0].T]
    told = [torch.stack([v, v]) for v in driven_inputs(actuation)]
    q = model.quantities(*states, *told, constants(parameters))
    lagged = terms[0] in TERMS[INERTIA]  # of a static temperature that isn't linear between samples in the first second
    rows = slice(6, None) if lagged else slice(None)
    for name in ("dp_im", "dp_em", "domega_t", "W_egr", "W_c", "x_r_next", "T_1_next"):
        found, wanted = getattr(q, name)[1].numpy()[rows], getattr(expected, name)[rows]
        np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=(2e-3 if lagged else 1e-5) * np.abs(wanted).max())
    np.testing.assert_allclose(q.T_em[1].numpy()[rows], observed.measured[0, rows, 4], rtol=1e-3)


@pytest.mark.parametrize("terms", TERMS, ids=IDS)
def test_point_derivatives_are_those_of_differences(terms: tuple) -> None:
    parameters = we2011.PARAMETERS.replace(terms=terms)
    actuation, observed = _trajectory(parameters)
    model, told = PointModel(parameters, actuation=actuation), driven_inputs(actuation)
    states = torch.tensor(observed.states[:, :, :3].copy())
    log_health = torch.tensor([[np.log(getattr(parameters, name)) for name in HEALTH]])
    point = model(states, log_health, told)
    assert point.slopes is not None
    np.testing.assert_allclose(point.readings[0, 6:, 1], observed.measured[0, 6:, 4], rtol=2e-3)
    if any(getattr(term, "effect", "") in LAGS for term in terms):
        return  # the lag is held constant
    for column in range(7):
        moved, moved_health = states.clone(), log_health.clone()
        if column < 3:
            step = 1e-5 * states[..., column : column + 1].abs()
            moved[..., column : column + 1] += step
        else:
            moved_health[:, column - 3] += 1e-5
            step = torch.full_like(states[..., :1], 1e-5)
        other = model(moved, moved_health, told, derivatives=False)
        slope = torch.cat([(other.rates - point.rates) / step, (other.readings - point.readings) / step], -1)
        exact = point.slopes[:, :, column].mT
        error = (slope - exact).abs().median(1).values
        assert (error <= 2e-3 * exact.abs().amax(1) + 1e-9).all(), column


def test_offsets_and_gains_are_taken_out_of_the_readings() -> None:
    terms = (
        Term(effect="p_em_offset", magnitude=2000.0), Term(effect="p_em_gain", magnitude=0.02, onset_s=5.0),
        Term(effect="boost_leak", magnitude=1e-5),
    )  # fmt: skip
    parameters = we2011.PARAMETERS.replace(terms=terms)
    actuation, observed = _trajectory(parameters)
    clean = simulate_states(actuation, parameter_batch(parameters.replace(terms=terms[2:])), START).measured[0]
    conditions = {name: getattr(INPUTS, name)[INPUTS.n_history :] for name in ("n_e_rpm",)}
    readings, rest = undo_sensor_terms(
        observed.measured[0], INPUTS.segment_time_s, INPUTS.recording_start_s, conditions, parameters
    )
    np.testing.assert_allclose(readings, clean, rtol=1e-12)
    assert rest.terms == terms[2:]
