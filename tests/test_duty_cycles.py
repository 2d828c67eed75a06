"""Driving: GTR 4 figures, full load, the ECU map, random transients, and the limits that inputs keep."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dieseltwin.duty_cycles.driving import Driving, drive, fuel_for_torque, limit_breaks
from dieseltwin.duty_cycles.ecu import idle_weight, positions
from dieseltwin.duty_cycles.random_driving import random_demand, slow_dither
from dieseltwin.duty_cycles.schedules import (
    FULL_LOAD_SPEED_RPM,
    FULL_LOAD_TORQUE_NM,
    denormalised_speed,
    full_load_torque,
    joined,
    load_schedule,
    schedule_demand,
    speed_per_norm,
)
from dieseltwin.engine import Inputs, actuate, bind, constants, parameter_batch, simulate, simulate_states, we2011
from dieseltwin.errors import InputError, NotConvergedError
from dieseltwin.settings.params import DrivingConfig, load_params

LAB = we2011.PARAMETERS


@pytest.fixture(scope="module")
def config(project_root) -> DrivingConfig:
    return load_params(project_root / "params.yaml").driving


@pytest.fixture(scope="module")
def whtc_drive(config) -> Driving:
    """WHTC seconds 640-900: idles, tip-ins and overrun."""
    demand = schedule_demand(load_schedule("whtc"), config.speed_map, 640, 900, 1.0)
    return drive(demand, config, LAB, np.random.default_rng(7))


# --- regulation -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("norm", "rpm"), [(0.0, 600.0), (1.0, 611.78966), (41.5, 1089.27089), (55.0, 1248.4313), (100.0, 1778.966)]
)
def test_gtr4_speed_against_hand_figures(config, norm, rpm):
    # 580 * 2.0327 = 1178.966; the table of docs/definitions.md rounds it to 11.79 rpm per %
    assert denormalised_speed(np.array([norm]), config.speed_map)[0] == pytest.approx(rpm, rel=1e-9)


def test_speed_per_norm_is_protocols(config):
    assert round(speed_per_norm(config.speed_map), 2) == 11.79


def test_schedules_are_whole():
    whtc, whsc = load_schedule("whtc"), load_schedule("whsc")
    assert whtc.time_s.tolist() == list(range(1, 1801))
    assert (whtc.motoring.sum(), round(whtc.speed_norm_pct.mean(), 4)) == (401, 37.0809)
    assert (whtc.torque_norm_pct[whtc.motoring] == 0).all()
    assert whsc.time_s.tolist() == list(range(1, 1896))
    assert not whsc.motoring.any() and whsc.torque_norm_pct.max() == 100
    with pytest.raises(InputError, match="whtc"):
        load_schedule("wthc")


def test_schedule_demand_is_linear_between_seconds(config):
    whtc = load_schedule("whtc")
    coarse = schedule_demand(whtc, config.speed_map, 200, 400, 1.0)
    fine = schedule_demand(whtc, config.speed_map, 200, 400, 0.2)
    assert coarse.time_s[0] == 0 and coarse.time_s.size == 201 and fine.time_s.size == 1001
    np.testing.assert_allclose(fine.n_e_rpm[::5], coarse.n_e_rpm, rtol=1e-12)
    np.testing.assert_allclose(np.diff(fine.torque_nm, 2).reshape(-1)[0:3], 0.0, atol=1e-9)
    row = 55  # WHTC second 255
    speed = denormalised_speed(whtc.speed_norm_pct[254], config.speed_map)
    expected = whtc.torque_norm_pct[254] / 100 * full_load_torque(speed)
    assert coarse.torque_nm[row] == pytest.approx(expected)


def test_joined_blocks_pass_smoothly(config):
    whtc = load_schedule("whtc")
    blocks = [schedule_demand(whtc, config.speed_map, *span, 1.0) for span in [(940, 1000), (1, 60)]]
    both = joined(blocks, 1.0, 4.0)
    assert both.time_s.tolist() == list(range(121))
    assert np.abs(np.diff(both.n_e_rpm))[60:65].max() < 0.3 * abs(blocks[0].n_e_rpm[-1] - 600.0)
    np.testing.assert_array_equal(both.n_e_rpm[65:], blocks[1].n_e_rpm[4:])


# --- the engine's torque --------------------------------------------------------------------------------------------


def at_rest(n_e, fuel, u_egr, u_vgt):
    """Mean of the last 10 s of 90 s at constant inputs: columns of MEASURED and the states, one row per point."""
    time = np.arange(0.0, 90.5, 1.0)
    rows = np.broadcast_arrays(n_e, fuel, u_egr, u_vgt)
    actuations = [
        actuate(Inputs(time, *(np.full(time.size, float(v)) for v in row)), LAB) for row in zip(*rows, strict=True)
    ]
    result = simulate_states(actuations, parameter_batch(LAB, size=rows[0].size), np.array([1.2e5, 1.3e5, 3000.0]))
    return result.measured[:, -11:].mean(axis=1), result.states[:, -11:].mean(axis=1)


def lambda_of(measured, n_e, fuel):
    return measured[:, 5] / (1e-6 / 120 * fuel * n_e * LAB.n_cyl) / LAB.AF_s


def test_full_load_torque_is_what_the_engine_gives():
    """docs/definitions.md: lambda >= 1.2, EGR closed, at most 250 mg/cycle, VGT at its best."""
    torque, c = bind("numpy").torque, constants(LAB)
    u_vgt = np.arange(20.0, 101.0, 5.0)
    for n_e, expected in list(zip(FULL_LOAD_SPEED_RPM, FULL_LOAD_TORQUE_NM, strict=True))[1:]:
        fuel = np.full(u_vgt.size, 250.0)
        measured, states = at_rest(n_e, fuel, 0.0, u_vgt)
        allowed = lambda_of(measured, n_e, fuel) >= 1.2
        best = torque(250.0, n_e, states[:, 0], states[:, 1], c)[allowed].max()
        assert best == pytest.approx(expected, rel=0.005)


def test_full_load_at_600_rpm_is_limited_by_smoke():
    p_amb = np.array([LAB.p_amb])
    fuel = fuel_for_torque(np.array([FULL_LOAD_TORQUE_NM[0]]), np.array([600.0]), p_amb, p_amb, LAB)
    assert 180.0 < fuel[0] < 215.0  # far from the 250 mg of the other speeds
    measured, _ = at_rest(600.0, fuel, 0.0, np.array([25.0]))
    assert lambda_of(measured, 600.0, fuel)[0] >= 1.2
    measured, _ = at_rest(600.0, np.array([250.0]), 0.0, np.array([25.0]))
    assert lambda_of(measured, 600.0, np.array([250.0]))[0] < 1.2


@given(
    torque_nm=st.floats(-200, 2200), n_e=st.floats(600, 1900), p_im=st.floats(1e5, 4e5), difference=st.floats(-5e4, 5e4)
)
def test_fuel_gives_the_torque_back(torque_nm, n_e, p_im, difference):
    fuel = fuel_for_torque(np.array([torque_nm]), np.array([n_e]), np.array([p_im]), np.array([p_im + difference]), LAB)
    back = bind("numpy").torque(fuel, n_e, p_im, p_im + difference, constants(LAB))
    assert back[0] == pytest.approx(torque_nm, abs=1e-6)


# --- the ECU map ----------------------------------------------------------------------------------------------------


def test_map_at_rest_keeps_the_limits(config):
    n_e, fuel = (x.ravel() for x in np.meshgrid([1000.0, 1300.0, 1600.0, 1900.0], [10.0, 60.0, 120.0, 180.0, 250.0]))
    u_egr, u_vgt = positions(n_e, fuel, 1.0, config.ecu)
    measured, states = at_rest(n_e, fuel, u_egr, u_vgt)
    assert lambda_of(measured, n_e, fuel).min() > config.ecu.smoke_lambda_min
    fraction = measured[:, 3] / (measured[:, 3] + measured[:, 5])
    assert fraction.min() >= 0.0 and fraction.max() < 0.32
    assert states[:, 2].max() < config.ecu.turbo_speed_max_rad_s


def test_idle_shuts_the_valve_by_and_by_and_load_opens_it(config):
    n_e, fuel = np.full(60, 605.0), np.full(60, 7.0)
    n_e[:10], fuel[:10] = 1200.0, 80.0
    u_egr, u_vgt = positions(n_e, fuel, 1.0, config.ecu)
    assert u_egr[:10].min() > 30.0
    assert u_egr[10] == config.ecu.idle_u_egr_pct
    assert (np.diff(u_egr[10:]) <= 0).all()
    assert u_egr[40:].max() == pytest.approx(config.ecu.idle_shut_u_egr_pct)
    assert u_vgt.min() > 20.0


@given(n_e=st.floats(500, 2000), fuel=st.floats(0, 250))
def test_idle_weight_is_a_share(n_e, fuel):
    weight = idle_weight(np.array([n_e]), np.array([fuel]))[0]
    assert 0.0 <= weight <= 1.0
    assert weight == 1.0 if n_e < 660 and fuel < 15 else weight < 1.0


# --- random driving -------------------------------------------------------------------------------------------------


@settings(max_examples=15)
@given(seed=st.integers(0, 10**6))
def test_random_driving_is_as_protocol_says(config, seed):
    demand = random_demand(1200.0, 0.2, config.random, np.random.default_rng(seed))
    idle = demand.n_e_rpm < 640.0
    assert demand.time_s.size == 6001
    assert demand.n_e_rpm.min() > 598.0 and demand.n_e_rpm.max() <= 1850.0
    assert 0.05 < idle.mean() < 0.32  # holds of idle levels; their ramps count in the drawn 10-30 %
    assert demand.torque_nm.min() > -1e-9
    assert np.median(demand.torque_nm[idle]) < 1.0  # no load
    assert (demand.torque_nm <= 0.9 * full_load_torque(demand.n_e_rpm) + 250.0).all()


def test_random_driving_has_levels_and_ramps(config):
    quiet = config.random.model_copy(update={"smoothing_s": 0.0})
    demand = random_demand(3600.0, 0.2, quiet, np.random.default_rng(5))
    flat = np.abs(np.diff(demand.n_e_rpm)) < 1e-9
    edges = np.flatnonzero(np.diff(flat.astype(int)))
    lengths = 0.2 * np.diff(edges)
    holds = lengths[flat[edges[:-1] + 1]]
    ramps = lengths[~flat[edges[:-1] + 1]]
    assert holds.min() > 3.0 - 0.5 and holds.max() < 15.0 + 0.5
    assert ramps.min() > 1.0 - 0.5 and ramps.max() < 4.0 + 0.5


def test_random_driving_depends_on_its_seed_only(config):
    def make(seed, step_s=0.2):
        return random_demand(300.0, step_s, config.random, np.random.default_rng(seed))

    np.testing.assert_array_equal(make(1).n_e_rpm, make(1).n_e_rpm)
    assert np.abs(make(1).n_e_rpm - make(2).n_e_rpm).max() > 100.0
    np.testing.assert_array_equal(make(1, 1.0).torque_nm, make(1, 0.2).torque_nm[::5])


def test_dither_is_slow_and_as_large_as_asked(config):
    for seed in range(5):
        dither = slow_dither(40_000, 0.2, config.random, np.random.default_rng(seed))
        assert 0.05 < dither.std() < 0.13
        assert np.abs(np.diff(dither)).max() < 0.05
        correlation = np.corrcoef(dither[:-100], dither[100:])[0, 1]  # over 20 s, the time constant
        assert 0.2 < correlation < 0.55


# --- limits ---------------------------------------------------------------------------------------------------------


def test_limits_hold_and_the_smoke_limit_works(config, whtc_drive):
    ecu = config.ecu
    assert not any(rows.any() for rows in limit_breaks(whtc_drive.response, ecu).values())
    fuelled = whtc_drive.response[whtc_drive.response.u_delta_mg > 1.1 * ecu.fuel_min_mg]
    least = fuelled["lambda"].min()
    assert ecu.smoke_lambda_min <= least < 1.2 * ecu.smoke_lambda_min  # it is active somewhere
    assert 0.01 < whtc_drive.limited_share < 0.2
    assert whtc_drive.response["omega_t_rad_s"].max() < ecu.turbo_speed_max_rad_s
    assert whtc_drive.response["egr_fraction"].between(0.0, ecu.egr_fraction_max).all()


def test_without_limits_they_would_be_broken(config):
    """The demand itself is beyond the limits: what holds above is the loop's doing."""
    free = config.ecu.model_copy(update={"smoke_lambda_min": 0.3, "smoke_reserve_rel": 0.0})
    demand = schedule_demand(load_schedule("whtc"), config.speed_map, 640, 900, 1.0)
    driven = drive(demand, config.model_copy(update={"ecu": free}), LAB, np.random.default_rng(7))
    assert limit_breaks(driven.response, config.ecu)["smoke"].sum() > 50


