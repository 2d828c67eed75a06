"""A twin whose samples are settled points: no time, no local states; its readings are the settled states of each point.

`simulate` solves the six balances of every point for all lanes at once (Newton's method from the measured states).
Signals enter at the insertion points of `STEADY_POINTS`; hypotheses are the terms of `calibration.coefficients.TERMS`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from dieseltwin.calibration.calibrate import Calibration
from dieseltwin.calibration.coefficients import TERMS
from dieseltwin.calibration.repair import available
from dieseltwin.calibration.steady_model import ROWS, SteadyModel
from dieseltwin.discovery.twins.interface import Array, Hypothesis, Lanes, Parameter, Point
from dieseltwin.recordings.steady_points import STATES, SteadyPoints

STEADY_POINTS: tuple[Point, ...] = (
    Point("W_t", "turbine_flow", True, "-", ("p_em", "T_em", "p_amb", "u_vgt", "u_flap"), tolerance=0.01,
          tolerance_over=("u_vgt", "p_em")),
    Point("p_es", "turbine_flow", True, "-", ("W_t", "T_es", "p_amb", "u_flap")),
    Point("p_bc", "compressor_flow", True, "-", ("W_c", "p_amb")),
    Point("W_c", "compressor_flow", True, "-", ("p_im", "p_amb", "omega_t"), tolerance=0.02,
          tolerance_over=("omega_t", "p_im")),
    Point("eta_c", "compressor_power", True, "-", ("W_c", "p_im", "p_amb"), tolerance=0.02,
          tolerance_over=("W_c", "p_im")),
    Point("eta_tm", "turbine_power", True, "-", ("omega_t", "T_em", "p_em", "p_amb", "u_vgt"), tolerance=0.02,
          tolerance_over=("omega_t", "p_em")),
    Point("eta_vol", "cylinder_flow", True, "-", ("p_im", "p_em", "n_e", "T_im"), tolerance=0.01,
          tolerance_over=("p_im", "n_e")),
    Point("T_im", "intake_temperature", True, "-", ("T_c", "T_amb", "T_em", "W_c", "W_egr")),
    Point("T_em", "exhaust_temperature", True, "-", ("W_ei", "W_f", "T_im", "T_amb"), tolerance=0.01,
          tolerance_over=("W_f", "n_e")),
    Point("W_egr", "egr_flow", True, "-", ("p_em", "p_im", "T_em", "u_egr"), tolerance=0.02,
          tolerance_over=("u_egr", "p_em")),
)  # fmt: skip

NEWTON_STEPS = 30
LARGEST_STEP = 0.1  # of ln x
ENOUGH = 1e-7  # of ln x
DIFFERENCE = 1e-5
DAMPING = 1e-8  # keeps a speed line that is flat at a trial state from throwing the state away


def settle(model: SteadyModel, points: SteadyPoints, values: Mapping[str, Any], start: Array) -> Array:
    """States at which every balance holds, (B, n, 6).

    Args:
        model, points: relations and n points.
        values: coefficient -> number or (B,).
        start: (n, 6) or (B, n, 6) states to start from.

    Points without a settled state keep the state of the smallest residual found.
    """
    lanes = max([np.size(v) for v in values.values()] or [1])
    bare = replace(model, extra=(), active=model.active & frozenset(TERMS))
    y = np.log(np.broadcast_to(start, (lanes, *start.shape[-2:]))).copy()
    size = len(STATES)

    def residual(y: Array) -> Array:
        r = bare.relations(points, np.exp(y), values).residual[..., : len(ROWS)]
        return np.clip(np.nan_to_num(r), -3.0, 3.0)

    r = residual(y)
    best, best_y = np.max(np.abs(r), axis=-1), y.copy()
    for _ in range(NEWTON_STEPS):
        J = np.stack([(residual(y + DIFFERENCE * np.eye(size)[j]) - r) / DIFFERENCE for j in range(size)], axis=-1)
        normal = np.swapaxes(J, -1, -2) @ J + DAMPING * np.eye(size)
        step = -np.linalg.solve(normal, np.swapaxes(J, -1, -2) @ r[..., None])[..., 0]
        longest = np.max(np.abs(step), axis=-1, keepdims=True)
        step = step * np.minimum(1.0, LARGEST_STEP / np.maximum(longest, 1e-300))
        y = y + step
        r = residual(y)
        worst = np.max(np.abs(r), axis=-1)
        better = worst < best
        best, best_y = np.where(better, worst, best), np.where(better[..., None], y, best_y)
        if np.max(np.abs(step)) < ENOUGH:
            break
    return np.exp(best_y)


class SteadyTwin:
    """The `Twin` of settled points; every point is a sample, one window holds all, there are no local states.

    Args:
        calibration: engine, points and coefficients without terms.
    """

    channels: tuple[str, ...] = STATES
    states: tuple[str, ...] = ()

    def __init__(self, calibration: Calibration) -> None:
        self.calibration = calibration
        self.data = calibration.points
        self.points: tuple[Point, ...] = STEADY_POINTS
        self._coefficients = calibration.estimate.coefficients
        self.parameters: tuple[Parameter, ...] = tuple(
            Parameter(c.name, float(v), c.std, c.unit, 0.1 * c.std)
            for c, v in zip(self._coefficients, calibration.estimate.theta, strict=True)
        )
        self.state_scales: Array = np.zeros(0)
        self.hypotheses: Mapping[str, Hypothesis] = {
            term.name: Hypothesis(
                name=term.name, site=term.site, law=term.law, unit=term.parameters[0].unit, tolerance=term.smallest,
                limits=(term.parameters[0].low, term.parameters[0].high), smooth=False,
                sizes=(term.parameters[0].mean,), confused_with=term.confused_with,
                kind="sensor" if term.site.startswith("sensor:") else "physics",
            )
            for term in available(self.data)
        }  # fmt: skip
        self.time_s: Array = np.arange(self.data.size, dtype=np.float64)
        self.starts = np.zeros(1, dtype=np.int64)
        self.measured: Array = self.data.states()
        self.conditions: Mapping[str, Array] = {
            name: self.data[name]
            for name in ("n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct", "u_flap_pct") if name in self.data
        }  # fmt: skip

    def first_local(self) -> Array:
        """No local states: (1, 0)."""
        return np.zeros((1, 0))

    def simulate(self, lanes: Lanes) -> Array:
        """Settled states of every point as the sensors read them, (B, n, 6).

        A term's other parameters (a flap's exponents) stand at their prior means; lanes in which its magnitude is at
        the neutral value of 0 are solved without it.
        """
        values: dict[str, Any] = {p.name: lanes.parameters[:, i] for i, p in enumerate(self.parameters)}
        out = np.empty((lanes.size, self.data.size, len(STATES)))
        keys = [tuple(name for name, m in lanes.magnitudes.items() if m[b] != 0.0) for b in range(lanes.size)]
        extra = {p: np.zeros((lanes.size, self.data.size)) for p in (q.name for q in self.points)}
        for name, signal in lanes.signals.items():
            extra[name] += signal
        if lanes.lane_points is not None and lanes.lane_signals is not None:
            for b, index in enumerate(lanes.lane_points):
                if index >= 0:
                    extra[self.points[int(index)].name][b] += lanes.lane_signals[b]
        for key in dict.fromkeys(keys):
            rows = np.array([i for i, k in enumerate(keys) if k == key])
            used = {name: column[rows] for name, column in values.items()}
            for name in key:
                term = TERMS[name]
                used |= {c.name: np.full(rows.size, c.mean) for c in term.parameters}
                used[term.parameters[0].name] = lanes.magnitudes[name][rows]
            used = {**{k: np.full(rows.size, v) for k, v in self._fixed(used).items()}, **used}
            model = replace(self.calibration.model, active=frozenset(key),
                            signals={p: s[rows] for p, s in extra.items() if s[rows].any()})
            out[rows] = settle(model, self.data, used, self.calibration.estimate.x)
        return out

    def _fixed(self, used: Mapping[str, Any]) -> dict[str, float]:
        return {k: v for k, v in self.calibration.start.items() if k not in used}

    def variables(self, lanes: Lanes) -> dict[str, Array]:
        """Every variable that ports name, at the settled states of lane 0, (n,) each."""
        x = self.simulate(lanes)[0]
        values = {p.name: float(lanes.parameters[0, i]) for i, p in enumerate(self.parameters)}
        values = {**self._fixed(values), **values}
        q = {k: v[0] for k, v in self.calibration.model.relations(self.data, x, values).quantities.items()}
        named = dict(zip(("p_im", "p_em", "omega_t", "W_c", "W_egr", "T_em"), x.T, strict=True))
        inputs = {"n_e": "n_e_rpm", "u_delta": "u_delta_mg", "u_egr": "u_egr_pct", "u_vgt": "u_vgt_pct",
                  "p_amb": "p_amb_pa", "T_amb": "t_amb_k"}  # fmt: skip
        columns = {name: self.data[column] for name, column in inputs.items()}
        columns["u_flap"] = self.data["u_flap_pct"] if "u_flap_pct" in self.data else np.full(self.data.size, 100.0)
        return {**{k: v for k, v in q.items() if np.isfinite(v).all()}, **columns, **named}
