"""Sections of params.yaml of the estimators of the core."""

from __future__ import annotations

from pydantic import Field, PositiveFloat, PositiveInt

from dieseltwin.settings.method_settings import MethodSettings


class ClassicalConfig(MethodSettings):
    """Maximum likelihood by shooting with sensitivities."""

    iterations_max: PositiveInt = Field(description="most evaluations of a run")
    tolerance: PositiveFloat = Field(description="Newton decrement at which a run stops [standard deviations]")
    damping_start: PositiveFloat = Field(description="first Levenberg-Marquardt factor [-]")
