"""Alarm over the history of an engine: a test that may be looked at after every recording, for years.

Every recording leaves one estimate of the size of every effect, made beside its own health parameters. A healthy
engine's estimates are zero but for noise, new in every recording, and for what is still open of its maps and sensors,
which is the same in all. Against that stands: since some day the effect has a size, or grows. The evidence is a
likelihood ratio, averaged over effects, sizes and days:

    M(t) = sum over days d up to t of w(d) mean over effects of p(estimates up to t | begins at d) / p(.. | healthy)

With w in years it is an e-detector (Shin, Ramdas and Rinaldo, "E-detectors: a nonparametric framework for sequential
change detection", 2023, definition 2.2): the mean of M(t) of a healthy engine is at most the years that have passed,
and so an alarm at M >= 1/rate is false within T years with probability rate max(T, 1) at most, however often one looks
(Doob's inequality for submartingales). M is a function of the set of recordings: the order in which they are added
doesn't matter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.special import log_ndtr, logsumexp

Array = np.ndarray

ALARMS_PER_YEAR = 0.02
"""False alarms per engine and year that are accepted [1/year]: of fifty healthy engines one a year."""

INFLATION = 1.5
"""Scatter of estimates from recording to recording over what the likelihood states [-] (docs/fleet.md)."""

CLIP = 3.5
"""Standard deviations that one recording counts for at most: a single odd recording is its own verdict's business."""

_STEP_SIZE = 5.0  # of the effect's tolerance: typical size of a fault that is there at once
_GROWTH_SIZE = 10.0  # of the effect's tolerance in a year: typical growth
_AT_START = 0.5  # years' worth of weight for what began between the reference and the first recording
_YEAR_D = 365.25
_LEAST_SIZE = 0.8  # of the tolerance of interest, as for one recording
_SURE = 0.9


@dataclass(frozen=True)
class Score:
    """What one recording says of one effect, at the health-only fit.

    Attributes:
        name, site: of the effect.
        unit: of its size.
        tolerance: smallest size of interest [unit].
        one_sided: whether a negative size is impossible.
        estimate: linear estimate of its size, impossible signs included [unit].
        noise_std: standard deviation by what is new in every recording [unit].
        shared: (D,) response of the estimate to what is open of maps and sensors, in standard deviations [unit].
    """

    name: str
    site: str
    unit: str
    tolerance: float
    one_sided: bool
    estimate: float
    noise_std: float
    shared: Array

    @property
    def std(self) -> float:
        """Standard deviation of the estimate, maps and sensors included [unit]."""
        return float(np.sqrt(self.noise_std**2 + self.shared @ self.shared))


@dataclass(frozen=True)
class Alarm:
    """An alarm, as of the recording that raised it.

    Attributes:
        at: number of that recording in time order.
        name, site, unit: of the likeliest effect; share: of the evidence that it has.
        others: names of further effects that have at least a tenth of the evidence.
        size, std: of it, at that recording [unit].
        grows: whether growth explains it better than one size since its beginning.
        since: day of its beginning, most likely; earliest, latest: 90 % interval.
        evidence: M.
    """

    at: int
    name: str
    site: str
    unit: str
    share: float
    others: tuple[str, ...]
    size: float
    std: float
    grows: bool
    since: datetime
    earliest: datetime
    latest: datetime
    evidence: float


@dataclass(frozen=True)
class Course:
    """Evidence over a history.

    Attributes:
        evidence: (n,) M after each recording [years].
        threshold: from which it is an alarm [years].
        alarm: the first one, None for none.
    """

    evidence: Array
    threshold: float
    alarm: Alarm | None


@dataclass(frozen=True)
class _OfEffect:
    """Log likelihood ratios (n, 2, K) of one effect after each recording, kind by day of beginning; sizes and stds."""

    score: Score
    log_ratio: Array
    size: Array
    std: Array


