"""The weather that a learned engine's maps are of, and what its compressor does in other weather.

The published compressor's efficiency is a function of mass flow (A.41) and its ellipse one of speed (A.47, A.48). A
real compressor's map is one of corrected flow and corrected speed. In the weather of learning both are the same, and
what was learned there says nothing of which holds: 1500 m higher the efficiency differs by 2 to 6 %.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dieseltwin.engine import EngineParameters
from dieseltwin.recordings.reader import Recording

UNDECIDED = 0.5
"""Exponent halfway between mass flow and corrected flow, and between speed and corrected speed [-]."""

EXPONENTS = ("k_cflow", "k_cspeed")
"""Engine parameters that say how far the compressor's maps go by corrected values."""

WEATHER = ("p_cmap", "T_cmap")
"""Engine parameters that say which weather its maps are of."""


def of_own_weather(engine: EngineParameters, recordings: Sequence[Recording]) -> EngineParameters:
    """An engine whose compressor's maps are of the mean weather of some recordings.

    What an engine file says of the exponents stays, but for 0, which every engine has of which nobody said anything.

    Args:
        engine: before anything is learned.
        recordings: that it is learned from.
    """
    weights = np.array([item.running_s for item in recordings])
    p_amb, t_amb = (
        float(np.average([getattr(item, name) for item in recordings], weights=weights))
        for name in ("p_amb_pa", "t_amb_k")
    )
    undecided = {name: UNDECIDED for name in EXPONENTS if getattr(engine, name) == 0.0}
    return engine.replace(p_cmap=p_amb, T_cmap=t_amb, **undecided)
