"""Sections of params.yaml of the estimators of the core."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field, PositiveFloat, PositiveInt

from dieseltwin.settings.method_settings import MethodSettings

PATIENT_STAGES = (100.0, 30.0, 10.0, 3.0, 1.0)
"""Stages of few-shot-newton's second attempt, from the laboratory values themselves."""
PATIENT_ITERATIONS = 30
"""At least that many steps in it: idle leaves a long curved valley of eta_sc and h_tot."""


class ClassicalConfig(MethodSettings):
    """Maximum likelihood by shooting with sensitivities."""

    iterations_max: PositiveInt = Field(description="most evaluations of a run")
    tolerance: PositiveFloat = Field(description="Newton decrement at which a run stops [standard deviations]")
    damping_start: PositiveFloat = Field(description="first Levenberg-Marquardt factor [-]")


class NewtonConfig(MethodSettings):
    """Gauss-Newton / Levenberg-Marquardt on heads and parameters."""

    stages: tuple[PositiveFloat, ...] = Field(min_length=1, description="multiples of the process noise, the last 1")
    iterations_early: PositiveInt = Field(description="most steps of a stage but the last, which need not converge")
    iterations_max: PositiveInt = Field(description="most steps of the last stage and of each renewal of the defect")
    tolerance: PositiveFloat = Field(description="decrement at which a run of a stage stops [standard deviations]")
    damping_start: PositiveFloat = Field(description="first Levenberg-Marquardt factor of a stage [-]")
    student_dof: PositiveFloat = Field(description="tails of the physics residuals [-]")
    defect_share: PositiveFloat = Field(description="of the basis's local defect that is left after its correction")
    floor_share: PositiveFloat = Field(description="of the median defect that the process noise doesn't fall below")

    renewals_max: ClassVar[int] = 6
    """Most renewals of the defect at the last stage."""
    noticed_share: ClassVar[float] = 0.1
    """Of a standard error: what moves a state by less isn't noticed (`process_noise`)."""

    def patient(self) -> PatientConfig:
        """Settings of the second attempt, which starts from the laboratory values themselves."""
        changed = {
            "stages": PATIENT_STAGES,
            "iterations_early": self.iterations_max,
            "iterations_max": max(PATIENT_ITERATIONS, self.iterations_max),
        }
        return PatientConfig.model_validate({**self.model_dump(), **changed})


class PatientConfig(NewtonConfig):
    """The second attempt of a doubtful run."""

    renewals_max: ClassVar[int] = 10
    """More: idle's valley is long."""
    noticed_share: ClassVar[float] = 0.3
    """Softer equations make that valley wider, at 1-5 % of the standard deviation (measured)."""
