"""The few array primitives that the engine's equations are written in, one binding per backend.

The equations of `manifolds`, `cylinder`, `egr`, `turbocharger`, `actuators` and `model` call these names as globals.
`binding.bind` re-creates the same functions with the primitives of another backend, so that the compiled simulator,
the differentiable physics residual and the plots share one text per formula.

`root` and `positive_power` are the square root and the power of ``max(x, 0)``. They are primitives because their
derivative at zero is infinite: the torch versions return a zero gradient there (the limiter is active), where a
plain ``sqrt(clamp(x))`` would return NaN.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

Array = Any
"""A float, a numpy array, a torch tensor or a numba scalar: whatever the bound backend computes with."""

PRIMITIVES = (
    "exp", "root", "positive_power", "maximum", "minimum", "where", "with_ambient_pressure", "with_charge",
)  # fmt: skip


def exp(x: Array) -> Array:
    """e**x [-]."""
    return np.exp(x)


def root(x: Array) -> Array:
    """Square root of max(x, 0)."""
    return np.sqrt(np.maximum(x, 0.0))


def positive_power(x: Array, exponent: Array) -> Array:
    """max(x, 0)**exponent; 0 for x <= 0, and NaN stays NaN: a missing reading must not become a number."""
    nothing = np.asarray(x) <= 0.0
    if not nothing.any():
        return np.power(x, exponent)
    return np.where(nothing, 0.0, np.power(np.where(nothing, 1.0, x), exponent))


def maximum(a: Array, b: Array) -> Array:
    """The larger of a and b, element by element."""
    return np.maximum(a, b)


def minimum(a: Array, b: Array) -> Array:
    """The smaller of a and b, element by element."""
    return np.minimum(a, b)


def where(condition: Array, a: Array, b: Array) -> Array:
    """a where the condition holds, b elsewhere (both are evaluated)."""
    return np.where(condition, a, b)


def with_ambient_pressure(c: Any, pressure: Array) -> Any:
    """The constants with another pressure [Pa] in place of p_amb: before the compressor or behind the turbine."""
    return c._replace(p_amb=pressure)


def with_charge(c: Any, T_im: Array, eta_sc: Array) -> Any:
    """The constants with another intake manifold temperature [K] and compensation factor of the cycle [-]."""
    return c._replace(T_im=T_im, eta_sc=eta_sc)


def torch_primitives() -> dict[str, Callable[..., Any]]:
    """The primitives over torch tensors (any of the arguments may be a float)."""
    import torch

    def tensors(*values: Any) -> list[torch.Tensor]:
        like = next((v for v in values if isinstance(v, torch.Tensor)), None)
        if like is None:
            return [torch.as_tensor(v, dtype=torch.float64) for v in values]
        return [v if isinstance(v, torch.Tensor) else like.new_tensor(v) for v in values]

    def t_root(x: Any) -> torch.Tensor:
        (x,) = tensors(x)
        positive = x > 0.0
        return torch.where(positive, torch.sqrt(torch.where(positive, x, torch.ones_like(x))), torch.zeros_like(x))

    def t_positive_power(x: Any, exponent: Any) -> torch.Tensor:
        (x,) = tensors(x)
        positive = x > 0.0
        return torch.where(positive, torch.where(positive, x, torch.ones_like(x)) ** exponent, torch.zeros_like(x))

    def t_maximum(a: Any, b: Any) -> torch.Tensor:
        if not isinstance(b, torch.Tensor) and isinstance(a, torch.Tensor):
            return torch.clamp_min(a, b)
        a, b = tensors(a, b)
        return torch.maximum(a, b)

    def t_minimum(a: Any, b: Any) -> torch.Tensor:
        if not isinstance(b, torch.Tensor) and isinstance(a, torch.Tensor):
            return torch.clamp_max(a, b)
        a, b = tensors(a, b)
        return torch.minimum(a, b)

    def t_where(condition: Any, a: Any, b: Any) -> torch.Tensor:
        a, b = tensors(a, b)
        return torch.where(condition, a, b)

    def t_exp(x: Any) -> torch.Tensor:
        return torch.exp(tensors(x)[0])

    return {
        "exp": t_exp,
        "root": t_root,
        "positive_power": t_positive_power,
        "maximum": t_maximum,
        "minimum": t_minimum,
        "where": t_where,
        "with_ambient_pressure": with_ambient_pressure,
        "with_charge": with_charge,
    }
