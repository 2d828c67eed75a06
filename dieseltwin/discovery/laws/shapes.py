"""Shapes that laws are made of: the compressible orifice, signed powers, and the operators lag and play of samples."""

from __future__ import annotations

from typing import Any

import numpy as np

from dieseltwin.discovery.twins.interface import Array
from dieseltwin.engine._compiled import follow_lanes
from dieseltwin.engine.nozzle import nozzle_flow_factor
from dieseltwin.engine.terms import ORIFICE_CHOKING, ORIFICE_GAMMA
from dieseltwin.inner import kernel


def orifice(up: Any, down: Any) -> Any:
    """Flow of a compressible orifice over its choked value at the same upstream state, signed [-]."""
    high, low = np.maximum(up, down), np.minimum(up, down)
    shape = nozzle_flow_factor(low / high, ORIFICE_GAMMA, ORIFICE_CHOKING)
    return np.sign(up - down) * shape / nozzle_flow_factor(ORIFICE_CHOKING, ORIFICE_GAMMA, ORIFICE_CHOKING)


def signed_power(x: Any, exponent: Any) -> Any:
    """sign(x) |x|^exponent, finite slope at 0."""
    return np.sign(x) * np.maximum(np.abs(x), 1e-12) ** exponent


def lagged(values: Array, time_s: Array, constant: float) -> Array:
    """First-order lag [s] of samples, linear between them."""
    rows = np.ascontiguousarray(values, dtype=np.float64)[None]
    return np.asarray(follow_lanes(np.ascontiguousarray(time_s), rows, np.full_like(rows, constant))[0])


def played(values: Array, width: float) -> Array:
    """Play (backlash) operator of full width."""
    return np.asarray(_pushed(np.ascontiguousarray(values, dtype=np.float64), 0.5 * width))


@kernel()
def _pushed(values, half):  # type: ignore[no-untyped-def]
    out, at = np.empty_like(values), values[0]
    for k, value in enumerate(values):
        at = min(max(at, value - half), value + half)
        out[k] = at
    return out
