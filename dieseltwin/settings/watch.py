"""Section `watch` of `params.yaml`: when the history of an engine raises an alarm (docs/fleet.md)."""

from __future__ import annotations

from pydantic import Field, NonNegativeFloat, PositiveFloat

from dieseltwin.settings.strict import StrictModel


class WatchConfig(StrictModel):
    """Alarm over a history; the numbers stand in the file with their reasons."""

    alarms_per_year: float = Field(gt=0, le=1, description="false alarms per engine and year, at most")
    inflation: float = Field(ge=1, description="scatter of estimates between recordings over what is stated [-]")
    clip: PositiveFloat = Field(description="standard deviations that one recording counts for at most")
    step_size: PositiveFloat = Field(description="of a fault that is there at once, in tolerances of its effect")
    growth_size: PositiveFloat = Field(description="of the growth of a fault in a year, in the same")
    at_start_years: float = Field(gt=0, le=1, description="weight of what began before the first recording")
    least_size: NonNegativeFloat = Field(description="of a fault that is worth an alarm, in the same")
    schedule: str = Field(description="of the flow that looks for new recordings, as cron writes it")
