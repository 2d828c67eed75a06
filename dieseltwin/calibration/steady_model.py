"""The balances of settled points: what each submodel says beside what was measured, for many parameter sets at once.

Only the engine's own equations and the laws of its effects are used (`bind("numpy")`), with measured flows and
temperatures in their places: so an error of one submodel stays there, and no state at rest has to be found. Effects
have the names, laws and units of the engine's catalogue; one that is not among the values is absent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dieseltwin.arrays import Array
from dieseltwin.calibration.coefficients import FLAP_COEFFICIENTS, WEAR
from dieseltwin.calibration.relations import Relations, cooled_charge, log_ratio, middle_sizes, spread
from dieseltwin.engine.binding import bind
from dieseltwin.engine.effects import EFFECTS, effects_at
from dieseltwin.engine.map_corrections import corrections_of, with_corrections_at
from dieseltwin.engine.parameters import CONSTANT_NAMES, EngineParameters, parameter_batch
from dieseltwin.engine.terms import (
    SENSOR_SLOTS,
    CorrectionTerm,
    LawTerm,
    OneTerm,
    Term,
    corrections_in,
    effect_terms,
    law_terms,
    sensor_slot,
)
from dieseltwin.recordings.steady_points import JUDGED, LEAST, SINCE, STATES, SteadyPoints

ROWS = ("cylinder_flow", "turbine_flow", "turbo_power", "compressor_flow", "egr_flow", "exhaust_temperature")
"""Submodels that every set of points has, one relation each."""

EXTRA_ROWS: Mapping[str, str] = {"t_im_k": "T_im", "t_c_k": "T_c", "p_es_pa": "p_es", "p_bc_pa": "p_bc"}
"""Optional channels that, where measured, add a relation each: column -> implied quantity."""

IMPLIED = ("p_es", "p_bc", "T_im", "T_c")
WORK_ROW = "compressor_work"
T_CHARGE = 310.0  # K, temperature at which eta_vol's map is meant
SHARE_OF_HEAD = 0.25  # where the flow has no part in the ellipse, an error of the head counts as four of the flow
ELLIPSE_MIN = 1e-4  # limiter of the implicit compressor map: keeps the logarithm of trial states finite
T_ES_MIN = 200.0  # K, limiter: keeps trial states physical
T_IM_MIN = 100.0  # K, the same of the charge: readings that contradict the engine ask for one below 0 K
SWEEPS = 4  # of the cylinder's fixed point
LEAST_FLOW = 1e-5  # kg/s, limiter: keeps trial flows positive
MAP_MODE = "map:"
"""Begin of the names of a map's modes, "map:<insertion point>:<number>": columns of the points and values."""

SENSOR_ERROR = "reading:"
"""Begin of the names of errors that a sensor had at the time of the reference already, "reading:<column>:gain"."""

COOLED_CHARGE, COOLED_EGR = "cooled_charge", "cooled_egr"
"""Beliefs of `imply` that say how the charge gets its temperature, in `SteadyModel.active`."""

CHARGE_OFFSET = "t_im_k:offset"
"""Fault of the sensor that reads the charge. It is no sensor of the likelihood of recordings, so no slot of a term."""

_SINCE = frozenset({*EFFECTS, *SENSOR_SLOTS, *WEAR.values(), CHARGE_OFFSET})
"""What may have come since a reference; coefficients and beliefs were there before."""

_eq = bind("numpy")


