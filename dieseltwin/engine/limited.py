"""When and where a term of an engine acts: since when and until when, growing or at once, in which driving."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from dieseltwin.engine.courses import Spans, course
from dieseltwin.settings.names import close_names
from dieseltwin.settings.strict import where_told
from dieseltwin.symbols import INPUT_COLUMNS

Region = dict[str, tuple[float, float]]
"""Input column -> (low, high): where a term acts."""


def _listed(spans: Spans) -> str:
    return ", ".join(f"{first:g} to {last:g} s" for first, last in spans)


class Limited(BaseModel):
    """A term that may act in a part of the time or of the driving only."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    std: float | None = Field(None, ge=0, description="standard deviation of the magnitude [its unit]")
    onset_s: float | None = Field(None, description="acts from this time of the recording on [s]; None: always")
    # Files leave these two out where they say nothing: most terms don't need them.
    until_s: float | None = where_told(description="and before this time [s]; None: to the end")
    grown_s: float | None = where_told(
        description="grows evenly from the onset to its magnitude at this time [s] and keeps it; None: at once"
    )
    gone_s: Spans = where_told(
        (), description="spans in between in which it is gone, from the first time to before the second of each [s]"
    )
    region: Region | None = Field(None, description="acts only inside these ranges of input columns; None: everywhere")
    valid_for: str | None = Field(None, description="domain of the data behind it, in words")

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        since = 0.0 if self.onset_s is None else self.onset_s
        for name, end in (("until_s", self.until_s), ("grown_s", self.grown_s)):
            if end is not None and end <= since:
                raise ValueError(f"{name} {end:g} s isn't after onset_s, {since:g} s")
        last = np.inf if self.until_s is None else self.until_s
        edges = [since, *(time for span in self.gone_s for time in span), last]
        if self.gone_s and not all(earlier < later for earlier, later in itertools.pairwise(edges)):
            raise ValueError(f"gone_s {_listed(self.gone_s)}: spans follow each other, between onset_s and until_s")
        return self

    @property
    def always(self) -> bool:
        """Whether it acts with its whole magnitude at all times in all driving."""
        return all(limit is None for limit in (self.onset_s, self.until_s, self.grown_s)) and not (
            self.region or self.gone_s
        )

    def later(self) -> Self | None:
        """The term on a later recording: what began or grew is there from the start, what went again is gone (None)."""
        usual = {"onset_s": None, "grown_s": None, "gone_s": ()}
        return None if self.until_s is not None else self.model_copy(update=usual)

    @field_validator("region")
    @classmethod
    def _known_columns(cls, region: Region | None) -> Region | None:
        for column, (low, high) in (region or {}).items():
            if column not in INPUT_COLUMNS:
                raise ValueError(f"unknown region column {column!r}; {close_names(column, INPUT_COLUMNS)}")
            if not low <= high:
                raise ValueError(f"region {column}: low {low:g} above high {high:g}")
        return region

    def factor(self, time_s: np.ndarray, start_s: float, conditions: Mapping[str, np.ndarray]) -> np.ndarray:
        """Share of its magnitude that the term has, shape (n,); half of it over an interval in which a condition enters
        or leaves its region. Between rows of one time, as settled points are, lies no interval.

        Args:
            time_s: sample times [s], (n,); start_s: the recording's start, from which its times count.
            conditions: the input columns of `INPUT_COLUMNS`, (n,) each.
        """
        since = 0.0 if self.onset_s is None else self.onset_s
        factor = course(time_s - start_s, since, self.until_s, self.grown_s, self.gone_s)
        if self.region:
            inside = np.ones(time_s.shape)
            for column, (low, high) in self.region.items():
                inside *= (conditions[column] >= low) & (conditions[column] <= high)
            # Factors are held over the interval behind their sample; the region's edge lies somewhere inside.
            inside[:-1] = np.where(np.diff(time_s) > 0.0, 0.5 * (inside[:-1] + inside[1:]), inside[:-1])
            factor = factor * inside
        return factor
