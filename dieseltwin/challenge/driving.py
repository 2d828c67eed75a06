"""The inputs of one recording of the benchmark."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

INPUTS = ("n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct")


@dataclass(frozen=True)
class Driving:
    """Engine inputs at equal steps, linear in between; every array (n,).

    Attributes:
        time_s: [s]; n_e_rpm: [rpm]; u_delta_mg: [mg/cycle]; u_egr_pct, u_vgt_pct: commands [%].
        kind: what was driven, in words.
        u_flap_pct: position of an exhaust flap [%], where there is one.
    """

    time_s: np.ndarray
    n_e_rpm: np.ndarray
    u_delta_mg: np.ndarray
    u_egr_pct: np.ndarray
    u_vgt_pct: np.ndarray
    kind: str = ""
    u_flap_pct: np.ndarray | None = None

    def columns(self) -> dict[str, np.ndarray]:
        """Columns of a recording: time and inputs."""
        return {name: getattr(self, name) for name in ("time_s", *INPUTS)}
