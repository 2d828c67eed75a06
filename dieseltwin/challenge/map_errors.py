"""Smooth random errors of the empirical maps: random Fourier features over each map's range, multiplicative."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

NODES = 33  # of a table per argument; fields of correlation length 1/3 are met within 0.002 of their rms, 1/6 0.008
FEATURES = 48
CORRELATION_LENGTH = 1.0 / 3.0  # of the map's range (docs/benchmark.md)

MAPS = ("eta_vol", "f_egr", "F_vgt_Pi_t", "eta_tm", "eta_c", "Phi_c")
"""Order of the tables; arguments below."""

TURBINE_OF_RATIO = len(MAPS)
"""A further table: errors of the turbine's efficiency over its formula's own arguments (A.33), which change with the
exhaust's temperature; where it isn't nought, the one over the pressure ratio is."""

# ranges that driving covers: (first argument), (second argument)
RANGES = (
    ((1.0e5, 3.0e5), (600.0, 1900.0)),  # p_im [Pa], n_e [rpm]
    ((0.0, 80.0), (0.0, 1.0)),  # u_egr [%], none
    ((25.0, 100.0), (0.35, 1.0)),  # u_vgt [%], Pi_t [-]
    ((1600.0, 11000.0), (0.35, 1.0)),  # omega_t [rad/s], Pi_t [-]
    ((0.05, 0.55), (1.0, 3.0)),  # W_c [kg/s], Pi_c [-]
    ((0.2, 1.45), (1600.0, 11000.0)),  # Psi_c [-], omega_t [rad/s]
    ((1600.0, 11000.0), (0.3, 1.1)),  # omega_t [rad/s], blade speed ratio [-]
)


@dataclass(frozen=True)
class MapErrors:
    """Relative errors of the six maps.

    Attributes:
        tables: (7, NODES, NODES) relative errors [-] over a grid of both arguments: one each, and `TURBINE_OF_RATIO`.
        low, high: (7, 2) ends of the grid.
    """

    tables: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @classmethod
    def none(cls) -> MapErrors:
        """The published maps."""
        low, high = _ends()
        return cls(np.zeros((len(RANGES), NODES, NODES)), low, high)

    @property
    def rms(self) -> float:
        """Of all maps together, over their ranges [-]."""
        return float(np.sqrt(np.sum(self.tables**2) / (len(MAPS) * NODES**2)))

    @classmethod
    def draw(
        cls, rms: float, rng: np.random.Generator, length: float = CORRELATION_LENGTH, of_ratio: bool = False
    ) -> MapErrors:
        """Fields of the given rms (over their ensemble; one draw's own rms differs by some 20 %) and correlation
        length [of the map's range]; ``of_ratio``: that of the turbine's efficiency over the blade speed ratio."""
        low, high = _ends()
        at = np.linspace(0.0, 1.0, NODES)
        grid = np.stack(np.meshgrid(at, at, indexing="ij"), axis=-1)
        tables = np.zeros((len(RANGES), NODES, NODES))
        for k, name in enumerate(MAPS):
            waves = rng.standard_normal((FEATURES, 2)) / length
            if name == "f_egr":
                waves[:, 1] = 0.0
            phases = rng.uniform(0.0, 2.0 * np.pi, FEATURES)
            weights = rng.standard_normal(FEATURES)
            field = np.cos(grid @ waves.T + phases) @ weights * np.sqrt(2.0 / FEATURES)
            tables[TURBINE_OF_RATIO if of_ratio and name == "eta_tm" else k] = rms * field
        return cls(tables, low, high)


def _ends() -> tuple[np.ndarray, np.ndarray]:
    ranges = np.array(RANGES)
    return np.ascontiguousarray(ranges[..., 0]), np.ascontiguousarray(ranges[..., 1])
