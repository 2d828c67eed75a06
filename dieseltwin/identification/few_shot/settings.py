"""Settings of few-shot-newton, and how the second attempt of a doubtful run differs from the first."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from dieseltwin.identification.unknowns import START_SIGMA

if TYPE_CHECKING:
    from dieseltwin.settings.params import IdentifyConfig

METHOD = "few-shot-newton"
PATIENT_STAGES = (100.0, 30.0, 10.0, 3.0, 1.0)
"""Stages of the second attempt, from the laboratory values themselves."""
PATIENT_ITERATIONS, PATIENT_RENEWALS = 30, 10
"""At least that many steps and renewals in the second attempt: idle leaves a long curved valley of eta_sc and h_tot."""
PATIENT_NOTICED_SHARE = 0.3
"""Of the second attempt: softer equations make the valley wider, at 1-5 % of the standard deviation (measured)."""


@dataclass(frozen=True)
class NewtonSettings:
    """Settings; `from_config` takes them from params.yaml.

    Attributes:
        start_at: "lab" or "truth" (only to show how much that flatters).
        start_sigma: spread of the starts in masked space [-].
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

    start_at: str = "lab"
    start_sigma: float = START_SIGMA
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

    @classmethod
    def from_config(cls, config: IdentifyConfig | NewtonSettings | None) -> NewtonSettings:
        """Take the settings from `identify` of params.yaml; they may also be given themselves, or None."""
        if isinstance(config, NewtonSettings):
            return config
        if config is None:
            return cls()
        own = config.of(METHOD).model_dump(exclude={"members"})
        return cls(start_at=config.start.at, start_sigma=config.start.sd_masked, **own)

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
