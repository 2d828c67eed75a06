"""Score scan over effects and onsets, then an exact refit of the best of each effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve
from scipy.optimize import minimize_scalar

from dieseltwin.petrol.effects import HYPOTHESES, LOG_PRIOR
from dieseltwin.petrol.model import Bound

Array = NDArray[np.float64]

SCAN_S = 5.0  # between trial onsets of the scan
LEAST_AFTER_S = 20.0  # an onset leaves at least so much of the recording
NEAR_S = 12.0  # the exact onset is looked for so far around the scan's
WIDENINGS, AT_EDGE = 5, 0.1  # of the search for a magnitude; an end within a tenth of the span is an end
TRIALS = 10  # evaluations of one refit
CURVATURE_STEP = 0.02  # of the magnitude's tolerance or size, for its standard deviation
ONSET_COST = 3.0  # log-likelihood that a free onset has to be worth: log of the number of places, about


@dataclass(frozen=True)
class Scan:
    """Scores of one effect over trial onsets: 2 delta log-likelihood to first order, and the magnitude."""

    name: str
    onsets_s: Array
    score: Array
    magnitude: Array


@dataclass(frozen=True)
class Candidate:
    """An effect refitted exactly.

    Attributes:
        name: in HYPOTHESES.
        gain: log-likelihood over the null's, prior and cost of the onset included.
        magnitude, std: [unit].
        onset_s: None if it was there from the start.
    """

    name: str
    gain: float
    magnitude: float
    std: float
    onset_s: float | None


def step_of(name: str) -> float:
    """Magnitude for differences of an effect."""
    return HYPOTHESES[name].tolerance


def scan(bound: Bound, name: str) -> Scan:
    """Efficient scores of an effect that starts at each of many times (Lagrange multiplier test)."""
    null = bound.null()
    signatures = bound.signature(name, step_of(name))
    mid = bound.measured.mid_s
    onsets = np.concatenate([[0.0], np.arange(SCAN_S, mid[-1] - LEAST_AFTER_S, SCAN_S)])
    numerator, denominator = np.zeros(len(onsets)), np.zeros(len(onsets))
    first = np.searchsorted(mid, onsets, side="right")  # first block after each onset
    for balance, direction in signatures.items():
        fit = null[balance]
        s = np.nan_to_num(direction)
        weighted = fit.weight * s
        explained = _after(fit.design * weighted[:, None], first).T
        numerator += _after(weighted * fit.residual, first)
        denominator += _after(weighted * s, first)
        denominator -= np.einsum("ij,ij->j", explained, cho_solve(fit.factor, explained))
    magnitude = numerator / np.maximum(denominator, 1e-300)
    low, high = HYPOTHESES[name].limits
    clipped = np.clip(magnitude, low, high)
    score = 2.0 * clipped * numerator - clipped**2 * denominator
    return Scan(name, onsets, score, clipped)


def _after(rows: Array, first: NDArray[np.int64]) -> Array:
    """Sums of `rows` from each of the rows `first` to the end, (len(first), ...)."""
    total = np.concatenate([np.zeros((1, *rows.shape[1:])), np.cumsum(rows, axis=0)])
    return np.asarray(total[-1] - total[first])


def information(bound: Bound, name: str, onset_s: float = 0.0) -> float:
    """Marginal information on a magnitude that is there from `onset_s` on [1/unit2]."""
    total = 0.0
    for balance, direction in bound.signature(name, step_of(name)).items():
        fit = bound.null()[balance]
        after = np.where(bound.measured.mid_s >= onset_s, np.nan_to_num(direction), 0.0)
        total += float(after @ fit.project(after))
    return total


def refit(bound: Bound, name: str, start: float, onset_s: float | None) -> tuple[float, float]:
    """Most probable magnitude and its log-likelihood for a given onset."""
    h = HYPOTHESES[name]
    centre = start
    for _ in range(WIDENINGS):
        reach = max(3.0 * h.tolerance, 0.6 * abs(centre))
        low, high = max(h.limits[0], centre - reach), min(h.limits[1], centre + reach)
        found = minimize_scalar(lambda m: -bound.effect(name, m, onset_s)[0], bounds=(low, high), method="bounded",
                                options={"maxiter": TRIALS, "xatol": 0.01 * h.tolerance})
        centre = float(found.x)
        edge = AT_EDGE * (high - low)
        # a first-order guess is far too small for a large leak: go on from the end that was reached
        if not (low > h.limits[0] and centre < low + edge) and not (high < h.limits[1] and centre > high - edge):
            break
    return centre, -float(found.fun)


def sharpen_onset(bound: Bound, name: str, magnitude: float, onset_s: float) -> float:
    """The onset to a block: where the rows change sides between with and without the effect."""
    _, whole = bound.effect(name, magnitude, max(onset_s - NEAR_S, 0.0))
    _, later = bound.effect(name, magnitude, onset_s + NEAR_S)
    mid = bound.measured.mid_s
    near = (mid > onset_s - NEAR_S) & (mid < onset_s + NEAR_S)
    with_effect, without = np.zeros(len(mid)), np.zeros(len(mid))
    for balance in whole:
        with_effect += whole[balance].row_log_likelihood
        without += later[balance].row_log_likelihood
    difference = (with_effect - without)[near]
    # onset before block j: blocks before it without, from it on with
    total = np.concatenate([[0.0], np.cumsum(-difference)]) + difference.sum()
    edges = np.concatenate([mid[near] - 0.5, [mid[near][-1] + 0.5]])
    return float(edges[int(np.argmax(total))])


def standard_deviation(bound: Bound, name: str, magnitude: float, onset_s: float | None) -> float:
    """From the curvature of the marginal log-likelihood; infinite where it isn't curved."""
    step = max(HYPOTHESES[name].tolerance * 0.5, CURVATURE_STEP * abs(magnitude))
    values = [bound.effect(name, magnitude + k * step, onset_s)[0] for k in (-1, 0, 1)]
    curvature = -(values[0] - 2.0 * values[1] + values[2]) / step**2
    return float(1.0 / np.sqrt(curvature)) if curvature > 0.0 else float("inf")


