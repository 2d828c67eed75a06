"""Tolerances as directions: smooth errors of maps, gains and offsets of sensors (docs/discovery.md).

A map's error is a Gaussian random function of the map's own arguments with a declared standard deviation and a
correlation length of a third of the range driven. Its leading modes along the recording are the nuisance directions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpstrf

from dieseltwin.discovery.time_limit import check_time
from dieseltwin.discovery.twins.interface import Array, Lanes, Twin, WithSignals, joined, repeated

CORRELATION_LENGTH = 1.0 / 3.0
"""Of the range of each argument (docs/benchmark.md) [-]."""

_EDGE = 0.5  # % of the samples outside the range at either end
_RANK_BELOW = 1e-10  # of the variance, what knots that aren't pivots still have


@dataclass(frozen=True)
class Detail:
    """How much of a map's smooth error its modes along a recording carry.

    Attributes:
        kept: share of the variance; most: number of modes at most.
        knots: points of the recording that carry the random function.
    """

    kept: float
    most: int
    knots: int


LEADING = Detail(0.985, 16, 220)
"""What names are compared with: what is left out is about a tenth of the tolerance."""

FINE = Detail(0.9995, 40, 440)
"""What intervals of the weather need: it shows most where an engine seldom is, and there the leading modes are weak."""


@dataclass(frozen=True)
class Nuisance:
    """One direction, scaled to one standard deviation of its prior.

    Attributes:
        label: what it stands for.
        point: index into `Twin.points`, or None for a direction of the readings themselves.
        signal: (n,) what enters the point.
        response: (n, C) response of the readings, where it is known already: of sensors, and of what was learned.
        loading: (D,) of a direction of what was learned, in the coordinates of `learning.belief`.
        of_maps: (n, C) the part of `response` that comes through the maps.
    """

    label: str
    point: int | None = None
    signal: Array | None = None
    response: Array | None = None
    loading: Array | None = None
    of_maps: Array | None = None


def signs(directions: Array) -> Array:
    """(K,) by which directions (K, n) get the sign that makes the largest entry of each positive.

    An eigenvector's sign is any, another one on another processor; draws along it would be other draws there.
    """
    return np.asarray(np.sign(directions[np.arange(len(directions)), np.argmax(np.abs(directions), axis=1)]))


def tolerance_modes(arguments: Sequence[Array], detail: Detail = LEADING) -> Array:
    """Leading modes of a smooth random function of unit variance along the recording, (K, n).

    Args:
        arguments: each (n,); scaled to the range driven.
        detail: how much of the variance the modes carry.
    """
    scaled = []
    for values in arguments:
        low, high = np.nanpercentile(values, [_EDGE, 100.0 - _EDGE])
        span = high - low
        scaled.append(np.clip((values - low) / span, -0.2, 1.2) if span > 0 else np.zeros_like(values))
    x = np.stack(scaled, axis=1) / CORRELATION_LENGTH
    knots = x[np.linspace(0, len(x) - 1, min(detail.knots, len(x))).astype(int)]

    def kernel(a: Array, b: Array) -> Array:
        exponent = a @ b.T  # of |a - b|^2 = |a|^2 - 2 a b + |b|^2, minus a half
        exponent -= 0.5 * (a**2).sum(axis=1)[:, None]
        exponent -= 0.5 * (b**2).sum(axis=1)
        return np.exp(exponent, out=exponent)

    # a smooth function of so many knots is one of few: a Cholesky factor L with pivots takes a hundredth of the time
    # that all eigenvectors take, and with V those of L'L the modes anywhere are k(x, pivots) L_pivots^-T V
    factor, order, rank, _ = dpstrf(kernel(knots, knots), tol=_RANK_BELOW, lower=1)
    lower, pivots = np.tril(factor[:, :rank]), order[:rank] - 1
    values, vectors = np.linalg.eigh(lower.T @ lower)
    values, vectors = values[::-1], vectors[:, ::-1]
    count = min(int(np.searchsorted(np.cumsum(values) / len(knots), detail.kept)) + 1, detail.most, rank)
    vectors = vectors[:, :count]
    weights = solve_triangular(lower[:rank], vectors * signs((lower @ vectors).T), lower=True, trans=1)
    return np.asarray((kernel(x, knots[pivots]) @ weights).T)


def map_nuisances(
    twin: Twin, variables: dict[str, Array], factor: float = 1.0, detail: Detail = LEADING
) -> list[Nuisance]:
    """Directions of every point's map tolerance, times `factor`."""
    found = []
    for index, point in enumerate(twin.points):
        if not (point.tolerance > 0.0 and point.tolerance_over):
            continue
        sets = [names for names in (point.tolerance_over, point.tolerance_also) if names]
        share = factor * point.tolerance / np.sqrt(len(sets))
        for names in sets:
            modes = tolerance_modes([variables[name] for name in names], detail)
            label = f"map of {point.name} over {', '.join(names)}"
            found += [Nuisance(f"{label}, mode {k + 1}", index, share * mode) for k, mode in enumerate(modes)]
    return found


