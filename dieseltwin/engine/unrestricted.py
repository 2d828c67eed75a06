"""Where nothing restricts the flow before the compressor and behind the turbine: pressures without a root.

`model.inlet_pressure` and `model.outlet_pressure` solve for what a law there says to the flow that it lets through.
Without an effect of `effects.IMPLICIT` the root is where it starts, and half of the work of an evaluation is saved.
"""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array
from dieseltwin.engine.hooks import Magnitudes
from dieseltwin.engine.model_constants import Constants
from dieseltwin.engine.quantities import OperatingPoint, Signals


def inlet_pressure(x: OperatingPoint, m: Magnitudes, s: Signals, c: Constants) -> Array:
    """Pressure before the compressor p_bc [Pa]: ambient, under its signal."""
    return c.p_amb * (1.0 + s.p_bc)


def outlet_pressure(x: OperatingPoint, T_em: Array, m: Magnitudes, s: Signals, c: Constants) -> Array:
    """Pressure behind the turbine p_es [Pa]: ambient, under its signal."""
    return c.p_amb * (1.0 + s.p_es)
