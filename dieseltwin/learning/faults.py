"""The main faults that a reference may have had, as it says them of maps that are off by no more than usual."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FaultBeside:
    """A fault in the engine as all recordings of a reference say it, fitted beside maps off by no more than usual.

    Attributes:
        name: of the effect; unit: of the size.
        size, std: the likeliest, and its standard deviation by how the fits fall off about it [unit].
        gain: decrease of -2 log posterior against a healthy engine, of the likeliest size.
        tolerance: smallest size of interest [unit].
    """

    name: str
    unit: str
    size: float
    std: float
    gain: float
    tolerance: float
