"""Settled points as recordings in which the engine stands still at one point after another.

What a settled point says of an engine is what a simulation at its inputs comes to rest at. So a point is held for
`HOLD_S`, long enough for the turbocharger to forget where it began, and its readings count once, at the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dieseltwin.errors import InputError
from dieseltwin.notes import counted
from dieseltwin.recordings.channels import DIESEL_COLUMNS, TIME
from dieseltwin.recordings.columns import Columns
from dieseltwin.recordings.guess.physics import reversed_where_read
from dieseltwin.recordings.named_columns import columns_sha256
from dieseltwin.recordings.reader import Recording
from dieseltwin.recordings.steady_points import SteadyPoints, once_each

HOLD_S = 16.0
"""Of a point [s]. It begins at its reading; 2 % of turbo speed there are 0.08 % here at most, idle to full load."""

_PERIOD_S = 100.0  # from point to point; the hole between two is a break in any recording
_SAME_PRESSURE_PA, _SAME_TEMPERATURE_K = 1000.0, 6.0  # of the weather of one recording, which is its median
_MOST_WEATHERS = 6  # each is fitted its own circumstances
_FEWEST = 5
_SCATTERED = 25  # points up to which chance turns a direction round: in 18 % of sets of 5, 5 % of 12, 1.5 % of 20


def standing(points: SteadyPoints) -> list[Recording]:
    """The points as recordings, one for each weather; readings stand in every row. Copies count once, and an ambient
    that nothing gave has no column, as in a recording.

    Raises:
        InputError: fewer than five points, weather that changes from point to point, or a position that counts the
            other way round: maps bend to that, and little is left to see.
    """
    where, points = str(points.path or "points"), once_each(points)
    if points.size < _FEWEST:
        raise InputError(where, counted(points.size, "settled point"), f"{_FEWEST} or more", "measure more points")
    _refuse_turned(points, where)
    weather = np.stack([points["p_amb_pa"] / _SAME_PRESSURE_PA, points["t_amb_k"] / _SAME_TEMPERATURE_K], axis=1)
    of_day = _days(weather)
    days = int(of_day.max()) + 1
    if days > _MOST_WEATHERS:
        apart = f"{np.ptp(points['t_amb_k']):.0f} K and {np.ptp(points['p_amb_pa']) / 1e3:.1f} kPa apart"
        raise InputError(
            where, f"points in {days} weathers ({apart})",
            f"{_MOST_WEATHERS} at most (each within {_SAME_TEMPERATURE_K:g} K and {_SAME_PRESSURE_PA / 1e3:g} kPa)",
            "learn from the points of some days at a time",
        )  # fmt: skip
    return [_held(points, np.flatnonzero(of_day == day)) for day in range(days)]


def of_all_weathers(days: Sequence[Recording]) -> Recording:
    """The recordings of one file as one, of which it is asked what its points tell: a few of another day tell more of
    an engine, by themselves nothing. The weather is that of most.

    Args:
        days: as of `standing`, or one recording, which is given back.
    """
    if len(days) == 1:
        return days[0]
    columns = {name: np.concatenate([day.columns[name] for day in days]) for name in days[0].columns}
    starts = np.cumsum([0.0, *(day.time_s[-1] + _PERIOD_S for day in days[:-1])])
    columns[TIME] = np.concatenate([start + day.time_s for start, day in zip(starts, days, strict=True)])
    most = max(days, key=lambda day: day.time_s.size)
    return replace(most, time_s=columns[TIME], columns=Columns(columns), sha256=columns_sha256(columns))


def _days(weather: NDArray[np.float64]) -> NDArray[np.int_]:
    """(n,) number of the weather that each point belongs to; weather (n, 2) in units of what counts as the same.

    Each weather is that about the point with the most others near it, of those that are left.
    """
    near = np.abs(weather[:, None] - weather).max(axis=2) <= 0.5
    of_day, day = np.full(len(weather), -1), 0
    while (left := of_day < 0).any():
        most = int(np.argmax(np.where(left, (near & left).sum(axis=1), 0)))
        of_day[left & near[most]] = day
        day += 1
    return of_day


def _refuse_turned(points: SteadyPoints, where: str) -> None:
    columns = {name: points[name] for name in DIESEL_COLUMNS if name in points and np.isfinite(points[name]).any()}
    for name, why in reversed_where_read(columns, _SCATTERED).items():
        raise InputError(f"{where}: column {name}", why, "0 for shut, 100 for open",
                         "turn it round in a channel map (--channels): scale: -1, offset: 100")  # fmt: skip


def _held(points: SteadyPoints, which: NDArray[np.int_]) -> Recording:
    rows = round(HOLD_S) + 1
    names = [name for name in DIESEL_COLUMNS if name in points and name not in points.assumed]
    time_s: NDArray[np.float64] = np.asarray(np.arange(which.size)[:, None] * _PERIOD_S + np.arange(rows)).ravel()
    columns: dict[str, NDArray[np.float64]] = {TIME: time_s}
    columns |= {name: np.repeat(points[name][which], rows) for name in names}
    return Recording(
        time_s, Columns(columns), float(np.median(points["p_amb_pa"][which])),
        float(np.median(points["t_amb_k"][which])), points.path, columns_sha256(columns),
        points.notes, made=points.made.among(columns), standing=True,
    )  # fmt: skip
