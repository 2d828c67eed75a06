"""Inputs and output restrictions of the six learned maps, over the engine's primitives.

A learned map is ``output(network(inputs))``. Both ends are written once, like the engine's equations, and call the
engine's own functions and primitives by their global names; `bound_forms` gives them the globals of a backend.

`paper` follows the paper's table of surrogates to the letter. `improved` differs where the printed choice is known to
hurt, and only by what anyone knows without the empirical formula:

- Phi_c sees (Psi_c, omega_t), the dimensionless energy transfer, and not T_amb, of which the laboratory has three
  values; the network gives Phi_c squared (pressure goes with the square of flow), which has no infinite slope at zero.
- f_egr is the position times a network: nothing flows through a shut valve.
- F_vgt,Pi_t is the square root of 1 - Pi_t times a network: the limit of every orifice at small pressure drops.
- eta_tm sees the blade speed ratio, which the printed inputs determine, and the turbo speed, once plain (as its
  square root) and once between two knots, where its labels jump.
- eta_c sees the fourth root of Pi_c - 1: its labels have an infinite slope at no boost.
"""

from __future__ import annotations

import types
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

from dieseltwin.engine import turbocharger
from dieseltwin.engine.array_namespace import Array, exp, maximum, minimum, positive_power, root
from dieseltwin.engine.binding import COMPILED, Backend, bind
from dieseltwin.engine.parameters import Constants
from dieseltwin.engine.turbocharger import blade_speed_ratio, energy_transfer_coefficient

Kind = Literal["paper", "improved"]
KINDS: tuple[Kind, ...] = ("paper", "improved")

F_VGT_MAX = 1.1  # paper, table of surrogates: 1.1 S(F)
ETA_TM_CAP = 0.818  # min(0.818, eta_tm)
ETA_C_FLOOR = 0.2  # max(0.2, S(eta_c))
ETA_TM_FLOOR = turbocharger.ETA_TM_MIN  # the engine's own limit; improved only
BOOST_POWER = 0.25  # exponent on Pi_c - 1 in the improved eta_c
BOOST_MIN = 1e-6  # Pi_c - 1 below which that input rests, so that its slope stays finite


def sigmoid(z: Array) -> Array:
    """S(z) = 1 / (1 + exp(-z)) [-], the paper's S."""
    return 1.0 / (1.0 + exp(-z))


# --- network inputs ----------------------------------------------------------------------------------------------


def one_input(u: Array, c: Constants) -> tuple[Array, ...]:
    """The map's argument as printed: N_2 of u~_egr [%]."""
    return (u,)


def two_inputs(a: Array, b: Array, c: Constants) -> tuple[Array, ...]:
    """The arguments as printed: N_1 (p_im [Pa], n_e [rpm]), N_3 (u~_vgt [%], Pi_t [-]), N_5 (W_c [kg/s], Pi_c [-])."""
    return a, b


def three_inputs(a: Array, b: Array, d: Array, c: Constants) -> tuple[Array, ...]:
    """The arguments as printed: N_4 (omega_t [rad/s], T_em [K], Pi_t), N_6 (T_amb [K], Pi_c, omega_t [rad/s])."""
    return a, b, d


def turbine_inputs(omega_t: Array, T_em: Array, Pi_t: Array, c: Constants) -> tuple[Array, ...]:
    """Blade speed ratio [-], sqrt(omega_t) and omega_t [rad/s]; the last is limited to the two knots of the jump."""
    return blade_speed_ratio(omega_t, T_em, Pi_t, c), root(omega_t), omega_t


def boost_inputs(W_c: Array, Pi_c: Array, c: Constants) -> tuple[Array, ...]:
    """W_c [kg/s] and the fourth root of Pi_c - 1 [-]."""
    return W_c, positive_power(maximum(Pi_c - 1.0, BOOST_MIN), BOOST_POWER)


def compressor_inputs(T_amb: Array, Pi_c: Array, omega_t: Array, c: Constants) -> tuple[Array, ...]:
    """Psi_c [-] by the engine's own equation and omega_t [rad/s]."""
    return energy_transfer_coefficient(T_amb, Pi_c, omega_t, c), omega_t


# --- output restrictions: of the network's output z and its (limited) inputs x ------------------------------------


def unrestricted(z: Array, x: tuple[Array, ...]) -> Array:
    """z: N_1."""
    return z


