"""Alarm over the history of an engine: a test that may be looked at after every recording, for years.

Every recording leaves one estimate of the size of every effect, made beside its own health parameters. A healthy
engine's estimates are zero but for noise, new in every recording, and for what is still open of its maps and sensors,
which is the same in all. Against that stands: since some day the effect has a size, or grows. The evidence is a
likelihood ratio, averaged over effects, sizes and days:

    M(t) = sum over days d up to t of w(d) mean over effects of p(estimates up to t | begins at d) / p(.. | healthy)

where what would be smaller than is of interest by then counts for nothing. Any model differs from its engine by a
little that shows in the end (an actuator that is 2 ms late where 50 ms are of interest); such evidence would grow
for years and hide what comes beside it.

With w in years it is at most an e-detector (Shin, Ramdas and Rinaldo, "E-detectors: a nonparametric framework for
sequential change detection", 2023): the mean of M(t) of a healthy engine is at most the years that have passed,
and so an alarm at M >= 1/rate is false within T years with probability rate max(T, 1) at most, however often one looks
(Doob's inequality for submartingales). M is a function of the set of recordings: the order in which they are added
doesn't matter.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.special import log_ndtr, logsumexp

from dieseltwin.least_squares import Z_90
from dieseltwin.settings.watch import WatchConfig

Array = np.ndarray

_YEAR_D = 365.25
_SURE = 0.9
_GONE = 0.5  # of the alarm's size: what is surely less is no longer there


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
class Shown:
    """What one recording shows by itself, everything refitted.

    Attributes:
        names: of effects, with those that can't be told from them.
        sizes: size and standard deviation of the effects that it names first [unit of the effect].
    """

    names: Collection[str] = ()
    sizes: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Alarm:
    """An alarm, as of the recording that raised it.

    Attributes:
        at: number of that recording in time order.
        name, site, unit: of the likeliest effect; share: of the evidence that it has; shown: how many recordings since
            its beginning name it by themselves. Evidence adds up linear estimates, which a strong fault bends: where
            all recordings that name something by themselves agree, that is the likeliest.
        others: names of further effects that have at least a tenth of the evidence.
        size, std: of it, at that recording [unit]; of the recording's own refit where that names it, as are all sizes:
            linear estimates of a leak of 15 mm2 were 8.7 to 18.8 mm2.
        grows: whether growth explains it better than one size since its beginning.
        since: day of its beginning, most likely: the first recording that has it, or from which on it grows; earliest,
            latest: 90 % interval.
        sizes, stds: of it in every recording [unit]; where a recording doesn't name it, against those before it began
            (against none: the reference), and NaN where it wasn't scored.
        gone: number of the recording from which on it isn't there any more, None where it is.
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
    sizes: Array
    stds: Array
    gone: int | None = None
    shown: int = 0


@dataclass(frozen=True)
class Course:
    """Evidence over a history.

    Attributes:
        evidence: (n,) M after each recording, of changes that are of interest [years].
        threshold: from which it is an alarm [years].
        alarm: the first one, None for none.
    """

    evidence: Array
    threshold: float
    alarm: Alarm | None


@dataclass(frozen=True)
class _OfEffect:
    """One effect after each recording, kind by day of beginning: all (n, 2, K).

    Attributes:
        score: its first.
        counted: log likelihood ratio in which no recording counts for more than it may: raises alarms.
        whole: the same of the estimates as they are: says what an alarm is about.
        size, std: of the effect at that recording [unit].
    """

    score: Score
    counted: Array
    whole: Array
    size: Array
    std: Array

    def of_interest(self, settings: WatchConfig) -> Array:
        """(n, 2, K) where its size is large enough to matter."""
        return np.asarray(np.abs(self.size) >= settings.least_size * self.score.tolerance)


