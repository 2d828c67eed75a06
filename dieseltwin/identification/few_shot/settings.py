"""Settings of few-shot-newton, and how the second attempt of a doubtful run differs from the first."""

from __future__ import annotations

from dataclasses import dataclass, replace

from dieseltwin.identification.unknowns import StartSettings

METHOD = "few-shot-newton"
PATIENT_STAGES = (100.0, 30.0, 10.0, 3.0, 1.0)
"""Stages of the second attempt, from the laboratory values themselves."""
PATIENT_ITERATIONS, PATIENT_RENEWALS = 30, 10
"""At least that many steps and renewals in the second attempt: idle leaves a long curved valley of eta_sc and h_tot."""
PATIENT_NOTICED_SHARE = 0.3
"""Of the second attempt: softer equations make the valley wider, at 1-5 % of the standard deviation (measured)."""


@dataclass(frozen=True)
class NewtonSettings(StartSettings):
    """Settings; `from_config` takes them from params.yaml.

    Attributes:
        stages: multiples of the process noise, one stage each, the last 1.
        iterations_early: most steps of a stage but the last, which need not converge.
        iterations_max: most steps of the last stage, and of each renewal of the defect.
        tolerance: decrement at which a run of a stage stops [standard deviations].
        damping_start: first Levenberg-Marquardt factor of a stage [-].
        student_dof: tails of the physics residuals [-].
        defect_share, floor_share, noticed_share: of `process_noise`.
        renewals_max: most renewals of the defect at the last stage.
        samples: draws from the uncertainty for the bands.
    """

    method = METHOD
    stages: tuple[float, ...] = (30.0, 5.0, 1.0)
    iterations_early: int = 8
    iterations_max: int = 12
    tolerance: float = 0.05
    damping_start: float = 1e-3
    student_dof: float = 4.0
    defect_share: float = 0.3
    floor_share: float = 0.3
    noticed_share: float = 0.1
    renewals_max: int = 6
    samples: int = 24

    def patient(self) -> NewtonSettings:
        """Settings of the second attempt, which starts from the laboratory values themselves."""
        return replace(
            self,
            stages=PATIENT_STAGES,
            iterations_early=self.iterations_max,
            iterations_max=max(PATIENT_ITERATIONS, self.iterations_max),
            renewals_max=max(PATIENT_RENEWALS, self.renewals_max),
            noticed_share=max(PATIENT_NOTICED_SHARE, self.noticed_share),
        )
