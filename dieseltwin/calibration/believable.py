"""What nobody measured is only as free as what is believed of it: laws at such a place must stay there.

The balances see T_im only as a quotient with eta_vol, p_bc only through the compressor's map: a law that bends the one
for an error of the other fits as well, and says 120 degC behind a charge cooler or a pressure before the compressor
above ambient. So a found law is refused where the place that it changes leaves the beliefs of `imply`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from dieseltwin.arrays import Array
from dieseltwin.calibration.coefficients import BELIEFS
from dieseltwin.calibration.relations import cooled_charge
from dieseltwin.recordings.steady_points import SteadyPoints

FAR = 3.0  # standard deviations of a belief
MOST = 0.1  # of the points may lie beyond
CLOSE = 0.002  # relative, of a pressure: rounding of what was fitted

_BELIEVED = {belief.name: belief for belief in BELIEFS}


def _extreme(name: str, side: float) -> float:
    belief = _BELIEVED[name]
    return float(np.clip(belief.mean + side * FAR * belief.std, belief.low, belief.high))


def believed_range(place: str, points: SteadyPoints, q: Mapping[str, Array]) -> tuple[Array, Array] | None:
    """Lowest and highest value [SI] that is believed of an unmeasured place at each point, None of any other place.

    Args:
        place: by the paper's symbol.
        points: n of them.
        q: quantities of the balances, (n,) each.
    """
    p_0, T_0 = points["p_amb_pa"], points["t_amb_k"]
    if place == "p_bc":  # a filter throttles, nothing before the compressor compresses
        return p_0 - _extreme("air_filter_restriction", 1.0) * q["W_c"] ** 2, p_0
    if place == "p_es":  # pipes and valves throttle
        return p_0, np.full(points.size, np.inf)
    if place == "T_im":
        limits = []
        for side in (-1.0, 1.0):
            belief = partial(_extreme, side=side)
            limits.append(cooled_charge(T_0 + belief("cooler_approach"), T_0, q, belief))
        return limits[0], limits[1]
    return None


def unbelievable(places: frozenset[str], points: SteadyPoints, q: Mapping[str, Array]) -> frozenset[str]:
    """Those of `places` whose value leaves what is believed at more than `MOST` of the points."""
    found = set()
    for place in places:
        limits = believed_range(place, points, q)
        if limits is not None:
            beyond = (q[place] < limits[0] * (1.0 - CLOSE)) | (q[place] > limits[1] * (1.0 + CLOSE))
            if np.mean(beyond) > MOST:
                found.add(place)
    return frozenset(found)
