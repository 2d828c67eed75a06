"""A health parameter as a verdict has it, and what became of it since the reference."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from dieseltwin.settings.strict import FrozenModel, where_told

NotNegative = Annotated[float, Field(ge=0.0)]


class SinceReference(FrozenModel):
    """A health parameter now over what it was when the reference was recorded [-], and its standard deviation."""

    value: float
    std: NotNegative

    @property
    def text(self) -> str:
        """As a change, in words."""
        digits = 1 if self.std >= 5e-4 else 2
        return f"{100.0 * (self.value - 1.0):+.{digits}f} ± {100.0 * self.std:.{digits}f} %"


class HealthValue(FrozenModel):
    """A health parameter of the repaired twin, its standard deviation, and its value in the health-only fit; what
    became of it since the reference, where there is one."""

    value: float
    std: NotNegative | None
    before: float
    since_reference: SinceReference | None = where_told()