def restricted_opening(z: Array, x: tuple[Array, ...]) -> Array:
    """S(z): N_2 and N_6 as printed; never zero, so a shut EGR valve leaks."""
    return sigmoid(z)


def restricted_turbine_opening(z: Array, x: tuple[Array, ...]) -> Array:
    """1.1 S(z): N_3 as printed."""
    return F_VGT_MAX * sigmoid(z)


def capped(z: Array, x: tuple[Array, ...]) -> Array:
    """min(0.818, z): N_4 as printed."""
    return minimum(z, ETA_TM_CAP)


def restricted_floored(z: Array, x: tuple[Array, ...]) -> Array:
    """max(0.2, S(z)): N_5 as printed."""
    return maximum(sigmoid(z), ETA_C_FLOOR)


def position_times(z: Array, x: tuple[Array, ...]) -> Array:
    """Position times z: zero at a shut valve by construction, and never below."""
    return maximum(0.01 * x[0] * z, 0.0)


def orifice_times(z: Array, x: tuple[Array, ...]) -> Array:
    """sqrt(1 - Pi_t) z, not below 0."""
    return root(1.0 - x[1]) * maximum(z, 0.0)


def capped_floored(z: Array, x: tuple[Array, ...]) -> Array:
    """z within [0.2, 0.818]."""
    return minimum(maximum(z, ETA_TM_FLOOR), ETA_TM_CAP)


def floored(z: Array, x: tuple[Array, ...]) -> Array:
    """max(0.2, z)."""
    return maximum(z, ETA_C_FLOOR)


def root_of(z: Array, x: tuple[Array, ...]) -> Array:
    """Square root of max(0, z), where z stands for the square of the flow coefficient, scaled."""
    return root(PHI_C_SQUARE * z)


PHI_C_SQUARE = 0.02  # [-] usual size of Phi_c squared, so that the network's output is of order one

FORMS: dict[Kind, dict[str, tuple[Callable[..., Any], Callable[..., Any], int]]] = {
    "paper": {
        "eta_vol": (two_inputs, unrestricted, 2),
        "f_egr": (one_input, restricted_opening, 1),
        "F_vgt_Pi_t": (two_inputs, restricted_turbine_opening, 2),
        "eta_tm": (three_inputs, capped, 3),
        "eta_c": (two_inputs, restricted_floored, 2),
        "Phi_c": (three_inputs, restricted_opening, 3),
    },
    "improved": {
        "eta_vol": (two_inputs, unrestricted, 2),
        "f_egr": (one_input, position_times, 1),
        "F_vgt_Pi_t": (two_inputs, orifice_times, 2),
        "eta_tm": (turbine_inputs, capped_floored, 3),
        "eta_c": (boost_inputs, floored, 2),
        "Phi_c": (compressor_inputs, root_of, 2),
    },
}
"""Inputs, output restriction and number of network inputs of each map."""


@dataclass(frozen=True)
class Form:
    """One map's ends, bound to a backend.

    Attributes:
        inputs: the map's arguments and c -> tuple of network inputs.
        output: network output and tuple of the (limited) network inputs -> value of the map.
        n_inputs: number of network inputs.
    """

    inputs: Callable[..., tuple[Any, ...]]
    output: Callable[..., Any]
    n_inputs: int


def backend_globals(backend: Backend) -> dict[str, Any]:
    """Primitives and equations of the engine as one backend sees them."""
    bound = bind(backend).eta_tm
    return dict(getattr(bound, "py_func", bound).__globals__)


@lru_cache(maxsize=8)
def bound_forms(kind: Kind, backend: Backend) -> dict[str, Form]:
    """Forms of the six maps for a backend ("numpy", "torch"; "numba": compiled scalars)."""
    scope = {**backend_globals(backend), **{n: v for n, v in globals().items() if isinstance(v, float)}}

    def rebind(function: Callable[..., Any]) -> Callable[..., Any]:
        copy = types.FunctionType(function.__code__, scope, function.__name__)
        if backend != "numba":
            return copy
        from dieseltwin.inner import inner

        return inner(**COMPILED)(copy)

    scope["sigmoid"] = rebind(sigmoid)
    return {name: Form(rebind(form[0]), rebind(form[1]), form[2]) for name, form in FORMS[kind].items()}
