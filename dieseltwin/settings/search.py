"""Section `discover.search` of `params.yaml`: what the search decides by, for each kind of machine.

The numbers stand in the file with their reasons. Gains are decreases of -2 log marginal likelihood.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt

from dieseltwin.settings.strict import StrictModel


class SearchSettings(StrictModel):
    """Thresholds of the search on one kind of machine; `withhold` and `seed` are of the question that is asked."""

    sensor_gain: NonNegativeFloat = Field(description="tolerance of every sensor's gain, one standard deviation [-]")
    sensor_offset: NonNegativeFloat = Field(description="the same of its offset, share of its middle reading [-]")
    tolerance_factor: NonNegativeFloat = Field(description="on the map tolerances of the twin's points [-]")
    alarm_level: PositiveFloat = Field(description="probability of a false alarm by chance alone [-]")
    alarm_gain: PositiveFloat = Field(description="that a mismatch needs at least, whatever chance says")
    alarm_size: NonNegativeFloat = Field(description="and this share of the effect's tolerance of interest [-]")
    beside_size: NonNegativeFloat = Field(description="the same of a lesser effect beside one of that size [-]")
    least_share: float = Field(gt=0, le=0.5, description="of the samples that an onset or a region must act on, and "
                               "leave out [-]")
    least_spread: float = Field(ge=0, le=1, description="share of its gain (`score.spread`) that a finding near its "
                                "bar must keep without its best window [-]")
    unstick: bool = Field(description="whether a refit that found no way down gets sensitivities of its own")
    refits: PositiveInt = Field(description="names that are refitted at least, however little their linear score says")
    second_gain: NonNegativeFloat = Field(description="that a second effect must add; it must keep that share of it")
    other_pair_gain: NonNegativeFloat = Field(description="that two effects must be ahead of the best single one "
                                              "where that isn't among them")
    hanging_second_gain: NonNegativeFloat = Field(description="that a second effect must add that hangs on one window")
    second_size_std: NonNegativeFloat = Field(description="standard deviations, widened by what is left, that the size "
                                              "of either of two effects must be away from nought")
    variant_gain: NonNegativeFloat = Field(description="that an onset or a region must add")
    hidden_gain: NonNegativeFloat = Field(description="of an onset or a region that raises an alarm by itself")
    profile_gain: NonNegativeFloat = Field(description="that a size that differs between recordings must be ahead of "
                                           "one size for all")
    hidden_profile_gain: NonNegativeFloat = Field(description="of such a size that raises an alarm by itself")
    unnamed_gain: NonNegativeFloat = Field(description="of a term without a name that raises an alarm by itself, where "
                                           "it keeps that share of it")
    unnamed_sensor_gain: NonNegativeFloat = Field(description="the same of a sensor's fault")
    law_gain: NonNegativeFloat = Field(description="that a law outside the catalogue must be ahead of the best name")
    left_gain: tuple[float, float, float] = Field(description="of a term without a name beyond the chosen explanation, "
                                                  "above which that is refused: one effect; two; an onset or a region")
    left_share: tuple[float, float, float] = Field(description="the same as shares of the explanation's own gain [-]")
    left_ahead: NonNegativeFloat = Field(description="that such a term must be ahead of the best second effect")
    local_gain: NonNegativeFloat = Field(description="of a bump over an argument of a map that raises an alarm, or "
                                         "beyond an explanation refuses it")
    missing_share: NonNegativeFloat = Field(description="of an explanation's gain that it may leave before more is "
                                            "said to be missing [-]")
    equivalent_gain: NonNegativeFloat = Field(description="within which names can't be told apart")
    equivalent_share: NonNegativeFloat = Field(description="the same as a share of the gain [-]")
    edges_share: NonNegativeFloat = Field(description="of the gain of an effect in a region: closer names can't be "
                                          "told apart [-]")
    unnamed_simulated_from: NonNegativeFloat | None = Field(
        description="gain by its linear score from which a term without a name is simulated before it raises no alarm; "
        "null: never"
    )
    rivals_from: NonNegativeFloat = Field(
        description="gain of what an explanation leaves from which terms without a name are refitted against it"
    )
    chance_leaves: PositiveFloat = Field(description="gain of the best term without a name beyond a right explanation")
    believed_range: float = Field(gt=1, description="of magnitudes over their tolerance, log-uniform [-]")
    own_metric_gain: PositiveFloat | None = Field(description="from which leading explanations are compared with the "
                                                  "nuisances of each about itself; null: never")
    standing_from: PositiveFloat | None = Field(description="chi-square per reading that health leaves, from which a "
                                                "valve that stands still is looked for; null: never")
    standing_share: float = Field(gt=0, le=1, description="of what health leaves beyond noise, that such a valve must "
                                  "explain [-]")
    withhold: tuple[str, ...] = Field((), description="effects to do without, besides those that a command names")
    seed: NonNegativeInt = Field(0, description="of the bootstrap; a command's --seed takes its place")

    def asked(self, withhold: tuple[str, ...], seed: int) -> SearchSettings:
        """The same with what a question adds."""
        return self.model_copy(update={"withhold": (*self.withhold, *withhold), "seed": seed})

    def in_own_metrics(self, gain: float) -> bool:
        """Whether leading explanations of that gain are compared with the nuisances of each about itself."""
        return self.own_metric_gain is not None and gain > self.own_metric_gain


class SubmodelErrors(StrictModel):
    """Errors that are believed of mean-value submodels on settled points, one standard deviation [-].

    They have two halves: one is smooth over the map's arguments, the other differs from point to point.
    """

    cylinder_flow: PositiveFloat
    turbine_flow: PositiveFloat
    turbo_power: PositiveFloat = Field(description="of turbine over compressor power")
    compressor_flow: PositiveFloat = Field(description="of the compressor's ellipse")
    egr_flow: PositiveFloat
    exhaust_temperature: PositiveFloat
    measured_place: PositiveFloat = Field(description="of any further measured temperature or pressure")
    smooth_share: float = Field(ge=0, le=1, description="of the variance that is smooth")

    def error(self, submodel: str) -> float:
        """Whole error of a submodel [-]."""
        values: dict[str, float] = self.model_dump()
        return values.get(submodel, self.measured_place)

    def scatter(self, submodel: str) -> float:
        """Standard deviation of the half that differs from point to point [-]."""
        return float(self.error(submodel) * (1.0 - self.smooth_share) ** 0.5)

    def smooth_error(self, submodel: str) -> float:
        """Standard deviation of the smooth half [-]."""
        return float(self.error(submodel) * self.smooth_share**0.5)


class PointSettings(SearchSettings):
    """Settled points: the search of each round, when the rounds end, and what is believed of the submodels."""

    submodels: SubmodelErrors
    map_beside_reference: PositiveFloat = Field(description="smooth error of every map that a reference is there to "
                                                "tell, one standard deviation, at least that of the submodel [-]")
    least_explained: float = Field(ge=0, le=1, description="of the misfit that a name must explain where more is left")
    onset_share: float = Field(gt=0, lt=0.5, description="of the judged points that must lie before a point from which "
                               "on something is there, and behind it [-]")
    most_effects: PositiveInt = Field(description="that are named")
    flap_spread: PositiveFloat = Field(description="prior standard deviation of the exponents of the exhaust flap's "
                                       "law [-]")
    rough_maps: tuple[Annotated[float, Field(gt=1)], ...] = Field(
        description="times what is believed of the maps, that are tried on what has no name without a reference; "
        "[]: none [-]"
    )


class RigSettings(SearchSettings):
    """Machines that are no engines: the search of each round, when the rounds end, and what a finding must foretell."""

    least_explained: float = Field(ge=0, le=1, description="of the misfit that a name must explain where more is left")
    most_effects: PositiveInt = Field(description="that are named")
    onset_share: float = Field(gt=0, lt=0.5, description="of the samples that must lie before an onset, and behind it "
                               "[-]")
    checked_share: float = Field(gt=0, lt=1, description="of the recording, its end, that a finding must foretell "
                                 "which was fitted to the rest [-]")
    loss_of_name: PositiveFloat = Field(description="on the error there, up to which a name is kept [-]")
    gain_of_law: PositiveFloat = Field(description="on the error there, up to which a law is kept [-]")


class CircumstanceSettings(StrictModel):
    """What is believed of all that a recording doesn't say, one standard deviation each, and when it is put right."""

    p_amb_pa: PositiveFloat = Field(description="ambient pressure without a column, about the engine file's [Pa]")
    t_amb_k: PositiveFloat = Field(description="ambient temperature without a column, about the engine file's [K]")
    p_amb_read_pa: PositiveFloat = Field(description="a reading of the ambient pressure [Pa]")
    t_amb_read_k: PositiveFloat = Field(description="a reading of the ambient temperature [K]")
    drift_pa: PositiveFloat = Field(description="change of the ambient pressure over a recording, no column [Pa]")
    t_im_k: PositiveFloat = Field(description="temperature of the charge behind its cooler, no column [K]")
    t_im_read_k: PositiveFloat = Field(description="a reading of it, and where before the valves it is taken [K]")
    fuel_scale: PositiveFloat = Field(description="scale of the fuel signal times the fuel's heating value [-]")
    time_shift_s: PositiveFloat = Field(description="a channel's clock, where channels aren't in time [s]")
    k_cflow: PositiveFloat = Field(description="how far a learned engine's compressor's efficiency goes by corrected "
                                   "flow, about halfway [-]")
    k_cspeed: PositiveFloat = Field(description="the same of its flow and corrected speed [-]")
    evidence: NonNegativeFloat = Field(description="for clocks that are off, from which they are put right")
    ahead: NonNegativeFloat = Field(description="that they must be ahead of what an effect would add in their place")
    several: PositiveInt = Field(description="clocks off, from which none is trusted")
    jitter_rows: NonNegativeFloat = Field(description="of a channel that was put right, where its signal has kinks "
                                          "between rows [rows]")


class SearchConfig(StrictModel):
    """One set of thresholds; a kind of machine changes what differs for it, with its reason."""

    driving: SearchSettings = Field(description="recordings of the diesel engine")
    points: PointSettings = Field(description="its settled points")
    petrol: SearchSettings = Field(description="recordings of a petrol engine")
    rigs: RigSettings = Field(description="recordings of machines that are no engines")
    circumstances: CircumstanceSettings = Field(description="recordings of the diesel engine")