@dataclass(frozen=True)
class SteadyModel:
    """The engine at settled points, with the terms that are active.

    Attributes:
        engine: every coefficient that `values` does not name.
        active: names of the beliefs that are switched on.
        extra: optional measured columns that add a relation (`EXTRA_ROWS`).
        signals: insertion point -> what enters there, (n,) or (B, n).
        lasting: names among the values that act in the points of a reference too (beliefs; the engine's own terms do).
        added: how many of the engine's terms, its last ones, have come since the reference.
    """

    engine: EngineParameters
    active: frozenset[str] = frozenset()
    extra: tuple[str, ...] = ()
    signals: Mapping[str, Array] = field(default_factory=dict)
    lasting: frozenset[str] = frozenset()
    added: int = 0

    @property
    def before(self) -> tuple[OneTerm, ...]:
        """The engine's terms at the time of the reference."""
        return self.engine.terms[: len(self.engine.terms) - self.added]

    @property
    def since(self) -> tuple[OneTerm, ...]:
        """The engine's terms that have come since the reference."""
        return self.engine.terms[len(self.before) :]

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
            values: coefficient of the engine, effect, fault of a sensor (`SENSOR_SLOTS`), coefficient of an effect
                (`FLAP_COEFFICIENTS`) or of a belief -> number or (B,).
        """
        if law_terms(self.engine.terms):
            return self._with_laws(points, x, values)
        if corrections_in(self.engine.terms) is not None:
            return self._with_corrections(points, x, values)
        lanes = max([np.size(v) for v in values.values()] or [1])
        engine_values = {k: np.broadcast_to(v, (lanes,)) for k, v in values.items() if k in CONSTANT_NAMES}
        if "c_m1" in engine_values and self.engine.c_m[0] > 0:  # the straight part of c_m follows, or the curve jumps
            engine_values["c_mlin"] = self.engine.c_mlin * engine_values["c_m1"] / self.engine.c_m[0]
        c = parameter_batch(self.engine, size=lanes, **engine_values).constants()
        t = _Terms({k: np.reshape(v, (-1, 1)) for k, v in values.items() if k not in CONSTANT_NAMES}, self.active,
                   points.columns, {**dict.fromkeys(self.lasting), **self._always(points)})
        c = c._replace(**{name: getattr(c, name) * (1.0 + t(wear)) for name, wear in WEAR.items() if wear in values})
        entered = self._entered(points, values, lanes)

        def signal(name: str, quantity: Any) -> Any:
            """The quantity times (1 + signal) where a signal enters at its insertion point."""
            return quantity * (1.0 + entered[name]) if name in entered else quantity

        def added(name: str, quantity: Any) -> Any:
            """The quantity plus the signal where one enters a balance."""
            return quantity + entered[name] if name in entered else quantity

        p_im, p_em, omega, W_c, W_egr, T_em = (t.true(name, x[..., i]) for i, name in enumerate(STATES))
        n_e, T_0, p_0 = points["n_e_rpm"], points["t_amb_k"], points["p_amb_pa"]
        c_0 = c._replace(p_amb=p_0, T_amb=T_0)
        known: dict[str, Any] = {"p_im": p_im, "p_em": p_em, "omega_t": omega, "W_c": W_c, "W_egr": W_egr,
                                 "T_em": T_em, "n_e": n_e, "c": c_0}  # fmt: skip

        def changed(name: str, quantity: Any) -> Any:
            """The quantity under the effects and the signal that enter it; laws then find it under its name."""
            known[name] = signal(name, t.changed(name, quantity, known, points))
            return known[name]

        u_delta = changed("u_delta", points["u_delta_mg"])
        W_f = _eq.fuel_flow(u_delta, n_e, c)

        # compressor: what lies before and behind it
        p_bc = changed("p_bc", p_0)
        p_c = p_im + t("k_cooler_dp") * W_c * W_c * (c.T_im / 300.0) * (1e5 / p_im)
        c_c = c._replace(p_amb=p_bc, T_amb=T_0)
        Pi_c = known["Pi_c"] = _eq.compressor_pressure_ratio(p_c, c_c)
        phi = _eq.Phi_c(T_0, Pi_c, omega, c_c)
        lost = signal("W_c", t.changed("W_c", 1.0, known, points))
        W_c_model = lost * _eq.compressor_flow(phi, omega, c_c)
        eta_c = changed("eta_c", _eq.eta_c(W_c, Pi_c, c_c))
        T_c = known["T_c"] = _eq.compressor_out_temperature(eta_c, Pi_c, c_c)
        P_c = _eq.compressor_power(_eq.isentropic_compressor_power(W_c, Pi_c, c_c), eta_c)

        # charge: coolers, cylinder
        eta_vol = changed("eta_vol", _eq.eta_vol(p_im, n_e, c))
        T_well = points.usual_charge if "t_im_k" in self.extra else None
        T_charge = t.charge_temperature(c.T_im if T_well is None else T_well, known, points)
        T_im_model = known["T_im"] = signal("T_im", T_charge)
        read = {name: t.true(name, points[name]) for name in self.extra}
        T_im = self._as_read(read.get("t_im_k"), T_im_model)
        eta_vol = eta_vol * t.wall_heating(T_im)
        c_i = c._replace(T_im=T_im, T_amb=T_0)
        W_ei_model = _eq.cylinder_inflow(eta_vol, p_im, n_e, c_i)
        lost_im = added("intake_balance", t.changed("intake_balance", 0.0, known, points))
        W_ei = known["W_ei"] = np.maximum(W_c + lost_im + W_egr, LEAST_FLOW)
        W_eo = changed("W_eo", _eq.cylinder_outflow(W_f, W_ei))
        T_em_static = self._exhaust_temperature(p_im, p_em, W_ei, W_f, W_eo, c_i)
        T_em_model = signal("T_em", t.changed("T_em", T_em_static, known, points))

        # turbine: what lies behind it
        lost_em = added("exhaust_balance", t.changed("exhaust_balance", 0.0, known, points))
        W_t = known["W_t"] = np.maximum(W_eo + lost_em - W_egr, LEAST_FLOW)
        T_es = np.maximum(T_em - P_c / (W_t * c.c_pe), T_ES_MIN)
        p_es = changed("p_es", p_0)
        c_t = c._replace(p_amb=p_es)
        Pi_t = known["Pi_t"] = _eq.turbine_pressure_ratio(p_em, c_t)
        u_vgt = added("u_vgt", t.changed("u_vgt", points["u_vgt_pct"], known, points))
        opening = _eq.F_vgt_Pi_t(u_vgt, Pi_t, c_t)
        W_t_model = signal("W_t", t.changed("W_t", _eq.turbine_flow(opening, p_em, T_em, c_t), known, points))
        eta_tm = changed("eta_tm", _eq.eta_tm(omega, T_em, Pi_t, c_t))
        extra_power = added("shaft_power", t.changed("shaft_power", 0.0, known, points))
        P_t = _eq.turbine_power(eta_tm, W_t, T_em, Pi_t, c_t) + extra_power

        Psi = _eq.egr_flow_factor(_eq.egr_pressure_ratio(p_im, p_em, c), c)
        u_egr = added("u_egr", t.changed("u_egr", points["u_egr_pct"], known, points))
        f_egr = t.changed("egr_opening", added("egr_opening", signal("f_egr", _eq.f_egr(u_egr, c))), known, points)
        W_egr_model = signal("W_egr", _eq.egr_flow(_eq.egr_area(f_egr, c), p_em, Psi, T_em, c))

        pairs: dict[str, tuple[Any, Any]] = {
            "cylinder_flow": (W_ei, W_ei_model),
            "turbine_flow": (W_t, W_t_model),
            "turbo_power": (P_c, P_t),
            "compressor_flow": (W_c, W_c_model),
            "egr_flow": (W_egr, W_egr_model),
            "exhaust_temperature": (T_em, T_em_model),
        }
        implied = {"p_es": p_es, "p_bc": p_bc, "T_im": T_im_model, "T_c": T_c}
        volume = W_c * c.R_a * T_0 / (p_bc * c.wheel_volume * omega)  # flow coefficient (A.45)
        if WORK_ROW in self.active:
            psi = _eq.energy_transfer_coefficient(T_0, Pi_c, omega, c_c)
            pairs[WORK_ROW] = (eta_c, 0.5 * psi / t.work_coefficient(volume, Pi_c))
        for name in self.extra:
            pairs[EXTRA_ROWS[name]] = (read[name], implied[EXTRA_ROWS[name]])
        shape = np.broadcast_shapes((lanes, points.size), x.shape[:-1])
        sizes = middle_sizes(points)
        residual = np.stack([spread(log_ratio(*pairs[k], sizes.get(k)), shape) for k in self.rows], axis=-1)
        # The compressor's map is judged in its implicit form (A.46): solved for the flow, a flat speed line would
        # turn 1 % of pressure into 30 % of flow.
        psi = _eq.energy_transfer_coefficient(T_0, Pi_c, omega, c_c) - c.c_psi2
        flow = volume / lost - c.c_phi2
        of_flow = _eq.ellipse_coefficient_phi(omega, c) * flow * flow
        ellipse = np.maximum(_eq.ellipse_coefficient_psi(omega, c) * psi * psi + of_flow, ELLIPSE_MIN)
        share = of_flow / ellipse + SHARE_OF_HEAD  # else a map of the head alone, blind to the flow, would fit best
        residual[..., ROWS.index("compressor_flow")] = 0.5 * np.log(ellipse) / share
        quantities = {
            **implied, "eta_c": eta_c, "eta_tm": eta_tm, "eta_vol": eta_vol, "Pi_c": Pi_c, "Pi_t": Pi_t, "P_c": P_c,
            "T_es": T_es, "W_f": W_f, "W_t": W_t, "Phi_c": phi, "omega_t": omega, "f_egr": f_egr, "W_ei": W_ei_model,
            "W_egr": W_egr, "W_eo": W_eo, "T_em": T_em, "p_im": p_im, "p_em": p_em, "W_c": W_c, "u_egr": u_egr,
            "u_vgt": u_vgt, "BSR": _eq.blade_speed_ratio(omega, T_em, Pi_t, c_t),
            "Psi_c": _eq.energy_transfer_coefficient(T_0, Pi_c, omega, c_c),
        }  # fmt: skip
        return Relations(residual, pairs, quantities)

    @staticmethod
    def _as_read(read: Any, modelled: Any) -> Any:
        """What a reading says where there is one, else what is modelled: a charge of one temperature, while the weather
        and the cooler change it by some per cent from point to point, would be errors of the filling."""
        return modelled if read is None else np.where(np.isfinite(read), read, modelled)

    def _always(self, points: SteadyPoints) -> dict[str, float]:
        """Magnitudes of the engine's terms by slot that act in all points: of a term that these points were found to
        have from one of them on, the column says where."""
        return {slot: size for slot, size in term_values(self.before).items() if f"{SINCE}{slot}" not in points}

    def _entered(self, points: SteadyPoints, values: Mapping[str, Any], lanes: int) -> dict[str, Array]:
        """Signals by insertion point, with the smooth errors of maps; points without their columns are elsewhere and
        have none."""
        modes: dict[str, list[str]] = {}
        for name in values:
            if name.startswith(MAP_MODE) and name in points:
                modes.setdefault(name.split(":")[1], []).append(name)
        entered = dict(self.signals)
        for point, names in modes.items():
            sizes = np.stack([np.broadcast_to(values[name], (lanes,)) for name in names], axis=1)
            entered[point] = entered.get(point, 0.0) + sizes @ np.stack([points[name] for name in names])
        return entered

    def _with_laws(self, points: SteadyPoints, x: Array, values: Mapping[str, Any]) -> Relations:
        """Found laws of the engine as signals, of the quantities without them."""
        bare = self._without(LawTerm)
        variables = law_variables(points, bare.relations(points, x, values).quantities)
        entered = dict(self.signals)
        for law in law_terms(self.engine.terms):
            acts = law.factor(np.zeros(points.size), 0.0, dict(points.columns))
            acts = acts * points.columns.get(JUDGED, 1.0) if law in self.since else acts
            entered[law.point] = entered.get(law.point, 0.0) + np.nan_to_num(acts * law.signal(variables))
        return replace(bare, signals=entered).relations(points, x, values)

    def _with_corrections(self, points: SteadyPoints, x: Array, values: Mapping[str, Any]) -> Relations:
        """Learned corrections of the engine's maps as signals; none of their arguments depends on them."""
        tables = corrections_of(np.asarray(corrections_in(self.engine.terms))).tables
        bare = self._without(CorrectionTerm)
        variables = law_variables(points, bare.relations(points, x, values).quantities)
        entered = with_corrections_at(tables, variables, self.signals)
        return replace(bare, signals=entered).relations(points, x, values)

    def _without(self, kind: type[LawTerm | CorrectionTerm]) -> SteadyModel:
        """The model without the engine's terms of a kind, those since the reference still told from the others."""

        def others(terms: Sequence[OneTerm]) -> tuple[OneTerm, ...]:
            return tuple(term for term in terms if not isinstance(term, kind))

        return replace(self, engine=self.engine.replace(terms=others(self.engine.terms)), added=len(others(self.since)))

    @staticmethod
    def _exhaust_temperature(p_im: Any, p_em: Any, W_ei: Any, W_f: Any, W_eo: Any, c: Any) -> Any:
        x_r, T_1 = 0.03 + 0.0 * p_im, 330.0 + 0.0 * p_im
        ratio = _eq.exhaust_to_intake_ratio(p_em, p_im)
        for _ in range(SWEEPS):
            sweep = _eq.cylinder_sweep(ratio, W_ei, W_f, x_r, T_1, c)
            x_r, T_1 = sweep.x_r, sweep.T_1
        return _eq.exhaust_manifold_temperature(sweep.T_e, W_eo, c)


