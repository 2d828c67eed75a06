"""The plant's actuators and injection before the right-hand side: play, dead time, lags, on the fine grid."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dieseltwin.challenge.driving import Driving
from dieseltwin.challenge.plant_effects import Fault, schedule
from dieseltwin.inner import kernel


@kernel(error_model="numpy")
def lag(u, step, tau):  # type: ignore[no-untyped-def]
    """First-order lag of u (n,), settled at its start; u runs straight between its points."""
    out = np.empty_like(u)
    out[0] = u[0]
    ratio = step / tau
    keep = np.exp(-ratio)
    ramp = (1.0 - keep) / ratio  # share of the slope's response that is still missing at the step's end
    for i in range(u.size - 1):
        out[i + 1] = keep * out[i] + (ramp - keep) * u[i] + (1.0 - ramp) * u[i + 1]
    return out


@kernel(error_model="numpy")
def sluggish(u, step, taus):  # type: ignore[no-untyped-def]
    """u (n,) behind a lag whose time constant changes (n,), 0 for none; each step with u's mean over it."""
    out = np.empty_like(u)
    out[0] = u[0]
    for i in range(1, u.size):
        keep = np.exp(-step / taus[i]) if taus[i] > 0.0 else 0.0
        mean = 0.5 * (u[i - 1] + u[i]) if taus[i] > 0.0 else u[i]
        out[i] = keep * out[i - 1] + (1.0 - keep) * mean
    return out


@kernel(error_model="numpy")
def play(u, width):  # type: ignore[no-untyped-def]
    """Play operator of full width `width` (n,) on u (n,): follows only when an end of the gap is pushed."""
    out = np.empty_like(u)
    out[0] = u[0]
    for i in range(1, u.size):
        half = 0.5 * width[i]
        out[i] = min(max(out[i - 1], u[i] - half), u[i] + half)
    return out


def fine_command(
    fine_s: np.ndarray, driving: Driving, actuator: str, dead_time_s: float, faults: Sequence[Fault]
) -> np.ndarray:
    """Command behind a valve that stands still, play and dead time at the fine times [%]; `actuator`: "egr", "vgt"."""
    extra = np.zeros(fine_s.size)
    width = np.zeros(fine_s.size)
    for fault in faults:
        if fault.effect == f"{actuator}_dead_time":
            extra += fault.magnitude * schedule(fault, fine_s, driving)
        if fault.effect == f"{actuator}_backlash":
            width += fault.magnitude * schedule(fault, fine_s, driving)
    command = np.interp(fine_s, driving.time_s, getattr(driving, f"u_{actuator}_pct"))
    for fault in faults:
        if fault.effect == f"{actuator}_stuck":
            command = np.where(schedule(fault, fine_s, driving) > 0.0, fault.magnitude, command)
    if width.any():
        command = play(command, width)
    return np.interp(fine_s - dead_time_s - extra, fine_s, command)


def fine_fuel(fine_s: np.ndarray, driving: Driving, faults: Sequence[Fault]) -> np.ndarray:
    """Injected mass at the fine times [mg/cycle], behind its signal where it is late."""
    fuel = np.interp(fine_s, driving.time_s, driving.u_delta_mg)
    tau = np.zeros(fine_s.size)
    for fault in faults:
        if fault.effect == "fuel_lag":
            tau += fault.magnitude * schedule(fault, fine_s, driving)
    return sluggish(fuel, fine_s[1] - fine_s[0], tau) if tau.any() else fuel
