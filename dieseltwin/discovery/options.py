"""What a user may choose of a discovery: of any machine, and of a diesel engine's recording."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

from pydantic import BaseModel

from dieseltwin.settings.defaults import default_discover, default_search
from dieseltwin.settings.params import params_sha256
from dieseltwin.settings.search import CircumstanceSettings, SearchSettings


@dataclass(frozen=True, kw_only=True)
class SearchOptions:
    """What a user may choose of any machine's search.

    Attributes:
        withhold: effects to keep out of the catalogue.
        seed: of everything random.
        search: what is decided by.
    """

    withhold: tuple[str, ...] = ()
    seed: int = 0
    search: SearchSettings

    def settings(self) -> SearchSettings:
        """For a search."""
        return self.search.asked(self.withhold, self.seed)

    @property
    def sha256(self) -> str:
        """SHA-256 (hex) of everything that was chosen, what is decided by included."""
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        plain = {k: v.model_dump(mode="json") if isinstance(v, BaseModel) else v for k, v in values.items()}
        return params_sha256(plain)


@dataclass(frozen=True, kw_only=True)
class Options(SearchOptions):
    """What a user may choose.

    Attributes:
        sensors: columns to use, None for all that there are.
        map_tolerance: standard deviation of the maps' smooth relative errors [-].
        law_search: look for a law where no name fits.
        circumstances: what is believed of all that a recording doesn't say.
    """

    sensors: tuple[str, ...] | None = None
    map_tolerance: float = field(default_factory=lambda: default_discover().map_tolerance)
    law_search: bool = True
    search: SearchSettings = field(default_factory=lambda: default_search().driving)
    circumstances: CircumstanceSettings = field(default_factory=lambda: default_search().circumstances)
