"""What is believed of settled points before they are seen: sensors, submodels, the exhaust flap."""

from __future__ import annotations

from pydantic import Field, NonNegativeFloat, PositiveFloat

from dieseltwin.settings.strict import StrictModel


class PointSettings(StrictModel):
    """Errors that are believed of a test bed's settled points and of mean-value submodels, each with its reason.

    A submodel's error has two halves: one is smooth over its map's arguments, the other differs from point to point.
    """

    sensor_gain: NonNegativeFloat = Field(0.005, description="of every sensor, one standard deviation [-]: data sheets")
    sensor_offset: NonNegativeFloat = Field(0.003, description="the same of an offset, share of the median [-]")
    cylinder_flow: PositiveFloat = Field(0.008, description="error of volumetric efficiency [-]: Wahlstrom & Eriksson "
                                         "(2011) report 0.9 %; calibrated UW points 1.4 %")
    turbine_flow: PositiveFloat = Field(0.010, description="of the turbine's flow [-]: 2.5 % there, 1.3 % on UW")
    turbo_power: PositiveFloat = Field(0.020, description="of turbine over compressor power [-]: 4 to 7 % there")
    compressor_flow: PositiveFloat = Field(0.015, description="of the compressor's ellipse [-]: 2 to 4 % there")
    egr_flow: PositiveFloat = Field(0.020, description="of the EGR valve [-]: 4 to 5 % there")
    exhaust_temperature: PositiveFloat = Field(0.015, description="of the gas temperature [-]: 2 % there")
    measured_place: PositiveFloat = Field(0.010, description="of a further measured temperature or pressure [-]")
    smooth_share: float = Field(0.5, ge=0, le=1, description="of the variance of a submodel's error that is smooth: "
                                "residuals of neighbouring points are half correlated")
    left_share: float = Field(0.15, ge=0, le=1, description="of an explanation's gain that may be left: the "
                              "next round looks at it with refitted maps")
    least_explained: float = Field(0.2, ge=0, le=1, description="of the misfit that a name must explain "
                                   "where more is left")
    most_effects: int = Field(4, ge=1, description="that are named; on real points more were never told apart")
    flap_spread: PositiveFloat = Field(3.0, description="prior standard deviation of the exponents of the "
                                       "flap's law [-]")

    def error(self, submodel: str) -> float:
        """Whole error of a submodel [-]."""
        values = self.model_dump()
        return float(values.get(submodel, self.measured_place))

    def scatter(self, submodel: str) -> float:
        """Standard deviation of the half that differs from point to point [-]."""
        return float(self.error(submodel) * (1.0 - self.smooth_share) ** 0.5)

    def smooth_error(self, submodel: str) -> float:
        """Standard deviation of the smooth half [-]."""
        return float(self.error(submodel) * self.smooth_share**0.5)
