"""Whether maps that are further off than is believed would explain what the points leave without a name.

Without points from when the engine was well an error of a map and a law that nobody knows look alike, and what is
believed of maps decides: their smooth half is 0.6 to 1.4 % (`PointSettings.submodels`), while textbook maps of another
engine are off by several per cent. So the last round is made again with wider beliefs, and the answer says how wide.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace

from dieseltwin.calibration.steady_twin import SteadyTwin
from dieseltwin.discovery.search import run as search
from dieseltwin.discovery.search.state import Search
from dieseltwin.notes import Note
from dieseltwin.settings.search import PointSettings

_MAPS = ("cylinder_flow", "turbine_flow", "turbo_power", "compressor_flow", "egr_flow")


def rough_enough(found: Search, twin: SteadyTwin) -> float | None:
    """The smallest of `rough_maps` with which the points call for nothing more; None where none of them explains them.

    Args:
        found: the round that sees something without a name, without a reference.
        twin: of it.
    """
    for times in sorted(twin.settings.rough_maps):
        wider = copy(twin)
        wider.points = tuple(replace(point, tolerance=times * point.tolerance) for point in twin.points)
        if search.run(wider, found.settings, laws=False).kind == "healthy":
            return times
    return None


def rough_maps_note(times: float, believed: PointSettings) -> Note:
    """For people, with the errors in per cent.

    Args:
        times: of `rough_enough`.
        believed: of the maps.
    """
    usual = [100.0 * believed.submodels.smooth_error(name) for name in _MAPS]
    low, high = times * min(usual), times * max(usual)
    return Note(f"smooth errors of the maps of {low:.1f} to {high:.1f} % would explain what has no name as well "
                f"({min(usual):.1f} to {max(usual):.1f} % are believed): it may be no fault at all. Points from when "
                "the engine was well (--reference) tell", "rough_maps")  # fmt: skip
