"""What the sections of params.yaml of all estimators have in common."""

from __future__ import annotations

from pydantic import Field, PositiveInt

from dieseltwin.settings.strict import StrictModel


class MethodSettings(StrictModel):
    """Base of a method's section `identify.methods.NAME` in params.yaml."""

    members: PositiveInt | None = Field(default=None, description="runs a segment; none: identify.runs")

    @property
    def trained_epochs(self) -> int | None:
        """Epochs of its training; None for a method that iterates until it has converged."""
        return None
