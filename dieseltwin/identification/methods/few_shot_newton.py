"""`few-shot-newton`: learned bodies, Gauss-Newton on their heads and the health parameters, exact formulae."""

from __future__ import annotations

from pydantic import Field, PositiveFloat, PositiveInt

from dieseltwin.settings.method_settings import MethodSettings
from dieseltwin.settings.methods import Method, MethodStyle, Needs


class NewtonConfig(MethodSettings):
    """Gauss-Newton / Levenberg-Marquardt on heads and parameters."""

    stages: tuple[PositiveFloat, ...] = Field(min_length=1, description="multiples of the process noise, the last 1")
    iterations_early: PositiveInt
    iterations_max: PositiveInt
    tolerance: PositiveFloat
    damping_start: PositiveFloat
    student_dof: PositiveFloat
    defect_share: PositiveFloat = Field(description="of the basis's local defect that is left after its correction")
    floor_share: PositiveFloat = Field(description="of the median defect that the process noise doesn't fall below")


METHOD = Method(
    name="few-shot-newton",
    estimate="dieseltwin.identification.few_shot.newton",
    settings=NewtonConfig,
    style=MethodStyle("#D55E00", "s", "--", "few-shot-newton"),
    learned="bodies learned, exact formulae",
    rank=20,
    needs=Needs(bodies="bodies_conditioned.pt"),
    extra="networks",
)
