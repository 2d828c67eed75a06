"""The four unknown health parameters: masks, scalings and starting values of the paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dieseltwin.engine import HEALTH, EngineParameters
from dieseltwin.errors import InputError

__all__ = ["HEALTH", "SCALES", "health_of", "physical_columns", "start_centre",
           "starts", "to_masked", "to_physical"]  # fmt: skip

SCALES: NDArray[np.float64] = np.array([1e-4, 1e-4, 1.0, 10.0])
"""Scaling that follows the mask: exp, exp, softplus, exp (paper, table of true values of parameters)."""

_SOFTPLUS = 2
"""Index of eta_sc, the only unknown with the softplus mask."""


def to_physical(masked: Any, xp: ModuleType = np) -> Any:
    """Map masked unknowns to SI values by exp, exp, softplus, exp and the scalings 1e-4, 1e-4, 1, 10.

    Source: paper, table "True value of estimated parameters", rows mask function and scaling.

    Args:
        masked: (.., 4) array or tensor, any real numbers [-].
        xp: array namespace of `masked`, numpy or torch.

    Returns:
        (.., 4) values [m2, m2, -, W/(m2 K)], all positive.
    """
    return xp.stack(physical_columns([masked[..., i] for i in range(len(HEALTH))], xp), -1)


def physical_columns(masked: Sequence[Any], xp: ModuleType = np) -> list[Any]:
    """`to_physical` of four arrays of equal shape, one after the other."""
    eta_sc = masked[_SOFTPLUS]
    # The shifted form of log(1 + exp(x)) neither overflows nor loses small values.
    softplus = xp.clip(eta_sc, 0.0, None) + xp.log1p(xp.exp(-xp.abs(eta_sc)))
    return [softplus if i == _SOFTPLUS else xp.exp(v) * SCALES[i] for i, v in enumerate(masked)]


def to_masked(physical: ArrayLike) -> NDArray[np.float64]:
    """Invert `to_physical`.

    Args:
        physical: (.., 4) positive values [m2, m2, -, W/(m2 K)].

    Returns:
        (.., 4) masked values [-].

    Raises:
        InputError: a value is not positive and finite.
    """
    values = np.asarray(physical, dtype=np.float64)
    if values.shape[-1:] != (len(HEALTH),):
        raise InputError(
            "unknown parameters", f"shape {values.shape}", f"(.., 4) in the order {HEALTH}", "give all four"
        )
    if not np.all(np.isfinite(values) & (values > 0.0)):
        raise InputError(f"values of {HEALTH}", values.tolist(), "positive finite numbers", "check the engine file")
    scaled = values / SCALES
    masked = np.log(scaled)
    eta_sc = scaled[..., _SOFTPLUS]
    masked[..., _SOFTPLUS] = eta_sc + np.log(-np.expm1(-eta_sc))
    return masked


def health_of(parameters: EngineParameters | Mapping[str, float]) -> NDArray[np.float64]:
    """Take the four health values out of a parameter set.

    Args:
        parameters: EngineParameters, or a mapping with the names of `HEALTH`.

    Returns:
        (4,) values [m2, m2, -, W/(m2 K)].
    """
    if isinstance(parameters, EngineParameters):
        return parameters.health()
    return np.array([float(parameters[name]) for name in HEALTH])


def start_centre(parameters: EngineParameters, truth: Mapping[str, float] | None, start_at: str) -> NDArray[np.float64]:
    """Centre of the starts: the engine file's health parameters, (4,) [m2, m2, -, W/(m2 K)].

    `start_at` "truth" takes the true ones, where a recording knows them; others start at the file's all the same.
    """
    return health_of(truth if start_at == "truth" and truth is not None else parameters)


def starts(centre: ArrayLike, runs: int, rng: np.random.Generator, sigma: float) -> NDArray[np.float64]:
    """Draw starting values of the unknowns: Gaussian in masked space around a centre.

    The centre is the laboratory set: nobody knows the truth. Only the extra set of runs that repeats the paper's "near
    the true values" passes the truth.

    Args:
        centre: (4,) values around which to start [m2, m2, -, W/(m2 K)].
        runs: number of members R.
        rng: source of the draws.
        sigma: standard deviation in masked space [-]; 0 starts every member at the centre.

    Returns:
        (R, 4) starting values [m2, m2, -, W/(m2 K)].

    Raises:
        InputError: `runs` < 1 or `sigma` < 0.
    """
    if runs < 1:
        raise InputError("runs", runs, "1 or more", "ask for at least one run")
    if sigma < 0.0:
        raise InputError("start sigma", sigma, "0 or more", "use 0 to start every run at the centre")
    masked = to_masked(centre) + sigma * rng.standard_normal((runs, len(HEALTH)))
    return np.asarray(to_physical(masked))
