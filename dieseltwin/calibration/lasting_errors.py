"""Errors of sensors as free numbers of the balances, and errors of maps where a reference is there to tell them.

Without one, errors of maps can't be told from what is missing, and stay tolerances of the search. They are sums of the
functions that an engine file holds (`engine.map_corrections`), so that the repaired machine has them too. The exhaust
temperature has such an error as well, over engine speed and injected quantity; it is no map, and no file holds it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from dieseltwin.calibration.coefficients import Coefficient
from dieseltwin.calibration.rest import nearest_rest, rest_of
from dieseltwin.calibration.steady_model import MAP_MODE, SENSOR_ERROR, SteadyModel, law_variables
from dieseltwin.engine.map_corrections import CORRECTED_POINTS, basis, basis_along, smooth_functions
from dieseltwin.recordings.steady_points import STATES, SteadyPoints
from dieseltwin.settings.search import PointSettings

EXHAUST = "T_em"
"""Insertion point of the exhaust temperature, whose formula errs smoothly over engine speed and injected quantity."""

TOLERANCE_OVER: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    EXHAUST: (("n_e", "u_delta"), ()), "f_egr": (("u_egr",), ("Pi_egr",)),
}  # fmt: skip
"""Insertion point -> variables over which its error is smooth at settled points (two ways of thinking of it), where
they are others than a map's in a recording: the exhaust's temperature is no map there, and the EGR flow's factor over
the pressure ratio is a parabola (A.9) in place of a nozzle, which a mean over points at all ratios shows."""

BESIDE_REFERENCE: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {"eta_tm": (("u_vgt",), ())}
"""The same for an error that the search takes out beside a reference, too: no map of the model has the turbine's
efficiency over its vanes' position, where a real one has some per cent. No fit and no file holds it."""

_KEPT = 0.95  # of the variance; the rest is below what differs from point to point
_TOLD = 1e-4  # of a correction that is not worth a larger coefficient [-]
_MOST = 5.0  # standard deviations
_ROW_OF = {"p_im_pa": "cylinder_flow", "p_em_pa": "turbine_flow", "omega_t_rad_s": "compressor_flow",
           "w_c_kg_s": "cylinder_flow", "w_egr_kg_s": "egr_flow", "t_em_k": "exhaust_temperature"}  # fmt: skip

SUBMODEL_OF: Mapping[str, str] = {
    "eta_vol": "cylinder_flow", "W_t": "turbine_flow", "eta_tm": "turbo_power", "eta_c": "turbo_power",
    "W_c": "compressor_flow", "f_egr": "egr_flow", "T_em": "exhaust_temperature",
}  # fmt: skip
"""Insertion point of a map -> submodel whose tolerance it has."""


def with_lasting_errors(
    points: SteadyPoints, model: SteadyModel, values: Mapping[str, float], believed: PointSettings
) -> tuple[SteadyPoints, list[Coefficient]]:
    """The points with a column for every leading mode of every map's error and the exhaust temperature's; coefficients
    of the modes, and gain and offset of every sensor.

    Args:
        points: of the reference and judged.
        model, values: from which the maps' arguments are taken, at the points as measured.
        believed: how large the errors may be.
    """
    along = basis_along(_variables(points, model, values))
    errors = {name: believed.map_beside_reference * along[_smooth(m)] for m, name in enumerate(CORRECTED_POINTS)}
    believed_of_heat = believed.submodels.smooth_error(SUBMODEL_OF[EXHAUST])
    errors[EXHAUST] = believed_of_heat * _over_inputs(points, model)
    columns: dict[str, NDArray[np.float64]] = {}
    found = []
    for name, functions in errors.items():
        for k, mode in enumerate(_leading(functions)):
            label = f"{MAP_MODE}{name}:{k}"
            columns[label] = mode
            found.append(Coefficient(label, SUBMODEL_OF[name], 0.0, 1.0, -_MOST, _MOST, "-", "smooth error of the map"))
    return points.with_columns(**columns), [*found, *sensor_errors(points, believed)]