def test_turbo_limit_is_kept_when_it_binds(config):
    low = config.ecu.model_copy(update={"turbo_speed_max_rad_s": 7000.0})
    demand = random_demand(200.0, 1.0, config.random, np.random.default_rng(3))
    free = drive(demand, config, LAB, np.random.default_rng(4))
    bound = drive(demand, config.model_copy(update={"ecu": low}), LAB, np.random.default_rng(4))
    assert free.response["omega_t_rad_s"].max() > 8000.0
    assert bound.response["omega_t_rad_s"].max() < 7000.0


def test_egr_limit_is_kept_when_it_binds(config):
    low = config.ecu.model_copy(update={"egr_fraction_max": 0.15})
    demand = random_demand(200.0, 1.0, config.random, np.random.default_rng(3))
    free = drive(demand, config, LAB, np.random.default_rng(4))
    bound = drive(demand, config.model_copy(update={"ecu": low}), LAB, np.random.default_rng(4))
    assert free.response["egr_fraction"].max() > 0.2
    assert bound.response["egr_fraction"].max() <= 0.15


def test_limits_that_cannot_be_kept_are_an_error(config):
    absurd = config.ecu.model_copy(update={"turbo_speed_max_rad_s": 900.0})
    demand = random_demand(60.0, 1.0, config.random, np.random.default_rng(3))
    with pytest.raises(NotConvergedError, match="turbo_speed"):
        drive(demand, config.model_copy(update={"ecu": absurd}), LAB, np.random.default_rng(4))


