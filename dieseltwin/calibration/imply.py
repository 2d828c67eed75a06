"""What nobody measured: every quantity of a point with its standard deviation, from whatever was measured there.

For a point the unknowns are its six states and how far the laws are off there (pressure after the turbine and before
the compressor, charge temperature, compressor efficiency). The relations, each with its own error, and the readings
update them; what the relations left at the points near by is taken off (`local_errors`); the coefficients' covariance,
carried through the same update, adds the rest. Without readings the same update solves the balances from the inputs
alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from dieseltwin.arrays import Array
from dieseltwin.calibration.likelihood import STEEPEST
from dieseltwin.calibration.local_errors import Foretold, LocalErrors
from dieseltwin.calibration.outlying import FAR_OFF
from dieseltwin.calibration.steady_model import IMPLIED, SteadyModel
from dieseltwin.notes import Note, counted, listing
from dieseltwin.recordings.noise import SETTLED_NOISE
from dieseltwin.recordings.steady_points import STATES, SteadyPoints

COLUMNS: Mapping[str, str] = {
    "p_es_pa": "p_es", "p_bc_pa": "p_bc", "t_im_k": "T_im", "t_c_k": "T_c", "t_es_k": "T_es", "eta_c": "eta_c",
    "eta_tm": "eta_tm", "eta_vol": "eta_vol", "p_c_w": "P_c", "w_t_kg_s": "W_t", "w_ei_kg_s": "W_ei",
}  # fmt: skip
"""Column of the table -> quantity."""

LOCAL = ("p_es", "p_bc", "T_im", "eta_c")
# How far the laws may be off at a point (standard deviation, stated belief): share of the rise, and an absolute part.
P_ES_SHARE, P_ES_PA = 0.12, 400.0
P_BC_SHARE, P_BC_PA = 0.25, 150.0
T_IM_K = 4.0
T_IM_NOISE = 0.005  # relative, of the charge where it was read
ETA_C_SHARE = 0.03
POINT_ERROR = 1.5  # a map's error at one point is smooth: readings there tell less than the scatter suggests
# Heat that the turbine's housing gives the compressed air, h (T_em - T_c): most at little flow (heavy-duty practice)
SOAK_W_K, SOAK_STD_W_K = 0.8, 0.6
# Heat that the exhaust loses in the turbine's housing, h (T_em - T_amb): 1 to 4 kW at full load (heavy-duty practice)
LOSS_W_K, LOSS_STD_W_K = 5.0, 4.0
T_C_STD_K = 1.0  # of the temperature before the compressor, taken as ambient
SHARE = 0.02  # of a standard deviation, for the slopes in the coefficients
ITERATIONS = 25
STEP = 5e-4
GUESS_FACTOR, GUESS_LEAST = 1.5, 0.03  # spread of a state known from the regression on the inputs alone [-]
_NO_VARIANCE = 1e-300
LARGEST = 0.15  # of ln x in one iteration
NAMED_ROWS = 5  # data rows that a note names


@dataclass(frozen=True)
class Guess:
    """Regression of the states on the inputs: a first guess where nothing was measured.

    Attributes:
        weights: (k, 6) of ln x on the features.
        centre, spread: (4,) of the inputs.
        residual: (6,) standard deviation of ln x about it.
    """

    weights: Array
    centre: Array
    spread: Array
    residual: Array

    def states(self, points: SteadyPoints) -> Array:
        """(n, 6) states."""
        return np.exp(_features(points, self.centre, self.spread) @ self.weights)


def _features(points: SteadyPoints, centre: Array, spread: Array) -> Array:
    z = (points.inputs() - centre) / spread
    pairs = [z[:, i] * z[:, j] for i in range(4) for j in range(i, 4)]
    return np.stack([np.ones(len(z)), *z.T, *pairs], axis=1)


def guess_of(points: SteadyPoints) -> Guess:
    """The regression (a quadric in the four inputs, lightly ridged) of the measured states."""
    u = points.inputs()
    centre, spread = u.mean(axis=0), np.maximum(u.std(axis=0), 1e-6)
    A = _features(points, centre, spread)
    y = np.log(np.maximum(points.states(), 1e-6))
    good = np.isfinite(y).all(axis=1)
    weights = np.linalg.solve(A[good].T @ A[good] + 1e-2 * np.eye(A.shape[1]), A[good].T @ y[good])
    return Guess(weights, centre, spread, np.std(y[good] - A[good] @ weights, axis=0))


@dataclass(frozen=True)
class Answerer:
    """A repaired engine that answers for new points, by one formulation of the places that nobody measured.

    Attributes:
        model: with all its terms.
        values: every coefficient.
        names, covariance: the free coefficients and their covariance (P, P).
        discrepancy: relation -> standard deviation of its own error [-].
        guess: of the states.
        noise: relative standard deviation of the readings [-].
        bounds: of the free coefficients.
        local: what the relations left at the points; None of a file that was written before there was such.
    """

    model: SteadyModel
    values: Mapping[str, float]
    names: tuple[str, ...]
    covariance: Array
    discrepancy: Mapping[str, float]
    guess: Guess
    noise: Mapping[str, float]
    bounds: Mapping[str, tuple[float, float]]
    local: LocalErrors | None = None

    def __call__(self, points: SteadyPoints) -> pd.DataFrame:
        """Implied quantities of n points: every column of `COLUMNS`, and the states that the points lack somewhere.

        Each has its standard deviation beside it, `<column>_std`, in its own unit.
        """
        at = self._solved(points)
        here, y, gain, posterior, engine = at.here, at.y, at.gain, at.posterior, self.model.engine
        known = np.isfinite(points.states())
        lanes, unit = self._lanes()
        r = here.residual(y, lanes)
        d_r = (r[1:] - r[:1]) / unit[..., None]  # (P, n, R) per standard deviation
        q = here.quantities(y, lanes)
        d_y = -np.einsum("nij,pnj->pni", gain, d_r)
        out: dict[str, Array] = {}
        for i in np.flatnonzero(~known.all(axis=0)):
            between = np.einsum("pn,pq,qn->n", d_y[..., i], self._correlation(), d_y[..., i])
            out[STATES[i]] = np.exp(y[:, i])
            out[f"{STATES[i]}_std"] = out[STATES[i]] * np.sqrt(between + np.maximum(posterior[:, i, i], 0.0))
        slopes = here.slopes(y, self.values)
        for column, name in COLUMNS.items():
            out[column] = q[name][0]
            d_q = (q[name][1:] - q[name][:1]) / unit + np.einsum("ni,pni->pn", slopes[name], d_y)
            between = np.einsum("pn,pq,qn->n", d_q, self._correlation(), d_q)
            within = np.einsum("ni,nij,nj->n", slopes[name], posterior, slopes[name])
            out[f"{column}_std"] = np.sqrt(between + np.maximum(within, 0.0))
        x = np.exp(y[:, :6])
        rise = (x[:, STATES.index("t_em_k")] - out["t_c_k"]) / (x[:, STATES.index("w_c_kg_s")] * engine.c_pa)
        out["t_c_k"] = out["t_c_k"] + SOAK_W_K * rise
        out["t_c_k_std"] = np.sqrt(out["t_c_k_std"] ** 2 + (SOAK_STD_W_K * rise) ** 2 + T_C_STD_K**2)
        colder = (x[:, STATES.index("t_em_k")] - points["t_amb_k"]) / (out["w_t_kg_s"] * engine.c_pe)
        out["t_es_k"] = out["t_es_k"] - LOSS_W_K * colder
        out["t_es_k_std"] = np.sqrt(out["t_es_k_std"] ** 2 + (LOSS_STD_W_K * colder) ** 2)
        return pd.DataFrame(out)

    def misfit(self, points: SteadyPoints) -> Array:
        """How far the readings of each of n points contradict the engine, (n,): the sum of squared deviations that the
        most likely state leaves of the readings, the laws and the balances [-], a chi-square of as many as balances."""
        return self._solved(points).left

    def _solved(self, points: SteadyPoints) -> _Solved:
        """The most likely unknowns of n points, from whatever was measured there."""
        model = replace(self.model, extra=())
        measured = points.states()
        known = np.isfinite(measured)
        first = self.guess.states(points)
        centre = np.log(np.where(known, measured, first))
        sigma = np.array([self.noise.get(name, SETTLED_NOISE[name]) for name in STATES])
        prior = np.where(known, sigma, np.maximum(GUESS_FACTOR * self.guess.residual, GUESS_LEAST))
        foretold = None if self.local is None else self.local.at(points)
        if foretold is None:
            S = np.broadcast_to([POINT_ERROR * self.discrepancy.get(row, 0.03) for row in model.rows],
                                (points.size, len(model.rows)))  # fmt: skip
        else:
            S = np.sqrt(foretold.variance + (POINT_ERROR * foretold.own) ** 2)
        here = _Balances(model, points, foretold)
        expected = model.relations(points, np.exp(centre), self.values).quantities
        off, deviations = np.zeros((points.size, len(LOCAL))), self._deviations(points, expected)
        if "t_im_k" in points:
            read, at = points["t_im_k"] / expected["T_im"][0] - 1.0, LOCAL.index("T_im")
            off[:, at] = np.nan_to_num(read)
            deviations[:, at] = np.where(np.isfinite(read), T_IM_NOISE, deviations[:, at])
        variance = np.concatenate([prior**2, deviations**2], axis=1)
        y0 = np.concatenate([centre, off], axis=1)
        y, gain, posterior = here.solve(self.values, y0, variance, S)
        r = here.residual(y, self.values)
        left = np.sum((y - y0) ** 2 / variance, axis=1) + np.sum((r[0] / S) ** 2, axis=1)
        return _Solved(here, y, gain, posterior, left)

    def _correlation(self) -> Array:
        spread = np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))
        return self.covariance / np.outer(spread, spread)

    def _lanes(self) -> tuple[dict[str, Array], Array]:
        """The estimate itself, then each free coefficient moved by a small share of its standard deviation."""
        size = len(self.names)
        lanes: dict[str, Array] = {name: np.full(size + 1, value) for name, value in self.values.items()}
        spread = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        for i, name in enumerate(self.names):
            inward = -1.0 if self.values[name] + SHARE * spread[i] > self.bounds[name][1] else 1.0
            lanes[name][i + 1] += inward * SHARE * spread[i]
        signs = np.array([np.sign(lanes[n][i + 1] - self.values[n]) or 1.0 for i, n in enumerate(self.names)])
        return lanes, SHARE * signs[:, None]

    def _deviations(self, points: SteadyPoints, q: Mapping[str, Array]) -> Array:
        """(n, 4) how far the laws of `LOCAL` may be off where they say what `q` holds [-]."""
        p_0 = points["p_amb_pa"]
        p_es, p_bc, T_im = q["p_es"][0], q["p_bc"][0], q["T_im"][0]
        parts = [
            (P_ES_SHARE * np.abs(p_es - p_0) + P_ES_PA) / p_es, (P_BC_SHARE * np.abs(p_0 - p_bc) + P_BC_PA) / p_bc,
            T_IM_K / T_im, np.full(points.size, ETA_C_SHARE),
        ]  # fmt: skip
        return np.stack(parts, axis=1)


@dataclass(frozen=True)
class Answers:
    """All formulations together: their mean, and intervals that hold what they disagree about.

    Attributes:
        formulations: name -> answerer, all alike probable.
    """

    formulations: Mapping[str, Answerer]

    @property
    def first(self) -> Answerer:
        """The formulation with everything that is believed."""
        return next(iter(self.formulations.values()))

    def __call__(self, points: SteadyPoints) -> pd.DataFrame:
        """As `Answerer.__call__`; `<column>_std` is the root of the mean variance and of the variance of the means."""
        every = {name: answerer(points) for name, answerer in self.formulations.items()}
        frames = list(every.values())
        out = {}
        for column in frames[0]:
            values = np.stack([frame[column].to_numpy() for frame in frames])
            if column.endswith("_std"):
                between = np.stack([frame[column.removesuffix("_std")].to_numpy() for frame in frames])
                out[column] = np.sqrt(np.mean(values**2, axis=0) + np.var(between, axis=0))
            else:
                out[column] = np.mean(values, axis=0)
        return pd.DataFrame(out)

    def disagreement(self, points: SteadyPoints) -> dict[str, float]:
        """Share of each column's variance that the formulations disagree about, mean over the points [-]."""
        frames = [answerer(points) for answerer in self.formulations.values()]
        out = {}
        for column in COLUMNS:
            between = np.var(np.stack([frame[column].to_numpy() for frame in frames]), axis=0)
            within = np.mean(np.stack([frame[f"{column}_std"].to_numpy() for frame in frames]) ** 2, axis=0)
            out[column] = float(np.mean(between / np.maximum(between + within, _NO_VARIANCE)))
        return out


