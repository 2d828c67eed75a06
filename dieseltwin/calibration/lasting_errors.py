"""Errors of maps and of sensors as free numbers of the balances, where a reference is there to tell them.

Without one, they can't be told from what is missing, and stay tolerances of the search.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from dieseltwin.calibration.coefficients import Coefficient
from dieseltwin.calibration.steady_model import MAP_MODE, SENSOR_ERROR, SteadyModel, law_variables
from dieseltwin.discovery.likelihood.nuisance import tolerance_modes
from dieseltwin.discovery.twins.diesel_points import POINT_FACTS
from dieseltwin.recordings.steady_points import STATES, SteadyPoints
from dieseltwin.settings.search import PointSettings

_KEPT = 0.95  # of the variance; the rest is below what differs from point to point
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
    """The points with a column for every leading mode of every map's error; coefficients of the modes, and gain and
    offset of every sensor.

    Args:
        points: of the reference and judged.
        model, values: from which the maps' arguments are taken, at the points as measured.
        believed: how large the errors may be.
    """
    states = points.states()
    states = np.where(np.isfinite(states), states, np.nanmedian(states, axis=0))
    quantities = model.relations(points, states, values).quantities
    variables = law_variables(points, {name: np.asarray(v[0]) for name, v in quantities.items()})
    columns: dict[str, NDArray[np.float64]] = {}
    found = []
    for name, submodel in SUBMODEL_OF.items():
        sets = [names for names in (POINT_FACTS[name].over, POINT_FACTS[name].also) if names]
        if not sets:
            continue
        modes = np.concatenate([tolerance_modes([variables[v] for v in names], _KEPT) for names in sets])
        for k, mode in enumerate(modes):
            label = f"{MAP_MODE}{name}:{k}"
            columns[label] = believed.map_beside_reference / np.sqrt(len(sets)) * mode
            found.append(Coefficient(label, submodel, 0.0, 1.0, -_MOST, _MOST, "-", "smooth error of the map"))
    for column in STATES:
        level = float(np.nanmedian(points[column])) if column in points else 0.0
        for fault, std in (("gain", believed.sensor_gain), ("offset", believed.sensor_offset * level)):
            if std > 0.0:
                found.append(Coefficient(f"{SENSOR_ERROR}{column}:{fault}", _ROW_OF[column], 0.0, std, -_MOST * std,
                                         _MOST * std, "-", "error of the sensor"))
    return points.with_columns(**columns), found
