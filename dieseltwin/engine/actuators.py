"""Actuators: dead time and first-order lags, solved exactly for inputs that are linear between samples."""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array, exp, maximum, minimum, where


def actuator_update(u_state: Array, u_start: Array, u_end: Array, step: Array, tau: Array) -> Array:
    """State [%] of an actuator `step` [s] later (A.16, A.17, A.25), for an input linear from u_start to u_end [%].

    Exact solution of du_state/dt = (u_delayed - u_state) / tau: EGR with tau_egr1 and tau_egr2, VGT with tau_vgt.
    """
    slope_lag = (u_end - u_start) / step * tau
    return u_end - slope_lag + (u_state - u_start + slope_lag) * exp(-step / tau)


def play_output(y: Array, u: Array, half: Array) -> Array:
    """Output of a play operator of half width `half` behind the command u, before it y (Visintin, 1994) [%]."""
    return minimum(maximum(y, u - half), u + half)


def play_edge(y: Array, following: Array, half: Array) -> Array:
    """Command [%] at which the output of a play starts to move from y to `following`."""
    return where(following > y, y + half, y - half)
