"""Calibrate an engine of the same kind from settled points: submodel by submodel, then jointly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dieseltwin.arrays import Array
from dieseltwin.calibration.beside_checks import terms_of_then
from dieseltwin.calibration.checks import Actuator, actuators, check_points, egr_shut, filling_notes
from dieseltwin.calibration.coefficients import (
    BELIEFS,
    Coefficient,
    engine_coefficients,
    wear_coefficients,
    with_scalars,
)
from dieseltwin.calibration.lasting_errors import sensor_errors, with_lasting_errors
from dieseltwin.calibration.likelihood import Estimate, estimate
from dieseltwin.calibration.matched_values import SLOPE_OF_RATIO, known_turbine, matched_values
from dieseltwin.calibration.outlying import without_slips
from dieseltwin.calibration.steady_model import EXTRA_ROWS, MAP_MODE, ROWS, SENSOR_ERROR, SteadyModel, term_values
from dieseltwin.engine.parameters import EngineParameters, validated
from dieseltwin.errors import InputError
from dieseltwin.notes import Note, of_reading
from dieseltwin.recordings.steady_points import JUDGED, SteadyPoints
from dieseltwin.settings.search import PointSettings
from dieseltwin.settings.strict import read_mapping, unknown_name

GEOMETRY = ("bore_mm", "stroke_mm", "displacement_l")
STARTS = 3  # of every submodel, besides the base engine's values
START_SPREAD = 0.7  # prior standard deviations
BETTER = 1.0  # in log-likelihood: by less another start is no better than the base engine's values
HELD_OUT = 3  # every third point of a drawn order is held out
STANDS_STILL = 1e-6  # of its mean: a quantity that moves less has no variance to explain
WALL_HEATING = "vol_heating"
LEAST_EXPLAINED = 0.5  # of a submodel's variance: of T_em 0.4 with fuel in kg/h under mg, 0.97 and more else
RANGE_MARGIN = 0.02  # input ranges are widened beyond the data by this share


@dataclass(frozen=True)
class Fit:
    """How one submodel meets measured values, in % (100 times the root mean square of ln measured/predicted).

    Attributes:
        train, held_out: at points used for the fit, at the held-out third [%].
        median_held_out: median of the absolute error there [%].
        coefficient_of_determination: 1 - variance of the error/variance of the measured quantity, held-out [-].
        tolerance: relative standard deviation of the map itself, beyond sensor noise [-].
    """

    train: float
    held_out: float
    median_held_out: float
    coefficient_of_determination: float
    tolerance: float


@dataclass(frozen=True)
class Identified:
    """One coefficient: value, interval, and whether the points or the belief decided.

    `verdict` is "identified" (the points cut the prior's spread to less than half), "partly" or "prior only".
    """

    name: str
    submodel: str
    value: float
    std: float
    prior_mean: float
    prior_std: float
    unit: str
    verdict: str
    at_bound: bool


@dataclass(frozen=True)
class Calibration:
    """A calibrated engine and how it was come by.

    Attributes:
        engine: the calibrated parameters, input ranges widened to the data.
        base: what it started from.
        points: those used, actuators turned round where needed.
        held_out: (n,) mask of the held-out third.
        fits: submodel -> fit of the engine calibrated on the other two thirds.
        coefficients: of the fit to all points.
        covariance: (P, P) of the coefficients.
        actuators: EGR valve and VGT.
        notes: what could not be told and what was assumed, one sentence each; a `Note` where it is a doubt.
        estimate: of all points.
        model: the relations.
        start: fixed values.
        trained: coefficients of the fit to two thirds.
    """

    engine: EngineParameters
    base: EngineParameters
    points: SteadyPoints
    held_out: NDArray[np.bool_]
    fits: Mapping[str, Fit]
    coefficients: tuple[Identified, ...]
    covariance: Array
    actuators: tuple[Actuator, Actuator]
    notes: tuple[str, ...]
    estimate: Estimate
    model: SteadyModel
    start: Mapping[str, float]
    trained: Mapping[str, float]

    @property
    def geometry(self) -> EngineParameters:
        """The engine that was started from, with the points' ambient and ranges: what the balances fall back on."""
        return self.model.engine

    def tolerances(self) -> dict[str, float]:
        """Relative tolerance of each submodel's map [-]."""
        return {name: fit.tolerance for name, fit in self.fits.items()}


def read_geometry(
    source: EngineParameters | Mapping[str, Any] | str | Path, base: EngineParameters
) -> EngineParameters:
    """The base engine with the geometry of a YAML file or mapping: bore_mm, stroke_mm or displacement_l, and any engine
    parameter; parameters as they are.

    Raises:
        InputError: none of these, unknown name, bore without stroke, the displacement twice, or a value out of range.
    """
    if isinstance(source, EngineParameters):
        return source
    if not isinstance(source, str | Path | Mapping):
        raise InputError("geometry", f"a {type(source).__name__}", "a YAML file, a mapping or parameters",
                         'give one of these: {"displacement_l": 12.9, "n_cyl": 6}')  # fmt: skip
    content, path = (source, "geometry") if isinstance(source, Mapping) else (read_mapping(source), str(source))
    known = [*GEOMETRY, *EngineParameters.model_fields]
    for name in content:
        if name not in known:
            raise unknown_name(path, str(name), known)
    changes = {name: value for name, value in content.items() if name not in GEOMETRY}
    numbers: dict[str, float] = {}
    for name in GEOMETRY:
        if name in content:
            try:
                numbers[name] = float(content[name])
            except (TypeError, ValueError):
                raise InputError(f"{path}: {name}", repr(content[name]), "a number", "change this value") from None
            if not numbers[name] > 0:
                raise InputError(f"{path}: {name}", numbers[name], "a number above 0", "change this value")
    if ("bore_mm" in numbers) != ("stroke_mm" in numbers):
        raise InputError(path, "bore or stroke alone", "both, or displacement_l", "add the other one")
    sizes = {"bore_mm and stroke_mm": "bore_mm" in numbers, "displacement_l": "displacement_l" in numbers,
             "V_d": "V_d" in changes}  # fmt: skip
    if sum(sizes.values()) > 1:
        given = " beside ".join(name for name, there in sizes.items() if there)
        raise InputError(path, given, "the displacement once", "leave all but one of them out")
    engine = validated({**base.model_dump(), **changes}, source=path)
    if "bore_mm" in numbers:
        cylinder_m3 = np.pi / 4.0 * (numbers["bore_mm"] / 1e3) ** 2 * (numbers["stroke_mm"] / 1e3)
        return validated({**engine.model_dump(), "V_d": cylinder_m3 * engine.n_cyl}, f"{path}: bore_mm, stroke_mm")
    if "displacement_l" in numbers:
        return validated({**engine.model_dump(), "V_d": numbers["displacement_l"] / 1e3}, f"{path}: displacement_l")
    return engine


def split(points: SteadyPoints, seed: int = 0) -> NDArray[np.bool_]:
    """Mask of the held-out third: every third point of an order drawn by `seed`."""
    order = np.random.default_rng(seed).permutation(points.size)
    mask = np.zeros(points.size, dtype=bool)
    mask[order[::HELD_OUT]] = True
    return mask


def calibrate(
    points: SteadyPoints,
    base: EngineParameters,
    geometry: EngineParameters | None = None,
    *,
    noise: Mapping[str, float] | None = None,
    seed: int = 0,
    where: str = "points",
    believed: PointSettings | None = None,
) -> Calibration:
    """Calibrate the submodels of an engine to settled points.

    Args:
        points: n settled points with all of `STATES`.
        base: engine whose maps are the first belief.
        geometry: `base` with the new engine's displacement and the like; `base` itself by default.
        noise: relative standard deviation of each reading [-].
        seed: of the held-out third and the starts.
        where: name for messages.
        believed: of maps and sensors. Errors of sensors are estimated beside the coefficients, those of maps where a
            reference among the points is there to tell them; None: neither.

    Raises:
        InputError: too few points or swapped columns.
    """
    geometry = geometry or base
    points = check_points(points, where, geometry.n_cyl)
    valves = actuators(points, geometry.n_cyl)
    read = [of_reading(note) for note in points.notes]
    points, turned = _turned(points, valves)
    notes = [*read, *turned, *filling_notes(points.judged, geometry), *terms_of_then(points, geometry)]
    notes += [valve.sentence() for valve in valves]
    if all((points[c] == v).all() for c, v in (("p_amb_pa", geometry.p_amb), ("t_amb_k", geometry.T_amb))):
        notes.append(f"the ambient of every point is the engine's own, {geometry.p_amb / 1e3:.4g} kPa and "
                     f"{geometry.T_amb:.4g} K; give p_amb_pa and t_amb_k, or p_amb and T_amb in the geometry file, "
                     "where it was another")  # fmt: skip
    engine = _with_ambient_and_ranges(geometry, points)
    extra = tuple(name for name in EXTRA_ROWS if name in points and np.isfinite(points[name]).mean() > 0.5)
    if "t_im_k" in extra:
        points = points.with_usual_charge()
    model = SteadyModel(engine, extra=extra)
    free, fixed = _free(points, base, engine, valves, notes)
    if "t_im_k" in extra:  # walls heat a cold charge more, and more of it stays out: a filling of another day
        free += [belief for belief in BELIEFS if belief.name == WALL_HEATING]
    if JUDGED not in points and believed is not None:
        free += sensor_errors(points, believed)
    start = {**fixed, **{c.name: c.mean for c in free}, **term_values(engine.terms)}
    mask = split(points, seed)
    trained, _ = _fit(model, points.take(~mask), free, start, noise, seed)
    kept, slips = without_slips(model, points, {**start, **trained.values()})
    notes += slips
    if kept.size < points.size:
        points, mask = kept, split(kept, seed)
        trained, _ = _fit(model, points.take(~mask), free, {**start, **trained.values()}, noise, seed, staged=False)
    if JUDGED in points and believed is not None:
        points, errors = with_lasting_errors(points, model, {**start, **trained.values()}, believed)
        free = [*free, *errors]
        start |= dict.fromkeys((c.name for c in errors), 0.0)
        trained, _ = _fit(model, points.take(~mask), free, {**start, **trained.values()}, noise, seed, staged=False)
    whole, final = _fit(model, points, free, {**start, **trained.values()}, noise, seed, staged=False)
    if not whole.converged:
        notes.append(Note("the joint fit was still moving when it ended: coefficients that trade against each other",
                          "not_converged"))
    notes.append("c_pa, c_pe, the dead times, lags and volumes can't be told from settled points: the base's are kept")
    notes.append("eta_c and eta_tm enter the balances as a product: without t_c_k their scale is the prior's")
    if "t_im_k" not in points:
        notes.append("volumetric efficiency and T_im enter as a quotient: T_im is the geometry file's or the base's")
    fits = submodel_fits(model, points, mask, {**start, **trained.values()}, whole.discrepancy)
    notes += [Note(f"{name}: {100 * max(fit.coefficient_of_determination, 0.0):.0f} % of how the held-out points vary "
                   "is explained, where 95 and more are usual: is a column in another unit (fuel in kg/h under "
                   "u_delta_mg), or another quantity?", "misfit")
              for name, fit in fits.items()
              if name in ROWS and fit.coefficient_of_determination < LEAST_EXPLAINED]  # fmt: skip
    calibrated = with_scalars(engine, final)
    return Calibration(calibrated, base, points, mask, fits, _identified(whole), whole.covariance, valves,
                       tuple(notes), whole, model, final, {**start, **trained.values()})


def _turned(points: SteadyPoints, valves: Sequence[Actuator]) -> tuple[SteadyPoints, list[str]]:
    notes = []
    for valve in valves:
        if valve.opens < 0:
            points = points.with_columns(**{valve.column: 100.0 - points[valve.column]})
            notes.append(f"{valve.column} is turned round (100 % - position); use the channel map written beside")
    return points, notes


def _with_ambient_and_ranges(engine: EngineParameters, points: SteadyPoints) -> EngineParameters:
    changes: dict[str, Any] = {
        "p_amb": float(np.median(points["p_amb_pa"])), "T_amb": float(np.median(points["t_amb_k"])),
    }  # fmt: skip
    if "t_im_k" in points and np.isfinite(points["t_im_k"]).any():  # the maps are fitted at the charge that was read
        changes["T_im"] = float(np.nanmedian(points["t_im_k"]))
    for name, column in (("n_e_range", "n_e_rpm"), ("u_delta_range", "u_delta_mg"), ("u_egr_range", "u_egr_pct"),
                         ("u_vgt_range", "u_vgt_pct")):  # fmt: skip
        low, high = getattr(engine, name)
        margin = RANGE_MARGIN * (points[column].max() - points[column].min())
        low = min(low, float(points[column].min() - margin))
        high = max(high, float(points[column].max() + margin))
        if column.endswith("_pct"):
            low, high = max(low, 0.0), min(high, 100.0)
        changes[name] = (max(low, 0.0), high)
    return engine.replace(**changes)


def _free(points: SteadyPoints, base: EngineParameters, engine: EngineParameters, valves: Sequence[Actuator],
          notes: list[str]) -> tuple[list[Coefficient], dict[str, float]]:  # fmt: skip
    """Coefficients that these points can say something about, and the values of the others."""
    free = list(engine_coefficients(base, engine))
    dropped: set[str] = set()
    if egr_shut(points):
        dropped |= {c.name for c in free if c.submodel == "egr_flow"}
        notes.append(Note("not identifiable: the EGR valve is shut in every point, so A_egrmax, Pi_egropt and c_egr are"
                          " the base engine's; measure points with EGR", "not_identifiable", ("u_egr_pct",)))
    elif not valves[0].moves:
        dropped |= {"c_egr1", "c_egr3"}
        notes.append(Note("not identifiable: u_egr_pct doesn't move; A_egrmax is the area at that position",
                          "not_identifiable", ("u_egr_pct",)))
    if not valves[1].moves:
        dropped |= {"c_f2", "c_vgt1", "c_vgt2"}
        notes.append(Note("not identifiable: u_vgt_pct doesn't move; A_vgtmax is the area at that position, the shape "
                          "of f_vgt the base engine's; vary the VGT", "not_identifiable", ("u_vgt_pct",)))
    if JUDGED in points:
        free += [c for c in wear_coefficients() if not (c.submodel == "egr_flow" and egr_shut(points.judged))]
    fixed = {c.name: c.mean for c in free if c.name in dropped}
    if JUDGED in points and "t_c_k" not in points:
        dropped |= {*SLOPE_OF_RATIO}
        fixed |= {c.name: c.mean for c in free if c.name in SLOPE_OF_RATIO}
        fixed |= {} if known_turbine(base, engine) else matched_values(points, engine)
    return [c for c in free if c.name not in dropped], fixed


def _fit(
    model: SteadyModel, points: SteadyPoints, free: Sequence[Coefficient], start: Mapping[str, float],
    noise: Mapping[str, float] | None, seed: int, staged: bool = True,
) -> tuple[Estimate, dict[str, float]]:  # fmt: skip
    """Submodel by submodel from several starts, then all together."""
    values = dict(start)
    generator = np.random.default_rng(seed)
    discrepancy: dict[str, float] = {}
    used = counted_rows(model, free)
    if staged:
        for row in ROWS:
            own = [c for c in free if c.submodel == row and not c.name.startswith(SENSOR_ERROR)]
            if not own:
                continue
            best: Estimate | None = None
            for trial in range(STARTS + 1):
                begin = dict(values)
                if trial:
                    begin.update({c.name: float(np.clip(c.mean + START_SPREAD * c.std * generator.standard_normal(),
                                                        c.low, c.high)) for c in own})
                found = estimate(model, points, own, begin, rows=(row,), noise=noise, iterations=3)
                if best is None or found.cost < best.cost - BETTER:
                    best = found
            if best is not None:
                values.update(best.values())
                discrepancy[row] = float(best.discrepancy[model.rows.index(row)])
    joint = estimate(model, points, free, values, rows=used, noise=noise, discrepancy=discrepancy, iterations=20,
                     inflate=True)
    values.update(joint.values())
    return joint, values


def counted_rows(model: SteadyModel, free: Sequence[Coefficient]) -> tuple[str, ...]:
    """Relations that have free coefficients of their own (of what was measured besides: all); errors of sensors are
    none of these."""
    told = {c.submodel for c in free if not c.name.startswith(SENSOR_ERROR)}
    return tuple(row for row in model.rows if row not in ROWS or row in told)


def submodel_fits(
    model: SteadyModel, points: SteadyPoints, mask: NDArray[np.bool_], values: Mapping[str, float], discrepancy: Array
) -> dict[str, Fit]:
    """Fit of each relation in % at the measured states, of coefficients that never saw the masked points.

    Args:
        model, points: relations and n points.
        mask: (n,) points that the coefficients never saw.
        values: coefficients by name.
        discrepancy: (R,) each relation's own error [-].
    """
    relations = model.relations(points, points.states(), values)
    return {
        row: _fit_of(relations.residual[0, :, i], relations.measured[row][0], relations.predicted[row][0], mask,
                     float(discrepancy[i]))
        for i, row in enumerate(model.rows)
    }  # fmt: skip


def _fit_of(residual: Array, measured: Array, predicted: Array, mask: NDArray[np.bool_], tolerance: float) -> Fit:
    """The figures of one submodel; `residual` is ln measured/predicted, (n,) each."""
    good = np.isfinite(residual)

    def rms(chosen: NDArray[np.bool_]) -> float:
        chosen = chosen & good
        return float(100.0 * np.sqrt(np.mean(residual[chosen] ** 2))) if chosen.any() else float("nan")

    held = mask & good
    variance = float(np.var(measured[held])) if held.any() else 0.0
    moves = variance > (STANDS_STILL * float(np.mean(predicted[held]))) ** 2 if held.any() else False
    error = measured * np.expm1(-residual)  # not of the flow that the compressor's map is solved for: see there
    determination = 1.0 - float(np.mean(error[held] ** 2)) / variance if moves else float("nan")
    median = float(100.0 * np.median(np.abs(residual[held]))) if held.any() else float("nan")
    return Fit(rms(~mask), rms(mask), median, determination, tolerance)


def _identified(found: Estimate) -> tuple[Identified, ...]:
    std = found.std()
    rows = []
    for c, value in zip(found.coefficients, found.theta, strict=True):
        if c.name.startswith((MAP_MODE, SENSOR_ERROR)):
            continue
        share = std[c.name] / c.std
        verdict = "identified" if share < 0.5 else "partly" if share < 0.9 else "prior only"
        near = min(value - c.low, c.high - value) < 1e-3 * (c.high - c.low)
        rows.append(Identified(c.name, c.submodel, float(value), std[c.name], c.mean, c.std, c.unit, verdict,
                               bool(near)))
    return tuple(rows)
