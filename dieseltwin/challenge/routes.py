"""What the benchmark's engines drive: seeded transients and stretches of the WHTC through an ECU that keeps its limits.

Positions come from the ECU map with slow dither. The limits (smoke, EGR fraction, turbo speed) are kept on the
laboratory plant in a few passes: simulate, take back, simulate again. An engine of other health may then break them a
little, as engines do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from dieseltwin.challenge.driving import Driving
from dieseltwin.challenge.plant import SAMPLE_S, run_plant
from dieseltwin.duty_cycles.ecu import positions
from dieseltwin.duty_cycles.random_driving import random_demand, slow_dither, smoothed_demand
from dieseltwin.duty_cycles.schedules import Demand, joined, load_schedule, schedule_demand
from dieseltwin.settings.params import EcuConfig, RandomDrivingConfig, SpeedMapConfig

# The benchmark's own settings: what it is must not move with params.yaml. Values as in docs/definitions.md.
RANDOM = RandomDrivingConfig(
    speed_rpm=(900.0, 1850.0), load_rel=(0.0, 0.9), hold_s=(3.0, 15.0), ramp_s=(1.0, 4.0), idle_share=(0.10, 0.30),
    idle_speed_rpm=(600.0, 630.0), smoothing_s=0.6, speed_jitter_rpm=3.0, fuel_jitter_mg=0.5,
    position_dither_pct=(6.0, 12.0), dither_time_s=20.0,
)  # fmt: skip
SPEEDS = SpeedMapConfig(n_idle_rpm=600.0, n_lo_rpm=1000.0, n_pref_rpm=1200.0, n_hi_rpm=1900.0)
ECU = EcuConfig(
    smoke_lambda_min=1.2, egr_fraction_max=0.40, turbo_speed_max_rad_s=12000.0, smoke_reserve_rel=0.05,
    turbo_reserve_rel=0.13, idle_u_egr_pct=2.0, idle_shut_u_egr_pct=0.3, idle_shut_after_s=8.0, fuel_min_mg=1.0,
)  # fmt: skip

PASSES = 5
PASS_STEP_S = 0.01  # the limits don't need the plant's accuracy
UNSTABLE_RPM, UNSTABLE_LOAD_REL = (1770.0, 1810.0), (0.02, 0.10)  # where runs of the engine part (docs/discovery.md)
JOINT_S = 4.0
SMOKE_EGR_CUT = 0.3  # wanted fuel this share above the allowed one shuts the EGR valve, as ECUs do on tip-in
MARGIN = 0.01
SLOWEST_TURBO_LEAD_S = 4.0


def draw_driving(
    kind: str, duration_s: float, parameters: Mapping[str, Any], rng: np.random.Generator
) -> Driving:
    """Inputs of one recording.

    Args:
        kind: "random", "whtc" (a stretch of 300 s or half of the recording, then random) or "unstable" (a third of it
            near 1790 rpm at low load, in two stretches).
        duration_s: length [s]; rows at 0, 0.2, ..., below the duration.
        parameters: laboratory parameters by name.
        rng: the only source of randomness.
    """
    demand = _demand(kind, duration_s, rng)
    n = demand.time_s.size
    n_e = np.clip(demand.n_e_rpm + RANDOM.speed_jitter_rpm * rng.standard_normal(n), *parameters["n_e_range"])
    jitter = RANDOM.fuel_jitter_mg * rng.standard_normal(n)
    dither = [slow_dither(n, SAMPLE_S, RANDOM, rng) for _ in range(2)]
    still = np.full(n, parameters["p_amb"])
    cap, egr_scale, opening = np.full(n, parameters["u_delta_range"][1]), np.ones(n), np.zeros(n)

    def wanted(p_im: np.ndarray, p_em: np.ndarray) -> np.ndarray:
        fuel = (_fuel(demand.torque_nm, n_e, p_im, p_em, parameters) + jitter) * (1.0 - demand.motoring)
        return np.clip(fuel, ECU.fuel_min_mg, parameters["u_delta_range"][1])

    asked = wanted(still, still)
    time_s = np.round(SAMPLE_S * np.arange(n), 6)
    for last in range(PASSES):
        driving = _through_ecu(time_s, n_e, asked, cap, egr_scale, opening, dither, parameters, kind)
        if last == PASSES - 1:
            break
        run = run_plant(driving, parameters, step_s=PASS_STEP_S, warm_up_s=10.0)
        if last < 2:
            asked = wanted(run["p_im_pa"], run["p_em_pa"])
        fuel_flow = driving.u_delta_mg * 1e-6 * parameters["n_cyl"] * n_e / 120.0
        limit = driving.u_delta_mg * run["w_c_kg_s"] / (fuel_flow * parameters["AF_s"])
        limit /= ECU.smoke_lambda_min * (1.0 + ECU.smoke_reserve_rel) * (1.0 + MARGIN)
        cap = np.minimum(cap, np.maximum(minimum_filter1d(limit, 3, mode="nearest"), ECU.fuel_min_mg))
        fraction = run["w_egr_kg_s"] / (run["w_c_kg_s"] + run["w_egr_kg_s"])
        egr_scale = egr_scale * np.minimum(1.0, ECU.egr_fraction_max * (1.0 - MARGIN) / np.maximum(fraction, 1e-3))
        fast = run["omega_t_rad_s"] / (ECU.turbo_speed_max_rad_s * (1.0 - ECU.turbo_reserve_rel)) - 1.0
        ahead = maximum_filter1d(np.maximum(fast, 0.0), 2 * round(SLOWEST_TURBO_LEAD_S / SAMPLE_S) + 1, mode="nearest")
        opening = opening + np.where(ahead > 0.0, 3.0 + 400.0 * ahead, 0.0)
    return driving


def _through_ecu(
    time_s: np.ndarray, n_e: np.ndarray, asked: np.ndarray, cap: np.ndarray, egr_scale: np.ndarray,
    opening: np.ndarray, dither: list[np.ndarray], parameters: Mapping[str, Any], kind: str,
) -> Driving:  # fmt: skip
    fuel = np.minimum(asked, cap)
    u_egr, u_vgt = positions(n_e, fuel, SAMPLE_S, ECU)
    u_egr = u_egr * (1.0 + dither[0]) * np.clip(1.0 - (asked / fuel - 1.0) / SMOKE_EGR_CUT, 0.0, 1.0) * egr_scale
    u_vgt = u_vgt * (1.0 + dither[1]) + opening
    return Driving(
        time_s, n_e, fuel, np.clip(u_egr, *parameters["u_egr_range"]), np.clip(u_vgt, *parameters["u_vgt_range"]), kind
    )


def _fuel(
    torque_nm: np.ndarray, n_e: np.ndarray, p_im: np.ndarray, p_em: np.ndarray, parameters: Mapping[str, Any]
) -> np.ndarray:
    """Fuel for a torque [mg/cycle]: indicated work pays for torque, pumping and friction.

    Wahlström and Eriksson (2011), Eqs. 16-19, solved for the fuel.
    """
    speed = n_e / 1000.0
    a, b, c = parameters["c_fric"]
    paid = 4.0 * np.pi * torque_nm + parameters["V_d"] * (p_em - p_im + 1e5 * (a * speed**2 + b * speed + c))
    per_mg = 1e-6 * parameters["n_cyl"] * parameters["q_HV"] * parameters["eta_igch"]
    return np.asarray(paid / (per_mg * (1.0 - parameters["r_c"] ** (1.0 - parameters["gamma_cyl"]))))


def _demand(kind: str, duration_s: float, rng: np.random.Generator) -> Demand:
    last_s = duration_s - SAMPLE_S
    if kind == "whtc":
        length = min(300.0, 0.5 * duration_s)
        first = float(rng.integers(1, int(1800 - length)))
        part = smoothed_demand(schedule_demand(load_schedule("whtc"), SPEEDS, first, first + length, SAMPLE_S), RANDOM)
        rest = random_demand(last_s - length - SAMPLE_S, SAMPLE_S, RANDOM, rng)
        return _cut(joined([part, rest], SAMPLE_S, JOINT_S), duration_s)
    if kind == "unstable":
        length = duration_s / 6.0
        blocks = [random_demand(0.2 * duration_s, SAMPLE_S, RANDOM, rng), _light_load(length, rng),
                  random_demand(0.25 * duration_s, SAMPLE_S, RANDOM, rng), _light_load(length, rng),
                  random_demand(0.25 * duration_s, SAMPLE_S, RANDOM, rng)]  # fmt: skip
        return _cut(joined(blocks, SAMPLE_S, JOINT_S), duration_s)
    return _cut(random_demand(last_s, SAMPLE_S, RANDOM, rng), duration_s)


def _light_load(length_s: float, rng: np.random.Generator) -> Demand:
    config = RANDOM.model_copy(
        update={"speed_rpm": UNSTABLE_RPM, "load_rel": UNSTABLE_LOAD_REL, "idle_share": (0.0, 0.0),
                "hold_s": (5.0, 25.0)}
    )  # fmt: skip
    return random_demand(length_s, SAMPLE_S, config, rng)


def _cut(demand: Demand, duration_s: float) -> Demand:
    n = round(duration_s / SAMPLE_S)
    parts = {name: getattr(demand, name)[:n] for name in ("time_s", "n_e_rpm", "torque_nm", "motoring")}
    return replace(demand, **parts)
