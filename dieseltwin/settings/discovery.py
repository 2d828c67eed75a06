"""Sections of `params.yaml` for discovery, its proof and the registry of the networks: see `settings.params`."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt

from dieseltwin.settings.search import SearchConfig
from dieseltwin.settings.strict import StrictModel


class PaperMapsLimits(StrictModel):
    """Limits of the maps as printed, where the others' are for the maps that the champion serves."""

    monotony: NonNegativeFloat
    driving: NonNegativeFloat


class AcceptanceConfig(StrictModel):
    """Largest figures with which networks pass the physical tests (`identification.acceptance`); null: not tested."""

    balances: NonNegativeFloat | None = Field(description="imbalance of mass or power at settled points [-]")
    rest: NonNegativeFloat | None = Field(description="distance of the rest from the engine's own [-]")
    ranges: NonNegativeFloat | None = Field(description="share of rows with a value that can't be [-]")
    monotony: NonNegativeFloat | None = Field(description="share of moves of a flow against physics [-]")
    driving: NonNegativeFloat | None = Field(description="error of a state over its mean in held-out driving [-]")
    known_engine: NonNegativeFloat | None = Field(description="error of health over its stated standard deviation [-]")
    paper: PaperMapsLimits

    def of_maps(self, kind: str) -> AcceptanceConfig:
        """The limits of one kind of maps; a test that is left out is left out for each."""
        if kind != "paper":
            return self
        monotony = None if self.monotony is None else self.paper.monotony
        driving = None if self.driving is None else self.paper.driving
        return self.model_copy(update={"monotony": monotony, "driving": driving})


class PromotionConfig(StrictModel):
    """When newly trained networks take over from those in use (MLflow's registry)."""

    seed: NonNegativeInt = Field(description="of the driving that both are compared on")
    minutes: PositiveFloat
    mean_ratio_max: PositiveFloat = Field(description="geometric mean over the errors, new / in use")
    worst_ratio_max: PositiveFloat = Field(description="the same of every single error")
    acceptance: AcceptanceConfig


class DiscoverConfig(StrictModel):
    """Discovery: what it believes of the twin and decides by, and the concealed recording of the chain."""

    map_tolerance: NonNegativeFloat = Field(description="rms of the smooth error that is believed of the maps [-]")
    seed: NonNegativeInt
    concealed_seed: NonNegativeInt = Field(description="of the concealed recording that the flow makes for itself")
    minutes_max: PositiveFloat | None = Field(description="of driving that are judged of a longer recording; null: all")
    time_s: PositiveFloat | None = Field(description="of a whole discovery of a recording [s]; null: any")
    search: SearchConfig


class LearnConfig(StrictModel):
    """Learning an engine from recordings of when it was well."""

    map_error: PositiveFloat = Field(description="rms of the maps' errors that is believed of the base's family [-]")
    type_share: float = Field(ge=0.0, le=1.0, description="of their variance that engines of one type share [-]")
    misfit_max: PositiveFloat = Field(description="squared whitened residual over its degrees of freedom; more is "
                                    "another engine")
    misfit_level: float = Field(gt=0.0, lt=1.0, description="probability that few readings of a healthy engine leave "
                                "more than is allowed, by chance alone and of all recordings together [-]")
    suspicious_gain: PositiveFloat = Field(description="of an effect in the reference, beyond all that is believed")
    seed: NonNegativeInt = Field(description="of the draws by which windows are left out that don't act linearly")


class ProofConfig(StrictModel):
    """The concealed benchmark (docs/benchmark.md)."""

    cases: PositiveInt
    seed: NonNegativeInt
    tier: Literal["main", "one-percent"]
    sensors: Literal[5, 6] = Field(description="5: the paper's; 6: with w_c")
    duration_s: PositiveFloat
    baseline_cases: NonNegativeInt = Field(description="the Kalman and neural baselines run on the first so many")
