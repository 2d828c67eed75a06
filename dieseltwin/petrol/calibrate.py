"""Calibration on a fault-free recording: maps with covariance, scatter, false alarms on held-out pieces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from dieseltwin.arrays import Array, robust_std
from dieseltwin.errors import InputError
from dieseltwin.petrol.blocks import BLOCK_S, Blocks, Grid, blocks_of, make_grid
from dieseltwin.petrol.discover import judge
from dieseltwin.petrol.effects import undo_all
from dieseltwin.petrol.maps import BEND, FREEDOM, normal_equations, sum_roughness, tensor_roughness
from dieseltwin.petrol.model import (
    at_rest,
    cylinder_basis,
    drift_basis,
    opening,
    scale_of,
    throttle_basis,
    unsteadiness,
)
from dieseltwin.petrol.parameters import FILLED, FaultFreePiece, PetrolParameters, SplineMap, Spread, Volumes
from dieseltwin.petrol.recording import Signals

Bool = NDArray[np.bool_]

CYLINDER_KNOTS, THROTTLE_KNOTS = (8, 11), (10, 5)
REACH = 3.0  # standard deviation of a coefficient, where nothing else is known [-]
SUMMAND_REACH = 1.0  # the same of the second summand of the throttle's map: fixes the constant between the two
FIRST_SPREAD = Spread(base=0.02, rates=(0.1, 0.1, 0.1, 0.02))
LEARNED_CLOCKS = ("w_af_late", "throttle_late")  # against the pressures'; that of p_ic shows too little to be learned
CLOCK_ROUNDS, CLOCK_STEP_S, CLOCK_REACH_S = 3, 0.05, 0.1  # of the delays; their prior standard deviation
VOLUME_STEP, VOLUME_REACH = 0.02, 0.1  # of the volumes' logarithms; their prior standard deviation
FOLDS, FOLD_S = 5, 20.0  # cross-validation of the scatter
ROUNDS = 3  # of maps and scatter in turn
PASSES = 2  # of clocks, volumes and then those
REWEIGHTINGS = 8
PIECE_S = 300.0  # of the pieces that are judged with maps that did not see them
LEAST_DURATION_S = 600.0
LEAST_RANGE = 1e-3  # of a map's argument over its size [-]: knots are kept to six digits
LEAST_BOOST_SCALE, LEAST_SCALE = 1e-3, 4e-3  # of the boost balance: resolution, a compressor that runs down; others [-]


@dataclass(frozen=True)
class SubmodelFit:
    """How well one balance is met on held-out stretches: robust standard deviation over steady and all blocks [-]."""

    name: str
    steady: float
    all_blocks: float
    blocks: int


def _coefficients(B: Array, y: Array, scale: Array, tempering: float, prior: Array) -> tuple[Array, Array]:
    """Coefficients of a map (to six digits, as its file has them) and the precision (normal equations) they came of."""
    B = np.ascontiguousarray(B)
    residual = y - np.median(y[np.isfinite(scale)])
    inverse = 1.0 / scale**2
    for _ in range(REWEIGHTINGS):
        w = (FREEDOM + 1.0) / (FREEDOM + residual**2 * inverse) * inverse / tempering
        A, b = normal_equations(B, w, y, prior)
        theta = np.linalg.solve(A, b)
        residual = y - B @ theta
    return np.array(_six(theta)), A


def _spline_map(
    B: Array, y: Array, scale: Array, tempering: float, prior: Array, knots: tuple[Array, Array]
) -> SplineMap:
    theta, A = _coefficients(B, y, scale, tempering, prior)
    factor = np.linalg.cholesky(np.linalg.inv(A))
    rows = tuple(tuple(float(f"{v:.5g}") for v in row[: i + 1]) for i, row in enumerate(factor))
    x, y_knots = (_six(values) for values in knots)
    return SplineMap(knots_x=x, knots_y=y_knots, coefficients=tuple(theta.tolist()), covariance_factor=rows)


def _six(values: Array) -> tuple[float, ...]:
    return tuple(float(f"{v:.6g}") for v in values)


def _knots(column: str, x: Array, count: int, margin: float) -> Array:
    """`count` knots over the range of a map's argument (n,), and `margin` of it beyond either end."""
    low, high = float(x.min()), float(x.max())
    if not high - low > LEAST_RANGE * max(abs(low), abs(high)):
        raise InputError(f"calibration: column {column}", "the same reading all the time",
                         "one that follows the driving",
                         "record driving in which speed, load and throttle change, or mend this channel")
    return np.linspace(low - margin * (high - low), high + margin * (high - low), count)


