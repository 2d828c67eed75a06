"""From linear outputs of a network to states and back (paper, table "Neural network for PINN")."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from dieseltwin.arrays import Array
from dieseltwin.errors import InputError


@dataclass(frozen=True)
class OutputTransform:
    """State y = scale * (f(z) + offset) of a linear output z, f = softplus or sigmoid (paper, table of networks)."""

    function: Literal["softplus", "sigmoid"]
    scale: float
    offset: float = 0.0

    def scaled(self, z: Tensor) -> Tensor:
        """y / scale of a linear output."""
        f = torch.nn.functional.softplus if self.function == "softplus" else torch.sigmoid
        return f(z) + self.offset

    def state(self, z: ArrayLike) -> Array:
        """State [SI] of a linear output."""
        return self.scale * self.scaled(torch.as_tensor(np.asarray(z, dtype=np.float64))).numpy()

    def linear(self, state: ArrayLike) -> Array:
        """Linear output z of a state [SI], the inverse of `state`."""
        y = np.asarray(state, dtype=np.float64) / self.scale - self.offset
        upper = np.inf if self.function == "softplus" else 1.0
        if not ((y > 0.0) & (y < upper)).all():
            low, high = self.scale * self.offset, self.scale * (self.offset + upper)
            bad = float(np.asarray(state, dtype=np.float64)[~((y > 0.0) & (y < upper))].flat[0])
            raise InputError("state for a head", f"{bad:g}", f"{low:g} to {high:g}", "check units and gaps")
        return y + np.log(-np.expm1(-y)) if self.function == "softplus" else np.log(y) - np.log1p(-y)


TRANSFORMS: Mapping[str, OutputTransform] = {
    "p_im_pa": OutputTransform("softplus", 1e5),
    "p_em_pa": OutputTransform("softplus", 1e5),
    "x_r": OutputTransform("sigmoid", 1.0),
    "t_1_k": OutputTransform("softplus", 300.0, 230.0 / 300.0),
    "omega_t_rad_s": OutputTransform("softplus", 5e3),
}
