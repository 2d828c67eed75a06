"""The published model: what stands in the composition in place of what effects and signals need.

`binding.bind` puts these functions in the place of those with the same names in `model` and `array_namespace`, and the
hooks as they are written, so that nothing is computed that changes nothing.
"""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array
from dieseltwin.engine.hooks import Magnitudes
from dieseltwin.engine.model_constants import Constants
from dieseltwin.engine.quantities import Gas, OperatingPoint, Signals


def relative(quantity: Array, signal: Array) -> Array:
    """The quantity itself."""
    return quantity


def added(quantity: Array, signal: Array) -> Array:
    """The quantity itself."""
    return quantity


def driven(x: OperatingPoint, m: Magnitudes, s: Signals, c: Constants) -> OperatingPoint:
    """The operating point itself."""
    return x


def inlet_pressure(x: OperatingPoint, m: Magnitudes, s: Signals, c: Constants) -> Array:
    """Ambient pressure [Pa] before the compressor."""
    return c.p_amb


def outlet_pressure(x: OperatingPoint, T_em: Array, m: Magnitudes, s: Signals, c: Constants) -> Array:
    """Ambient pressure [Pa] behind the turbine."""
    return c.p_amb


def with_ambient_pressure(c: Constants, pressure: Array) -> Constants:
    """The constants themselves."""
    return c


def with_charge(c: Constants, T_im: Array, eta_sc: Array) -> Constants:
    """The constants themselves."""
    return c


def heating_egr_flow(A_egr: Array, p_em: Array, Psi_egr: Array, gas: Gas, c: Constants) -> Array:
    """No flow [kg/s] is needed: EGR doesn't heat the charge."""
    return 0.0


def stored(static: Array, gas: Gas) -> Array:
    """The static temperature [K]."""
    return static