def course(
    scores: Sequence[Sequence[Score]], dates: Sequence[datetime], settings: WatchConfig,
    shown: Sequence[Shown] = (),
) -> Course:  # fmt: skip
    """Evidence after each of n recordings, and the first alarm.

    Args:
        scores: of each recording; dates: of each, ascending.
        settings: rate of false alarms, what faults are like, and how much recordings scatter.
        shown: what each recording shows by itself; none where that isn't known. It raises no alarm.
    """
    threshold = 1.0 / settings.alarms_per_year
    count = len(scores)
    days = np.array([(date - dates[0]).total_seconds() / 86400.0 for date in dates]) if count else np.zeros(0)
    names = list(dict.fromkeys(score.name for some in scores for score in some))
    if not names:
        return Course(np.zeros(count), threshold, None)
    effects = [_of_effect(name, scores, days, settings) for name in names]
    begun = np.arange(count)[:, None] >= np.arange(count)[None, :]  # (recording, day of beginning)
    with np.errstate(divide="ignore"):
        weights = np.log(_weights(days, settings.at_start_years)) - np.log(2.0 * len(names))
        weights = np.where(begun, weights, -np.inf)[:, None, :]
        weights = np.stack([np.where(e.of_interest(settings), weights, -np.inf) for e in effects])
        counted = logsumexp(np.stack([e.counted for e in effects]) + weights, axis=(0, 2, 3))
    evidence = np.exp(np.minimum(counted, 700.0))
    at = int(np.argmax(evidence >= threshold))
    if evidence[at] < threshold:
        return Course(evidence, threshold, None)
    weighted = np.stack([item.whole[at] for item in effects]) + weights[:, at]
    alarm = _alarm(at, effects, weighted, scores, dates, settings, shown)
    return Course(evidence, threshold, alarm)


def _weights(days: Array, at_start: float) -> Array:
    """Years' worth of each day of beginning: the time since the recording before; `at_start` of the first year goes to
    the first recording."""
    passed = days / _YEAR_D
    spent = np.where(passed < 1.0, at_start + (1.0 - at_start) * passed, passed)
    return np.diff(spent, prepend=0.0)


def _of_effect(name: str, scores: Sequence[Sequence[Score]], days: Array, settings: WatchConfig) -> _OfEffect:
    own = [next((score for score in some if score.name == name), None) for some in scores]
    at = np.array([k for k, score in enumerate(own) if score is not None])
    known = [score for score in own if score is not None]
    first = known[0]
    shared = np.stack([score.shared for score in known])
    covariance = shared @ shared.T + np.diag([(settings.inflation * score.noise_std) ** 2 for score in known])
    lower = cholesky(covariance, lower=True)
    surprise = solve_triangular(lower, np.array([score.estimate for score in known]), lower=True)
    before = np.concatenate([days[:1], days[:-1]])
    profiles = np.concatenate([
        days[at][:, None] >= days[None, :], np.maximum(days[at][:, None] - before[None, :], 0.0) / _YEAR_D
    ], axis=1)  # fmt: skip
    columns = solve_triangular(lower, profiles, lower=True)
    spread = np.repeat([settings.step_size, settings.growth_size], len(days)) * first.tolerance
    std = (np.cumsum(columns**2, axis=0) + spread**-2.0) ** -0.5
    latest = np.searchsorted(at, np.arange(len(days)), side="right") - 1  # recordings without this effect add nothing
    means = []
    for estimates in (np.clip(surprise, -settings.clip, settings.clip), surprise):
        means.append(std**2 * np.cumsum(columns * estimates[:, None], axis=0))
    ratios = [np.where((latest >= 0)[:, None], _log_ratio(mean, std, spread, first)[latest], 0.0) for mean in means]
    now = profiles[latest]
    shape = (len(days), 2, len(days))
    return _OfEffect(
        first, ratios[0].reshape(shape), ratios[1].reshape(shape), (means[1][latest] * now).reshape(shape),
        (std[latest] * now).reshape(shape),
    )  # fmt: skip


