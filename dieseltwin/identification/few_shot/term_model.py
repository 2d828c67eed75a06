"""The engine's equations with its terms, over torch tensors: what the physics residuals of a repaired twin ask for.

`TermModel.quantities` has the arguments of `engine.model.quantities`, so that whoever asks a bound model for quantities
asks this one in the same way. Terms are those of one engine; where and when they act is known at the samples.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dieseltwin.engine import Actuation, Constants, EngineParameters, bind
from dieseltwin.engine.actuators import actuator_update
from dieseltwin.engine.array_namespace import torch_primitives
from dieseltwin.engine.effects import GAS_LAG, HEATED_BY_GAS, STATE_EFFECTS, Magnitudes, effects_at
from dieseltwin.engine.extended_terms import conditions_of, quantities_under
from dieseltwin.engine.quantities import Gas, Quantities
from dieseltwin.engine.terms import SENSOR_UNITS, amounts, corrections_in, effect_terms, law_terms, sensor_slot
from dieseltwin.errors import InputError

STATIC_SWEEPS = 3
"""Rounds of the fixed point between the gas temperature and the EGR that it heats; a round leaves a fiftieth."""
GAS_START_K = 700.0
LAW_SWEEPS = 3
_POWER = torch_primitives()["positive_power"]


class TermModel:
    """Equations of engines with the same terms, bound to the samples of one or several segments.

    Args:
        maps: equation name -> learned map over torch tensors, or None for the exact formulae.
        parameters: gives the terms. Those on actuators are in the actuation, and sensor offsets and gains are taken
            out of the readings (`sensor_effects.undo_sensor_terms`); neither enters here.
        actuations: one: quantities are (.., n) over its samples; several: (L, n), a row each.
        pointwise: the caller differentiates point by point, so a lag of the gas or of the thermocouple, which mixes
            points, is added as a constant that is renewed at each call. Its value is exact, its derivative left out.
        dtype: of the tensors.
    """

    def __init__(
        self,
        maps: Mapping[str, Any] | None,
        parameters: EngineParameters,
        actuations: Sequence[Actuation],
        pointwise: bool = False,
        dtype: torch.dtype = torch.float64,
    ) -> None:
        base = bind("torch", replace=maps)
        solved = {
            name: _implicit(getattr(base, name), getattr(base, defect), pressure)
            for name, (defect, pressure) in IMPLICIT.items()
        }
        self.model, self.pointwise = bind("torch", replace={**(maps or {}), **solved}), pointwise
        self.intake_valve_closing_temperature = self.model.intake_valve_closing_temperature
        if corrections_in(parameters.terms) is not None:
            raise InputError(
                "engine file", "learned corrections of the maps", "laws and effects", "take --method classical"
            )
        self.laws = law_terms(parameters.terms)
        slow = [term for term in effect_terms(parameters.terms) if term.slot in _OTHER_LAGS and term.magnitude]
        if slow:
            raise InputError(
                "engine file", f"a reading that lags ({slow[0].slot})", "a lag of the reading of t_em_k",
                "take --method classical",
            )
        names = (*STATE_EFFECTS, READING_LAG)
        rows, factors, times = [], [], []
        for actuation in actuations:
            start, conditions = actuation.inputs.recording_start_s, conditions_of(actuation)
            time = actuation.time_s
            rows.append(amounts(parameters.terms, names, time, start, conditions))
            factors.append([law.factor(time, start, conditions) for law in self.laws])
            times.append(time - start)

        def tensor(values: Any) -> Tensor:
            stacked = np.stack(values)
            return torch.tensor(stacked[0] if len(actuations) == 1 else stacked, dtype=dtype)

        self._sizes = {
            name: tensor([row[j] for row in rows]) if any(row[j].any() for row in rows) else 0.0
            for j, name in enumerate(names)
        }
        self._factors = [tensor([f[j] for f in factors]) for j in range(len(self.laws))]
        self._time = tensor(times)
        step = np.diff(actuations[0].time_s)
        self._inertia = _lag_matrices([row[names.index(GAS_LAG)] for row in rows], step, dtype)
        self._thermocouple = _lag_matrices([row[-1] for row in rows], step, dtype)

    def quantities(
        self, p_im: Any, p_em: Any, omega_t: Any, x_r: Any, T_1: Any,
        n_e: Any, u_delta: Any, u_egr: Any, u_vgt: Any, c: Constants,
    ) -> Quantities:  # fmt: skip
        """All quantities; `T_em` is what the sensor reads: behind the gas's and the thermocouple's lags.

        The last axis runs over the samples, all of them or the first alone.
        """
        count = p_im.shape[-1]

        def cut(value: Any) -> Any:
            return value[..., :count] if isinstance(value, Tensor) else value

        m = Magnitudes(**{name: cut(self._sizes[name]) for name in STATE_EFFECTS})
        factors = [cut(factor) for factor in self._factors]
        states = {
            "p_im": p_im, "p_em": p_em, "omega_t": omega_t, "x_r": x_r, "T_1": T_1,
            "n_e": n_e, "u_delta": u_delta, "u_egr": u_egr, "u_vgt": u_vgt, "t": cut(self._time),
        }  # fmt: skip

        def at(gas: Gas) -> Quantities:
            return quantities_under(self.model, states, gas, m, self.laws, factors, c, _POWER, LAW_SWEEPS)[0]

        T_gas: Any = torch.full_like(p_im, GAS_START_K)
        heated = any(isinstance(getattr(m, name), Tensor) for name in HEATED_BY_GAS)
        inertia = self._inertia if count > 1 else None
        q = at(Gas(T_gas, 1.0, 0.0))
        for _ in range(STATIC_SWEEPS if heated else int(inertia is not None)):
            if inertia is None:
                q = at(Gas(q.T_em, 1.0, 0.0))
                continue
            T_gas = self._lagged(q.T_em_static, inertia)
            q = at(Gas(T_gas, 1.0, (T_gas - q.T_em_static).detach()) if self.pointwise else Gas(T_gas, 0.0, T_gas))
        if self._thermocouple is not None and count > 1:
            q = q._replace(T_em=self._read(q.T_em, self._lagged(q.T_em, self._thermocouple)))
        return q

    def _lagged(self, static: Tensor, matrices: Tensor) -> Tensor:
        whole = static.expand(torch.broadcast_shapes(static.shape, (matrices.shape[-1],)))
        if matrices.dim() == 3:  # a row each
            return torch.einsum("lij,lj->li", matrices, whole)
        return whole @ matrices.T

    def _read(self, true: Tensor, lagged: Tensor) -> Tensor:
        return true + (lagged - true).detach() if self.pointwise else lagged

    def settle(self, states: Sequence[Any], inputs: Sequence[Any], x_r: Tensor, T_1: Tensor, c: Constants) -> Any:
        """Two sweeps of the cylinder's fixed point: quantities whose `x_r_next`, `T_1_next` are the better guess."""
        p_im, p_em, omega_t = states
        n_e, u_delta, u_egr, u_vgt = inputs
        for _ in range(2):
            q = self.quantities(p_im, p_em, omega_t, x_r, T_1, n_e, u_delta, u_egr, u_vgt, c)
            x_r, T_1 = q.x_r_next, q.T_1_next
        return q


