"""What a user may choose of a discovery."""

from __future__ import annotations

from dataclasses import dataclass, field

from dieseltwin.settings.defaults import default_discover, default_search
from dieseltwin.settings.search import CircumstanceSettings, SearchSettings


@dataclass(frozen=True)
class Options:
    """What a user may choose.

    Attributes:
        sensors: columns to use, None for all that there are.
        withhold: effects to keep out of the catalogue.
        map_tolerance: standard deviation of the maps' smooth relative errors [-].
        seed: of everything random.
        law_search: look for a law where no name fits.
        search: what is decided by.
        circumstances: what is believed of all that a recording doesn't say.
    """

    sensors: tuple[str, ...] | None = None
    withhold: tuple[str, ...] = ()
    map_tolerance: float = field(default_factory=lambda: default_discover().map_tolerance)
    seed: int = 0
    law_search: bool = True
    search: SearchSettings = field(default_factory=lambda: default_search().driving)
    circumstances: CircumstanceSettings = field(default_factory=lambda: default_search().circumstances)

    def settings(self) -> SearchSettings:
        """For the search."""
        return self.search.asked(self.withhold, self.seed)