def _log_ratio(mean: Array, std: Array, spread: Array, effect: Score) -> Array:
    """Log likelihood ratio of a size believed normal about 0 with standard deviation `spread`, by its posterior."""
    ratio = np.log(std / spread) + 0.5 * (mean / std) ** 2
    return ratio + np.log(2.0) + log_ndtr(mean / std) if effect.one_sided else ratio


def _alarm(
    at: int, effects: Sequence[_OfEffect], weighted: Array, scores: Sequence[Sequence[Score]],
    dates: Sequence[datetime], settings: WatchConfig, shown: Sequence[Shown],
) -> Alarm:  # fmt: skip
    """What the evidence (H, 2, K) after a recording says."""
    of_effects = logsumexp(weighted, axis=(1, 2))
    best = int(np.argmax(of_effects))
    first = divmod(int(np.argmax(weighted[best])), weighted[best].shape[1])[1]
    judged = [set(one.names) for one in shown[first : at + 1] if one.names]
    agreed = set.intersection(*judged) if judged else set()
    possible = [k for k in range(len(effects)) if np.isfinite(of_effects[k])]
    best = max(possible, key=lambda k: (effects[k].score.name in agreed, of_effects[k]))
    lead = effects[best]
    kind, day = divmod(int(np.argmax(weighted[best])), weighted[best].shape[1])
    shares = np.exp(of_effects - logsumexp(of_effects))
    cumulated = np.cumsum(np.exp(weighted[best] - of_effects[best]).sum(axis=0))
    edge = 0.5 * (1.0 - _SURE)
    early, late = (int(np.searchsorted(cumulated, level)) for level in (edge, 1.0 - edge))
    others = [effects[k].score.name for k in np.argsort(-shares) if k != best and shares[k] >= 0.1]
    grows = kind == 1
    sizes, stds = _sizes(lead.score.name, scores, day, settings)
    size, std = float(lead.size[at, kind, day]), float(lead.std[at, kind, day])
    for k, one in enumerate(shown):
        if lead.score.name in one.sizes:
            sizes[k], stds[k] = one.sizes[lead.score.name]
            size, std = (float(sizes[k]), float(stds[k])) if k == at else (size, std)
    # what is there from a recording on began since the one before; what grows from a recording on, with the one before
    return Alarm(
        at, lead.score.name, lead.score.site, lead.score.unit, float(shares[best]), tuple(others), size, std, grows,
        dates[max(day - grows, 0)], dates[max(early - 1, 0)], dates[max(min(late, at) - grows, 0)], sizes, stds,
        _gone(at, size, sizes, stds), sum(lead.score.name in names for names in judged),
    )  # fmt: skip


def _sizes(name: str, scores: Sequence[Sequence[Score]], day: int, settings: WatchConfig) -> tuple[Array, Array]:
    """An effect's size in every recording, against the mean of those before a day, and its standard deviation."""
    own = [next((score for score in some if score.name == name), None) for some in scores]
    estimates, noise, shared = np.array([
        (np.nan,) * 3 if s is None else (s.estimate, settings.inflation * s.noise_std, np.linalg.norm(s.shared))
        for s in own
    ]).T  # fmt: skip
    before = np.flatnonzero(np.isfinite(estimates[:day]))
    if not before.size:
        return estimates, np.hypot(noise, shared)
    weights = noise[before] ** -2.0
    return estimates - np.average(estimates[before], weights=weights), np.sqrt(noise**2 + 1.0 / weights.sum())


def _gone(at: int, size: float, sizes: Array, stds: Array) -> int | None:
    """Number of the recording after the alarm from which on an effect surely has less than half of the alarm's size."""
    absent = np.sign(size) * sizes + Z_90 * stds < _GONE * abs(size)
    gone: int | None = None
    for k in range(at + 1, len(sizes)):
        if np.isfinite(sizes[k]):
            gone = None if not absent[k] else k if gone is None else gone
    return gone

