"""What knowing the engine is worth: marks of own-engine benchmarks over minutes of reference and errors of maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from dieseltwin.atomic import atomic_path
from dieseltwin.challenge.cases import MAP_RMS
from dieseltwin.challenge.metrics import Share
from dieseltwin.challenge.own_engine import TIERS
from dieseltwin.challenge.run import read_manifest
from dieseltwin.challenge.score import SCORE
from dieseltwin.errors import InputError
from dieseltwin.sealed import read_json

_BESIDE = 0.02  # of the longest reference, between sizes of the maps' errors
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")


@dataclass(frozen=True)
class Place:
    """Marks of one benchmark.

    Attributes:
        minutes: of reference a case [min]; map_rms: size of the maps' errors [-]; cases: that were judged.
        named: right names among those that count; none: `none_of_these` among faults that could be named.
        health: median relative error of the health, A_egrmax, A_vgtmax and eta_sc together [-].
    """

    minutes: float
    map_rms: float
    cases: int
    named: Share
    none: Share
    health: float | None


def place_of(folder: Path) -> Place:
    """Marks of a benchmark that was scored.

    Raises:
        InputError: none of an own engine, or not scored.
    """
    manifest = read_manifest(folder)
    if manifest["tier"] not in TIERS:
        raise InputError(str(folder), f"tier {manifest['tier']}", " or ".join(TIERS), "name benchmarks of own engines")
    score, rows = (read_json(folder / SCORE / name, "the score of `challenge score`", "score it first")
                   for name in ("score.json", "rows.json"))  # fmt: skip
    try:
        return _place(folder, manifest, score, rows["rows"])
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise InputError(str(folder / SCORE), f"another content ({type(error).__name__}: {error})",
                         "the score of `challenge score`", "score it again") from None  # fmt: skip


def _place(folder: Path, manifest: Mapping[str, Any], score: Mapping[str, Any], rows: Sequence[Any]) -> Place:
    lines = {line["key"]: line["numbers"] for line in score["lines"]}
    errors = [
        abs(row["health_after"][name] / row["health_true"][name] - 1.0) if not row["since_said"]
        else abs(row["since_said"][name][0] / row["since_true"][name] - 1.0)
        for row in rows if row["health_after"] for name in ("A_egrmax", "A_vgtmax", "eta_sc")
    ]  # fmt: skip
    references = manifest["cases"][0].get("references", [])
    seconds = [float(pd.read_csv(folder / item["recording"], usecols=["time_s"])["time_s"].iloc[-1])
               for item in references]  # fmt: skip
    named, none = (Share(int(lines[key].get("hits", 0)), int(lines[key].get("of", 0)))
                   for key in ("name_in_set", "false_none"))  # fmt: skip
    health = float(np.median(errors)) if errors else None
    return Place(sum(seconds) / 60.0, MAP_RMS[manifest["tier"]], int(score["cases"]), named, none, health)


def write_curve(folders: Sequence[Path], out: Path) -> list[Place]:
    """Draw the marks of some benchmarks over the minutes of reference, a line for each size of map errors.

    Raises:
        InputError: as `place_of`.
    """
    from matplotlib.figure import Figure

    places = sorted((place_of(folder) for folder in folders), key=lambda place: (place.map_rms, place.minutes))
    figure = Figure(figsize=(10.5, 3.6), layout="constrained")
    names, nones, health = figure.subplots(1, 3)
    sizes = sorted({place.map_rms for place in places})
    beside = _BESIDE * max(1.0, max(place.minutes for place in places))  # intervals of two sizes don't cover each other
    for number, (colour, size) in enumerate(zip(_COLOURS, sizes, strict=False)):
        some = [place for place in places if place.map_rms == size]
        minutes = np.array([place.minutes for place in some]) + beside * (number - 0.5 * (len(sizes) - 1))
        label = f"maps off by {100 * size:g} %"
        for axes, shares in ((names, [place.named for place in some]), (nones, [place.none for place in some])):
            value = np.array([np.nan if share.value is None else share.value for share in shares])
            low, high = np.array([share.interval for share in shares]).T
            axes.errorbar(minutes, 100 * value, yerr=100 * np.abs([value - low, high - value]), fmt="o-", capsize=3,
                          color=colour, label=label)  # fmt: skip
        off = [np.nan if place.health is None else 100 * place.health for place in some]
        health.plot(minutes, off, "o-", color=colour, label=label)
        for place, at, error in zip(some, minutes, off, strict=True):
            health.annotate(f"{place.cases}", (at, error), (0, 7 if number else -12), textcoords="offset points",
                            fontsize=8, color=colour, ha="center")  # fmt: skip
    for axes, title in ((names, "true name in the set [%]"), (nones, "false none of these [%]"),
                        (health, "health: median error [%]; cases beside")):  # fmt: skip
        axes.set(xlabel="minutes of reference", ylabel=title, ylim=(0.0, None))
        axes.spines[["top", "right"]].set_visible(False)
    names.legend(frameon=False, fontsize=8)
    with atomic_path(out) as temporary:
        figure.savefig(temporary, dpi=150, format=out.suffix.lstrip(".") or "png")
    return places