def sensor_errors(points: SteadyPoints, believed: PointSettings) -> list[Coefficient]:
    """Gain and offset of every sensor, about nought, as free numbers of the balances."""
    found = []
    for column in STATES:
        level = float(np.nanmedian(points[column])) if column in points else 0.0
        for fault, std in (("gain", believed.sensor_gain), ("offset", believed.sensor_offset * level)):
            if std > 0.0:
                found.append(Coefficient(f"{SENSOR_ERROR}{column}:{fault}", _ROW_OF[column], 0.0, std, -_MOST * std,
                                         _MOST * std, "-", "error of the sensor"))
    return found


def map_corrections(
    points: SteadyPoints, model: SteadyModel, values: Mapping[str, float], believed: PointSettings
) -> NDArray[np.float64] | None:
    """Coefficients (K,) of `engine.map_corrections.basis` that make the errors of the maps at the points; None where
    none are free.

    Args:
        points: with the columns of the modes.
        model, values: as fitted.
        believed: how large the errors may be.
    """
    modes = [name for name in values if name.startswith(MAP_MODE) and name in points]
    if not modes:
        return None
    along = basis_along(_variables(points, model, values))
    coefficients = np.zeros(len(along))
    for m, point in enumerate(CORRECTED_POINTS):
        functions, own = _smooth(m), [name for name in modes if name.split(":")[1] == point]
        error = np.sum([values[name] * points[name] for name in own], axis=0)
        A = believed.map_beside_reference * along[functions].T / _TOLD
        smallest = np.linalg.solve(A.T @ A + np.eye(A.shape[1]), A.T @ (error / _TOLD))
        coefficients[functions] = believed.map_beside_reference * smallest
    return coefficients


def corrections_left(
    points: SteadyPoints, model: SteadyModel, values: Mapping[str, float], believed: PointSettings,
    left: Mapping[str, float],
) -> NDArray[np.float64]:  # fmt: skip
    """The same of points without a reference: smooth errors of the maps with which the machine comes to rest nearest to
    the points, everything else as fitted. No fault is told by them.

    Args:
        points, model, values: as fitted.
        believed: how large the errors may be.
        left: relation that counts -> what the fit leaves of it beyond noise [-]: no map errs by more.
    """
    maps = basis().maps
    of_map = [min(left.get(SUBMODEL_OF[name], 0.0), believed.map_beside_reference) for name in CORRECTED_POINTS]
    std = np.where(basis().usual, np.array(of_map)[maps], 0.0)
    coefficients, which = np.zeros(maps.size), std > 0.0
    if which.any():
        coefficients[which] = nearest_rest(rest_of(points, model, values, which), std[which])
    return coefficients


def _smooth(m: int) -> NDArray[np.bool_]:
    """(K,) which functions are the smooth ones of a map: settled points are too few for further ones."""
    return np.asarray((basis().maps == m) & basis().usual)


def _over_inputs(points: SteadyPoints, model: SteadyModel) -> NDArray[np.float64]:
    """Smooth functions (K, n) of engine speed and injected quantity, over the ranges of the engine."""
    ranges = {"n_e_rpm": model.engine.n_e_range, "u_delta_mg": model.engine.u_delta_range}
    return smooth_functions(*((points[column] - low) / (high - low) for column, (low, high) in ranges.items()))


def _variables(points: SteadyPoints, model: SteadyModel, values: Mapping[str, float]) -> dict[str, NDArray[np.float64]]:
    """Arguments of the maps at the points as measured, (n,) each."""
    quantities = model.relations(points, points.states_filled(), values).quantities
    return law_variables(points, {name: np.asarray(v[0]) for name, v in quantities.items()})


def _leading(functions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Leading modes (r, n) of a random sum of functions (K, n) with coefficients of unit variance."""
    _, sizes, along = np.linalg.svd(functions, full_matrices=False)
    count = int(np.searchsorted(np.cumsum(sizes**2) / np.sum(sizes**2), _KEPT)) + 1
    return np.asarray(sizes[:count, None] * along[:count])
