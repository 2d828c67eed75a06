"""What the balances of settled points say: measured beside predicted, for many parameter sets at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from dieseltwin.arrays import Array
from dieseltwin.recordings.steady_points import COMPRESSION, SteadyPoints

SMALL_FLOW = 0.05  # of the median flow: relative residuals are damped below
HEAT_CAPACITY, EFFICIENCY = 1005.0, 0.7  # J/(kg K), and of a compressor [-]: for the size of its power alone


@dataclass(frozen=True)
class Relations:
    """What the balances say at B parameter sets and n points.

    Attributes:
        residual: (B, n, R) logarithm of measured over predicted, NaN where a reading is missing.
        pairs: row name -> what was measured and what is predicted, as far as lanes differ.
        intermediate: as `quantities`, as far as lanes differ.
    """

    residual: Array
    pairs: Mapping[str, tuple[Any, Any]]
    intermediate: Mapping[str, Any]

    @cached_property
    def measured(self) -> Mapping[str, Array]:
        """Row name -> (B, n) [unit of the quantity]."""
        return {name: spread(values, self.residual.shape[:2]) for name, (values, _) in self.pairs.items()}

    @cached_property
    def predicted(self) -> Mapping[str, Array]:
        """Row name -> (B, n) [unit of the quantity]."""
        return {name: spread(values, self.residual.shape[:2]) for name, (_, values) in self.pairs.items()}

    @cached_property
    def quantities(self) -> Mapping[str, Array]:
        """Every intermediate quantity by the paper's symbol -> (B, n) [SI]."""
        return {name: spread(values, self.residual.shape[:2]) for name, values in self.intermediate.items()}


def spread(values: Any, shape: tuple[int, ...]) -> Array:
    """`np.broadcast_to`, which takes longer than an equation, where it has something to do."""
    return values if np.shape(values) == shape else np.broadcast_to(values, shape)


def _middle(values: Array) -> float:
    """`np.nanmedian` of all values without its overhead; NaN where there is none."""
    known = values[~np.isnan(values)]
    if not known.size:
        return np.nan
    half = known.size // 2
    if known.size % 2:
        return float(np.partition(known, half)[half])
    low, high = np.partition(known, (half - 1, half))[half - 1 : half + 1]
    return float((low + high) / 2.0)


def middle_sizes(points: SteadyPoints) -> dict[str, float]:
    """Submodel -> size of what it balances at the middle one of the points, as read; without those that weren't.

    By readings alone: residuals of many lanes at once are differences of one another, and a size that followed the
    lanes would let each of them depend on all others.
    """
    none = np.full(points.size, np.nan)
    p_im, W_c, W_egr, T_em = (points.columns.get(n, none) for n in ("p_im_pa", "w_c_kg_s", "w_egr_kg_s", "t_em_k"))
    T_0 = points["t_amb_k"]
    power = W_c * HEAT_CAPACITY * T_0 * ((p_im / points["p_amb_pa"]) ** COMPRESSION - 1.0) / EFFICIENCY
    sizes = {"cylinder_flow": W_c + W_egr, "turbine_flow": W_c, "turbo_power": power, "compressor_flow": W_c,
             "egr_flow": W_egr, "exhaust_temperature": T_em}  # fmt: skip
    found = {row: _middle(np.abs(values)) for row, values in sizes.items()}
    return {row: size for row, size in found.items() if np.isfinite(size)}


def log_ratio(measured: Array, predicted: Array, size: float | None = None) -> Array:
    """Logarithm of measured over predicted, as far as lanes differ, damped where both are small [-].

    Args:
        measured, predicted: (B, n) or (n,).
        size: at the middle point; None: that of each lane itself.
    """
    if size is None:
        lanes = np.abs(np.atleast_2d(measured))
        middle: Any = np.nan_to_num([[_middle(lane)] for lane in lanes], nan=1.0)
        middle = middle if np.ndim(measured) > 1 else float(middle[0, 0])
    else:
        middle = size
    floor = SMALL_FLOW * middle + 1e-9
    return np.asarray(np.log((np.maximum(measured, 0.0) + floor) / (np.maximum(predicted, 0.0) + floor)))


def cooled_charge(T_air: Any, T_0: Any, known: Mapping[str, Any], belief: Callable[[str], Any]) -> Any:
    """Charge temperature [K]: air behind its cooler mixed with EGR behind its own, both of one heat capacity.

    Args:
        T_air: of the air, were nothing lost in its cooler [K].
        T_0: ambient [K].
        known: T_c, T_em [K], W_c, W_egr [kg/s].
        belief: "charge_cooler_loss" [-], "egr_coolant" [K] and "egr_heating" [-] by name.
    """
    T_air = T_air + belief("charge_cooler_loss") * (known["T_c"] - T_0)
    coolant = belief("egr_coolant")
    T_egr = coolant + belief("egr_heating") * (known["T_em"] - coolant)
    return T_air + known["W_egr"] / (known["W_c"] + known["W_egr"]) * (T_egr - T_air)
