"""Seeded random transient driving (docs/definitions.md): levels of speed and load, ramps, idle phases, jitter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from dieseltwin.duty_cycles.schedules import Demand, full_load_torque
from dieseltwin.settings.params import RandomDrivingConfig

MINIMUM_STEP_S = 0.2  # random driving is drawn on this grid, so that a coarser step is the same driving with fewer rows


def random_demand(
    duration_s: float,
    step_s: float,
    config: RandomDrivingConfig,
    rng: np.random.Generator,
    *,
    idle_start_s: float = 0.0,
    busy_until_s: float = 0.0,
) -> Demand:
    """Levels of speed and load held for some seconds, joined by ramps, a share of them idle.

    Args:
        duration_s: length [s]; rows at 0, step_s, ..., duration_s.
        step_s: spacing of the rows [s].
        config: ranges of the levels.
        rng: the only source of randomness.
        idle_start_s: begin with so many seconds of idle [s]; they do not count in the share of idle.
        busy_until_s: no other level idles that starts before this time [s].
    """
    holds, ramps = _durations(duration_s - idle_start_s, config, rng)
    n = holds.size
    speed = rng.uniform(*config.speed_rpm, n)
    load = rng.uniform(*config.load_rel, n)
    starts = idle_start_s + np.cumsum(holds + ramps) - (holds + ramps)
    idle = _idle_levels(holds + ramps, starts >= busy_until_s, config, rng)
    speed = np.where(idle, rng.uniform(*config.idle_speed_rpm, n), speed)
    torque = np.where(idle, 0.0, load * full_load_torque(speed))
    if idle_start_s > 0.0:
        holds, ramps = np.r_[idle_start_s, holds], np.r_[0.0, ramps]
        speed, torque = np.r_[config.idle_speed_rpm[0], speed], np.r_[0.0, torque]

    # a level starts at the end of its ramp and lasts for its hold
    ends = np.cumsum(ramps + holds)
    corners = np.column_stack([ends - holds, ends]).ravel()
    fine = np.arange(0.0, duration_s + 0.5 * MINIMUM_STEP_S, MINIMUM_STEP_S)
    every = round(step_s / MINIMUM_STEP_S)
    n_e, load_nm = (
        _smoothed(np.interp(fine, corners, np.repeat(values, 2)), MINIMUM_STEP_S, config)[::every]
        for values in (speed, torque)
    )
    return Demand(step_s * np.arange(n_e.size), n_e, load_nm, np.zeros(n_e.size), f"random {duration_s:g} s")


def _durations(
    duration_s: float, config: RandomDrivingConfig, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    shortest = config.hold_s[0] + config.ramp_s[0]
    n = int(np.ceil(duration_s / shortest)) + 1
    holds, ramps = rng.uniform(*config.hold_s, n), rng.uniform(*config.ramp_s, n)
    needed = int(np.searchsorted(np.cumsum(holds + ramps), duration_s)) + 1
    return holds[:needed], ramps[:needed]


def _idle_levels(
    lengths: np.ndarray, may_idle: np.ndarray, config: RandomDrivingConfig, rng: np.random.Generator
) -> np.ndarray:
    """Which levels idle: drawn one by one until the drawn share of the time is reached."""
    share = rng.uniform(*config.idle_share)
    idle = np.zeros(lengths.size, dtype=bool)
    for level in rng.permutation(lengths.size):
        with_it = lengths[idle].sum() + lengths[level]
        if may_idle[level] and with_it <= share * lengths.sum():
            idle[level] = True
    return idle


def _smoothed(values: np.ndarray, step_s: float, config: RandomDrivingConfig) -> np.ndarray:
    if config.smoothing_s <= 0.0:
        return values
    return gaussian_filter1d(values, config.smoothing_s / step_s, mode="nearest")


def smoothed_demand(demand: Demand, config: RandomDrivingConfig) -> Demand:
    """A schedule's corners rounded as lightly as random driving (rows must be much closer than `smoothing_s`)."""
    step_s = float(demand.time_s[1] - demand.time_s[0])
    if step_s > config.smoothing_s:
        return demand
    return replace(
        demand,
        n_e_rpm=_smoothed(demand.n_e_rpm, step_s, config),
        torque_nm=_smoothed(demand.torque_nm, step_s, config),
        motoring=_smoothed(demand.motoring, step_s, config),
    )


def slow_dither(n: int, step_s: float, config: RandomDrivingConfig, rng: np.random.Generator) -> np.ndarray:
    """Slow random dither of an actuator position, relative to the position: (n,) [-].

    A first-order autoregressive process filtered once more, so that it has no corners; its standard deviation is drawn
    in `position_dither_pct` (in % of the position: an absolute one would open a valve that idle wants nearly shut).
    """
    from scipy.signal import lfilter  # takes half a second to load, and who only reads recordings drives nothing

    sd = rng.uniform(*config.position_dither_pct) / 100.0
    keep = np.exp(-step_s / config.dither_time_s)
    warm = int(np.ceil(5.0 * config.dither_time_s / step_s))
    slow = lfilter([1.0 - keep], [1.0, -keep], rng.standard_normal(n + warm))
    smooth = lfilter([0.5], [1.0, -0.5], slow)[warm:]
    # a long run has exactly the drawn standard deviation, a short one about it
    spread = np.sqrt((1.0 - keep) / (1.0 + keep))
    return np.clip(sd * smooth / spread, -3.0 * sd, 3.0 * sd)
