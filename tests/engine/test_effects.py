"""The effects: laws and their limits, signs by site, implicit laws, play, dead time, sensors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dieseltwin.engine import Inputs, actuate, bind, constants, we2011
from dieseltwin.engine.actuation import actuate_lanes, actuate_with, play
from dieseltwin.engine.effects import EFFECTS, GAS_LAG, SITES, STATE_EFFECTS, Magnitudes
from dieseltwin.engine.model import quantities
from dieseltwin.engine.nozzle import leak_flow, nozzle_flow_factor
from dieseltwin.engine.quantities import POINTS, Gas, OperatingPoint, Quantities, Signals
from dieseltwin.engine.sensor_effects import apply_sensor_effects
from dieseltwin.engine.terms import Term
from dieseltwin.errors import InputError

C = constants(we2011.PARAMETERS)
STATES = (np.array([1.4e5, 2.2e5]), np.array([1.7e5, 2.8e5]), np.array([5000.0, 8000.0]), 0.03, 330.0)
INPUTS = (1200.0, np.array([80.0, 150.0]), 30.0, 45.0)
MODEL = bind("numpy")
NONE = Magnitudes(*([0.0] * len(STATE_EFFECTS)))
QUIET = Signals(*([0.0] * len(POINTS)))
# what each effect does to dp_im, dp_em, domega_t, W_egr, T_em, W_c at fixed states; None: either sign
SIGNS: dict[str, tuple[int | None, ...]] = {
    "boost_leak": (-1, 0, 0, 0, 0, 0),
    "exhaust_leak": (0, -1, 0, 0, 0, 0),
    "back_pressure": (0, 1, -1, 0, 0, 0),
    "exhaust_flap": (0, 1, -1, 0, 0, 0),
    "air_filter_restriction": (-1, 0, 1, 0, 0, -1),
    "charge_cooler_loss": (1, None, None, None, 1, 0),
    "egr_heating": (1, None, None, None, 1, 0),
    "intake_heat_pickup": (1, None, None, None, 1, 0),
    "bearing_friction": (0, 0, -1, 0, 0, 0),
    "egr_valve_leak": (1, -1, 0, 1, 0, 0),
    "egr_offset": (1, -1, 0, 1, 0, 0),
    "egr_clogging": (-1, 1, 0, -1, 0, 0),
    "vgt_offset": (0, -1, 1, 0, 0, 0),
    "injector_drift": (-1, 1, None, -1, 1, 0),
    "compressor_efficiency_loss": (0, 0, -1, 0, 0, 0),
    "turbine_efficiency_loss": (0, 0, -1, 0, 0, 0),
    "compressor_flow_loss": (-1, 0, 1, 0, 0, -1),
    "volumetric_efficiency_residual": (1, -1, None, None, 1, 0),
    "blow_by": (1, -1, None, 1, -1, 0),
}


def _at(m: Magnitudes = NONE, s: Signals = QUIET, sweeps: int = 30) -> Quantities:
    x_r, T_1, T = STATES[3], STATES[4], np.full(2, 700.0)
    for _ in range(sweeps):
        q = MODEL.quantities_extended(OperatingPoint(*STATES[:3], x_r, T_1, *INPUTS), Gas(T, 1.0, 0.0), m, s, C)
        x_r, T_1, T = q.x_r_next, q.T_1_next, q.T_em
    return q


def _magnitude(name: str) -> float:
    return 0.05 if name == "egr_clogging" else EFFECTS[name].sizes[0]  # it stands for k t there


def test_without_effects_the_quantities_are_the_published_ones() -> None:
    """With the laws at zero, without them, and as the composition is written."""
    plain = MODEL.quantities(*STATES, *INPUTS, C)
    extended = MODEL.quantities_extended(OperatingPoint(*STATES, *INPUTS), Gas(700.0, 1.0, 0.0), NONE, QUIET, C)
    for name, as_written, bound in zip(Quantities._fields, quantities(*STATES, *INPUTS, C), plain, strict=True):
        np.testing.assert_allclose(as_written, bound, rtol=1e-9, err_msg=name)
    for name in Quantities._fields:
        np.testing.assert_allclose(getattr(extended, name), getattr(plain, name), rtol=1e-13, err_msg=name)


def test_catalogue_is_complete_and_consistent() -> None:
    for effect in EFFECTS.values():
        assert effect.site in SITES and effect.law and effect.source
        assert effect.limits[0] <= 0.0 < effect.tolerance < effect.limits[1]
        assert all(effect.limits[0] < size <= effect.limits[1] for size in effect.sizes) and effect.sizes
        assert set(effect.confused_with) <= set(EFFECTS) - {effect.name}
        assert effect.tolerance * 10 <= effect.limits[1], effect.name  # what the benchmark draws
    assert set(SIGNS) | {GAS_LAG} == set(STATE_EFFECTS)


@pytest.mark.parametrize("name", SIGNS)
def test_signs_by_site(name: str) -> None:
    base, changed = _at(), _at(NONE._replace(**{name: _magnitude(name)}))
    for field, sign in zip(("dp_im", "dp_em", "domega_t", "W_egr", "T_em", "W_c"), SIGNS[name], strict=True):
        change = np.broadcast_to(getattr(changed, field) - getattr(base, field), (2,))
        if sign is not None:
            scale = np.abs(getattr(base, field)).max()
            assert (np.sign(np.where(np.abs(change) < 1e-9 * scale, 0.0, change)) == sign).all(), (field, change)


def test_flows_are_conserved_under_all_effects_at_once() -> None:
    m = Magnitudes(*(_magnitude(name) for name in STATE_EFFECTS))
    s = QUIET._replace(intake_balance=0.003, exhaust_balance=-0.002, shaft_power=150.0)
    q = _at(m, s)
    stored_im = q.dp_im * C.V_im / (C.R_a * q.T_im)
    stored_em = q.dp_em * C.V_em / (C.R_e * q.T_em)
    np.testing.assert_allclose(stored_im, q.W_c + q.W_egr - q.W_ei - q.W_leak_im + 0.003, atol=1e-12)
    np.testing.assert_allclose(stored_em, q.W_eo - q.W_t - q.W_egr - q.W_leak_em - 0.002, atol=1e-12)
    np.testing.assert_allclose(q.W_eo, q.W_ei * (1 - m.blow_by) + q.W_f, rtol=1e-13)
    power = q.domega_t * C.J_t * STATES[2]
    np.testing.assert_allclose(power, q.P_t_eta_m - q.P_c - q.P_f + 150.0, rtol=1e-10)
    mixed = _at(NONE._replace(egr_heating=1.0))
    expected = (mixed.W_c * C.T_im + mixed.W_egr * mixed.T_em) / (mixed.W_c + mixed.W_egr)
    np.testing.assert_allclose(mixed.T_im, expected, rtol=1e-6)


@settings(max_examples=60, deadline=None)
@given(
    k_out=st.floats(1e3, 2e5), k_in=st.floats(1e3, 6e4), load=st.floats(0.0, 1.0), signal=st.floats(-0.03, 0.03)
)
def test_implicit_laws_hold(k_out: float, k_in: float, load: float, signal: float) -> None:
    p_im, p_em, omega_t = 1.1e5 + 1.5e5 * load, 1.3e5 + 2e5 * load, 4000.0 + 4500.0 * load
    m = NONE._replace(back_pressure=k_out, air_filter_restriction=k_in)
    s = QUIET._replace(p_es=signal, p_bc=-abs(signal))
    gas = Gas(700.0, 0.0, 700.0)
    x = OperatingPoint(p_im, p_em, omega_t, 0.03, 330.0, 1300.0, 30 + 150 * load, 20.0, 50.0)
    q = MODEL.quantities_extended(x, gas, m, s, C)
    assert q.p_es == pytest.approx((1 + signal) * (C.p_amb + k_out * q.W_t**2 * q.T_em / 700.0), rel=1e-6)
    assert q.p_bc == pytest.approx((1 - abs(signal)) * (C.p_amb - k_in * q.W_c**2), rel=1e-6)


@settings(max_examples=50, deadline=None)
@given(gamma=st.floats(1.2, 1.45))
def test_nozzle_chokes_continuously(gamma: float) -> None:
    choking = (2.0 / (gamma + 1.0)) ** (gamma / (gamma - 1.0))
    quotient = np.linspace(0.0, 1.3, 2001)
    factor = nozzle_flow_factor(quotient, gamma, choking)
    largest = np.sqrt(gamma * (2.0 / (gamma + 1.0)) ** ((gamma + 1.0) / (gamma - 1.0)))
    np.testing.assert_allclose(factor[quotient <= choking], largest, rtol=1e-12)
    assert (factor[quotient >= 1.0] == 0.0).all()
    assert (np.diff(factor) <= 1e-12).all()
    inner = (quotient > choking) & (quotient < 0.99)
    assert np.abs(np.diff(factor[inner])).max() < 0.02


def test_leak_of_the_worked_case() -> None:
    """67 mm2 passes about 1.06e-2 kg/s per bar of choked boost."""
    flow = leak_flow(6.7e-5 / 1.5, 2.4e5, C.T_im, C.p_amb, C.R_a, C.gamma_a, C.choking_a)
    assert flow == pytest.approx(6.7e-5 / 1.5 * 2.4e5 / np.sqrt(C.R_a * C.T_im) * 0.6837, rel=2e-3)
    assert leak_flow(1e-4, 0.9e5, 300.0, 1e5, C.R_a, C.gamma_a, C.choking_a) == 0.0


def test_torch_agrees_and_has_gradients() -> None:
    torch = pytest.importorskip("torch")
    model = bind("torch")
    states = [torch.tensor(np.broadcast_to(v, (2,)).copy(), dtype=torch.float64) for v in STATES]
    inputs = [torch.tensor(np.broadcast_to(v, (2,)).copy(), dtype=torch.float64) for v in INPUTS]
    sizes = {name: torch.tensor(_magnitude(name), dtype=torch.float64, requires_grad=True) for name in STATE_EFFECTS}
    gas = Gas(torch.full((2,), 700.0, dtype=torch.float64), 1.0, 0.0)
    q = model.quantities_extended(OperatingPoint(*states, *inputs), gas, Magnitudes(**sizes), QUIET, C)
    m = Magnitudes(**{name: _magnitude(name) for name in STATE_EFFECTS})
    expected = MODEL.quantities_extended(OperatingPoint(*STATES, *INPUTS), Gas(700.0, 1.0, 0.0), m, QUIET, C)
    for name in Quantities._fields:
        np.testing.assert_allclose(getattr(q, name).detach().numpy(), getattr(expected, name), rtol=1e-9, err_msg=name)
    (q.dp_im.sum() / 1e5 + q.dp_em.sum() / 1e5 + q.domega_t.sum()).backward()
    for name, value in sizes.items():
        if name != "exhaust_thermal_inertia":
            assert value.grad is not None and torch.isfinite(value.grad) and value.grad != 0, name


_commands = st.lists(st.floats(0.0, 100.0), min_size=3, max_size=25)


@settings(max_examples=80, deadline=None)
@given(values=_commands, width=st.floats(0.0, 30.0))
def test_play_stays_within_half_its_width_and_moves_only_when_pushed(values: list[float], width: float) -> None:
    time, u = 0.2 * np.arange(len(values)), np.array(values)
    knots, y = play(time, u, width)
    fine = np.union1d(np.linspace(time[0], time[-1], 40 * len(values)), np.append(knots, time))
    output, command = np.interp(fine, knots, y), np.interp(fine, time, u)
    assert (np.abs(output - command) <= 0.5 * width + 1e-6).all()
    moving = np.diff(output)
    pushed = np.abs(np.abs((output - command)[1:]) - 0.5 * width) < 1e-6
    assert (np.abs(moving[~pushed]) < 1e-6).all()
    assert (moving * np.diff(command) >= -1e-6).all()  # never against the command


@settings(max_examples=40, deadline=None)
@given(values=_commands, width=st.floats(0.1, 30.0))
def test_play_is_rate_independent_and_has_no_memory_of_inner_loops(values: list[float], width: float) -> None:
    u = np.array(values)
    slow, fast = (play(step * np.arange(u.size), u, width)[1][-1] for step in (1.0, 0.1))
    assert slow == pytest.approx(fast, abs=1e-9)
    inner = np.append(u, [u[-1], u[-1]])  # standing still changes nothing
    assert play(np.arange(inner.size, dtype=float), inner, width)[1][-1] == pytest.approx(slow, abs=1e-9)


def test_where_play_ends_its_output_jumps_to_the_command() -> None:
    time, u = np.arange(5.0), np.array([50.0, 60.0, 60.0, 60.0, 60.0])
    knots, y = play(time, u, np.array([8.0, 8.0, 8.0, 0.0, 0.0]))
    np.testing.assert_allclose(np.interp([1.0, 2.5, 2.99, 3.0, 4.0], knots, y), [56.0, 56.0, 56.0, 60.0, 60.0])


def _inputs() -> Inputs:
    time = np.arange(0.0, 20.01, 0.2)
    wave = 50.0 + 30.0 * np.sin(0.8 * time)
    return Inputs(time, np.full(time.size, 1200.0), np.full(time.size, 90.0), wave, 0.5 * wave + 20.0)


def test_no_actuator_effect_is_the_plain_actuation() -> None:
    inputs = _inputs()
    plain = actuate(inputs, we2011.PARAMETERS)
    np.testing.assert_allclose(actuate_with(inputs, we2011.PARAMETERS, {}).grid, plain.grid, rtol=1e-12)


def test_growing_dead_time_is_the_same_in_a_shorter_recording() -> None:
    grows = Term(effect="egr_dead_time", magnitude=0.8, grown_s=40.0)
    engine, inputs = we2011.PARAMETERS.replace(terms=[grows]), _inputs()
    part = {name: values[:51] for name, values in {"time_s": inputs.time_s, **inputs.columns}.items()}
    whole, begun = actuate(inputs, engine), actuate(Inputs(**part), engine)
    np.testing.assert_allclose(begun.u_egr1[:50], whole.u_egr1[:50], rtol=1e-9)
    before = actuate(inputs, we2011.PARAMETERS.replace(terms=[grows.model_copy(update={"grown_s": None})]))
    assert np.abs(whole.u_egr1 - before.u_egr1).max() > 1.0


def test_dead_time_delays_by_its_magnitude_and_from_its_onset() -> None:
    inputs = _inputs()
    longer = actuate(inputs, we2011.PARAMETERS.replace(tau_degr=we2011.PARAMETERS.tau_degr + 0.13))
    shifted = actuate_with(inputs, we2011.PARAMETERS, {"egr_dead_time": 0.13})
    np.testing.assert_allclose(shifted.grid, longer.grid, atol=1e-9)
    late = (inputs.time_s >= 10.0).astype(float)
    half = actuate_with(inputs, we2011.PARAMETERS, {"egr_dead_time": 0.13}, {"egr_dead_time": late})
    plain = actuate(inputs, we2011.PARAMETERS)
    at = np.searchsorted(inputs.time_s, 9.9)
    np.testing.assert_allclose(half.u_egr[:at], plain.u_egr[:at], atol=1e-9)
    np.testing.assert_allclose(half.u_egr[-20:], longer.u_egr[-20:], atol=1e-3)


def test_fuel_behind_its_lag_is_exact_and_begins_at_its_onset() -> None:
    time = np.arange(0.0, 10.01, 0.2)
    fuel = np.interp(time, [0.0, 2.0, 4.0, 10.0], [60.0, 60.0, 120.0, 120.0])  # a ramp of 30 mg/s
    inputs = Inputs(time, np.full(time.size, 1200.0), fuel, np.full(time.size, 30.0), np.full(time.size, 50.0))
    late = actuate_with(inputs, we2011.PARAMETERS, {"fuel_lag": 0.8}).at_samples()
    t = time[10:21] - 2.0
    np.testing.assert_allclose(late[1, 10:21], 60.0 + 30.0 * (t - 0.8 * (1.0 - np.exp(-t / 0.8))), rtol=1e-9)
    plain = actuate(inputs, we2011.PARAMETERS).at_samples()
    np.testing.assert_array_equal(late[[0, 2, 3]], plain[[0, 2, 3]])
    acts = (time >= 3.0 - 1e-9).astype(float)
    from_onset = actuate_with(inputs, we2011.PARAMETERS, {"fuel_lag": 0.8}, {"fuel_lag": acts}).at_samples()[1]
    np.testing.assert_allclose(from_onset[:16], plain[1, :16], rtol=1e-12)
    assert from_onset[17] < plain[1, 17] and abs(from_onset[-1] - 120.0) < 0.1


def test_a_valve_stands_still_between_its_onset_and_its_end() -> None:
    inputs = _inputs()
    time, told = inputs.time_s, actuate(inputs, we2011.PARAMETERS).at_samples()
    acts = ((time >= 2.0 - 1e-9) & (time < 6.0 - 1e-9)).astype(float)
    for name, row in (("egr_stuck", 2), ("vgt_stuck", 3)):
        stood = actuate_with(inputs, we2011.PARAMETERS, {name: 37.0}, {name: acts}).at_samples()
        np.testing.assert_array_equal(np.delete(stood, row, axis=0), np.delete(told, row, axis=0))
        np.testing.assert_allclose(stood[row, time <= 2.0], told[row, time <= 2.0], atol=1e-5)  # a jump takes 1 us
        still = (time > 5.0) & (time < 6.0)  # its lags have come to rest
        np.testing.assert_allclose(stood[row, still], 37.0, atol=0.02)
        assert np.abs(told[row, still] - 37.0).max() > 2.0
        always = actuate_with(inputs, we2011.PARAMETERS, {name: 37.0}).at_samples()
        np.testing.assert_allclose(always[row], 37.0, rtol=1e-12)


def test_lanes_share_actuations() -> None:
    lanes = actuate_lanes(_inputs(), we2011.PARAMETERS, {"egr_backlash": np.array([0, 4.0, 0, 4.0, 8.0])}, 5)
    assert lanes[0] is lanes[2] and lanes[1] is lanes[3] and len({id(lane) for lane in lanes}) == 3
    assert np.ptp(lanes[4].u_egr[20:]) < np.ptp(lanes[1].u_egr[20:]) < np.ptp(lanes[0].u_egr[20:])
    with pytest.raises(InputError):
        actuate_with(_inputs(), we2011.PARAMETERS, {"egr_backlash": float("nan")})


def test_what_no_effect_moves_is_taken_from_the_actuation_without() -> None:
    inputs, alike = _inputs(), ("steps", "u_egr1", "u_egr2", "u_vgt", "u_egr", "grid")
    plain = actuate_with(inputs, we2011.PARAMETERS, {})
    doubled = replace(plain, grid=2.0 * plain.grid)  # not what would come out anew
    for name, rows in (("egr_backlash", [2]), ("egr_dead_time", [2]), ("egr_stuck", [2]), ("vgt_backlash", [3]),
                       ("vgt_dead_time", [3]), ("vgt_stuck", [3]), ("fuel_lag", [1])):  # fmt: skip
        anew = actuate_with(inputs, we2011.PARAMETERS, {name: 1.0})
        beside = actuate_with(inputs, we2011.PARAMETERS, {name: 1.0}, plain=plain)
        for attribute in alike:
            np.testing.assert_array_equal(getattr(anew, attribute), getattr(beside, attribute))
        moved = actuate_with(inputs, we2011.PARAMETERS, {name: 1.0}, plain=doubled).grid
        assert [row for row in range(4) if not np.array_equal(moved[row], doubled.grid[row])] == rows
        np.testing.assert_array_equal(moved[rows], anew.grid[rows])


def test_sensor_effects() -> None:
    time = np.arange(0.0, 10.01, 0.2)
    measured = np.ones((2, time.size, 6)) * np.array([1.5e5, 1.8e5, 5000.0, 0.03, 700.0, 0.2])
    measured[:, 10:, 4] += 100.0
    late = (time >= 5.0).astype(float)
    out = apply_sensor_effects(
        measured, time, {"p_im_offset": np.array([0.0, 1000.0]), "p_em_gain": 0.01, "thermocouple_lag": 1.0,
                         "boost_leak": 1e-5}, {"p_em_gain": late},
    )  # fmt: skip
    np.testing.assert_allclose(out[:, :, 0] - measured[:, :, 0], [[0.0] * time.size, [1000.0] * time.size], atol=1e-9)
    np.testing.assert_allclose(out[0, :, 1], 1.8e5 * (1 + 0.01 * late))
    ramp = 100.0 - 100.0 / 0.2 * (1 - np.exp(-0.2))  # a ramp of 0.2 s behind a lag of 1 s
    assert out[0, 10, 4] == pytest.approx(700.0 + ramp)
    assert out[0, 15, 4] == pytest.approx(800.0 - (100.0 - ramp) * np.exp(-1.0))
    np.testing.assert_array_equal(out[..., 2:4], measured[..., 2:4])
    assert apply_sensor_effects(measured, time, {"boost_leak": 1e-5}) is measured


def test_a_lag_acts_in_the_interval_after_its_onset() -> None:
    """As every effect: the reading at the onset is what it was, the one at the end still lags."""
    time = 0.2 * np.arange(6)
    rising = 600.0 + 10.0 * time[None, :, None]
    acting = {"thermocouple_lag": np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0])}
    (out,) = apply_sensor_effects(rising, time, {"thermocouple_lag": 0.5}, acting, ("t_em_k",))[..., 0]
    late = np.abs(out - rising[0, :, 0]) > 1e-9
    assert late.tolist() == [False, False, False, True, True, False]
