"""A twin whose sensors are at fault: gain, offset and lag of readings as further parameters, so that every fit works.

A fault of a sensor changes its own reading and nothing else, so it acts on what the twin simulates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dieseltwin.discovery.laws.features import FaultKind
from dieseltwin.discovery.laws.shapes import lagged
from dieseltwin.discovery.laws.twin import of_base
from dieseltwin.discovery.twins.interface import Array, Lanes, Parameter, Twin

LOOSE_GAIN = 1.0  # prior standard deviation of a gain; of an offset relative to the channel's mean: says nothing
_LOOSE_LAG_S = 20.0
_SCALE = 0.02  # of a gain, and of an offset relative to the channel's mean: size of steps and differences
_SCALE_LAG_S = 0.5


@dataclass(frozen=True)
class ReadingFault:
    """A fault of one reading.

    Attributes:
        channel: its column.
        kind: "gain" (reading (1 + size)), "offset" (reading + size) or "lag" (first order, of the reading alone).
        size: gain [-], offset [unit of the channel], lag [s].
        std: standard deviation of it, None before it is known.
        since_s: from when on it is there, in the time of the twin [s]; None: always.
    """

    channel: str
    kind: FaultKind
    size: float = 0.0
    std: float | None = None
    since_s: float | None = None

    def unit(self, of_channel: str) -> str:
        """Unit of the size."""
        return {"gain": "-", "lag": "s"}.get(self.kind, of_channel)

    def text(self, unit: str = "") -> str:
        """For people."""
        spread = "" if self.std is None else f" ± {self.std:.2g}"
        if self.kind == "gain":
            return f"reading of {self.channel} (1 + g), g = {self.size:.4g}{spread}"
        if self.kind == "offset":
            return f"reading of {self.channel} + {self.size:.4g}{spread} {unit}".rstrip()
        return f"reading of {self.channel} behind a first-order lag of {self.size:.4g}{spread} s"


class ReadingTwin:
    """A twin with faults of readings; satisfies `dieseltwin.discovery.twins.interface.Twin`, most of it by the base's.

    Args:
        base: the twin without them.
        faults: what is wrong; their sizes are further parameters, whose priors say nothing.
    """

    def __init__(self, base: Twin, faults: Sequence[ReadingFault]) -> None:
        self.base, self.faults = base, tuple(faults)
        self._at = [base.channels.index(fault.channel) for fault in self.faults]
        mean = np.nanmean(np.abs(base.measured), axis=0)
        extra = []
        for k, (fault, at) in enumerate(zip(self.faults, self._at, strict=True)):
            size = float(mean[at]) if fault.kind == "offset" else 1.0
            loose, scale = (_LOOSE_LAG_S, _SCALE_LAG_S) if fault.kind == "lag" else (LOOSE_GAIN * size, _SCALE * size)
            extra.append(Parameter(f"fault_{k + 1}", 0.0, loose, fault.unit(""), scale))
        self.parameters = (*base.parameters, *extra)

    def __getattr__(self, name: str) -> object:
        return getattr(self.base, name)

    def simulate(self, lanes: Lanes) -> Array:
        """Readings without noise, (B, n, C)."""
        out = np.array(self.base.simulate(of_base(lanes, self.base)), dtype=np.float64)
        time_s = self.base.time_s
        sizes = lanes.parameters[:, len(self.base.parameters) :]
        firsts = [0 if f.since_s is None else int(np.searchsorted(time_s, f.since_s)) for f in self.faults]
        for kind in ("lag", "gain", "offset"):
            for k, (fault, at) in enumerate(zip(self.faults, self._at, strict=True)):
                if fault.kind != kind:
                    continue
                rows = slice(firsts[k], None)
                if kind == "lag":
                    for lane, size in zip(out, sizes[:, k], strict=True):
                        if size > 0.0:
                            lane[rows, at] = lagged(np.nan_to_num(lane[rows, at]), time_s[rows], float(size))
                elif kind == "gain":
                    out[:, rows, at] *= 1.0 + sizes[:, k, None]
                else:
                    out[:, rows, at] += sizes[:, k, None]
        return out

    def variables(self, lanes: Lanes) -> dict[str, Array]:
        """Along the trajectory of lane 0; a fault of a reading doesn't touch them."""
        return self.base.variables(of_base(lanes, self.base))


__all__ = ["ReadingFault", "ReadingTwin"]
