"""The weather that a learned engine's maps are of, and what its compressor does in other weather.

The published compressor's efficiency is a function of mass flow (A.41) and its ellipse one of speed (A.47, A.48). A
real compressor's map is one of corrected flow and corrected speed. In the weather of learning both are the same, and
what was learned there says nothing of which holds: 1500 m higher the efficiency differs by 2 to 6 %.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dieseltwin.engine import EngineParameters
from dieseltwin.recordings.circumstances import POSSIBLE_EXPONENTS
from dieseltwin.recordings.reader import Recording
from dieseltwin.settings.search import CircumstanceSettings

UNDECIDED = 0.5
"""Exponent halfway between mass flow and corrected flow, and between speed and corrected speed [-]."""

EXPONENTS = ("k_cflow", "k_cspeed")
"""Engine parameters that say how far the compressor's maps go by corrected values."""

WEATHER = ("p_cmap", "T_cmap")
"""Engine parameters that say which weather its maps are of."""


@dataclass(frozen=True)
class Exponent:
    """What recordings in different weather say of an exponent: value and standard deviation [-]."""

    value: float
    std: float


@dataclass(frozen=True)
class OfType:
    """What other engines of a type say of a compressor.

    Attributes:
        exponents: by name, of which they say enough.
        p_cmap, T_cmap: weather in which they say what its maps are [Pa, K].
    """

    exponents: Mapping[str, Exponent]
    p_cmap: float
    T_cmap: float


def of_own_weather(
    engine: EngineParameters, recordings: Sequence[Recording], known: Mapping[str, Exponent] | None = None,
    of_type: OfType | None = None,
) -> EngineParameters:  # fmt: skip
    """An engine whose compressor's maps are of the mean weather of some recordings.

    What an engine file says of the exponents stays, but for 0, which every engine has of which nobody said anything.

    Args:
        engine: before anything is learned.
        recordings: that it is learned from.
        known: exponents that these show, by name.
        of_type: what engines of its type say, whose weather the maps are then of.
    """
    if of_type is None:
        ordered = sorted(recordings, key=lambda item: item.sha256)  # a sum is another one in another order
        weights = np.array([item.running_s for item in ordered])
        p_amb, t_amb = (
            float(np.average([getattr(item, name) for item in ordered], weights=weights))
            for name in ("p_amb_pa", "t_amb_k")
        )
    else:
        p_amb, t_amb = of_type.p_cmap, of_type.T_cmap
        known = {**of_type.exponents, **(known or {})}
    values = {name: item.value for name, item in (known or {}).items()}
    open_ones = {name: values.get(name, UNDECIDED) for name in EXPONENTS if getattr(engine, name) == 0.0}
    return engine.replace(p_cmap=p_amb, T_cmap=t_amb, **open_ones)


def as_sure_as_the_weather(
    exponents: Mapping[str, Exponent], recordings: Sequence[Recording], engine: EngineParameters,
    beliefs: CircumstanceSettings,
) -> dict[str, Exponent]:  # fmt: skip
    """Exponents known no better than the sensors of the weather let them be, of those of which that leaves anything.

    A barometer that is 0.3 kPa off on one of several days is 0.3 % of the compressor's flow: as much as corrected speed
    is, in place of speed, with 3 K between the days.

    Args:
        exponents: by name; recordings: that show them; engine: of their weather (`of_own_weather`).
        beliefs: how far a reading of the weather may be off, and how far what no column gives.
    """
    columns = (item.columns.get(name, np.array([np.nan])) for item in recordings for name in ("p_amb_pa", "t_amb_k"))
    read = [bool(np.isfinite(values).any()) for values in columns]
    p_std, t_std = (beliefs.p_amb_read_pa, beliefs.t_amb_read_k) if all(read) else (beliefs.p_amb_pa, beliefs.t_amb_k)
    error = np.hypot(p_std / engine.p_cmap, 0.5 * t_std / engine.T_cmap)
    warmer = 0.5 * np.log([item.t_amb_k / engine.T_cmap for item in recordings])
    more = {"k_cflow": warmer - np.log([item.p_amb_pa / engine.p_cmap for item in recordings]), "k_cspeed": warmer}
    found = {}
    for name, item in exponents.items():
        apart = float(np.sqrt(np.mean(more[name] ** 2)))
        if apart == 0.0:  # one weather, as it is where no column gives any: they say nothing of it
            continue
        std = float(np.hypot(item.std, error / apart))
        if std < getattr(beliefs, name):
            found[name] = Exponent(float(np.clip(item.value, *POSSIBLE_EXPONENTS)), std)
    return found


def beside_exponents(beliefs: CircumstanceSettings, exponents: Mapping[str, Exponent]) -> CircumstanceSettings:
    """What is believed of a recording's circumstances, beside exponents that are known."""
    return beliefs.model_copy(update={name: item.std for name, item in exponents.items()})


def exponent_words(exponents: Mapping[str, Exponent], of_type: OfType | None = None) -> list[str]:
    """What recordings in different weather, or engines of its type, show of the compressor, as lines of text."""
    theirs = {} if of_type is None else of_type.exponents
    of = {"k_cflow": ("efficiency", "flow"), "k_cspeed": ("flow", "speed")}
    return [
        f"  the compressor's {of[name][0]} follows corrected {of[name][1]} by {100.0 * item.value:.0f} ± "
        f"{100.0 * item.std:.2g} % (0 % is the published model), as "
        f"{'engines of its type' if theirs.get(name) == item else 'recordings in different weather'} show"
        for name, item in exponents.items()
    ]
