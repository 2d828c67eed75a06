"""The calibrated twin bound to one recording: rows of the balances, and their fit under a hypothesis.

cylinder: log of (air flow - filling of both volumes) over displaced flow = log eta_vol(omega_e, p_im);
throttle: log of (air flow - filling before the throttle) over the nozzle's flow factor = log A(alpha) + c(Psi);
boost: p_ic = p_amb while the engine idles with the throttle shut and the compressor does nothing;
cooler: T_ic follows T_amb slowly.

The sensors enter with different signs: W_af in the first two, p_im in the first and, unchoked, the second, p_ic in
the last two. That is what tells their faults apart.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dieseltwin.petrol.effects import TOUCHES, undo
from dieseltwin.petrol.likelihood import BalanceFit, Prior, fit_balance
from dieseltwin.petrol.maps import sum_basis, tensor_basis
from dieseltwin.petrol.parameters import PetrolParameters, SplineMap, Spread
from dieseltwin.petrol.recording import BLOCK_S, LEAST_FLOW, Blocks, Grid, Signals, balances, make_grid

Array = NDArray[np.float64]

BALANCES = ("cylinder", "throttle", "boost", "cooler")
SHUT_PCT, IDLE_RAD_S, REST_S = 4.0, 130.0, 3  # idle: throttle below, speed below, for so many blocks before
DRIFT_S = 300.0  # between anchors of the slow drift
BOOST_DRIFT = 0.0005  # standard deviation of the boost balance's drift [-]
COOLER_DRIFT = 0.01  # of the intercooler's temperature over ambient: 3 K in five minutes [-]
ALPHA_SHIFT = 1.0  # %, added before the logarithm: the throttle's map is smooth in log(alpha + 1)
CHOKED_PSI, LEAST_PSI = 0.685, 0.02  # flow factor of a choked throttle; where 1/Psi is limited [-]
ZERO_STEP_PCT = 0.05  # for the derivative to the throttle's zero


@dataclass(frozen=True)
class Rows:
    """One balance under one hypothesis: values, basis, log Jacobian per block."""

    y: Array
    design: Array
    log_jacobian: Array


@dataclass(frozen=True)
class Bound:
    """A petrol twin bound to a recording.

    Attributes:
        parameters: the engine.
        signals: measured.
        grid: blocks.
        scales: balance -> (m,) scale; infinite where a block says nothing.
        priors: balance -> prior of the nuisances.
        thetas: balance -> expected coefficients.
    """

    parameters: PetrolParameters
    signals: Signals
    grid: Grid
    measured: Blocks
    scales: Mapping[str, Array]
    priors: Mapping[str, Prior]
    thetas: Mapping[str, Array]
    _null: dict[str, BalanceFit] = field(default_factory=dict)

    @property
    def tempering(self) -> Mapping[str, float]:
        """Balance -> divisor of its log-likelihood."""
        p = self.parameters
        return {"cylinder": p.cylinder_spread.tempering, "throttle": p.throttle_spread.tempering,
                "boost": p.boost_spread.tempering, "cooler": p.cooler_spread.tempering}

    def rows(self, blocks: Blocks) -> dict[str, Rows]:
        """The balances with their bases."""
        return {name: self._rows(name, blocks) for name in BALANCES}

    def _rows(self, name: str, b: Blocks) -> Rows:
        hats = drift_basis(b.mid_s)
        p = self.parameters
        if name == "cylinder":
            return Rows(b.y_cyl, np.hstack([cylinder_basis(b, _map(p.cylinder)), hats]), b.log_jacobian_cyl)
        if name == "throttle":
            base = throttle_basis(b, _map(p.throttle))
            zero = throttle_zero(b, _map(p.throttle))
            return Rows(b.y_th, np.hstack([base, zero[:, None], hats]), b.log_jacobian_th)
        level = np.hstack([np.ones((len(b.mid_s), 1)), hats])
        if name == "boost":
            return Rows(b.y_ic - p.boost_level, level, np.zeros(len(b.mid_s)))
        return Rows(np.log(b.T_ic / b.T_amb), level, np.zeros(len(b.mid_s)))

    def null(self) -> dict[str, BalanceFit]:
        """Fit of each balance without any effect."""
        if not self._null:
            found = self.rows(self.measured)
            self._null.update({name: self._fit(name, found[name], None) for name in BALANCES})
        return self._null

    def _fit(self, name: str, rows: Rows, start: Array | None) -> BalanceFit:
        return fit_balance(rows.y, rows.design, self.thetas[name], self.priors[name], self.scales[name],
                           self.tempering[name], start)

    def effect(self, name: str, magnitude: float, onset_s: float | None) -> tuple[float, dict[str, BalanceFit]]:
        """Log-likelihood and fits with an effect of `magnitude` from `onset_s` on (None: all along)."""
        return self.effects(((name, magnitude, onset_s),))

    def effects(self, terms: tuple[tuple[str, float, float | None], ...]) -> tuple[float, dict[str, BalanceFit]]:
        """The same with several effects at once: (name, magnitude, onset_s)."""
        corrected = self.signals
        touched: set[str] = set()
        for name, magnitude, onset_s in terms:
            corrected = undo(name, magnitude, active_rows(self.signals.time_s, onset_s), corrected)
            touched |= set(TOUCHES[name])
        fits = dict(self.null())
        if not touched:
            return sum(f.log_likelihood for f in fits.values()), fits
        blocks = balances(corrected, self.grid, self.parameters.volumes.geometry)
        jacobian = 0.0
        offset = any(name == "w_af_offset" for name, _, _ in terms)
        for name in sorted(touched):
            rows = self._rows(name, blocks)
            fits[name] = self._fit(name, rows, self.null()[name].residual)
            counted = np.isfinite(self.scales[name])
            jacobian += float(rows.log_jacobian[counted].sum()) / self.tempering[name]
            before = self._rows(name, self.measured).log_jacobian
            if offset and name in ("cylinder", "throttle"):  # d log W/d log reading is not 1, as it is for a gain
                ratio = np.maximum(self.measured.W_af, LEAST_FLOW) / np.maximum(blocks.W_af, LEAST_FLOW)
                before = before - np.log(ratio)
            jacobian -= float(before[counted].sum()) / self.tempering[name]
        return sum(f.log_likelihood for f in fits.values()) + jacobian, fits

    def signature(self, name: str, step: float) -> dict[str, Array]:
        """Change of each touched balance per unit magnitude, had the effect been there all along: balance -> (m,)."""
        corrected = undo(name, step, np.ones(len(self.signals.time_s)), self.signals)
        blocks = balances(corrected, self.grid, self.parameters.volumes.geometry)
        result = {}
        for balance in TOUCHES[name]:
            before, after = self._rows(balance, self.measured), self._rows(balance, blocks)
            # what the effect adds to y - B theta, to first order: the opposite of what undoing it does
            known = after.design @ self.thetas[balance] - before.design @ self.thetas[balance]
            result[balance] = -((after.y - before.y) - known) / step
        return result


def active_rows(time_s: Array, onset_s: float | None) -> Array:
    """(n,) 1 from the onset on, before it 0."""
    return np.ones(len(time_s)) if onset_s is None else (time_s >= onset_s).astype(np.float64)


def _map(found: SplineMap | None) -> SplineMap:
    if found is None:
        raise ValueError("the engine is not calibrated")
    return found


def cylinder_basis(b: Blocks, m: SplineMap) -> Array:
    """Basis of log eta_vol over (omega_e, log p_im)."""
    return tensor_basis(b.omega_e, np.log(b.p_im), np.array(m.knots_x), np.array(m.knots_y))


def throttle_basis(b: Blocks, m: SplineMap, shift_pct: float = 0.0) -> Array:
    """Basis of the log area over log(alpha + 1) and Psi."""
    opening = np.log(np.maximum(b.alpha + shift_pct, -0.5 * ALPHA_SHIFT) + ALPHA_SHIFT)
    return sum_basis(opening, b.psi, np.array(m.knots_x), np.array(m.knots_y))


def throttle_zero(b: Blocks, m: SplineMap) -> Array:
    """(m,) change of the log area per % of throttle position."""
    theta = np.array(m.coefficients)
    up, down = throttle_basis(b, m, ZERO_STEP_PCT), throttle_basis(b, m, -ZERO_STEP_PCT)
    return np.asarray((up - down) @ theta / (2.0 * ZERO_STEP_PCT))


def drift_basis(mid_s: Array) -> Array:
    """Hat functions over time with an anchor every DRIFT_S (m, anchors)."""
    anchors = np.arange(0.0, mid_s[-1] + DRIFT_S, DRIFT_S)
    return np.maximum(0.0, 1.0 - np.abs(mid_s[:, None] - anchors[None]) / DRIFT_S)


def unsteadiness(s: Signals, grid: Grid, b: Blocks) -> Array:
    """(m, 4) how unsteady each block is: pressure change, throttle motion, speed change, 1/Psi over choked [-]."""
    def relative(x: Array, floor: float) -> Array:
        middle = grid.mean(x)
        spread = np.sqrt(np.maximum(grid.mean(x * x) - middle * middle, 0.0))
        return np.asarray(spread / np.maximum(np.abs(middle), floor))

    pressure = np.abs(grid.slope(s.p_im, s.time_s)) * BLOCK_S / b.p_im
    nearly_open = np.maximum(CHOKED_PSI / np.maximum(b.psi, LEAST_PSI) - 1.0, 0.0)
    return np.stack([pressure, relative(s.alpha, 1.0), relative(s.omega_e, 10.0), nearly_open], 1)


def scale_of(spread: Spread, unsteady: Array) -> Array:
    """(m,) Student-t scale of a balance."""
    rates = np.array(spread.rates)
    return np.sqrt(spread.base**2 + (unsteady[:, : len(rates)] ** 2) @ rates**2)


def at_rest(b: Blocks) -> NDArray[np.bool_]:
    """(m,) the engine idles with the throttle shut, for a while: the compressor does nothing."""
    idle = (b.alpha < SHUT_PCT) & (b.omega_e < IDLE_RAD_S)
    result = idle.copy()
    for back in range(1, REST_S + 1):
        result[back:] &= idle[:-back]
        result[:back] = False
    return result


def bind(parameters: PetrolParameters, signals: Signals) -> Bound:
    """Bind the calibrated twin to a recording."""
    grid = make_grid(signals.time_s)
    blocks = balances(signals, grid, parameters.volumes.geometry)
    unsteady = unsteadiness(signals, grid, blocks)
    out = ~grid.kept
    out[-1] = True  # the last block is seldom full
    rest = at_rest(blocks)
    scales = {"cylinder": scale_of(parameters.cylinder_spread, unsteady),
              "throttle": scale_of(parameters.throttle_spread, unsteady),
              "boost": np.where(rest, parameters.boost_spread.base, np.inf),
              "cooler": np.full(len(rest), parameters.cooler_spread.base)}
    scales = {name: np.where(out, np.inf, scale) for name, scale in scales.items()}
    priors, thetas = _nuisances(parameters, drift_basis(blocks.mid_s).shape[1])
    return Bound(parameters, signals, grid, blocks, scales, priors, thetas)


def _nuisances(p: PetrolParameters, anchors: int) -> tuple[dict[str, Prior], dict[str, Array]]:
    t = p.tolerances
    cylinder, throttle = _map(p.cylinder), _map(p.throttle)
    k_c, k_t, k_x = len(cylinder.coefficients), len(throttle.coefficients), len(throttle.knots_x) + 2
    drift = t.drift**2 * np.ones(anchors)
    first = np.zeros(k_t)
    first[:k_x] = 1.0  # a level is a constant on one of the two summands
    c = _stack(cylinder.covariance + t.cylinder_level**2 + t.cylinder_field**2 * np.eye(k_c), drift)
    level = t.throttle_level**2 * np.outer(first, first)
    zero = np.concatenate([[t.throttle_zero_pct**2], drift])
    th = _stack(throttle.covariance + level + t.throttle_field**2 * np.eye(k_t), zero)
    boost = np.diag(np.concatenate([[t.boost_level**2], BOOST_DRIFT**2 * np.ones(anchors)]))
    cooler = np.diag(np.concatenate([[t.cooler_level**2], COOLER_DRIFT**2 * np.ones(anchors)]))
    thetas = {"cylinder": np.concatenate([cylinder.coefficients, np.zeros(anchors)]),
              "throttle": np.concatenate([throttle.coefficients, np.zeros(1 + anchors)]),
              "boost": np.zeros(1 + anchors), "cooler": np.zeros(1 + anchors)}
    covariances = {"cylinder": c, "throttle": th, "boost": boost, "cooler": cooler}
    return {name: Prior(covariance) for name, covariance in covariances.items()}, thetas


def _stack(first: Array, diagonal: Array) -> Array:
    size = len(first) + len(diagonal)
    both = np.zeros((size, size))
    both[: len(first), : len(first)] = first
    both[len(first):, len(first):] = np.diag(diagonal)
    return both
