"""Circumstances of a recording as documents have them: weather, charge, fuel, clocks."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from dieseltwin.discovery.verdict.health_value import NotNegative
from dieseltwin.settings.strict import FrozenModel

Name = Annotated[str, Field(min_length=1)]


class FoundCircumstance(FrozenModel):
    """Something that the recording doesn't say, or says wrongly: its value, standard deviation and what was assumed
    [unit], whether it is plainly another than assumed, and effects of the catalogue that would look the same.

    Names are columns of the ambient and of the charge (`p_amb_pa`, `t_amb_k`, `t_im_k`), `drift:p_amb_pa` from the
    first row to the last, `scale:u_delta_mg` (true over recorded) and `time_shift:<column>` (recorded late by it).
    Of several recordings, `recording` is its number. `read`: a column gives it and is believed, as far as such a sensor
    may be off. `std` holds, beside a learned engine, that of the reference's own weather.
    """

    name: Name
    value: float
    std: NotNegative
    assumed: float
    unit: Name
    off: bool
    read: bool = False
    equivalent_names: tuple[Name, ...] = ()
    recording: int | None = Field(default=None, ge=1)
