"""Integration steps of discovery on the diesel engine: as long as stability and a fraction of the noise allow.

The pressures in the manifolds relax within 0.01 to 0.05 s, the turbocharger within a second. So stability limits the
step, and by how much changes along a recording. Behind a window's start the pressures settle from smoothed readings;
there the step is short, as an error of the turbo's speed lasts until the window's end.
"""

from __future__ import annotations

import numpy as np

from dieseltwin.discovery.twins.interface import Array
from dieseltwin.engine import EngineParameters
from dieseltwin.engine.inputs import Actuation
from dieseltwin.engine.parameters import constants
from dieseltwin.engine.simulate import numpy_model

LATE = 0.48
"""`simulate_extended`'s share of the third stage: stability polynomial 1 + z + z^2/2 + z^3/6 + z^4/50, below 0.55 for
real z down to -5.2, where RK4 ends at -2.8."""

_REACH = 2.6  # z of a step along the nominal trajectory: half of what is stable
_LONGEST_S = 0.067
_SHORTEST_S = 0.0125
_NEAR = 2  # samples to either side that share a step: another trajectory meets the same kinks a little earlier or later
_PRESSURE_STEP = 20.0  # Pa, for derivatives
_FASTEST = 1e6  # 1/s, of what is believed


def stiffness(states: Array, actuation: Actuation, engine: EngineParameters) -> Array:
    """Fastest rate of the pressures at every sample of a trajectory, (n,) [1/s].

    Args:
        states: (n, 5 or more) p_im, p_em [Pa], omega_t [rad/s], x_r [-], T_1 [K].
        actuation: inputs and actuators at the samples.
        engine: the engine.
    """
    model, c = numpy_model(), constants(engine)
    p_im, p_em, omega_t, x_r, T_1 = states[:, :5].T

    def rates(intake: float, exhaust: float) -> Array:
        q = model.quantities(p_im + intake, p_em + exhaust, omega_t, x_r, T_1, *actuation.at_samples(), c)
        return np.stack([q.dp_im, q.dp_em], axis=-1)

    here = rates(0.0, 0.0)
    columns = [rates(_PRESSURE_STEP, 0.0) - here, rates(0.0, _PRESSURE_STEP) - here]
    jacobian = np.clip(np.nan_to_num(np.stack(columns, axis=-1) / _PRESSURE_STEP), -_FASTEST, _FASTEST)
    return np.asarray(np.abs(np.linalg.eigvals(jacobian)).max(axis=1))


def step_lengths(rate: Array, starts: np.ndarray) -> Array:
    """Longest step in every interval between samples, (n - 1,) [s].

    Args:
        rate: (n,) `stiffness`.
        starts: (W,) first samples of the windows.
    """
    n = rate.size
    fastest = np.maximum(rate[1:], rate[:-1])
    padded = np.pad(fastest, _NEAR, mode="edge")
    near = np.lib.stride_tricks.sliding_window_view(padded, 2 * _NEAR + 1).max(axis=1)
    lengths = np.clip(_REACH / np.maximum(near, 1e-3), _SHORTEST_S, _LONGEST_S)
    lengths[starts[starts < n - 1]] = _SHORTEST_S
    return np.asarray(lengths)
