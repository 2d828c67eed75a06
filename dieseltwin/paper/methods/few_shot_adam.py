"""`few-shot-adam`: the paper's few-shot transfer, everything as printed: learned bodies, maps and operators."""

from __future__ import annotations

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt

from dieseltwin.settings.method_settings import MethodSettings
from dieseltwin.settings.methods import Method, MethodStyle, Needs


class AdamConfig(MethodSettings):
    """The paper's loop: Adam on heads, unknowns and self-adaptive weights."""

    epochs: PositiveInt
    weights_until_epoch: PositiveInt
    rate_heads: PositiveFloat
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
    weight_start: dict[str, PositiveFloat]
    held_out_share: NonNegativeFloat = Field(default=0.0, lt=1.0, description="readings no loss sees: early stopping")
    weight_share: PositiveFloat = Field(default=1.0, description="factor on the starting weights")

    @property
    def trained_epochs(self) -> int:
        """Epochs of the loop."""
        return self.epochs


METHOD = Method(
    name="few-shot-adam",
    estimate="dieseltwin.paper.loops.few_shot_adam",
    settings=AdamConfig,
    style=MethodStyle("#009E73", "^", "-.", "few-shot-adam"),
    learned="maps, operators and bodies learned",
    rank=30,
    needs=Needs(bodies="bodies_paper.pt", operators="operators.pt", maps="paper"),
    extra="networks",
    with_epochs=True,
    varied=frozenset({"held_out_share", "weight_share", "scale_x_r", "start"}),
)
