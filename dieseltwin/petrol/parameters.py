"""The engine file of a petrol engine: geometry, calibrated maps with their covariance, tolerances, effects found."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import yaml
from pydantic import Field, NonNegativeFloat, model_validator

from dieseltwin.arrays import Array
from dieseltwin.atomic import write_text
from dieseltwin.errors import InputError
from dieseltwin.petrol.blocks import Geometry
from dieseltwin.sealed import sealed_text
from dieseltwin.settings.strict import StrictModel, read_mapping, validate, where_told

KIND = "petrol"
FILLED = ("V_im", "V_ic")  # volumes whose filling is learned


class Volumes(StrictModel):
    """Volumes [m3]: displacement, intake manifold, intercooler with pipes; `spread` of those of `FILLED`: relative
    standard deviations with which their filling was learned [-]."""

    V_d: float = Field(1.953e-3, gt=0)
    V_im: float = Field(1.8e-3, gt=0)
    V_ic: float = Field(4.7e-3, gt=0)
    spread: tuple[NonNegativeFloat, NonNegativeFloat] = (0.0, 0.0)

    @property
    def geometry(self) -> Geometry:
        """As the balances take them."""
        return Geometry(self.V_d, self.V_im, self.V_ic)


class SplineMap(StrictModel):
    """A map of two arguments: knots, coefficients, and the lower Cholesky factor of the coefficients' covariance."""

    knots_x: tuple[float, ...]
    knots_y: tuple[float, ...]
    coefficients: tuple[float, ...]
    covariance_factor: tuple[tuple[float, ...], ...]

    @model_validator(mode="after")
    def _sizes(self) -> SplineMap:
        if [len(row) for row in self.covariance_factor] != list(range(1, len(self.coefficients) + 1)):
            raise ValueError("covariance_factor has to be lower triangular, a row for each coefficient")
        return self

    @property
    def covariance(self) -> Array:
        """(k, k) covariance of the coefficients."""
        factor = np.zeros((len(self.coefficients),) * 2)
        for i, row in enumerate(self.covariance_factor):
            factor[i, : i + 1] = row
        return np.asarray(factor @ factor.T)


class Spread(StrictModel):
    """Scatter of one balance over a block: a Student-t scale that grows with how unsteady the block is.

    scale**2 = base**2 + sum(rates_j**2 * unsteadiness_j**2); `tempering` divides the log-likelihood: neighbouring
    blocks are correlated, (1 + rho)/(1 - rho).
    """

    base: float = Field(gt=0)
    rates: tuple[float, ...] = ()
    tempering: float = Field(1.0, ge=1.0)


class Tolerances(StrictModel):
    """What may differ between two healthy recordings (standard deviations).

    Attributes:
        cylinder_level, throttle_level: of a whole recording, air-flow sensor included [-].
        cylinder_field, throttle_field: smooth, over the map [-].
        drift: of both flow balances, of an anchor every five minutes: warm-up [-].
        boost_drift, cooler_drift: the same of the other two; 0.01 of the cooler's temperature is 3 K [-].
        throttle_zero_pct: of the throttle's closed position, which the controller learns anew [%].
        boost_level: of p_ic against p_amb at rest [-].
        cooler_level: of T_ic against T_amb [-].
        p_im_gain, p_im_offset_pa: of the manifold's pressure sensor [-], [Pa].
        clock: of the delay of each channel, share of the one that is of interest: a part of a row [-].
    """

    cylinder_level: float = 0.02
    throttle_level: float = 0.02
    cylinder_field: float = 0.02
    throttle_field: float = 0.02
    drift: float = 0.01
    boost_drift: float = 0.0005
    cooler_drift: float = 0.01
    throttle_zero_pct: float = 0.15
    boost_level: float = 0.002
    cooler_level: float = 0.03
    p_im_gain: float = 0.005
    p_im_offset_pa: float = 200.0
    clock: float = 0.1


class FaultFreePiece(StrictModel):
    """A piece of the fault-free recording, judged with maps that did not see it.

    Attributes:
        start_s, end_s: where it lies [s].
        gain: of the strongest effect, decrease of -2 log likelihood.
        name: of that effect.
        alarm: whether it would have been reported.
    """

    start_s: float
    end_s: float
    gain: float
    name: str
    alarm: bool


class PetrolTerm(StrictModel):
    """An effect that was found and is part of the twin.

    Attributes:
        effect: name, see `petrol.effects`.
        magnitude, std: its size and standard deviation [unit of the effect].
        onset_s: time stamp since when it acts in the recording `found_in` [s]; None for all along. In every other
            recording it is taken to be there from the first row on.
        until_s, grown_s: as of `engine.courses.course`, in that recording.
        found_in: SHA-256 of the recording that it was found in.
        valid_for: the driving behind it, in words.
    """

    effect: str
    magnitude: float
    std: float | None = Field(None, ge=0)
    onset_s: float | None = None
    until_s: float | None = where_told()
    grown_s: float | None = where_told()
    found_in: str = ""
    valid_for: str = ""


class PetrolParameters(StrictModel):
    """A calibrated petrol engine; `clocks` are delays of its channels by their effects' names [s]."""

    kind: Literal["petrol"] = "petrol"
    name: str = "liu_petrol"
    volumes: Volumes = Volumes()
    cylinder: SplineMap | None = None
    throttle: SplineMap | None = None
    boost_level: float = 0.0
    clocks: dict[str, float] = Field(default_factory=dict)
    cylinder_spread: Spread = Spread(base=0.015)
    throttle_spread: Spread = Spread(base=0.015)
    boost_spread: Spread = Spread(base=0.0004)
    cooler_spread: Spread = Spread(base=0.004, tempering=20.0)
    tolerances: Tolerances = Tolerances()
    pieces: tuple[FaultFreePiece, ...] = ()
    terms: tuple[PetrolTerm, ...] = ()
    calibrated_on: str = ""
    source: str = "Jung, Frisk, Krysander 2024, arXiv 2408.13269"

    @property
    def calibrated(self) -> bool:
        """Whether it has its maps."""
        return self.cylinder is not None and self.throttle is not None

    @property
    def maps(self) -> tuple[SplineMap, SplineMap]:
        """Maps of the cylinders and of the throttle.

        Raises:
            InputError: not calibrated.
        """
        if self.cylinder is None or self.throttle is None:
            raise InputError(f"engine {self.name}: cylinder, throttle", "no maps", "a calibrated engine",
                             "run `dieseltwin learn HEALTHY --engine ENGINE --out FILE` with this one as ENGINE")
        return self.cylinder, self.throttle


def is_petrol(path: str | Path) -> bool:
    """Whether an engine file is of this kind (`kind: petrol`)."""
    return read_mapping(path).get("kind") == KIND


def load_petrol(path: str | Path) -> PetrolParameters:
    """Read a calibrated engine file.

    Raises:
        InputError: not readable, an unknown key, or without maps.
    """
    found = validate(PetrolParameters, read_mapping(path), str(path))
    if not found.calibrated:
        raise InputError(f"{path}: cylinder, throttle", "no maps", "a calibrated engine",
                         f"run `dieseltwin learn HEALTHY --engine {path} --out FILE` and name FILE")
    return found


def save_petrol(parameters: PetrolParameters, path: str | Path) -> Path:
    """Write the engine file atomically; numbers with six digits."""
    content = _rounded(parameters.model_dump(mode="json"))
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=118)
    return write_text(path, sealed_text(text))


def _rounded(value: object) -> object:
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {k: _rounded(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_rounded(v) for v in value]
    return value