def test_wanted_torque_is_met_where_nothing_limits(config):
    light = config.random.model_copy(update={"load_rel": (0.1, 0.4)})
    demand = random_demand(300.0, 1.0, light, np.random.default_rng(8))
    quiet = config.model_copy(
        update={"random": config.random.model_copy(update={"fuel_jitter_mg": 0.0, "speed_jitter_rpm": 0.0})}
    )
    driven = drive(demand, quiet, LAB, np.random.default_rng(9))
    free = driven.inputs["u_delta_mg"].to_numpy() > 1.5
    missed = (driven.response["torque_nm"].to_numpy()[::5] - demand.torque_nm)[free]
    assert np.quantile(np.abs(missed), 0.9) < 5.0  # N m; tip-ins may be held back by smoke


def test_overrun_has_the_least_fuel_and_idle_the_valve_nearly_shut(config, whtc_drive):
    whtc = load_schedule("whtc")
    inputs = whtc_drive.inputs
    overrun = whtc.motoring[639:900]
    assert (inputs["u_delta_mg"][overrun] == config.ecu.fuel_min_mg).all()
    idle = (inputs["n_e_rpm"] < 630.0) & (inputs["u_delta_mg"] < 12.0)
    assert idle.sum() > 60
    assert inputs["u_egr_pct"][idle].max() < 1.4 * config.ecu.idle_u_egr_pct
    assert inputs["u_egr_pct"][idle].min() < 1.4 * config.ecu.idle_shut_u_egr_pct


def test_inputs_stay_in_the_engines_ranges_and_repeat_by_seed(config, whtc_drive):
    inputs = whtc_drive.inputs
    ranges = {"n_e_rpm": LAB.n_e_range, "u_delta_mg": LAB.u_delta_range, "u_egr_pct": LAB.u_egr_range}
    ranges["u_vgt_pct"] = LAB.u_vgt_range
    for name, limits in ranges.items():
        assert inputs[name].between(*limits).all(), name
    demand = schedule_demand(load_schedule("whtc"), config.speed_map, 640, 900, 1.0)
    again = drive(demand, config, LAB, np.random.default_rng(7))
    np.testing.assert_array_equal(again.inputs.to_numpy(), inputs.to_numpy())
    # the response is the simulation of these inputs, linear in between
    columns = [np.interp(whtc_drive.response["time_s"], inputs["time_s"], inputs[n]) for n in ranges]
    made = simulate(Inputs(whtc_drive.response["time_s"].to_numpy(), *columns), LAB, oxygen=False)
    np.testing.assert_array_equal(made["p_em_pa"], whtc_drive.response["p_em_pa"])
