"""The metric of every comparison: whitened residuals with local states and tolerances taken out.

A residual is a vector in a space with one row per reading (whitened by its AR(1) noise) and one row per prior (of each
local initial state and of each nuisance coefficient). Nuisances are the tolerances of maps and sensors: directions in
which the twin may be wrong by a declared amount. Projecting them out in the augmented space is the same as
marginalising them with their priors, so that sums of squares in this space are -2 log marginal likelihood up to a
constant that all hypotheses share.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from itertools import pairwise

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular

from dieseltwin.discovery.twins.interface import Array
from dieseltwin.recordings.noise import Noise

UNKNOWN = 1e30
"""Variance of what nothing is known of; in any unit far above all that is."""

_LOCAL_PRIOR = 1.0  # of a state's scale: weak, only holds states that no reading of the window sees


@dataclass(frozen=True)
class ModelScatter:
    """What readings scatter by beside the noise of their sensors.

    Attributes:
        readings: (n, C) variance of each reading, uncorrelated; None for nothing.
        windows: of each window of r rows the covariance (r C, r C) of its readings, row by row; none for nothing.
        bent: (window, the same of it) of those in which errors of maps don't act linearly, beside `windows`.
    """

    readings: Array | None = None
    windows: tuple[Array, ...] = ()
    bent: tuple[tuple[int, Array], ...] = ()

    def by_window(self) -> dict[int, Array]:
        """Window -> covariance of its readings (r C, r C), of the windows that have one."""
        found = dict(enumerate(self.windows))
        for window, covariance in self.bent:
            found[window] = found[window] + covariance if window in found else covariance
        return found


# What was last worked out of a scatter, by the noise beside it: one search asks some thirty times in turn for the same.
# One, because ten minutes at 10 Hz take 170 MiB.
_latest: list[tuple[ModelScatter, bytes, tuple[tuple[slice, Array], ...]]] = []


@dataclass(frozen=True)
class Whitening:
    """Rows of readings -> independent unit variance.

    Attributes:
        present: (n, C) readings that exist.
        previous: (n, C) 0 where the sample before is missing or in another window, else rho.
        scale: (n, C) factor of each row behind that, 0 where there is no reading.
        lower: of each window its readings, row by row, and the lower triangular matrix (r C, r C) that makes
            independent what the model's scatter ties together; none where nothing does.
    """

    present: np.ndarray
    previous: Array
    scale: Array
    lower: tuple[tuple[slice, Array], ...] = ()

    @classmethod
    def of(cls, measured: Array, noise: Noise, starts: np.ndarray, scatter: ModelScatter | None = None) -> Whitening:
        """Of readings (n, C) with their noise and what they scatter by beside it."""
        scatter = scatter or ModelScatter()
        present = np.isfinite(measured)
        linked = np.zeros_like(present)
        linked[1:] = present[1:] & present[:-1]
        linked[starts] = False
        previous = np.where(linked, noise.rho, 0.0)
        variance = noise.sigma**2 * (1.0 - previous**2) + (0.0 if scatter.readings is None else scatter.readings)
        scale = np.where(present, 1.0 / np.sqrt(variance), 0.0)
        apart = cls(present, previous, scale)
        tied = scatter.by_window()
        if not tied:
            return apart
        key = sha256(previous.tobytes() + scale.tobytes()).digest()
        if not (_latest and _latest[0][0] is scatter and _latest[0][1] == key):
            lower = []
            for block, spread in apart.whitened(starts[list(tied)], list(tied.values())):
                factor = cholesky(np.eye(len(spread)) + spread, lower=True)
                lower.append((block, solve_triangular(factor, np.eye(len(spread)), lower=True)))
            _latest[:] = [(scatter, key, tuple(lower))]
        return cls(present, previous, scale, _latest[0][2])

    def whitened(self, starts: np.ndarray, windows: Sequence[Array]) -> Iterator[tuple[slice, Array]]:
        """Which readings each window holds, row by row, and its covariance (r C, r C) behind the noise's whitening.

        Args:
            starts: first sample of each of these windows.
            windows: their covariances.
        """
        channels = self.present.shape[1]
        for start, covariance in zip(starts.tolist(), windows, strict=True):
            rows = slice(start, start + len(covariance) // channels)
            apart = Whitening(self.present[rows], self.previous[rows], self.scale[rows])
            half = apart.apply(covariance.reshape(-1, *apart.present.shape))
            whole = apart.apply(half.T.reshape(-1, *apart.present.shape))
            yield slice(start * channels, start * channels + len(covariance)), whole

    def apply(self, values: Array) -> Array:
        """(..., n, C) -> (..., n * C)."""
        out = np.where(self.present, values, 0.0)
        out[..., 1:, :] -= self.previous[1:] * out[..., :-1, :]
        out *= self.scale
        out = out.reshape(*out.shape[:-2], out.shape[-2] * out.shape[-1])
        for block, lower in self.lower:
            out[..., block] = out[..., block] @ lower.T
        return out

    def log_normaliser(self, present: np.ndarray) -> float:
        """Log of what normalises the Gaussian density of some readings, (n, C) True: of whole windows."""
        scale = self.scale.copy()
        for block, lower in self.lower:
            scale.reshape(-1)[block] *= np.diag(lower)
        return float(-np.log(scale[present]).sum() + 0.5 * np.log(2 * np.pi) * present.sum())


@dataclass(frozen=True)
class WhitenedNuisances:
    """Responses to nuisances that metrics about nearby fits share.

    Attributes:
        responses: (K, n C) whitened.
        gram: (K, K) their inner products.
    """

    responses: Array
    gram: Array

    @classmethod
    def of(cls, whitening: Whitening, responses: Array | None) -> WhitenedNuisances | None:
        """Of responses (K, n, C) per standard deviation of each prior; None for none."""
        if responses is None or not len(responses):
            return None
        whitened = whitening.apply(responses)
        return cls(whitened, whitened @ whitened.T)


class Metric:
    """Projection of readings onto what neither local states nor tolerances explain.

    Args:
        whitening: of the readings.
        starts: (W,) first sample of each window.
        local: (S, n, C) response of the readings to each initial state, all windows moved together.
        state_scales: (S,) typical sizes of the states, for their weak priors.
        nuisances: whitened responses to the nuisance coefficients, or None.
        columns: (S, n C) `local` whitened, where that is known.

    Raises:
        LinAlgError: responses that are not finite.
    """

    def __init__(
        self,
        whitening: Whitening,
        starts: np.ndarray,
        local: Array,
        state_scales: Array,
        nuisances: WhitenedNuisances | None = None,
        columns: Array | None = None,
    ) -> None:
        self.whitening = whitening
        n, channels = whitening.present.shape
        bounds = np.append(starts, n) * channels
        self._blocks = [slice(int(a), int(b)) for a, b in pairwise(bounds)]
        if columns is None:
            columns = whitening.apply(local) if local.size else np.zeros((0, n * channels))
        columns = columns.T
        ridge = np.diag(1.0 / (_LOCAL_PRIOR * np.asarray(state_scales))) if columns.shape[1] else np.zeros((0, 0))
        self._columns = columns
        self.states = columns.shape[1]
        self._first = np.array([block.start for block in self._blocks])
        self._rows_of = np.array([block.stop - block.start for block in self._blocks])
        self._orthonormal = []
        self._triangular = []
        self._unit, self._unit_prior = np.zeros(0), np.zeros(0)
        if self.states == 0:
            pass
        elif self.states == 1:  # the orthonormal basis of all windows in a line
            weight = float(ridge[0, 0])
            lengths = np.sqrt(np.add.reduceat(columns[:, 0] ** 2, self._first) + weight**2)
            self._unit, self._unit_prior = columns[:, 0] / np.repeat(lengths, self._rows_of), weight / lengths
            self._lengths = lengths
        else:
            for block in self._blocks:
                q, r = np.linalg.qr(np.vstack([columns[block], ridge]))
                self._orthonormal.append(q)
                self._triangular.append(r)
        self.rows = n * channels + len(self._blocks) * self.states
        self._nuisances = nuisances
        if nuisances is not None:
            # what the initial states leave of the responses is never formed: a projection has the products of its parts
            along = self.along_local(nuisances.responses)
            gram = nuisances.gram - along @ along.T + np.eye(len(along))
            if not np.isfinite(gram).all():
                raise np.linalg.LinAlgError("responses that are not finite: the machine runs away near this fit")
            self._lower = cholesky(gram, lower=True)

    def along_local(self, whitened: Array) -> Array:
        """(B, n C) -> (B, W S) parts along the orthonormal directions of the windows' initial states."""
        if self.states == 0:
            return np.zeros((len(whitened), 0))
        if self.states == 1:
            return np.asarray(np.add.reduceat(whitened * self._unit, self._first, axis=1))
        blocks = zip(self._blocks, self._orthonormal, strict=True)
        return np.hstack([whitened[:, block] @ q[: block.stop - block.start] for block, q in blocks])

    def _without_local(self, whitened: Array, extra: int = 0) -> Array:
        """(B, n C) -> (B, n C + W S), and `extra` columns of zeros."""
        count = whitened.shape[0]
        out = np.zeros((count, self.rows + extra))
        size = whitened.shape[1]
        out[:, :size] = whitened
        if self.states == 0:
            return out
        if self.states == 1:
            along = np.add.reduceat(whitened * self._unit, self._first, axis=1)
            parts = np.repeat(along, self._rows_of, axis=1)
            parts *= self._unit
            out[:, :size] -= parts
            out[:, size : size + along.shape[1]] = -along * self._unit_prior
            return out
        for w, (block, q) in enumerate(zip(self._blocks, self._orthonormal, strict=True)):
            rows = block.stop - block.start
            weights = whitened[:, block] @ q[:rows]
            out[:, block] -= weights @ q[:rows].T
            at = size + w * self.states
            out[:, at : at + self.states] = -weights @ q[rows:].T
        return out

    def project(self, values: Array) -> Array:
        """Readings or their differences (B, n, C) -> (B, rows): whitened, local states and nuisances taken out."""
        return self.project_whitened(self.whitening.apply(np.asarray(values)))

    def project_whitened(self, whitened: Array) -> Array:
        """As `project`, of values (B, n C) that are whitened already."""
        if self._nuisances is None:
            return self._without_local(whitened)
        weights = self._nuisance_weights(self._nuisances, self._without_local(whitened))
        out = self._without_local(whitened - weights @ self._nuisances.responses, weights.shape[1])
        out[:, self.rows :] = -weights
        return out

    def _nuisance_weights(self, nuisances: WhitenedNuisances, inner: Array) -> Array:
        """Posterior mean (B, K) of the nuisance coefficients for vectors (B, rows) without the initial states."""
        size = nuisances.responses.shape[1]  # the rows of the states' priors are in the projection already
        products = nuisances.responses @ inner[:, :size].T
        # what runs away has no number of its own, and is no end of the search for all others
        return np.asarray(cho_solve((self._lower, True), products, check_finite=False).T)

    @cached_property
    def nuisance_basis(self) -> Array | None:
        """Orthonormal directions of the nuisances (K, rows + K), None without any."""
        if self._nuisances is None:
            return None
        inner = self._without_local(self._nuisances.responses)
        return np.asarray(solve_triangular(self._lower, np.hstack([inner, np.eye(len(inner))]), lower=True))

    @property
    def log_determinant(self) -> float:
        """Of the nuisances' information with their priors: what marginal likelihoods of two metrics differ by."""
        return 0.0 if self._nuisances is None else 2.0 * float(np.log(np.diag(self._lower)).sum())

    def without_local(self, values: Array) -> Array:
        """(B, n, C) -> (B, rows): whitened with the initial states alone taken out."""
        return self._without_local(self.whitening.apply(np.asarray(values)))

    def local_step(self, residual: Array) -> Array:
        """Least-squares change of the initial states for one residual (n, C) -> (W, S)."""
        return self._local_steps(self.whitening.apply(residual[None]))[0]

    def local_steps_beside_nuisances(self, residuals: Array) -> Array:
        """The same for residuals (B, n, C) -> (B, W, S), each without what nuisances most likely are of it."""
        return self.local_steps_of_whitened(self.whitening.apply(residuals))

    def local_steps_of_whitened(self, whitened: Array) -> Array:
        """As `local_steps_beside_nuisances`, of residuals (B, n C) that are whitened already."""
        if self._nuisances is None:
            return self._local_steps(whitened)
        weights = self._nuisance_weights(self._nuisances, self._without_local(whitened))
        return self._local_steps(whitened - weights @ self._nuisances.responses)

    def _local_steps(self, whitened: Array) -> Array:
        if self.states == 1:
            return np.asarray(np.add.reduceat(whitened * self._unit, self._first, axis=1) / self._lengths)[..., None]
        steps = np.zeros((len(whitened), len(self._blocks), self.states))
        if self.states == 0:
            return steps
        for w, (block, q, r) in enumerate(zip(self._blocks, self._orthonormal, self._triangular, strict=True)):
            steps[:, w] = np.linalg.solve(r, q[: block.stop - block.start].T @ whitened[:, block].T).T
        return steps

    def window_costs(self, residual: Array) -> Array:
        """(W,) squared whitened residual of each window."""
        squared = self.whitening.apply(residual[None])[0] ** 2
        return np.asarray(np.add.reduceat(squared, self._first))

    def growing(self, factor: float) -> np.ndarray:
        """(W,) windows at whose end a change of an initial state counts more than `factor` times what it did before."""
        found = np.zeros(len(self._blocks), dtype=bool)
        for w, block in enumerate(self._blocks):
            thirds = np.array_split(self._columns[block], 3)
            early, late = (np.sqrt((part**2).sum(axis=0)) for part in (thirds[0], thirds[2]))
            found[w] = bool(np.any(late > factor * early))
        return found

    def nuisance_covariance(self) -> Array:
        """Covariance (K, K) of the nuisance coefficients beside the initial states alone, in standard deviations of
        their priors."""
        if self._nuisances is None:
            return np.zeros((0, 0))
        return np.asarray(cho_solve((self._lower, True), np.eye(len(self._lower))))

    def nuisance_estimate(self, residual: Array) -> Array:
        """Posterior mean of the nuisance coefficients, in standard deviations of their priors, (K,)."""
        if self._nuisances is None:
            return np.zeros(0)
        return self._nuisance_weights(self._nuisances, self._without_local(self.whitening.apply(residual[None])))[0]


def covariance_of(information: Array) -> Array:
    """Inverse of an information matrix (K, K).

    What the recording and beliefs tell nothing of (the overflow of a tank that never fills) stands still, apart from
    all others. Its variance is `UNKNOWN`: an infinite one times a slope of nought would be no number.
    """
    silent = np.diag(information) == 0.0
    found = np.linalg.inv(information + np.diag(silent.astype(np.float64)))
    found[silent, silent] = UNKNOWN
    return np.asarray(found, dtype=np.float64)


def std_of(covariance: Array) -> Array:
    """Standard deviations (K,) of a covariance of `covariance_of`, infinite where nothing is known."""
    variance = np.maximum(np.diag(covariance), 0.0)
    return np.where(variance < 1e-6 * UNKNOWN, np.sqrt(variance), np.inf)  # whatever factor it was widened by