def law_variables(points: SteadyPoints, q: Mapping[str, Array]) -> dict[str, Array]:
    """Every variable that laws, ports and tolerances name, from the quantities of a relation, (B, n) or (n,)."""
    inputs = {"n_e": "n_e_rpm", "u_delta": "u_delta_mg", "p_amb": "p_amb_pa", "T_amb": "t_amb_k"}
    columns = {name: points[column] for name, column in inputs.items()}
    if "u_flap_pct" in points:
        columns["u_flap"] = points["u_flap_pct"]
    return {
        **q, **columns, "Pi_egr": q["p_im"] / q["p_em"], "Pi_e": q["p_em"] / q["p_im"], "t": np.zeros(points.size),
        "egr_share": q["W_egr"] / np.maximum(q["W_egr"] + q["W_c"], LEAST_FLOW), "T_e": q["T_em"],
    }  # fmt: skip


def term_values(terms: Sequence[OneTerm]) -> dict[str, float]:
    """Magnitudes of an engine's terms by slot, and coefficients of their laws: what `SteadyModel` takes as values."""
    found: dict[str, float] = {}
    for term in effect_terms(terms):
        found[term.slot] = found.get(term.slot, 0.0) + term.magnitude
        if isinstance(term, Term):
            names = {key: name for name, key in FLAP_COEFFICIENTS.items()}
            found |= {names[key]: value for key, value in term.shape.items() if key in names}
    return found


