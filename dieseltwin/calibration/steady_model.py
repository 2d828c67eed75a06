"""The balances of settled points: what each submodel says beside what was measured, for many parameter sets at once.

Only the engine's own equations are used (`bind("numpy")`). What the mean-value model leaves out enters through their
arguments: the pressure after the turbine and before the compressor stand in place of `p_amb`, the temperature of the
charge in place of the constant `T_im`. A term that is not active leaves the published model.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dieseltwin.engine.binding import bind
from dieseltwin.engine.parameters import CONSTANT_NAMES, EngineParameters, parameter_batch
from dieseltwin.recordings.steady_points import SteadyPoints

Array = NDArray[np.float64]

ROWS = ("cylinder_flow", "turbine_flow", "turbo_power", "compressor_flow", "egr_flow", "exhaust_temperature")
"""Submodels that every set of points has, one relation each."""

EXTRA_ROWS: Mapping[str, str] = {"t_im_k": "T_im", "t_c_k": "T_c", "p_es_pa": "p_es", "p_bc_pa": "p_bc"}
"""Optional channels that, where measured, add a relation each: column -> implied quantity."""

IMPLIED = ("p_es", "p_bc", "T_im", "T_c")
WORK_ROW = "compressor_work"
T_REFERENCE = 700.0  # K, of the back-pressure law (DISCOVERY.md)
T_CHARGE = 310.0  # K, temperature at which eta_vol's map is meant
FLAP_REFERENCE = 50.0  # %
SMALL_FLOW = 0.05  # of the median flow: relative residuals are damped below
SHARE_OF_HEAD = 0.25  # where the flow has no part in the ellipse, an error of the head counts as four of the flow
ELLIPSE_MIN = 1e-4  # limiter of the implicit compressor map: keeps the logarithm of trial states finite
T_ES_MIN = 200.0  # K, limiter: keeps trial states physical
SWEEPS = 4  # of the cylinder's fixed point
KNEE_WIDTH = 60.0  # rad/s over which the speed sensor's fault sets in

_eq = bind("numpy")


@dataclass(frozen=True)
class Relations:
    """What the balances say at B parameter sets and n points.

    Attributes:
        residual: (B, n, R) logarithm of measured over predicted, NaN where a reading is missing.
        measured, predicted: row name -> (B, n) [unit of the quantity].
        quantities: every intermediate quantity by the paper's symbol -> (B, n) [SI].
    """

    residual: Array
    measured: Mapping[str, Array]
    predicted: Mapping[str, Array]
    quantities: Mapping[str, Array]


@dataclass(frozen=True)
class SteadyModel:
    """The engine at settled points, with the terms that are active.

    Attributes:
        engine: every coefficient that `values` does not name.
        active: names of the terms that are switched on (see `terms.TERMS`).
        extra: optional measured columns that add a relation (`EXTRA_ROWS`).
    """

    engine: EngineParameters
    active: frozenset[str] = frozenset()
    extra: tuple[str, ...] = ()
    signals: Mapping[str, Array] = field(default_factory=dict)

    @property
    def rows(self) -> tuple[str, ...]:
        """Names of the R relations, in the order of the last axis of a residual."""
        work = (WORK_ROW,) if WORK_ROW in self.active else ()
        return (*ROWS, *work, *(EXTRA_ROWS[name] for name in self.extra))

    def relations(self, points: SteadyPoints, x: Array, values: Mapping[str, Any]) -> Relations:
        """Evaluate all submodels.

        Args:
            points: the n points (inputs, ambient, extra channels).
            x: states (n, 6) or (B, n, 6) in the order of `steady_points.STATES`.
            values: coefficient or term parameter -> number or (B,).
        """
        lanes = max([np.size(v) for v in values.values()] or [1])
        engine_values = {k: np.broadcast_to(v, (lanes,)) for k, v in values.items() if k in CONSTANT_NAMES}
        if "c_m1" in engine_values and self.engine.c_m[0] > 0:  # the straight part of c_m follows, or the curve jumps
            engine_values["c_mlin"] = self.engine.c_mlin * engine_values["c_m1"] / self.engine.c_m[0]
        c = parameter_batch(self.engine, size=lanes, **engine_values).constants()
        t = _Terms({k: np.reshape(v, (-1, 1)) for k, v in values.items() if k not in CONSTANT_NAMES}, self.active)
        signal = self._signal
        p_im, p_em, reading, W_c, W_egr, T_em = (x[..., i] for i in range(6))
        n_e, u_delta = points["n_e_rpm"], points["u_delta_mg"]
        T_0, p_0 = points["t_amb_k"], points["p_amb_pa"]
        W_f = _eq.fuel_flow(u_delta, n_e, c)
        W_t = W_c + W_f
        omega = t.true_speed(reading)

        # compressor: what lies before and behind it
        p_bc = signal("p_bc", p_0 - t("k_filter") * W_c * W_c)
        p_c = p_im + t("k_cooler_dp") * W_c * W_c * (c.T_im / 300.0) * (1e5 / p_im)
        c_c = c._replace(p_amb=p_bc, T_amb=T_0)
        Pi_c = _eq.compressor_pressure_ratio(p_c, c_c)
        phi = _eq.Phi_c(T_0, Pi_c, omega, c_c)
        W_c_model = signal("W_c", _eq.compressor_flow(phi, omega, c_c))
        eta_c = signal("eta_c", _eq.eta_c(W_c, Pi_c, c_c))
        T_c = _eq.compressor_out_temperature(eta_c, Pi_c, c_c)
        P_c = _eq.compressor_power(_eq.isentropic_compressor_power(W_c, Pi_c, c_c), eta_c)

        # charge: cooler, EGR cooler, cylinder
        T_im = signal("T_im", t.charge_temperature(c.T_im, T_0, T_c, T_em, W_c, W_egr))
        c_i = c._replace(T_im=T_im, T_amb=T_0)
        eta_vol = signal("eta_vol", _eq.eta_vol(p_im, n_e, c_i) * t.volumetric(p_em / p_im, T_im))
        W_ei_model = _eq.cylinder_inflow(eta_vol, p_im, n_e, c_i)
        T_em_model = signal("T_em", self._exhaust_temperature(p_im, p_em, W_c + W_egr, W_f, c_i))

        # turbine: what lies behind it
        T_es = np.maximum(T_em - P_c / (W_t * c.c_pe), T_ES_MIN)
        p_es = signal("p_es", t.pressure_after_turbine(p_0, W_t, T_es, c.R_e, points))
        c_t = c._replace(p_amb=p_es)
        Pi_t = _eq.turbine_pressure_ratio(p_em, c_t)
        opening = _eq.F_vgt_Pi_t(points["u_vgt_pct"], Pi_t, c_t)
        W_t_model = signal("W_t", _eq.turbine_flow(opening, p_em, T_em, c_t))
        eta_tm = signal("eta_tm", _eq.eta_tm(omega, T_em, Pi_t, c_t))
        P_t = _eq.turbine_power(eta_tm, W_t, T_em, Pi_t, c_t)

        Psi = _eq.egr_flow_factor(_eq.egr_pressure_ratio(p_im, p_em, c), c)
        f_egr = _eq.f_egr(points["u_egr_pct"], c)
        W_egr_model = signal("W_egr", _eq.egr_flow(_eq.egr_area(f_egr, c), p_em, Psi, T_em, c))

        pairs: dict[str, tuple[Any, Any]] = {
            "cylinder_flow": (W_c + W_egr, W_ei_model),
            "turbine_flow": (W_t, W_t_model),
            "turbo_power": (P_c, P_t),
            "compressor_flow": (W_c, W_c_model),
            "egr_flow": (W_egr, W_egr_model),
            "exhaust_temperature": (T_em, T_em_model),
        }
        implied = {"p_es": p_es, "p_bc": p_bc, "T_im": T_im, "T_c": T_c}
        if WORK_ROW in self.active:
            psi = _eq.energy_transfer_coefficient(T_0, Pi_c, omega, c_c)
            volume = W_c * c.R_a * T_0 / (p_bc * c.wheel_volume * omega)
            pairs[WORK_ROW] = (eta_c, 0.5 * psi / t.work_coefficient(volume, Pi_c))
        for name in self.extra:
            pairs[EXTRA_ROWS[name]] = (points[name], implied[EXTRA_ROWS[name]])
        shape = np.broadcast_shapes((lanes, points.size), x.shape[:-1])
        measured = {k: np.broadcast_to(v[0], shape) for k, v in pairs.items()}
        predicted = {k: np.broadcast_to(v[1], shape) for k, v in pairs.items()}
        residual = np.stack([_log_ratio(measured[k], predicted[k]) for k in self.rows], axis=-1)
        # The compressor's map is judged in its implicit form (A.46): solved for the flow, a flat speed line would
        # turn 1 % of pressure into 30 % of flow.
        psi = _eq.energy_transfer_coefficient(T_0, Pi_c, omega, c_c) - c.c_psi2
        flow = W_c * c.R_a * T_0 / (p_bc * c.wheel_volume * omega * (1.0 + self.signals.get("W_c", 0.0))) - c.c_phi2
        of_flow = _eq.ellipse_coefficient_phi(omega, c) * flow * flow
        ellipse = np.maximum(_eq.ellipse_coefficient_psi(omega, c) * psi * psi + of_flow, ELLIPSE_MIN)
        share = of_flow / ellipse + SHARE_OF_HEAD  # else a map of the head alone, blind to the flow, would fit best
        residual[..., ROWS.index("compressor_flow")] = 0.5 * np.log(ellipse) / share
        quantities = {
            **implied, "eta_c": eta_c, "eta_tm": eta_tm, "eta_vol": eta_vol, "Pi_c": Pi_c, "Pi_t": Pi_t, "P_c": P_c,
            "T_es": T_es, "W_f": W_f, "W_t": W_t, "Phi_c": phi, "omega_t": omega, "f_egr": f_egr, "W_ei": W_ei_model,
            "flap_area": t.flap_area(points) if "exhaust_flap" in self.active else np.full(shape, np.inf),
        }  # fmt: skip
        return Relations(residual, measured, predicted,
                         {k: np.broadcast_to(v, shape) for k, v in quantities.items()})

    def _signal(self, name: str, quantity: Any) -> Any:
        """The quantity times (1 + signal) where a signal enters at its insertion point."""
        return quantity * (1.0 + self.signals[name]) if name in self.signals else quantity

    @staticmethod
    def _exhaust_temperature(p_im: Any, p_em: Any, W_ei: Any, W_f: Any, c: Any) -> Any:
        x_r, T_1 = 0.03 + 0.0 * p_im, 330.0 + 0.0 * p_im
        ratio = _eq.exhaust_to_intake_ratio(p_em, p_im)
        for _ in range(SWEEPS):
            sweep = _eq.cylinder_sweep(ratio, W_ei, W_f, x_r, T_1, c)
            x_r, T_1 = sweep.x_r, sweep.T_1
        return _eq.exhaust_manifold_temperature(sweep.T_e, _eq.cylinder_outflow(W_f, W_ei), c)


class _Terms:
    """The laws of what the published model leaves out; parameters (B, 1), neutral where a term is not active."""

    def __init__(self, values: Mapping[str, Array], active: frozenset[str]) -> None:
        self.values, self.active = values, active

    def __call__(self, name: str, neutral: float = 0.0) -> Any:
        return self.values.get(name, neutral)

    def true_speed(self, reading: Any) -> Any:
        """Turbo speed [rad/s] from its reading: below a knee the sensor reads low (sensor:omega_t_rad_s)."""
        if "turbo_speed_low" not in self.active:
            return reading
        below = (self("omega_knee") - reading) / KNEE_WIDTH
        on = 1.0 / (1.0 + np.exp(-np.clip(below, -50.0, 50.0)))
        return reading * (1.0 + on * (self("omega_step") + self("omega_slope") * below * KNEE_WIDTH / 1000.0))

    def charge_temperature(self, T_im: Any, T_0: Any, T_c: Any, T_em: Any, W_c: Any, W_egr: Any) -> Any:
        """Charge temperature [K]: behind the cooler T_amb + dT + (1 - eff)(T_c - T_amb), then mixed with cooled EGR."""
        if "charge_cooler_loss" in self.active:
            T_im = T_0 + self("cooler_approach") + self("cooler_loss") * (T_c - T_0)
        if "egr_heating" in self.active:
            T_egr = self("egr_coolant") + self("egr_cooler_loss") * (T_em - self("egr_coolant"))
            T_im = T_im + W_egr / (W_c + W_egr) * (T_egr - T_im)
        return T_im

    def volumetric(self, Pi_e: Any, T_im: Any) -> Any:
        """Factor of eta_vol [-]: residual gas and the heating of the charge by the walls."""
        return (1.0 - self("vol_residual") * (Pi_e - 1.0)) * (T_im / T_CHARGE) ** self("vol_heating")

    def flap_area(self, points: SteadyPoints) -> Any:
        """Effective area of the exhaust flap [m2], ln A a parabola of ln(u_flap/50 %)."""
        u = np.log(np.clip(points["u_flap_pct"], 1.0, 100.0) / FLAP_REFERENCE)
        return np.exp(self("flap_0") + self("flap_1") * u + self("flap_2") * u * u)

    def pressure_after_turbine(self, p_0: Any, W_t: Any, T_es: Any, R_e: Any, points: SteadyPoints) -> Any:
        """p_es [Pa]: pipes p = p_amb + k W_t^2 T/700 K, before them a flap p_es^2 - p^2 = W_t^2 R_e T/A^2."""
        flow = W_t * W_t * T_es
        p = p_0 + self("k_back_pressure") * flow / T_REFERENCE
        if "exhaust_flap" not in self.active:
            return p
        return np.sqrt(p * p + flow * R_e / self.flap_area(points) ** 2)

    def work_coefficient(self, volume: Any, Pi_c: Any) -> Any:
        """Euler work over tip speed squared [-]: falls with the flow at the wheel's exit (backsweep)."""
        return self("work_0") * (1.0 - self("work_slope") * volume * Pi_c ** -0.36)


def _log_ratio(measured: Array, predicted: Array) -> Array:
    with np.errstate(invalid="ignore"):
        middle = np.nanmedian(np.abs(measured)) if np.isfinite(measured).any() else 1.0
    floor = SMALL_FLOW * middle + 1e-9
    return np.log((np.maximum(measured, 0.0) + floor) / (np.maximum(predicted, 0.0) + floor))


Evaluate = Callable[[Array, Mapping[str, Any]], Relations]
