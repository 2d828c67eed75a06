"""What the balances of settled points say: measured beside predicted, for many parameter sets at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from dieseltwin.arrays import Array

SMALL_FLOW = 0.05  # of the median flow: relative residuals are damped below


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
    """`np.nanmedian` of all values without its overhead; there is one."""
    known = values[~np.isnan(values)]
    half = known.size // 2
    if known.size % 2:
        return float(np.partition(known, half)[half])
    low, high = np.partition(known, (half - 1, half))[half - 1 : half + 1]
    return float((low + high) / 2.0)


def log_ratio(measured: Array, predicted: Array) -> Array:
    """Logarithm of measured over predicted, as far as lanes differ, damped where both are small [-]."""
    middle = _middle(np.abs(measured)) if np.isfinite(measured).any() else 1.0
    floor = SMALL_FLOW * middle + 1e-9
    return np.log((np.maximum(measured, 0.0) + floor) / (np.maximum(predicted, 0.0) + floor))


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
