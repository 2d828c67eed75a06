"""A fault that a reference shows although its engine was believed to be well."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Suspicion:
    """An effect that the recordings show although they are believed to be of a healthy engine.

    Attributes:
        name: of the effect; unit: of the magnitude.
        magnitude, std: linear estimate and its standard deviation [unit].
        gain: decrease of -2 log posterior that it gives beyond all that maps, sensors and health can take up.
        alone: hash of the recording that shows it, where the others don't.
        tolerances: how many tolerances of interest it has [-].
    """

    name: str
    unit: str
    magnitude: float
    std: float
    gain: float
    alone: str | None = None
    tolerances: float = 1.0
