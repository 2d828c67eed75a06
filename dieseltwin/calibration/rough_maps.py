"""Whether maps that are further off than is believed would explain what the points show as well.

Without points from when the engine was well an error of a map and a fault look alike, and what is believed of maps
decides: their smooth half is 0.6 to 1.4 % (`PointSettings.submodels`), while textbook maps of another engine are off by
several per cent. So a round that has a name, and the last one where something has none, is made again with wider
beliefs, and the answer says how wide, and which other names are then as good.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace

from dieseltwin.calibration.steady_twin import SteadyTwin
from dieseltwin.discovery.search import run as search
from dieseltwin.discovery.search.state import Search
from dieseltwin.notes import Note
from dieseltwin.settings.names import listed
from dieseltwin.settings.search import PointSettings

_MAPS = ("cylinder_flow", "turbine_flow", "turbo_power", "compressor_flow", "egr_flow")


@dataclass(frozen=True)
class Rough:
    """What wider beliefs of the maps make of a round.

    Attributes:
        times: the smallest of `rough_maps` with which the points call for nothing; None where none of them explains it.
        others: names that are as good as the best one with the widest beliefs that still call for something.
    """

    times: float | None
    others: tuple[str, ...] = ()


def wider(found: Search, twin: SteadyTwin) -> Rough:
    """A round made again with wider beliefs of all maps and of the exhaust temperature's formula.

    Args:
        found: the round that sees something, without a reference.
        twin: of it.
    """
    others: tuple[str, ...] = ()
    for times in sorted(twin.settings.rough_maps):
        rougher = copy(twin)
        rougher.points = tuple(replace(point, tolerance=times * point.tolerance) for point in twin.points)
        again = search.run(rougher, found.settings, laws=False)
        if again.kind == "healthy":
            return Rough(times, others)
        gains = {fit.candidate.names[0]: again.gain(fit) for fit in again.singles}
        least = max(gains.values(), default=0.0) - again.settings.equivalent_gain
        others = tuple(name for name, gain in gains.items() if gain > max(least, 0.0))
    return Rough(None, others)


def rough_maps_notes(unnamed: Rough | None, named: Mapping[str, Rough], believed: PointSettings) -> list[Note]:
    """For people, with the errors in per cent.

    Args:
        unnamed: of what has no name; None where there is nothing.
        named: of what has one, by its name.
        believed: of the maps.
    """
    usual = [100.0 * believed.submodels.smooth_error(name) for name in _MAPS]
    low, high = min(usual), max(usual)
    tell = "Points from when the engine was well (--reference) tell"
    asked = [("what has no name", unnamed), *named.items()]
    notes = [Note(f"smooth errors of the maps of {rough.times * low:.1f} to {rough.times * high:.1f} % would explain "
                  f"{what} as well ({low:.1f} to {high:.1f} % are believed): it may be no fault at all. {tell}",
                  "rough_maps") for what, rough in asked if rough is not None and rough.times is not None]  # fmt: skip
    for what, rough in named.items():
        others = [other for other in rough.others if other != what]
        if rough.times is None and others:
            most = max(believed.rough_maps)
            notes.append(Note(f"if the maps are off by {most * low:.1f} to {most * high:.1f} %, {what} may also be "
                              f"{listed(others)} ({low:.1f} to {high:.1f} % are believed). {tell}", "rough_maps"))
    return notes
