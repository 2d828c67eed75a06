"""The section of params.yaml that the two methods of the hybrid PINN share."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt

from dieseltwin.settings.method_settings import MethodSettings
from dieseltwin.settings.strict import StrictModel


class PinnStageConfig(StrictModel):
    """A piece of the PINN's schedule with constant learning rates; a rate of 0 freezes."""

    until_epoch: PositiveInt
    layers: Literal["all", "last"] = Field(description="which layers of the networks are trained")
    rate_networks: NonNegativeFloat
    rate_unknowns: NonNegativeFloat
    rate_weights: NonNegativeFloat = Field(description="of the self-adaptive weights")


class PinnConfig(MethodSettings):
    """The paper's hybrid PINN: all layers from scratch, or from a source model in stages."""

    stages: tuple[PinnStageConfig, ...] = Field(min_length=1)
    first_layer_slopes: tuple[float, float] | None = Field(
        description="start of the first layer on time scaled to [-1, 1]"
    )
    scale_t_em_k: PositiveFloat = Field(description="unit of the data residual of T_em")
    scale_rates: PositiveFloat = Field(description="further divisor of the residuals of the three rates")
    scale_x_r: PositiveFloat = Field(description="unit of the residual of x_r")
    fresh_dropout: bool = Field(description="the maps lose other neurons in every epoch; else one realisation a run")
    average_share: NonNegativeFloat = Field(le=1.0, description="of the epochs, at the end, whose mean is the estimate")
    weight_start: dict[str, PositiveFloat]

    @property
    def trained_epochs(self) -> int:
        """Epochs of all stages."""
        return self.stages[-1].until_epoch