def course(
    scores: Sequence[Sequence[Score]], dates: Sequence[datetime], alarms_per_year: float = ALARMS_PER_YEAR,
    inflation: float = INFLATION,
) -> Course:  # fmt: skip
    """Evidence after each of n recordings, and the first alarm.

    Args:
        scores: of each recording; dates: of each, ascending.
        alarms_per_year: false alarms per engine and year that are accepted.
        inflation: of the scatter from recording to recording.
    """
    threshold = 1.0 / alarms_per_year
    count = len(scores)
    days = np.array([(date - dates[0]).total_seconds() / 86400.0 for date in dates]) if count else np.zeros(0)
    names = list(dict.fromkeys(score.name for some in scores for score in some))
    if not names:
        return Course(np.zeros(count), threshold, None)
    effects = [_of_effect(name, scores, days, inflation) for name in names]
    begun = np.arange(count)[:, None] >= np.arange(count)[None, :]  # (recording, day of beginning)
    with np.errstate(divide="ignore"):
        weights = np.log(_weights(days)) - np.log(2.0 * len(names))
        weighted = np.stack([item.log_ratio + np.where(begun, weights, -np.inf)[:, None, :] for item in effects])
    evidence = np.exp(np.minimum(logsumexp(weighted, axis=(0, 2, 3)), 700.0))
    for at in np.flatnonzero(evidence >= threshold):
        alarm = _alarm(int(at), effects, weighted[:, at], dates, float(evidence[at]))
        if alarm is not None:
            return Course(evidence, threshold, alarm)
    return Course(evidence, threshold, None)


def _weights(days: Array) -> Array:
    """Years' worth of each day of beginning: the time since the recording before; half of it in the first year."""
    passed = days / _YEAR_D
    spent = np.where(passed < 1.0, _AT_START + (1.0 - _AT_START) * passed, passed)
    return np.diff(spent, prepend=0.0)


def _of_effect(name: str, scores: Sequence[Sequence[Score]], days: Array, inflation: float) -> _OfEffect:
    own = [next((score for score in some if score.name == name), None) for some in scores]
    at = np.array([k for k, score in enumerate(own) if score is not None])
    known = [score for score in own if score is not None]
    first = known[0]
    shared = np.stack([score.shared for score in known])
    covariance = shared @ shared.T + np.diag([(inflation * score.noise_std) ** 2 for score in known])
    lower = cholesky(covariance, lower=True)
    surprise = solve_triangular(lower, np.array([score.estimate for score in known]), lower=True)
    surprise = np.clip(surprise, -CLIP, CLIP)
    before = np.concatenate([days[:1], days[:-1]])
    profiles = np.concatenate([
        days[at][:, None] >= days[None, :], np.maximum(days[at][:, None] - before[None, :], 0.0) / _YEAR_D
    ], axis=1)  # fmt: skip
    columns = solve_triangular(lower, profiles, lower=True)
    push, information = np.cumsum(columns * surprise[:, None], axis=0), np.cumsum(columns**2, axis=0)
    spread = np.repeat([_STEP_SIZE, _GROWTH_SIZE], len(days)) * first.tolerance
    variance = 1.0 / (information + spread**-2.0)
    mean, std = variance * push, np.sqrt(variance)
    log_ratio = np.log(std / spread) + 0.5 * (mean / std) ** 2
    if first.one_sided:
        log_ratio += np.log(2.0) + log_ndtr(mean / std)
    latest = np.searchsorted(at, np.arange(len(days)), side="right") - 1  # recordings without this effect add nothing
    shape = (len(days), 2, len(days))
    kept = np.where((latest >= 0)[:, None], log_ratio[latest], 0.0)
    now = profiles[latest]
    return _OfEffect(first, kept.reshape(shape), (mean[latest] * now).reshape(shape), (std[latest] * now).reshape(shape))


def _alarm(
    at: int, effects: Sequence[_OfEffect], weighted: Array, dates: Sequence[datetime], evidence: float
) -> Alarm | None:
    """What the evidence (H, 2, K) after a recording says; None where its size is below what is of interest."""
    shares = np.exp(weighted - logsumexp(weighted))
    of_effects = shares.sum(axis=(1, 2))
    best = int(np.argmax(of_effects))
    lead = effects[best]
    kind, day = np.unravel_index(int(np.argmax(shares[best])), shares[best].shape)
    size, std = float(lead.size[at, kind, day]), float(lead.std[at, kind, day])
    if abs(size) < _LEAST_SIZE * lead.score.tolerance:
        return None
    cumulated = np.cumsum(shares[best].sum(axis=0)) / of_effects[best]
    edge = 0.5 * (1.0 - _SURE)
    early, late = (int(np.searchsorted(cumulated, level)) for level in (edge, 1.0 - edge))
    others = [effects[k].score.name for k in np.argsort(-of_effects) if k != best and of_effects[k] >= 0.1]
    return Alarm(
        at, lead.score.name, lead.score.site, lead.score.unit, float(of_effects[best]), tuple(others), size, std,
        bool(kind == 1), dates[day], dates[max(early - 1, 0)], dates[min(late, at)], evidence,
    )  # fmt: skip