def sensor_nuisances(twin: Twin, simulated: Array, gains: Sequence[float], offsets: Sequence[float]) -> list[Nuisance]:
    """Directions of every sensor's gain and offset, at one standard deviation each.

    Args:
        twin: gives the channels.
        simulated: (n, C) readings of the model.
        gains: (C,) standard deviation of each gain [-].
        offsets: (C,) standard deviation of each offset, as a share of the channel's mean [-].
    """
    found = []
    for j, name in enumerate(twin.channels):
        for label, tolerance, direction in (
            ("gain", gains[j], simulated[:, j]),
            ("offset", offsets[j], np.full(len(simulated), np.mean(simulated[:, j]))),
        ):
            if tolerance > 0.0:
                response = np.zeros_like(simulated)
                response[:, j] = tolerance * direction
                found.append(Nuisance(f"{label} of {name}", response=response))
    return found


def signal_responses(
    twin: Twin, base: Lanes, simulated: Array, points: Sequence[int], signals: Array, linear: bool = False
) -> Array:
    """Responses of the readings to signals at points, (K, n, C), by simulation next to `base` (one lane).

    `linear`: the signals are so small that first order is enough, which some twins have sooner.
    """
    check_time()
    count = len(points)
    if not count:
        return np.zeros((0, *simulated.shape))
    lanes = replace(
        repeated(base, count), lane_points=np.asarray(points, dtype=np.int64),
        lane_signals=np.ascontiguousarray(signals), linear=linear,
    )  # fmt: skip
    return twin.simulate(lanes) - simulated


def nuisance_responses(
    twin: Twin, base: Lanes, simulated: Array, nuisances: Sequence[Nuisance], linear: bool = False
) -> Array:
    """Responses (K, n, C) of the readings to every direction next to `base` (one lane), whose simulation is known.

    `linear`: as of `signal_responses`.
    """
    out = np.empty((len(nuisances), *simulated.shape))
    at = [k for k, nuisance in enumerate(nuisances) if nuisance.point is not None]
    if at:
        points = [int(nuisances[k].point) for k in at]  # type: ignore[arg-type]
        signals = np.stack([nuisances[k].signal for k in at])  # type: ignore[misc]
        out[at] = signal_responses(twin, base, simulated, points, signals, linear)
    for k, nuisance in enumerate(nuisances):
        if nuisance.response is not None:
            out[k] = nuisance.response
    return out


def at_sizes(
    twin: Twin, nuisances: Sequence[Nuisance], responses: Array, sizes: Array
) -> tuple[dict[str, Array], Array]:
    """Signals at points that errors of maps have, and what they do linearly to the readings, (n, C).

    Args:
        twin: gives the points.
        nuisances: directions; those of no point count for nothing.
        responses: (K, n, C) their linear responses.
        sizes: (K,) in standard deviations.
    """
    signals: dict[str, Array] = {}
    linear = np.zeros_like(twin.measured)
    for nuisance, response, size in zip(nuisances, responses, sizes, strict=True):
        if nuisance.point is not None and nuisance.signal is not None:
            signals = joined(signals, {twin.points[nuisance.point].name: size * nuisance.signal})
            linear += size * response
    return signals, linear


class Rebased(WithSignals):
    """A twin about another point of its tolerances: maps off by an estimate, not by nothing.

    Tolerances are taken out linearly. Where the machine bends (no back-flow through the EGR valve at p_em = p_im) that
    is only good near the point of linearisation. Here the estimated errors are simulated, and the readings are moved by
    their linear response, so that the same linear tolerances remain to be taken out, with the same priors.

    Args:
        twin: the twin.
        nuisances: directions.
        responses: (K, n, C) their linear responses.
        estimate: (K,) in standard deviations.
    """

    def __init__(self, twin: Twin, nuisances: Sequence[Nuisance], responses: Array, estimate: Array) -> None:
        signals, moved = at_sizes(twin, nuisances, responses, estimate)
        super().__init__(twin, signals)
        self.measured = twin.measured + moved
