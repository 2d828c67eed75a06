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
        rival: decrease that larger or further errors of the maps promise in its place; 0 where none were asked for.
    """

    name: str
    unit: str
    size: float
    std: float
    gain: float
    tolerance: float
    rival: float = 0.0

    def told(self, least: float) -> bool:
        """Whether a reference with it looks faulty: it gains as much as is asked, and more than errors of maps."""
        return self.gain > max(least, self.rival) and abs(self.size) > self.tolerance

    def hidden(self, least: float) -> float:
        """Size up to which it could be there and would not be said [unit], by the fits beside it."""
        return self.std * float(max(least, self.rival) ** 0.5)
