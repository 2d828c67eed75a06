"""Batches, history, exact actuators, limits and outputs of the simulator."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dieseltwin.engine import Inputs, actuate, load_engine, parameter_batch, settle, simulate, simulate_states, we2011
from dieseltwin.engine.inputs import steps_between
from dieseltwin.engine.manifolds import X_OC
from dieseltwin.engine.simulate import LOADED_START, SETTLE_START
from dieseltwin.engine.terms import LawTerm, Term
from dieseltwin.errors import InputError


def _cut(inputs: Inputs, start: float, end: float, history_s: float = 2.0) -> Inputs:
    rows = (inputs.time_s >= start - history_s - 1e-9) & (inputs.time_s <= end + 1e-9)
    time = inputs.time_s[rows]
    columns = {n: getattr(inputs, n)[rows] for n in ("n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct")}
    return Inputs(time, **columns, n_history=int((time < start - 1e-9).sum()))


def test_batch_equals_single_runs_and_threads_change_nothing(field_trace) -> None:  # type: ignore[no-untyped-def]
    _, inputs, engine, initial = field_trace
    actuation = actuate(_cut(inputs, 60.0, 75.0), engine)
    scales = np.linspace(0.8, 1.2, 19)
    batch = parameter_batch(engine, A_egrmax=engine.A_egrmax * scales, eta_sc=engine.eta_sc * scales[::-1])
    together = simulate_states(actuation, batch, initial, threads=2)
    again = simulate_states(actuation, batch, initial, threads=1)
    assert np.array_equal(together.states, again.states)
    for lane in (0, 7, 8, 18):
        one = replace(batch, values=batch.values[:, [lane]])
        alone = simulate_states(actuation, one, initial)
        np.testing.assert_allclose(together.states[lane], alone.states[0], rtol=1e-9)
        np.testing.assert_allclose(together.measured[lane], alone.measured[0], rtol=1e-7, atol=1e-9)


def test_lanes_with_inputs_of_their_own(field_trace) -> None:  # type: ignore[no-untyped-def]
    _, inputs, engine, initial = field_trace
    pieces = [actuate(_cut(inputs, start, start + 10.0), engine) for start in (20.0, 50.0, 90.0)]
    batch = parameter_batch(engine, size=3)
    together = simulate_states(pieces, batch, initial)
    for lane, piece in enumerate(pieces):
        alone = simulate_states(piece, parameter_batch(engine), initial)
        np.testing.assert_allclose(together.states[lane], alone.states[0], rtol=1e-9)


def test_history_continues_the_actuators(field_trace) -> None:  # type: ignore[no-untyped-def]
    """A segment with history gives the same trace as the whole recording from there on."""
    table, inputs, engine, _ = field_trace
    start = table.loc[np.isclose(table["time_s"], 120.0), ["p_im_pa", "p_em_pa", "omega_t_rad_s"]].to_numpy()[0]
    result = simulate(_cut(inputs, 120.0, 130.0), engine, initial=start, oxygen=False)
    expected = table[(table["time_s"] > 119.99) & (table["time_s"] < 130.01)]
    for column in ("p_em_pa", "u_egr1_pct", "u_egr2_pct", "u_vgt_act_pct", "w_egr_kg_s"):
        error = np.abs(result[column].to_numpy() - expected[column].to_numpy()).max() / expected[column].mean()
        assert error < 1e-3, column
    without = simulate(_cut(inputs, 120.0, 130.0, history_s=0.0), engine, initial=start, oxygen=False)
    assert abs(without["u_egr2_pct"].iloc[0] - expected["u_egr2_pct"].iloc[0]) > 1e-3


@settings(max_examples=20, deadline=None)
@given(shift=st.floats(-1e5, 1e5))
def test_time_shift_changes_nothing(field_trace, shift: float) -> None:  # type: ignore[no-untyped-def]
    _, inputs, engine, initial = field_trace
    piece = _cut(inputs, 60.0, 63.0)
    moved = replace(piece, time_s=piece.time_s + shift)
    a = simulate_states(actuate(piece, engine), parameter_batch(engine), initial).states
    b = simulate_states(actuate(moved, engine), parameter_batch(engine), initial).states
    np.testing.assert_allclose(a, b, rtol=1e-6)


@settings(max_examples=30, deadline=None)
@given(delay=st.floats(0.0, 0.4), tau=st.floats(0.01, 0.5), end=st.floats(0.0, 100.0))
def test_actuator_step_is_exact(delay: float, tau: float, end: float) -> None:
    """A ramp in the first 0.2 s after a dead time, against the closed form of a first-order lag."""
    time = np.arange(0.0, 2.01, 0.2)
    u = np.where(time > 0.1, end, 20.0)
    engine = we2011.PARAMETERS.replace(tau_dvgt=delay, tau_vgt=tau)
    inputs = Inputs(time, np.full_like(time, 1000.0), np.full_like(time, 50.0), np.full_like(time, 10.0), u)
    got = actuate(inputs, engine).u_vgt
    slope, s = (end - 20.0) / 0.2, np.maximum(time - delay, 0.0)

    def ramp(t: np.ndarray) -> np.ndarray:
        t = np.maximum(t, 0.0)
        return t - tau * (1.0 - np.exp(-t / tau))

    np.testing.assert_allclose(got, 20.0 + slope * (ramp(s) - ramp(s - 0.2)), atol=1e-9)


def test_sample_rate_of_the_recording_does_not_matter(field_trace) -> None:  # type: ignore[no-untyped-def]
    """The same piecewise linear inputs, given at 5 Hz and at uneven finer times."""
    _, inputs, engine, initial = field_trace
    piece = _cut(inputs, 60.0, 70.0, history_s=0.0)
    finer = piece.resampled(0.03)
    a = simulate(piece, engine, initial=initial, oxygen=False)
    b = simulate(finer, engine, initial=initial, oxygen=False)
    both = np.isin(np.round(finer.time_s, 6), np.round(piece.time_s, 6))
    for column in ("p_im_pa", "p_em_pa", "omega_t_rad_s"):
        np.testing.assert_allclose(a[column], b.loc[both, column], rtol=2e-4)


def test_finer_times_divide_each_interval_evenly_to_the_bit() -> None:
    time = np.array([-3.1, -2.9, -2.8875, -1.5, 0.0, 0.2, 1e3])
    inputs = Inputs(time, *np.ones((4, time.size)))
    parts = [np.linspace(*ends, max(1, round(np.ptp(ends) / 0.0125)), endpoint=False) for ends in pairwise(time)]
    np.testing.assert_array_equal(inputs.resampled(0.0125).time_s, np.concatenate([*parts, time[-1:]]))


def test_inputs_are_clipped_by_simulate_only() -> None:
    engine = we2011.PARAMETERS
    time = np.arange(0.0, 5.0, 0.2)
    full = np.ones_like(time)
    inputs = Inputs(time, 2500.0 * full, 300.0 * full, 120.0 * full, 10.0 * full)
    result = simulate(inputs, engine, oxygen=False)
    assert result["n_e_rpm"].max() == engine.n_e_range[1]
    assert result["u_vgt_pct"].min() == engine.u_vgt_range[0]
    assert actuate(inputs, engine).grid[0].max() == 2500.0


def test_settled_state_is_at_rest() -> None:
    start = settle(1200.0, 100.0, 30.0, 50.0, we2011.PARAMETERS)
    time = np.array([0.0, 5.0, 10.0])
    one = np.ones(3)
    inputs = Inputs(time, 1200.0 * one, 100.0 * one, 30.0 * one, 50.0 * one)
    later = simulate_states(actuate(inputs, we2011.PARAMETERS), parameter_batch(we2011.PARAMETERS), start).states[
        0, -1, :3
    ]
    np.testing.assert_allclose(later, start, rtol=1e-6)


FLAT = we2011.PARAMETERS.replace(
    c_f2=-1.077, R_c=0.04164, c_m=(1.721, 2769.0, 0.01), W_copt=0.2211, c_omega_psi=(5.473e-10, -8.613e-6, 0.7824)
)
"""Speed lines as they were calibrated to a made-up engine whose own are nearly flat."""


@pytest.mark.parametrize("laws", [(), (LawTerm(point="W_c", coefficient=0.001, unit="-", factors=()),)])
def test_of_two_rests_an_engine_is_at_that_with_boost(laws: tuple[LawTerm, ...]) -> None:
    """Where the exhaust lacks the air that would give boost it stays, begun at light load."""
    at, engine = (1400.0, 130.0, 30.0, 45.0), FLAT.replace(terms=laws)
    one = np.ones(3)
    held = Inputs(np.array([0.0, 60.0, 120.0]), *(value * one for value in at))
    columns = ["p_im_pa", "p_em_pa", "omega_t_rad_s"]
    light, loaded = (simulate(held, engine, oxygen=False, initial=np.array(start))[columns].to_numpy()
                     for start in (SETTLE_START, LOADED_START))  # fmt: skip
    np.testing.assert_allclose(light[-1], light[-2], rtol=1e-6)  # both are rests
    assert loaded[-1, 0] > 1.5 * light[-1, 0]
    np.testing.assert_allclose(settle(*at, engine), loaded[-1], rtol=1e-5)


def test_an_engine_under_laws_comes_to_rest_where_its_simulation_stays() -> None:
    """Two laws at two points, one of a quantity that its own signal changes."""
    flow = LawTerm(point="W_c", coefficient=-0.05, unit="-", factors=(("W_c", 0.2, 1.0), ("omega_t", 6000.0, -1.0)))
    friction = LawTerm(point="shaft_power", coefficient=-300.0, unit="W", factors=(("omega_t", 5000.0, 2.0),))
    engine = we2011.PARAMETERS.replace(terms=[flow, friction])
    rest = settle(1200.0, 100.0, 30.0, 50.0, engine)
    one = np.ones(51)
    inputs = Inputs(np.arange(0.0, 10.1, 0.2), 1200.0 * one, 100.0 * one, 30.0 * one, 50.0 * one)
    table = simulate(inputs, engine, oxygen=False, initial=rest)
    np.testing.assert_allclose(table[["p_im_pa", "p_em_pa", "omega_t_rad_s"]].to_numpy()[-1], rest, rtol=2e-5)
    assert abs(rest[0] / settle(1200.0, 100.0, 30.0, 50.0, we2011.PARAMETERS)[0] - 1.0) > 0.02


def test_at_rest_terms_act_as_they_do_at_the_first_row() -> None:
    at = (1200.0, 100.0, 30.0, 50.0)
    leak = Term(effect="boost_leak", magnitude=2e-4)
    late = leak.model_copy(update={"onset_s": 60.0, "region": {"n_e_rpm": (500.0, 2000.0)}})
    growing = LawTerm(point="intake_balance", coefficient=-2e-4, unit="kg/s", factors=(("t", 1.0, 1.0),))
    published, leaking = settle(*at, we2011.PARAMETERS), settle(*at, we2011.PARAMETERS.replace(terms=[leak]))
    assert leaking[0] < 0.9 * published[0]
    for term, held_s, expected in ((late, 0.0, published), (growing, 0.0, published), (late, 61.0, leaking)):
        rest = settle(*at, we2011.PARAMETERS.replace(terms=[term]), elapsed_s=held_s)
        np.testing.assert_allclose(rest, expected, rtol=1e-6)
    one = np.ones(20)
    part = Inputs(75.0 + 0.2 * np.arange(20), *(value * one for value in at), start_s=10.0)
    frame = simulate(part, we2011.PARAMETERS.replace(terms=[late]), oxygen=False)
    np.testing.assert_allclose(frame["p_im_pa"], leaking[0], rtol=1e-6)


def test_oxygen_and_driver_columns(field_trace) -> None:  # type: ignore[no-untyped-def]
    _, inputs, engine, initial = field_trace
    result = simulate(_cut(inputs, 0.0, 60.0), engine, initial=initial)
    assert ((result["x_oim"] > 0.0) & (result["x_oim"] <= X_OC)).all()
    assert (result["x_oem"] <= result["x_oim"] + 0.06).all() and (result["x_oem"] >= 0.0).all()
    assert result["egr_fraction"].between(0.0, 1.0).all()
    ratio = result["w_c_kg_s"] / (result["w_f_kg_s"] * engine.AF_s)
    np.testing.assert_allclose(result["lambda"], ratio)
    closed = replace(_cut(inputs, 0.0, 60.0), u_egr_pct=np.zeros(301))
    assert simulate(closed, engine, initial=initial)["x_oim"].iloc[50:].min() == pytest.approx(X_OC, abs=1e-6)


def test_oxygen_balance_at_rest() -> None:
    """At rest the intake oxygen is the mixture of fresh air and recirculated gas."""
    one = np.ones(400)
    inputs = Inputs(0.2 * np.arange(400), 1300.0 * one, 110.0 * one, 50.0 * one, 45.0 * one)
    last = simulate(inputs, we2011.PARAMETERS).iloc[-1]
    mixed = (last.w_egr_kg_s * last.x_oem + last.w_c_kg_s * X_OC) / (last.w_egr_kg_s + last.w_c_kg_s)
    assert last.x_oim == pytest.approx(mixed, rel=1e-6)
    burnt = (last.w_ei_kg_s * last.x_oim - last.w_f_kg_s * we2011.PARAMETERS.AF_s * X_OC) / last.w_eo_kg_s
    assert last.x_oem == pytest.approx(burnt, rel=1e-6)


def test_engine_file(tmp_path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "engine.yaml"
    path.write_text("A_egrmax: 3.0e-4\nq_HV: 42.0e6\nc_vol: [-2.0e-4, -3.0e-3, 1.1]\n")
    engine = load_engine(path)
    assert engine.A_egrmax == 3.0e-4 and engine.q_HV == 42.0e6 and engine.c_vol[2] == 1.1
    for text, needle in (
        ("A_egrmx: 1\n", "A_egrmax"),
        ("A_egrmax: -1\n", "A_egrmax"),
        ("- 1\n", "mapping"),
        ("a: [\n", "YAML"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=needle):
            load_engine(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time_s": np.array([0.0, 0.2, 0.2])}, "increasing"),
        ({"n_e_rpm": np.array([1.0, np.nan, 1.0])}, "finite"),
        ({"u_egr_pct": np.zeros(2)}, "shape"),
        ({"n_history": 2}, "two rows"),
    ],
)
def test_bad_inputs(change: dict, message: str) -> None:
    good = Inputs(np.array([0.0, 0.2, 0.4]), *(np.ones(3),) * 4)
    with pytest.raises(InputError, match=message):
        replace(good, **change)


@pytest.mark.parametrize("offset", [0.0, 1e5, 1.76e9])
def test_rounded_time_stamps_keep_the_steps(offset: float) -> None:
    """Epoch time rounds stamps by 1e-7 s; 16 steps of 12.5 ms must not become 17 in some of the intervals."""
    time = offset + 0.2 * np.arange(300)
    assert set(steps_between(time, 0.0125).tolist()) == {16}
