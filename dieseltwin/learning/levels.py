"""How well health itself is known, where a health parameter and the level of a map are one product.

Nothing but what is believed beforehand tells the two apart. A smooth function of an assumed length does so by the
map's shape, and is as right as that length: it was stated to 0.9 % where it was off by 1.5 %. So the shape is not
believed to say anything of the mean along the driving, whose own variance is what was believed of the map.
"""

from __future__ import annotations

import numpy as np

from dieseltwin.engine import HEALTH
from dieseltwin.engine.map_corrections import CORRECTED_POINTS, basis, look_up
from dieseltwin.learning.belief import HEALTH_AT, MAPS_AT, Array, Belief
from dieseltwin.learning.files import LearnedEngine
from dieseltwin.least_squares import without_negative

LEVELS = {"f_egr": "A_egrmax", "W_t": "A_vgtmax"}
"""Maps whose level is one product with a health parameter."""

_MET = 3e-3
"""Of a constant, by which the sum of the basis that stands for it may miss it (root mean square) [-]."""


def health_covariance(learned: LearnedEngine) -> Array:
    """Covariance (4, 4) of the health parameters when the reference was recorded [squared units of them]."""
    functions = _functions_along(learned)
    return without_shape(learned.belief, learned.believed, functions)


def relative_health_std(learned: LearnedEngine) -> Array:
    """(4,) how well the health parameters were known when they were learned, over their values [-]."""
    return np.asarray(np.sqrt(np.diag(health_covariance(learned))) / learned.belief.health)


def without_shape(belief: Belief, believed: Belief, functions: dict[str, Array]) -> Array:
    """Covariance (4, 4) of the health parameters where the shape of a map says nothing of its mean along a driving.

    Args:
        belief, believed: after and before the recordings.
        functions: map -> (k, n) its functions of the basis along the driving.
    """
    scale = np.sqrt(np.diag(believed.covariance))
    across = np.outer(scale, scale)
    prior = believed.covariance / across
    seen = without_negative(np.linalg.inv(belief.covariance / across) - np.linalg.inv(prior))
    maps = basis().maps
    for name, along in functions.items():
        own = maps == CORRECTED_POINTS.index(name)
        at, along = np.flatnonzero(own & believed.free) + MAPS_AT.start, along[believed.free[own]]
        mean = along.mean(axis=1)
        gram = along @ along.T / along.shape[1] + _MET**2 * np.eye(len(at))
        constant = np.linalg.solve(gram, mean) / scale[at]
        mean = mean * scale[at]
        constant /= float(mean @ constant)
        before = prior[np.ix_(at, at)]
        product = np.zeros(len(prior))  # more of the one and less of the other: no reading shows it
        health = HEALTH.index(LEVELS[name])
        product[health], product[at] = belief.mean[health] / scale[health], -constant
        shown = seen @ product
        if product @ shown > 0.0:  # where the flow's slope has no limit, linear responses to the two differ
            seen = seen - np.outer(shown, shown) / float(product @ shown)
        shape = np.eye(len(at)) - np.outer(constant, mean)
        prior[np.ix_(at, at)] = shape @ before @ shape.T + float(mean @ before @ mean) * np.outer(constant, constant)
    covariance = np.linalg.inv(seen + np.linalg.inv(prior))
    return np.asarray((0.5 * (covariance + covariance.T) * across)[HEALTH_AT, HEALTH_AT])


def _functions_along(learned: LearnedEngine) -> dict[str, Array]:
    """Functions of the basis of both maps along the reference, as it was read: map -> (k, n)."""
    functions = basis()
    parts: dict[str, list[Array]] = {name: [] for name in LEVELS}
    for item in learned.recordings:
        rows = np.concatenate([np.arange(piece.start, piece.stop) for piece in item.pieces()])
        columns = {name: values[rows] for name, values in item.columns.items()}
        pressure_ratio = item.p_amb_pa / columns.get("p_em_pa", np.full(rows.size, np.nan))
        places = {"f_egr": (columns["u_egr_pct"], np.zeros(rows.size)), "W_t": (columns["u_vgt_pct"], pressure_ratio)}
        for name, (x, y) in places.items():
            there = np.isfinite(x) & np.isfinite(y)
            m = CORRECTED_POINTS.index(name)
            parts[name].append(look_up(functions.tables[functions.maps == m], m, x[there], y[there]))
    found = {name: np.concatenate(some, axis=1) for name, some in parts.items() if some}
    return {name: along for name, along in found.items() if along.shape[1]}