def contradictions(points: SteadyPoints, left: Array) -> list[Note]:
    """One line if readings contradict the engine, as a wrong unit, swapped columns or a dead sensor do.

    Args:
        points: n settled points.
        left: (n,) squared deviations, as `Answerer.misfit` gives them.
    """
    left = np.where(np.isfinite(left), left, np.inf)  # so far off that no law has a number there
    off = left > FAR_OFF**2
    if not off.any():
        return []
    worst = points.row[np.argsort(-left, kind="stable")[: min(NAMED_ROWS, int(off.sum()))]]
    rows = listing([str(row) for row in np.sort(worst)])
    which = f"{'worst in ' if off.sum() > NAMED_ROWS else ''}data row{'s' if off.sum() > 1 else ''} {rows}"
    return [Note(f"at {off.sum()} of {counted(points.size, 'point')} the readings contradict the engine by more than "
                 f"{FAR_OFF:g} deviations ({which}): what is implied there is worth nothing; check units and columns, "
                 "or leave the wrong reading out", "misfit")]  # fmt: skip


@dataclass(frozen=True)
class _Balances:
    """Balances and quantities of n points at unknowns y (..., n, 10): ln of the states, then `LOCAL`."""

    model: SteadyModel
    points: SteadyPoints
    foretold: Foretold | None

    def residual(self, y: Array, values: Mapping[str, Any]) -> Array:
        """Of the balances, less what their errors are foretold to be there, (lanes, n, R)."""
        r = self._at(y).relations(self.points, np.exp(y[..., :6]), values).residual
        if self.foretold is not None:
            r = r - self.foretold.residual(values)
        return np.clip(np.nan_to_num(r), -3.0, 3.0)

    def quantities(self, y: Array, values: Mapping[str, Any]) -> Mapping[str, Array]:
        """By name, (lanes, n) each."""
        return self._at(y).relations(self.points, np.exp(y[..., :6]), values).quantities

    def solve(self, values: Mapping[str, float], y0: Array, variance: Array, S: Array) -> tuple[Array, Array, Array]:
        """Most likely unknowns (n, 10), their gain on the residuals (n, 10, R) and their covariance (n, 10, 10).

        Args:
            y0, variance: belief of the unknowns, (n, 10) each.
            S: (n, R) standard deviation of the balances [-].
        """
        y, own = y0.copy(), S[..., None] ** 2 * np.eye(S.shape[1])
        for _ in range(ITERATIONS):
            r, J = self._linear(y, values)
            P_J = variance[..., None] * np.swapaxes(J, 1, 2)
            innovation = r - np.einsum("nij,nj->ni", J, y - y0)
            target = y0 - np.einsum("nij,nj->ni", P_J, np.linalg.solve(J @ P_J + own, innovation[..., None])[..., 0])
            step = np.clip(target - y, -LARGEST, LARGEST)
            y = y + step
            if np.max(np.abs(step)) < 1e-6:
                break
        _, J = self._linear(y, values)
        P_J = variance[..., None] * np.swapaxes(J, 1, 2)
        gain = P_J @ np.linalg.inv(J @ P_J + own)
        prior = variance[..., None] * np.eye(variance.shape[1])
        return y, gain, prior - gain @ np.swapaxes(P_J, 1, 2)

    def slopes(self, y: Array, values: Mapping[str, float]) -> dict[str, Array]:
        """Of every quantity in the unknowns, (n, 10) each."""
        size = y.shape[1]
        q = self.quantities(y + _shifts(np.eye(size), -np.eye(size)), values)
        return {name: ((q[name][:size] - q[name][size:]) / (2.0 * STEP)).T for name in {*COLUMNS.values(), *IMPLIED}}

    def _linear(self, y: Array, values: Mapping[str, float]) -> tuple[Array, Array]:
        size = y.shape[1]
        r = self.residual(y + _shifts(np.zeros((1, size)), np.eye(size), -np.eye(size)), values)
        J = np.moveaxis((r[1 : size + 1] - r[size + 1 :]) / (2.0 * STEP), 0, -1)
        return r[0], np.clip(J, -STEEPEST, STEEPEST)

    def _at(self, y: Array) -> SteadyModel:
        return replace(self.model, signals={name: y[..., 6 + i] for i, name in enumerate(LOCAL)})


@dataclass(frozen=True)
class _Solved:
    """Most likely unknowns y (n, 10), with gain and covariance as `_Balances.solve` gives them, and what they leave:
    sum of squared deviations (n,) of readings, laws and balances [-]."""

    here: _Balances
    y: Array
    gain: Array
    posterior: Array
    left: Array


def _shifts(*parts: Array) -> Array:
    return STEP * np.concatenate(parts)[:, None]
