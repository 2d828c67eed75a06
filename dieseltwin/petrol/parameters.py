"""The engine file of a petrol engine: geometry, calibrated maps with their covariance, tolerances, thresholds."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import Field, model_validator

from dieseltwin.atomic import write_text
from dieseltwin.errors import InputError
from dieseltwin.petrol.recording import Geometry
from dieseltwin.settings.strict import StrictModel, read_mapping, validate

Array = NDArray[np.float64]
KIND = "petrol"


class Volumes(StrictModel):
    """Volumes [m3]: displacement, intake manifold, intercooler with pipes."""

    V_d: float = Field(1.953e-3, gt=0)
    V_im: float = Field(1.8e-3, gt=0)
    V_ic: float = Field(4.7e-3, gt=0)

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
        drift: of an anchor every five minutes: warm-up [-].
        throttle_zero_pct: of the throttle's closed position, which the controller learns anew [%].
        boost_level: of p_ic against p_amb at rest [-].
        cooler_level: of T_ic against T_amb [-].
    """

    cylinder_level: float = 0.02
    throttle_level: float = 0.02
    cylinder_field: float = 0.02
    throttle_field: float = 0.02
    drift: float = 0.01
    throttle_zero_pct: float = 0.15
    boost_level: float = 0.002
    cooler_level: float = 0.03


class Detection(StrictModel):
    """When a mismatch is reported, from fault-free pieces that the maps did not see.

    Attributes:
        threshold: of twice the gain in log-likelihood [-].
        piece_scores: the largest score of each piece that it was set with.
        piece_s: length of those pieces [s].
    """

    threshold: float = Field(40.0, gt=0)
    piece_scores: tuple[float, ...] = ()
    piece_s: float = 300.0

    def stretch(self, duration_s: float) -> float:
        """How much larger scores are than in a piece: a systematic error gathers evidence in proportion to time [-]."""
        return max(duration_s / self.piece_s, 1.0)

    def for_duration(self, duration_s: float) -> float:
        """Threshold for a recording of another length [-]."""
        return self.threshold * self.stretch(duration_s)


class PetrolParameters(StrictModel):
    """A calibrated petrol engine."""

    kind: Literal["petrol"] = "petrol"
    name: str = "liu_petrol"
    volumes: Volumes = Volumes()
    cylinder: SplineMap | None = None
    throttle: SplineMap | None = None
    boost_level: float = 0.0
    cylinder_spread: Spread = Spread(base=0.015)
    throttle_spread: Spread = Spread(base=0.015)
    boost_spread: Spread = Spread(base=0.0004)
    cooler_spread: Spread = Spread(base=0.004, tempering=20.0)
    tolerances: Tolerances = Tolerances()
    detection: Detection = Detection()
    calibrated_on: str = ""
    source: str = "Jung, Frisk, Krysander 2024, arXiv 2408.13269"

    @property
    def calibrated(self) -> bool:
        """Whether it has its maps."""
        return self.cylinder is not None and self.throttle is not None


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
                         "run `dieseltwin calibrate RECORDING --base liu_petrol --out FILE` on a fault-free recording")
    return found


def save_petrol(parameters: PetrolParameters, path: str | Path) -> Path:
    """Write the engine file atomically; numbers with six digits."""
    text = yaml.safe_dump(_rounded(parameters.model_dump(mode="json")), sort_keys=False, default_flow_style=None,
                          width=118)
    return write_text(path, text)


def _rounded(value: object) -> object:
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {k: _rounded(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_rounded(v) for v in value]
    return value
