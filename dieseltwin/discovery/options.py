"""What a user may choose of a discovery."""

from __future__ import annotations

from dataclasses import dataclass

from dieseltwin.discovery.search.state import Settings
from dieseltwin.discovery.twins.diesel import MAP_TOLERANCE


@dataclass(frozen=True)
class Options:
    """What a user may choose.

    Attributes:
        sensors: columns to use, None for all that there are.
        withhold: effects to keep out of the catalogue.
        map_tolerance: standard deviation of the maps' smooth relative errors [-].
        seed: of everything random.
        law_search: look for a law where no name fits.
    """

    sensors: tuple[str, ...] | None = None
    withhold: tuple[str, ...] = ()
    map_tolerance: float = MAP_TOLERANCE
    seed: int = 0
    law_search: bool = True

    def settings(self) -> Settings:
        """For the search."""
        return Settings(withhold=self.withhold, seed=self.seed)
