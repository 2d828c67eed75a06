"""Sections of params.yaml of the paper's training loops, and the units of their residuals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt

from dieseltwin.settings.method_settings import MethodSettings
from dieseltwin.settings.strict import StrictModel


@dataclass(frozen=True)
class Scales:
    """Units that residuals are divided by before they are squared.

    Attributes:
        p: pressures [Pa], and their rates [Pa/s]; omega: turbo speed [rad/s], and its rate [rad/s2].
        T_em, T_1: temperatures [K]; w_egr: EGR flow [kg/s].
        rate: further divisor of the three rates [-]: below 1 the differential equations count more against the data.
        x_r: residual gas [-], which is of the order of 0.03.
    """

    T_em: float
    rate: float
    x_r: float
    T_1: float = 300.0
    p: float = 1e5
    omega: float = 5e3
    w_egr: float = 1.0

    @property
    def physics(self) -> tuple[float, ...]:
        """Scales of the five physics residuals."""
        return (self.p * self.rate, self.p * self.rate, self.omega * self.rate, self.x_r, self.T_1)

    @property
    def states(self) -> tuple[float, ...]:
        """Scales of p_im, p_em, omega_t, x_r, T_1."""
        return (self.p, self.p, self.omega, self.x_r, self.T_1)

    @property
    def channels(self) -> tuple[float, ...]:
        """Scales of the readings p_im, p_em, omega_t, W_egr, T_em."""
        return (self.p, self.p, self.omega, self.w_egr, self.T_em)


class AdamConfig(MethodSettings):
    """The paper's loop: Adam on heads, unknowns and self-adaptive weights."""

    epochs: PositiveInt
    weights_until_epoch: PositiveInt = Field(description="the self-adaptive weights rest from here on")
    rate_heads: PositiveFloat = Field(description="learning rate, as the two that follow")
    rate_unknowns: PositiveFloat
    rate_weights: PositiveFloat
    late_rates: PositiveFloat = Field(description="factor on the learning rates from late_from_epoch on")
    late_from_epoch: PositiveInt
    scale_t_em_k: PositiveFloat = Field(description="unit of the residual of T_em")
    scale_t_1_k: PositiveFloat = Field(description="unit of the residual of T_1")
    scale_rates: PositiveFloat = Field(description="of the rates' residuals, in 1e5 Pa/s and 5e3 rad/s2")
    scale_x_r: PositiveFloat = Field(description="unit of the residual of x_r")
    fresh_dropout: bool = Field(description="the maps lose other neurons in every epoch; else one realisation a run")
    average_share: NonNegativeFloat = Field(le=1.0, description="of the epochs, at the end, whose mean is the estimate")
    weight_start: dict[str, PositiveFloat] = Field(description="alpha of the weights by channel")
    held_out_share: NonNegativeFloat = Field(
        default=0.0, lt=1.0, description="readings no loss sees: the epoch that predicts them best is the result"
    )
    weight_share: PositiveFloat = Field(
        default=1.0, description="factor on the starting weights: below 1 the data count less against the equations"
    )

    @property
    def scales(self) -> Scales:
        """Units of the residuals."""
        return Scales(self.scale_t_em_k, self.scale_rates, self.scale_x_r, T_1=self.scale_t_1_k)

    @property
    def trained_epochs(self) -> int:
        """Epochs of the loop."""
        return self.epochs

    def schedule_of(self, epochs: int) -> dict[str, int]:
        """The settings of a training of so many epochs, its pieces in the same proportions."""
        share = epochs / self.epochs
        return {"epochs": epochs, "weights_until_epoch": max(1, round(share * self.weights_until_epoch)),
                "late_from_epoch": max(1, round(share * self.late_from_epoch))}  # fmt: skip


class Stage(StrictModel):
    """A piece of the PINN's schedule with constant learning rates; a rate of 0 freezes."""

    until_epoch: PositiveInt = Field(description="first epoch of the next stage")
    layers: Literal["all", "last"] = Field(description="which layers of the networks are trained")
    rate_networks: NonNegativeFloat
    rate_unknowns: NonNegativeFloat
    rate_weights: NonNegativeFloat = Field(description="of the self-adaptive weights")


class PinnConfig(MethodSettings):
    """The paper's hybrid PINN: all layers from scratch, or from a source model in stages."""

    stages: tuple[Stage, ...] = Field(min_length=1)
    first_layer_slopes: tuple[float, float] | None = Field(
        description="start of the first layer on time scaled to [-1, 1]"
    )
    scale_t_em_k: PositiveFloat = Field(description="unit of the data residual of T_em")
    scale_rates: PositiveFloat = Field(description="further divisor of the residuals of the three rates")
    scale_x_r: PositiveFloat = Field(description="unit of the residual of x_r")
    fresh_dropout: bool = Field(description="the maps lose other neurons in every epoch; else one realisation a run")
    average_share: NonNegativeFloat = Field(le=1.0, description="of the epochs, at the end, whose mean is the estimate")
    weight_start: dict[str, PositiveFloat] = Field(description="alpha of the weights by channel")

    @property
    def scales(self) -> Scales:
        """Units of the residuals."""
        return Scales(self.scale_t_em_k, self.scale_rates, self.scale_x_r)

    @property
    def trained_epochs(self) -> int:
        """Epochs of all stages."""
        return self.stages[-1].until_epoch

    def schedule_of(self, epochs: int) -> dict[str, list[Stage]]:
        """The settings of a training of so many epochs, its stages in the same proportions."""
        share = epochs / self.trained_epochs
        ends = [max(1, round(share * stage.until_epoch)) for stage in self.stages]
        return {"stages": [s.model_copy(update={"until_epoch": end}) for s, end in zip(self.stages, ends, strict=True)]}