@dataclass(frozen=True)
class _Balance:
    y: Array
    basis: Array
    prior: Array
    knots: tuple[Array, Array]


def _tables(b: Blocks, kept: Bool, like: Mapping[str, _Balance] | None = None) -> dict[str, _Balance]:
    """What each flow balance is fitted from; with the knots of other tables, if given."""
    speed, pressure = b.omega_e[kept], np.log(b.p_im[kept])
    if like is None:
        cyl_knots = (_knots("omega_e_rad_s", speed, CYLINDER_KNOTS[0], 0.05),
                     _knots("p_im_pa", pressure, CYLINDER_KNOTS[1], 0.05))  # fmt: skip
        th_knots = (_knots("alpha_th_pct", opening(b.alpha[kept]), THROTTLE_KNOTS[0], 0.02),
                    np.linspace(0.0, 0.69, THROTTLE_KNOTS[1]))  # fmt: skip
    else:
        cyl_knots, th_knots = like["cylinder"].knots, like["throttle"].knots
    shell = SplineMap(knots_x=(), knots_y=(), coefficients=(), covariance_factor=())
    cyl = cylinder_basis(b, shell.model_copy(update={"knots_x": tuple(cyl_knots[0]), "knots_y": tuple(cyl_knots[1])}))
    th = throttle_basis(b, shell.model_copy(update={"knots_x": tuple(th_knots[0]), "knots_y": tuple(th_knots[1])}))
    sizes = [len(k) + 2 for k in (*cyl_knots, *th_knots)]
    cyl_prior = tensor_roughness(sizes[0], sizes[1]) / BEND**2 + np.eye(cyl.shape[1]) / REACH**2
    reach = np.concatenate([np.full(sizes[2], 10.0 * REACH), np.full(sizes[3], SUMMAND_REACH)])
    th_prior = sum_roughness(sizes[2], sizes[3]) / BEND**2 + np.diag(1.0 / reach**2)
    tables = {
        "cylinder": _Balance(b.cylinder(b.W_af), cyl, cyl_prior, cyl_knots),
        "throttle": _Balance(b.throttle(b.W_af), th, th_prior, th_knots),
    }
    for name, table in tables.items():
        if lost := int(np.sum(~np.isfinite(table.y[kept]))):
            raise InputError("calibration", f"{lost} s without a {name}'s balance", "a running engine in every second",
                             "leave out rows in which the engine stands")  # fmt: skip
    return tables


def _held_out(t: _Balance, scale: Array, kept: Bool, fold: NDArray[np.int64]) -> Array:
    residual = np.full(len(t.y), np.nan)
    for k in range(FOLDS):
        train, test = kept & (fold != k), kept & (fold == k)
        theta, _ = _coefficients(t.basis[train], t.y[train], scale[train], 1.0, t.prior)
        residual[test] = t.y[test] - t.basis[test] @ theta
    return residual


def _spread(residual: Array, unsteady: Array, kept: Bool) -> Spread:
    squares, u2 = residual[kept] ** 2, unsteady[kept] ** 2

    def loss(log_values: Array) -> float:
        values = np.exp(log_values)
        s2 = LEAST_SCALE**2 + values[0] ** 2 + u2 @ values[1:] ** 2
        return float(np.sum(0.5 * np.log(s2) + 0.5 * (FREEDOM + 1.0) * np.log1p(squares / (FREEDOM * s2))))

    start = np.log(np.array([0.01, *[0.05] * u2.shape[1]]))
    found = minimize(loss, start, method="Nelder-Mead", options={"maxiter": 600, "xatol": 1e-2, "fatol": 1e-2})
    values = np.exp(found.x)
    base = Spread(base=float(np.hypot(LEAST_SCALE, values[0])), rates=tuple(float(v) for v in values[1:]))
    z = residual / scale_of(base, unsteady)
    return base.model_copy(update={"tempering": _tempering(z, kept)})


def _tempering(z: Array, kept: Bool) -> float:
    clipped = np.clip(z, -3.0, 3.0)
    pairs = kept[1:] & kept[:-1] & np.isfinite(z[1:]) & np.isfinite(z[:-1])
    if pairs.sum() < 20:
        return 1.0
    rho = float(np.corrcoef(clipped[1:][pairs], clipped[:-1][pairs])[0, 1])
    rho = min(max(rho, 0.0), 0.9)
    return (1.0 + rho) / (1.0 - rho)


