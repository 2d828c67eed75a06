"""The extended simulator: equal to the plain one without effects, kernel equal to numpy, restarts, signals, terms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dieseltwin.engine import (
    STATES,
    Inputs,
    actuate,
    constants,
    load_engine,
    parameter_batch,
    simulate,
    simulate_states,
    we2011,
)
from dieseltwin.engine.effects import EFFECTS, STATE_EFFECTS, Magnitudes
from dieseltwin.engine.extended import Extension, simulate_extended
from dieseltwin.engine.extended_frame import extended_frame
from dieseltwin.engine.extended_terms import along, simulate_terms
from dieseltwin.engine.inputs import actuate_like
from dieseltwin.engine.parameters import ParameterBatch
from dieseltwin.engine.quantities import ADDED_AT, POINTS, Signals
from dieseltwin.engine.terms import LawTerm, Term
from dieseltwin.errors import InputError

ENGINE = we2011.PARAMETERS


def _cut(inputs: Inputs, start: float, end: float) -> Inputs:
    rows = (inputs.time_s >= start - 1e-9) & (inputs.time_s <= end + 1e-9)
    columns = {n: getattr(inputs, n)[rows] for n in ("n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct")}
    return Inputs(inputs.time_s[rows], **columns)


@pytest.fixture(scope="module")
def drive(field_trace):  # type: ignore[no-untyped-def]
    """20 s of driving: inputs, actuation, initial state (3,)."""
    table, inputs, _, _ = field_trace
    inputs = _cut(inputs, 60.0, 80.0)
    inputs = replace(inputs, u_flap_pct=np.full(inputs.time_s.size, 40.0))
    row = table[np.isclose(table["time_s"], 60.0)].iloc[0]
    return inputs, actuate(inputs, ENGINE), row[["p_im_pa", "p_em_pa", "omega_t_rad_s"]].to_numpy(dtype=float)


def _magnitudes(**named: float) -> np.ndarray:
    out = np.zeros((len(STATE_EFFECTS), 1))
    for name, value in named.items():
        out[STATE_EFFECTS.index(name)] = value
    return out


def test_names_agree() -> None:
    assert Magnitudes._fields == STATE_EFFECTS and Signals._fields == POINTS
    assert set(STATE_EFFECTS) <= set(EFFECTS) and set(ADDED_AT) <= set(POINTS)


@pytest.mark.parametrize("restricted", [0.0, 1e-12])
def test_without_effects_it_is_the_plain_simulator(drive, restricted: float) -> None:  # type: ignore[no-untyped-def]
    """Both kernels: a magnitude of 1e-12 of back-pressure takes the one with implicit laws."""
    _, actuation, initial = drive
    batch = parameter_batch(ENGINE, A_egrmax=ENGINE.A_egrmax * np.linspace(0.8, 1.2, 11))
    plain = simulate_states(actuation, batch, initial)
    magnitudes = np.repeat(_magnitudes(back_pressure=restricted), 11, axis=1)
    extended = simulate_extended(actuation, batch, Extension(magnitudes), initial)
    np.testing.assert_allclose(extended.states[..., :5], plain.states, rtol=1e-9)
    np.testing.assert_allclose(extended.measured, plain.measured, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", STATE_EFFECTS)
def test_kernel_equals_numpy(drive, name: str) -> None:  # type: ignore[no-untyped-def]
    """What the kernel's sensors see is what the numpy equations give at its states."""
    inputs, actuation, initial = drive
    parameters = ENGINE.replace(terms=(Term(effect=name, magnitude=2.0 * EFFECTS[name].tolerance),))
    observed = simulate_terms(actuation, parameter_batch(parameters), initial)
    q, _ = along(observed.states[0], actuation, parameters.terms, constants(parameters))
    np.testing.assert_allclose(observed.measured[0, :, 3], q.W_egr, rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(observed.measured[0, :, 4], q.T_em, rtol=1e-7)
    np.testing.assert_allclose(observed.measured[0, :, 5], q.W_c, rtol=1e-7)
    plain = simulate_states(actuation, parameter_batch(ENGINE), initial)
    assert np.abs(observed.measured / np.where(plain.measured == 0, 1, plain.measured) - 1).max() > 1e-4
    fine = actuate_like(actuation, inputs.resampled(0.0125))
    states = simulate_terms(fine, parameter_batch(parameters), initial, sensors=False).states[0]
    q, _ = along(states, fine, parameters.terms, constants(parameters))
    for column, rate in enumerate((q.dp_im, q.dp_em, q.domega_t)):
        error = np.abs(np.gradient(states[:, column], fine.time_s) - rate)[2:-2]
        assert np.median(error) < 0.02 * np.abs(rate).mean()


def test_restart_equals_a_simulation_of_its_own(drive) -> None:  # type: ignore[no-untyped-def]
    inputs, actuation, initial = drive
    batch = parameter_batch(ENGINE, size=3)
    starts = np.stack([initial, initial * 1.02, initial * 0.98])
    at = np.array([0, 40, 71])
    extension = Extension(np.repeat(_magnitudes(boost_leak=2e-5), 3, axis=1), restarts=at)
    whole = simulate_extended(actuation, batch, extension, np.broadcast_to(starts, (3, 3, 3)))
    np.testing.assert_allclose(whole.states[0, at, :3], starts, rtol=1e-14)
    for window, first in enumerate(at):
        end = (*at, inputs.time_s.size)[window + 1]
        piece = replace(inputs, n_history=int(first))
        own = simulate_extended(
            actuate(piece, ENGINE), parameter_batch(ENGINE), Extension(_magnitudes(boost_leak=2e-5)), starts[[window]]
        )
        np.testing.assert_allclose(whole.states[0, first:end], own.states[0, : end - first], rtol=1e-7)


@pytest.mark.parametrize("restricted", [0.0, 1e-12])
def test_company_changes_no_bit(drive, restricted: float) -> None:  # type: ignore[no-untyped-def]
    """Windows of many lanes share eight places in whatever order; one lane carries its gas through all windows."""
    _, actuation, initial = drive
    lanes, at = 7, np.array([0, 13, 14, 40, 71])
    batch = parameter_batch(ENGINE, A_egrmax=ENGINE.A_egrmax * np.linspace(0.8, 1.2, lanes))
    magnitudes = np.repeat(_magnitudes(boost_leak=2e-5, back_pressure=restricted), lanes, axis=1)
    magnitudes[STATE_EFFECTS.index("exhaust_thermal_inertia"), 4] = 3.0
    rng = np.random.default_rng(5)
    starts = initial * (1.0 + 0.02 * rng.standard_normal((lanes, at.size, 3)))
    together = simulate_extended(actuation, batch, Extension(magnitudes, restarts=at), starts, threads=2)
    one_thread = simulate_extended(actuation, batch, Extension(magnitudes, restarts=at), starts, threads=1)
    np.testing.assert_array_equal(together.states, one_thread.states)
    np.testing.assert_array_equal(together.measured, one_thread.measured)
    for lane in range(lanes):
        own = ParameterBatch(batch.values[:, [lane]])
        alone = simulate_extended(actuation, own, Extension(magnitudes[:, [lane]], restarts=at), starts[[lane]])
        np.testing.assert_array_equal(together.states[lane], alone.states[0])
        np.testing.assert_array_equal(together.measured[lane], alone.measured[0])
    plain = simulate_extended(actuation, batch, Extension(magnitudes * 0.0, restarts=at), starts)
    t_1 = STATES.index("t_1_k")
    assert np.abs(together.states[4, 72:, t_1] / plain.states[4, 72:, t_1] - 1.0).max() > 1e-5  # it does lag


def test_lane_signal_is_a_shared_signal(drive) -> None:  # type: ignore[no-untyped-def]
    inputs, actuation, initial = drive
    wave = 0.02 * np.sin(inputs.time_s)
    lanes = np.arange(len(POINTS))
    scale = np.array([{"shaft_power": 1e3, "u_egr": 100.0, "u_vgt": 100.0}.get(p, 1.0) for p in POINTS])
    own = Extension(lane_point=lanes, lane_signal=scale[:, None] * wave)
    batch = parameter_batch(ENGINE, size=len(POINTS))
    together = simulate_extended(actuation, batch, own, initial)
    plain = simulate_states(actuation, batch, initial)
    for lane, point in enumerate(POINTS):
        signals = np.zeros((len(POINTS), wave.size))
        signals[lane] = scale[lane] * wave
        alone = simulate_extended(actuation, parameter_batch(ENGINE), Extension(signals=signals), initial)
        np.testing.assert_allclose(together.states[lane], alone.states[0], rtol=1e-9)
        assert np.abs(together.states[lane, :, :3] / plain.states[lane, :, :3] - 1).max() > 1e-5, point


@pytest.mark.parametrize(
    ("point", "name", "unit"),
    [("eta_sc", "T_e", 1.0), ("W_c", "compressor_flow_loss", -1.0), ("eta_c", "compressor_efficiency_loss", -1.0),
     ("eta_tm", "turbine_efficiency_loss", -1.0), ("u_delta", "injector_drift", 1.0), ("u_vgt", "vgt_offset", 1.0),
     ("u_egr", "egr_offset", 1.0)],
)  # fmt: skip
def test_constant_signal_is_its_effect(drive, point: str, name: str, unit: float) -> None:  # type: ignore[no-untyped-def]
    _, actuation, initial = drive
    signals = np.zeros((len(POINTS), actuation.time_s.size))
    signals[POINTS.index("T_e" if point == "eta_sc" else point)] = 0.03 * unit
    a = simulate_extended(actuation, parameter_batch(ENGINE), Extension(signals=signals), initial)
    if point == "eta_sc":
        b = simulate_states(actuation, parameter_batch(ENGINE.replace(eta_sc=ENGINE.eta_sc * 1.03)), initial)
    else:
        b = simulate_extended(actuation, parameter_batch(ENGINE), Extension(_magnitudes(**{name: 0.03})), initial)
    np.testing.assert_allclose(a.measured, b.measured, rtol=1e-9, atol=1e-12)


def test_schedule_holds_the_interval_after_its_sample(drive) -> None:  # type: ignore[no-untyped-def]
    inputs, actuation, initial = drive
    plain = simulate_states(actuation, parameter_batch(ENGINE), initial)
    onset = 50
    term = Term(effect="boost_leak", magnitude=4e-5, onset_s=float(inputs.time_s[onset] - inputs.time_s[0]) - 1e-6)
    parameters = ENGINE.replace(terms=(term,))
    late = simulate_terms(actuation, parameter_batch(parameters), initial)
    np.testing.assert_allclose(late.states[0, : onset + 1, :5], plain.states[0, : onset + 1], rtol=1e-9)
    assert late.states[0, onset + 5, 0] < plain.states[0, onset + 5, 0]


def test_thermal_inertia_is_a_lag_of_the_gas_temperature(drive) -> None:  # type: ignore[no-untyped-def]
    """Against a lag of the static temperature in steps a hundred times finer; and a small lag tends to none."""
    _, actuation, initial = drive
    plain = simulate_states(actuation, parameter_batch(ENGINE), initial)
    parameters = ENGINE.replace(terms=(Term(effect="exhaust_thermal_inertia", magnitude=0.4),))
    observed = simulate_terms(actuation, parameter_batch(parameters), initial)
    frame = extended_frame(observed.states[0], actuation, parameters)
    time = actuation.time_s
    fine = np.linspace(time[0], time[-1], 100 * (time.size - 1) + 1)
    static, T = np.interp(fine, time, frame["t_em_static_k"]), np.empty(fine.size)
    T[0] = static[0]
    for i in range(fine.size - 1):
        T[i + 1] = T[i] + (fine[i + 1] - fine[i]) / 0.4 * (0.5 * (static[i] + static[i + 1]) - T[i])
    assert np.abs(T[::100] - frame["t_em_k"]).max() < 0.05 * np.abs(frame["t_em_k"] - frame["t_em_static_k"]).max()
    tiny = simulate_extended(
        actuation, parameter_batch(ENGINE), Extension(_magnitudes(exhaust_thermal_inertia=1e-5)), initial
    )
    np.testing.assert_allclose(tiny.measured, plain.measured, rtol=1e-4, atol=1e-7)


def test_law_term_equals_its_effect(drive) -> None:  # type: ignore[no-untyped-def]
    """Bearing friction written as a law: -c omega_t^2 added to the shaft power."""
    _, actuation, initial = drive
    c = 5e-6
    law = LawTerm(point="shaft_power", coefficient=-c * 5000.0**2, unit="W", factors=(("omega_t", 5000.0, 2.0),))
    a, b = ENGINE.replace(terms=(law,)), ENGINE.replace(terms=(Term(effect="bearing_friction", magnitude=c),))
    found = simulate_terms(actuation, parameter_batch(a, size=2), initial)
    exact = simulate_terms(actuation, parameter_batch(b), initial)
    plain = simulate_states(actuation, parameter_batch(ENGINE), initial)
    change = np.abs(exact.measured[0] - plain.measured[0]).max(axis=0)
    assert (np.abs(found.measured[0] - exact.measured[0]).max(axis=0) < 1e-2 * change + 1e-12).all()


def test_two_laws_at_two_points(drive) -> None:  # type: ignore[no-untyped-def]
    _, actuation, initial = drive
    laws = (
        LawTerm(point="intake_balance", coefficient=-0.005, unit="kg/s", factors=(("p_im", 1e5, 1.0),)),
        LawTerm(point="W_t", coefficient=0.02, unit="-"),
    )
    parameters = ENGINE.replace(terms=laws)
    observed = simulate_terms(actuation, parameter_batch(parameters, size=2), initial)
    np.testing.assert_allclose(observed.states[0], observed.states[1], rtol=1e-12)
    signals = np.zeros((len(POINTS), actuation.time_s.size))
    signals[POINTS.index("W_t")] = 0.02
    signals[POINTS.index("intake_balance")] = -0.005 * observed.states[0, :, 0] / 1e5
    expected = simulate_extended(actuation, parameter_batch(ENGINE), Extension(signals=signals), initial)
    np.testing.assert_allclose(observed.states[0], expected.states[0], rtol=1e-4)


def test_a_law_of_a_valve_that_overshoots_shut_is_finite(drive) -> None:  # type: ignore[no-untyped-def]
    """A valve's lags take its position below nought when it shuts fast: no root of that, as in the search."""
    inputs, *_ = drive
    shut = replace(inputs, u_egr_pct=np.where(inputs.time_s < inputs.time_s[50], 80.0, 0.0))
    law = LawTerm(point="f_egr", coefficient=-0.1, unit="-", factors=(("u_egr", 20.0, 0.5),))
    table = simulate(shut, ENGINE.replace(terms=(law,)), oxygen=False)
    assert actuate(shut, ENGINE).at_samples()[2].min() < 0.0
    assert np.isfinite(table["w_egr_kg_s"]).all()


def test_simulate_takes_terms_and_files_keep_them(drive, tmp_path) -> None:  # type: ignore[no-untyped-def]
    inputs, _, initial = drive
    terms = (
        Term(effect="back_pressure", magnitude=1e5, std=1e3, region={"n_e_rpm": (0.0, 5000.0)}),
        Term(effect="p_im_offset", magnitude=2000.0),
        Term(effect="egr_backlash", magnitude=4.0),
    )
    parameters = ENGINE.replace(terms=terms)
    path = tmp_path / "engine.yaml"
    import yaml

    path.write_text(yaml.safe_dump(parameters.model_dump(mode="json")))
    assert load_engine(path) == parameters
    table = simulate(inputs, parameters, initial=initial)
    np.testing.assert_allclose(
        table["p_es_pa"], ENGINE.p_amb + 1e5 * table["w_t_kg_s"] ** 2 * table["t_em_k"] / 700.0, rtol=1e-6
    )
    assert table["p_im_pa"].iloc[0] == pytest.approx(initial[0] + 2000.0)
    assert {"x_oim", "torque_nm", "w_leak_im_kg_s", "t_im_k"} <= set(table)
    assert np.isfinite(table.to_numpy(dtype=float)).all()
    assert simulate(inputs, parameters, oxygen=False).shape[0] == inputs.time_s.size  # settles by itself


@pytest.mark.parametrize(
    ("term", "words"),
    [({"effect": "boost_leek", "magnitude": 1e-5}, "boost_leak"),
     ({"effect": "boost_leak", "magnitude": 1.0}, "0.0002 m2"),
     ({"effect": "boost_leak", "magnitude": float("nan")}, "nan"),
     ({"effect": "boost_leak", "magnitude": 1e-5, "region": {"rpm": (0, 1)}}, "n_e_rpm"),
     ({"point": "W_z", "coefficient": 1.0, "unit": "-"}, "W_"), ({"effect": "boost_leak"}, "required"),
     ({"point": "W_t", "coefficient": 1.0, "unit": "W"}, "allowed '-'")],
)  # fmt: skip
def test_wrong_terms_are_one_clear_line(term: dict, words: str) -> None:
    with pytest.raises(InputError) as caught:
        ENGINE.replace(terms=[term])
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_wrong_shapes_are_refused(drive) -> None:  # type: ignore[no-untyped-def]
    _, actuation, initial = drive
    batch = parameter_batch(ENGINE)
    for extension in (
        Extension(np.zeros((3, 1))), Extension(restarts=(1, 2)), Extension(restarts=(0, 0)),
        Extension(lane_point=np.array([99]), lane_signal=np.zeros((1, actuation.time_s.size))),
        Extension(signals=np.full((len(POINTS), actuation.time_s.size), np.nan)),
    ):  # fmt: skip
        with pytest.raises(InputError):
            simulate_extended(actuation, batch, extension, initial)


def test_actuator_terms_enter_the_actuation(drive) -> None:  # type: ignore[no-untyped-def]
    inputs, plain, _ = drive
    for name in ("egr_backlash", "egr_dead_time"):
        changed = actuate(inputs, ENGINE.replace(terms=(Term(effect=name, magnitude=0.8),)))
        assert np.abs(changed.u_egr - plain.u_egr).max() > 0.1
        np.testing.assert_allclose(changed.u_vgt, plain.u_vgt, atol=1e-9)


def test_every_lane_may_have_its_own_schedule(drive) -> None:  # type: ignore[no-untyped-def]
    _, actuation, initial = drive
    n = actuation.time_s.size
    schedules = np.ones((2, len(STATE_EFFECTS), n))
    schedules[1, :, : n // 2] = 0.0
    magnitudes = np.repeat(_magnitudes(boost_leak=1e-5, injector_drift=0.05), 3, axis=1)
    batch = parameter_batch(ENGINE, A_egrmax=np.full(3, ENGINE.A_egrmax))
    of_lane = np.array([1, 0, 1])
    found = simulate_extended(
        actuation, batch, Extension(magnitudes, schedules=schedules, schedule_of_lane=of_lane), initial
    )
    for lane, own in enumerate(of_lane):
        alone = simulate_extended(
            actuation, parameter_batch(ENGINE), Extension(magnitudes[:, :1], schedules[own]), initial
        )
        np.testing.assert_array_equal(found.measured[lane], alone.measured[0])
    with pytest.raises(InputError, match="schedule_of_lane"):
        simulate_extended(
            actuation, batch, Extension(magnitudes, schedules=schedules, schedule_of_lane=of_lane + 1), initial
        )


def test_stages_for_longer_steps(drive) -> None:  # type: ignore[no-untyped-def]
    """Third order, and stable at steps at which RK4 isn't: both against RK4 at 2.5 ms."""
    inputs, _, initial = drive
    errors = {}
    exact = simulate_extended(actuate(inputs, ENGINE, 0.0025), parameter_batch(ENGINE), Extension(), initial).measured
    for step in (0.0125, 0.025, 0.05):
        for late in (1.0, 0.48):
            actuation = actuate(inputs, ENGINE, step)
            some = simulate_extended(actuation, parameter_batch(ENGINE), Extension(), initial, late=late)
            errors[step, late] = float(np.max(np.abs(some.measured / exact - 1.0)[:, 10:, :3]))
    assert errors[0.025, 0.48] < 1e-3 and errors[0.0125, 0.48] < 0.3 * errors[0.025, 0.48]
    assert errors[0.05, 0.48] < 1e-3 and errors[0.05, 0.48] < 0.2 * errors[0.05, 1.0]