READING_LAG = sensor_slot("t_em_k", "lag")
"""The lag of a reading that physics residuals know: of the exhaust temperature, which is no state."""

_OTHER_LAGS = {sensor_slot(column, "lag") for column in SENSOR_UNITS} - {READING_LAG}

IMPLICIT = {"inlet_pressure": ("inlet_defect", "p_bc"), "outlet_pressure": ("outlet_defect", "p_es")}
"""Equations that are solved by iteration, what they bring to zero, and the pressure that they give."""

SLOPE_STEP = 1e-3  # of the pressure, for the derivative of the defect: above the rounding of single precision


def _implicit(solve: Callable[..., Tensor], defect: Callable[..., Tensor], pressure: str) -> Callable[..., Tensor]:
    """A solved equation whose derivative is that of the implicit function, and which is skipped without its effects."""

    def solved(*arguments: Any) -> Any:
        *_, m, s, c = arguments
        if not any(isinstance(getattr(m, name), Tensor) for name in effects_at(pressure)):
            return c.p_amb * (1.0 + getattr(s, pressure))
        with torch.no_grad():
            root = solve(*arguments)
            step = SLOPE_STEP * root
            slope = (defect(root + step, *arguments) - defect(root - step, *arguments)) / (2.0 * step)
        return root - defect(root, *arguments) / slope

    return solved


def _lag_matrices(taus: Sequence[np.ndarray], step: np.ndarray, dtype: torch.dtype) -> Tensor | None:
    """Matrices of lags, exact for values that are linear between samples: (n, n), or (L, n, n) for several rows."""
    if not any(tau.any() for tau in taus):
        return None
    made = torch.tensor(np.stack([_lag_matrix(tau, step) for tau in taus]), dtype=dtype)
    return made[0] if len(taus) == 1 else made


def _lag_matrix(tau: np.ndarray, step: np.ndarray) -> np.ndarray:
    n = tau.size
    out = np.zeros((n, n))
    out[0, 0] = 1.0
    for i in range(n - 1):
        if tau[i] > 0.0:  # the state's, the old value's and the new value's share of the next state
            kept = float(np.exp(-step[i] / tau[i]))
            new = float(actuator_update(0.0, 0.0, 1.0, step[i], tau[i]))
            out[i + 1] = kept * out[i]
            out[i + 1, i] += 1.0 - kept - new
            out[i + 1, i + 1] += new
        else:
            out[i + 1, i + 1] = 1.0
    return out
