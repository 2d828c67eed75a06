"""Settings of the empirical surrogates (`params.yaml`, `pretrain.maps`)."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt

from dieseltwin.settings.strict import StrictModel

Widths = tuple[PositiveInt, ...]


class PaperMapsConfig(StrictModel):
    """Empirical surrogates as printed."""

    hidden: Widths
    activation: Literal["tanh", "sin", "relu", "silu", "softplus"]
    dropout_rel: NonNegativeFloat
    steps: PositiveInt = Field(description="Adam steps, one mini-batch each")
    batch: PositiveInt
    rate: PositiveFloat
    rate_end: PositiveFloat
    finish_steps: NonNegativeInt = Field(description="Gauss-Newton steps on all weights at the end; 0 for none")
    finish_maps: tuple[str, ...] = Field(description="maps that they are taken for")
    finish_cells: PositiveInt = Field(description="cells that the labels are averaged over for them")
    finish_ridge: NonNegativeFloat
    finish_missing: NonNegativeFloat = Field(description="weight of the error without one neuron, each neuron in turn")


class ImprovedMapsConfig(StrictModel):
    """Improved empirical surrogates: an ensemble of small networks, second-order least squares on averaged labels."""

    hidden: dict[str, Widths]
    cells: PositiveInt = Field(description="cells that the labels are averaged over")
    starts: PositiveInt = Field(description="random starts; the best is the nominal network")
    members: PositiveInt
    steps: PositiveInt = Field(description="Levenberg-Marquardt steps from a random start")
    refine_steps: PositiveInt = Field(description="steps of every later fit")
    rounds: NonNegativeInt = Field(description="corrections for the curvature within cells")
    accepted_cost_ratio: PositiveFloat = Field(description="of a start's cost to the best, up to which members use it")
    ridge: NonNegativeFloat
    first_layer_scale: PositiveFloat
    start_level: float
    spread: PositiveFloat = Field(description="factor on the members' standard deviation")


class MapsConfig(StrictModel):
    """Empirical surrogates: as printed, and improved."""

    paper: PaperMapsConfig
    improved: ImprovedMapsConfig