def candidate(bound: Bound, found: Scan) -> Candidate:
    """The best onset and magnitude of one effect, refitted exactly; the onset is None if the start does as well."""
    null = sum(f.log_likelihood for f in bound.null().values())
    best = int(np.argmax(found.score))
    trials: list[tuple[float, float, float | None]] = []
    magnitude, value = refit(bound, found.name, float(found.magnitude[0]), None)
    trials.append((value - null, magnitude, None))
    if best > 0:
        onset = float(found.onsets_s[best])
        magnitude, value = refit(bound, found.name, float(found.magnitude[best]), onset)
        onset = sharpen_onset(bound, found.name, magnitude, onset)
        magnitude, value = refit(bound, found.name, magnitude, onset)
        trials.append((value - null - ONSET_COST, magnitude, onset))
    gain, magnitude, at = max(trials, key=lambda t: t[0])
    return Candidate(found.name, gain + LOG_PRIOR.get(found.name, 0.0), magnitude, float("nan"), at)


def search(bound: Bound, names: Sequence[str] = tuple(HYPOTHESES), keep: int = 6) -> tuple[list[Candidate], list[Scan]]:
    """Candidates, strongest first: all effects are scanned, the `keep` with the highest scores refitted exactly."""
    scans = sorted((scan(bound, name) for name in names), key=lambda s: -float(s.score.max()))
    found = [candidate(bound, s) for s in scans[:keep]]
    return sorted(found, key=lambda c: -c.gain), scans


def with_std(bound: Bound, c: Candidate) -> Candidate:
    """The candidate with its standard deviation."""
    return Candidate(c.name, c.gain, c.magnitude, standard_deviation(bound, c.name, c.magnitude, c.onset_s), c.onset_s)