class _Terms:
    """Effects, faults of sensors, wear and beliefs; numbers (B, 1), neutral where one is absent.

    Args:
        columns: of the points; those that say where something acts (`JUDGED`, `SINCE`) count, everywhere without any.
        before: name -> what was there at the time of the reference already; None: all of it.
    """

    def __init__(self, values: Mapping[str, Array], active: frozenset[str], columns: Mapping[str, Array],
                 before: Mapping[str, float | None]) -> None:  # fmt: skip
        self.values, self.active, self.columns, self.before = values, active, columns, before

    def __call__(self, name: str, neutral: float = 0.0) -> Any:
        value = self.values.get(name, neutral)
        acts = self.columns.get(f"{SINCE}{name}", self.columns.get(JUDGED))
        if acts is None or name not in self.values or name not in _SINCE:
            return value
        before = self.before.get(name, 0.0)
        return value if before is None else before + acts * (value - before)

    def true(self, column: str, reading: Any) -> Any:
        """What a sensor would read without its offset and gain (reading = true (1 + g) + b)."""
        gain, offset = (self(sensor_slot(column, fault)) + self(f"{SENSOR_ERROR}{column}:{fault}")
                        for fault in ("gain", "offset"))  # fmt: skip
        return np.maximum((reading - offset) / (1.0 + gain), LEAST)

    def changed(self, name: str, quantity: Any, known: Mapping[str, Any], points: SteadyPoints) -> Any:
        """The quantity under the effects that enter it, in the order of their names."""
        for effect in (EFFECTS[n] for n in effects_at(name) if n in self.values):
            magnitude = self(effect.name)
            if effect.follows is not None:
                own = {key: self(column, effect.coefficients[key]) for column, key in FLAP_COEFFICIENTS.items()}
                magnitude = magnitude * effect.follows(points.columns, own)
            c = known["c"]
            further = [known[a] if a in known else getattr(c, a) for a in effect.arguments]
            quantity = effect.change(quantity, magnitude, *further) if effect.change is not None else quantity
        return quantity

    def charge_temperature(self, T_im: Any, known: Mapping[str, Any], points: SteadyPoints) -> Any:
        """Charge temperature [K]; by the beliefs of `imply` the coolers' approach and coolant stand for a constant."""
        T_0 = points["t_amb_k"]
        if COOLED_CHARGE in self.active:
            T_im = T_0 + self("cooler_approach")
        if COOLED_EGR not in self.active:
            return self.changed("T_im", T_im, known, points)
        return cooled_charge(T_im, T_0, known, self)

    def wall_heating(self, T_im: Any) -> Any:
        """Factor of eta_vol [-]: by belief the charge is heated by the walls."""
        return (np.maximum(T_im, T_IM_MIN) / T_CHARGE) ** self("vol_heating")

    def work_coefficient(self, volume: Any, Pi_c: Any) -> Any:
        """Euler work over tip speed squared [-]: falls with the flow at the wheel's exit (backsweep)."""
        return self("work_0") * (1.0 - self("work_slope") * volume * Pi_c ** -0.36)