def fit_maps(signals: Signals, base: PetrolParameters, without: tuple[float, float] | None = None
             ) -> tuple[PetrolParameters, list[SubmodelFit]]:
    """Maps and scatter from a fault-free recording; blocks in the span `without` [s] are not used."""
    grid = make_grid(signals.time_s)
    kept = grid.kept.copy()
    if without is not None:
        kept &= (grid.mid_s < without[0]) | (grid.mid_s >= without[1])
    fold = (grid.mid_s // FOLD_S).astype(np.int64) % FOLDS
    spreads: dict[str, Spread] = {}
    for _ in range(PASSES):  # the first one doesn't know yet how little the balances scatter
        clocks, volumes = learned_clocks_and_volumes(signals, grid, base.volumes, kept, spreads)
        undone = undo_all(clocks, signals)
        b = blocks_of(undone, grid, volumes.geometry)
        unsteady = unsteadiness(undone, grid, b)
        tables = _tables(b, kept)
        left = {}
        for name, table in tables.items():
            spread = spreads.get(name, FIRST_SPREAD)
            for _ in range(ROUNDS):
                left[name] = _held_out(table, scale_of(spread, unsteady), kept, fold)
                spread = _spread(left[name], unsteady, kept)
            spreads[name] = spread
    maps, fits = {}, []
    for name, table in tables.items():
        spread, residual = spreads[name], left[name]
        scale = scale_of(spread, unsteady)
        maps[name] = _spline_map(
            table.basis[kept], table.y[kept], scale[kept], spread.tempering, table.prior, table.knots
        )
        steady = kept & (scale < 1.5 * spread.base)
        fits.append(SubmodelFit(name, _robust_std(residual[steady]), _robust_std(residual[kept]), int(kept.sum())))
    rest = at_rest(b, grid) & kept
    if rest.sum() < 20:
        raise InputError("calibration", f"{int(rest.sum())} s at idle with the throttle shut", "at least 20 s",
                         "record idling too: there the boost sensor is compared with the surroundings")
    level = float(np.median(b.boost[rest]))
    z = np.where(rest, b.boost - level, np.nan)
    scale_ic = max(_robust_std(z[rest]), LEAST_BOOST_SCALE)
    fits.append(SubmodelFit("boost", scale_ic, scale_ic, int(rest.sum())))
    boost = Spread(base=scale_ic, tempering=_tempering(z / scale_ic, rest))
    cooler_scale = max(base.cooler_spread.base, _beyond_drift(b.cooler, grid, kept))
    return base.model_copy(update={
        "clocks": clocks, "volumes": volumes, "cylinder": maps["cylinder"], "throttle": maps["throttle"],
        "boost_level": level, "cylinder_spread": spreads["cylinder"], "throttle_spread": spreads["throttle"],
        "boost_spread": boost, "cooler_spread": base.cooler_spread.model_copy(update={"base": cooler_scale}),
    }), fits


def _beyond_drift(y: Array, grid: Grid, kept: Bool) -> float:
    """Standard deviation of a balance (m,) about its slow drift, each piece between gaps by itself."""
    left = []
    for piece in np.unique(grid.piece):
        own = kept & (grid.piece == piece)
        if own.sum() > 1:
            hats = drift_basis(grid.mid_s[own])
            left.append(y[own] - hats @ np.linalg.lstsq(hats, y[own], rcond=None)[0])
    return float(np.std(np.concatenate(left)))


def learned_clocks_and_volumes(
    signals: Signals, grid: Grid, volumes: Volumes, kept: Bool, spreads: Mapping[str, Spread]
) -> tuple[dict[str, float], Volumes]:
    """Delays of air flow and throttle against the pressures [s], and the volumes that fill: both flow balances scatter
    least, maps fitted along.

    A logger reads its channels in turn and a hot film answers late; a row of 50 ms is 5 % of the air flow in a tip-in.
    What fills is never quite the volume of a drawing, and noise of the pressures at the ends of a second makes it look
    some per cent less: a gain of the air flow, as every later recording would show it again.

    Args:
        volumes: as given; kept: (m,) blocks to use; spreads: of the balances, as far as they are known.
    """
    steps = np.array([CLOCK_STEP_S] * len(LEARNED_CLOCKS) + [VOLUME_STEP] * len(FILLED))
    belief = np.array([CLOCK_REACH_S] * len(LEARNED_CLOCKS) + [VOLUME_REACH] * len(FILLED)) ** -2
    found = np.zeros(len(steps))

    def at(values: Array) -> tuple[dict[str, float], Volumes]:
        delays, logs = np.split(values, [len(LEARNED_CLOCKS)])
        factors = zip(FILLED, np.exp(logs).tolist(), strict=True)
        filling = {name: getattr(volumes, name) * factor for name, factor in factors}
        return dict(zip(LEARNED_CLOCKS, delays.tolist(), strict=True)), volumes.model_copy(update=filling)

    def blocks(values: Array) -> Blocks:
        clocks, filled = at(values)
        return blocks_of(undo_all(clocks, signals), grid, filled.geometry)

    for _ in range(CLOCK_ROUNDS):
        here, *moved = (blocks(found + step) for step in (np.zeros(len(steps)), *np.diag(steps)))
        unsteady = unsteadiness(signals, grid, here)
        information, push = np.diag(belief), found * belief
        tables = _tables(here, kept)
        others = [_tables(b, kept, tables) for b in moved]
        for name, table in tables.items():
            spread = spreads.get(name, FIRST_SPREAD)
            scale = scale_of(spread, unsteady)[kept]
            B = np.ascontiguousarray(table.basis[kept])
            theta, _ = _coefficients(B, table.y[kept], scale, spread.tempering, table.prior)
            left = (table.y - table.basis @ theta)[kept]
            weight = (FREEDOM + 1.0) / (FREEDOM * scale**2 + left**2) / spread.tempering
            change = np.stack([(o[name].y - o[name].basis @ theta)[kept] - left for o in others], 1) / steps
            A, _ = normal_equations(B, weight, left, table.prior)
            weighted = weight[:, None] * change
            free = change - B @ np.linalg.solve(A, B.T @ weighted)
            information += weighted.T @ free
            push += free.T @ (weight * left)
        found = found - np.linalg.solve(information, push)
    std = np.sqrt(np.diag(np.linalg.inv(information)))[len(LEARNED_CLOCKS) :]
    clocks, filled = at(np.array([float(f"{value:.4g}") for value in found]))
    return clocks, filled.model_copy(update={"spread": (float(f"{std[0]:.3g}"), float(f"{std[1]:.3g}"))})


def _robust_std(x: Array) -> float:
    return float(robust_std(x)) if len(x) else float("nan")


def pieces(grid: Grid) -> list[tuple[float, float]]:
    """Spans that hold `PIECE_S` of blocks each, whatever pauses lie between them [s]; a rest shorter than half a piece
    goes to the last one."""
    begins = grid.mid_s - 0.5 * BLOCK_S
    a_piece = round(PIECE_S / BLOCK_S)
    count = max(round(len(begins) / a_piece), 1)
    edges = [*begins[: count * a_piece : a_piece].tolist(), float(begins[-1]) + 2.0 * BLOCK_S]
    return list(pairwise(edges))


def calibrate(
    signals: Signals, base: PetrolParameters, sha256: str
) -> tuple[PetrolParameters, list[SubmodelFit], int]:
    """Calibrate, then judge pieces of the recording with maps that did not see them: an alarm there is a false one.

    A piece that can't be judged, as nothing else idles or goes as far, is counted alone.

    Returns:
        the engine, with those pieces; the fit of each balance on held-out stretches; how many pieces can't be judged.

    Raises:
        InputError: a recording of less than ten minutes, or without idling.
    """
    grid = make_grid(signals.time_s)
    driven_s, end_s = len(grid.mid_s) * BLOCK_S, float(signals.time_s[-1])
    if driven_s < LEAST_DURATION_S:
        raise InputError("calibration", f"{driven_s:.0f} s", f"at least {LEAST_DURATION_S:.0f} s", "record longer")
    engine, fits = fit_maps(signals, base)
    judged, unjudged = [], 0
    for span in pieces(grid):
        try:
            rest, _ = fit_maps(signals, base, without=span)
            _, found = judge(rest, signals.part(*span))
        except InputError:
            unjudged += 1
            continue
        best = max([(found.gain(fit), fit.candidate.names[0]) for fit in found.singles[:1]]
                   + [(v.gain, v.name) for v in found.scanned[:1]], default=(0.0, "none"))
        judged.append(FaultFreePiece(start_s=span[0], end_s=min(span[1], end_s), gain=max(best[0], 0.0),
                                     name=best[1], alarm=found.kind != "healthy"))
    return engine.model_copy(update={"pieces": tuple(judged), "calibrated_on": sha256}), fits, unjudged
