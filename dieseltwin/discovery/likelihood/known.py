"""Twins whose scatter and whose own errors are known beforehand, from a calibration with covariance.

Where readings are balances of several sensors, differences of neighbouring samples say nothing about their scatter: it
was measured on held-out driving. And maps that were fitted carry their covariance, which is sharper where they were
seen than any tolerance that holds everywhere.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from dieseltwin.discovery.likelihood.metric import Whitening
from dieseltwin.discovery.likelihood.nuisance import Nuisance
from dieseltwin.discovery.twins.interface import Lanes
from dieseltwin.discovery.twins.offers import Offer
from dieseltwin.recordings.noise import Noise


@runtime_checkable
class KnownErrors(Offer, Protocol):
    """What such a twin offers beside `discovery.twins.interface.Twin`; its channels are balances, not sensors."""

    def noise(self) -> Noise:
        """Typical scatter of each channel and its correlation from sample to sample."""
        ...

    def whitening(self) -> Whitening:
        """Whitening of the readings by what is known of each sample; follows holes made in `measured`."""
        ...

    def nuisances(self, lanes: Lanes) -> list[Nuisance]:
        """Directions in which the twin may be off about lane 0, one standard deviation each, as responses."""
        ...
