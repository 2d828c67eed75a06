"""Scores of all hypotheses at one linearisation, and what chance alone would give (docs/discovery.md)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from dieseltwin.discovery.likelihood.fit import Candidate, Fit, Linearisation
from dieseltwin.discovery.twins.interface import Array, Lanes, Twin, repeated
from dieseltwin.least_squares import Z_90, symmetric_root

_DRAWS = 4000  # of the parametric bootstrap; beyond their reach the tail of chi-square is taken
_WIDER_BESIDE = 1.5  # standard deviation of an effect that is there over that of none: 0.9 to 1.7, 14 of 15 below 1.46
_SIZE_OF_TOLERANCE = 1.5  # secants of smooth effects are taken at this multiple of their tolerance
_SAME_DIRECTION = 0.98  # cosine from which two sizes of an effect do the same


@dataclass(frozen=True)
class Scored:
    """One hypothesis at a linearisation.

    Attributes:
        name: of the effect.
        size: magnitude at which the secant was taken [unit].
        response: (n, C) response of the readings per unit of magnitude.
        projected: (rows + P,) the same in the metric, parameters taken out too; see `without_parameters`.
        magnitude, std: linear estimate and its standard deviation [unit].
        gain: decrease of -2 log likelihood that the linear estimate gives, 0 on the wrong side of a one-sided limit.
    """

    name: str
    size: float
    response: Array
    projected: Array
    magnitude: float
    std: float
    gain: float


def effect_responses(twin: Twin, at: Linearisation, wanted: Sequence[tuple[str, float]]) -> Array:
    """Responses (K, n, C) per unit of effects added to a fit, as secants at the given sizes."""
    return effects_beside(twin, at.fit.lanes(), at.simulated, wanted)


def effects_beside(twin: Twin, base: Lanes, simulated: Array, wanted: Sequence[tuple[str, float]]) -> Array:
    """The same next to one lane, whose readings (n, C) are known."""
    count = len(wanted)
    names = list(dict.fromkeys([*base.magnitudes, *(name for name, _ in wanted)]))
    magnitudes = {name: np.full(count, float(base.magnitudes.get(name, np.zeros(1))[0])) for name in names}
    for k, (name, size) in enumerate(wanted):
        magnitudes[name][k] += size
    lanes = replace(repeated(base, count), magnitudes=magnitudes)
    sizes = np.array([size for _, size in wanted])
    return (twin.simulate(lanes) - simulated) / sizes[:, None, None]


def secant_sizes(twin: Twin, names: Sequence[str]) -> list[tuple[str, float]]:
    """The sizes at which effects are tried first: one for smooth ones, several for those without a derivative at 0,
    none for those that take the place of a command."""
    wanted = []
    for name in names:
        hypothesis = twin.hypotheses[name]
        if hypothesis.in_place_of:
            continue
        sizes = hypothesis.sizes if not hypothesis.smooth else (_SIZE_OF_TOLERANCE * hypothesis.tolerance,)
        wanted += [(name, float(np.clip(-size if hypothesis.sign < 0.0 else size, *hypothesis.limits)))
                   for size in sizes]  # fmt: skip
    return wanted


def without_parameters(at: Linearisation, projected: Array) -> Array:
    """Vectors (K, rows) in the metric with the parameters' (and the fit's own effects') directions taken out.

    (K, rows + P + m): a parameter that moves for an effect costs what its prior says, in a row of its own. Without
    these an effect that a narrow prior lets the parameters take up, strained, would seem to gain nothing.
    """
    weights = (projected @ at.projected.T) @ at.covariance
    return np.hstack([projected - weights @ at.projected, -weights * np.sqrt(at.precision)])


def score(at: Linearisation, wanted: Sequence[tuple[str, float]], responses: Array) -> list[Scored]:
    """Efficient scores of effects: the linear estimate of each, and what it would gain."""
    projected = without_parameters(at, at.metric.project(responses))
    found = []
    for (name, size), response, vector in zip(wanted, responses, projected, strict=True):
        information = float(vector @ vector)
        low, high = at.twin.hypotheses[name].limits
        if information <= 0.0:
            found.append(Scored(name, size, response, vector, 0.0, np.inf, 0.0))
            continue
        estimate = float(vector @ at.pulled_residual) / information
        allowed = float(np.clip(estimate, low, high))
        gain = information * allowed * (2.0 * estimate - allowed)
        found.append(Scored(name, size, response, vector, allowed, information**-0.5, max(gain, 0.0)))
    return found


def spread(at: Linearisation, vector: Array) -> float:
    """Share of a direction's gain that is left without the window that it hangs on most, 0-1.

    Next to a kink (EGR flow at p_em = p_im) the tolerances of one window aren't linear, and can leave what looks like
    an effect; one that is real acts elsewhere too.

    Args:
        at: the fit that leaves the residual.
        vector: (rows,) the direction in its metric, parameters taken out.
    """
    n, channels = at.residual.shape
    starts = at.twin.starts * channels
    push, information = float(vector @ at.pulled_residual), float(vector @ vector)
    if starts.size < 2 or push == 0.0:
        return 1.0
    own = vector[: n * channels]
    pushes = np.add.reduceat(own * at.pulled_residual[: n * channels], starts)
    informations = np.add.reduceat(own * own, starts)
    rest = np.maximum(information - informations, 1e-9 * information)
    return min(1.0, float(np.min((push - pushes) ** 2 / rest)) * information / push**2)


def best_of_each(scored: Sequence[Scored]) -> list[Scored]:
    """The best size of each hypothesis, strongest first."""
    best: dict[str, Scored] = {}
    for item in scored:
        if item.name not in best or item.gain > best[item.name].gain:
            best[item.name] = item
    return sorted(best.values(), key=lambda item: -item.gain)


def ways_of_each(scored: Sequence[Scored]) -> list[Scored]:
    """The best size of each hypothesis, and of the others those whose direction is another, strongest first.

    Next to a kink (a throttle that a pressure read high makes wide open) an effect does one thing upwards and another
    downwards; which of them begins in the middle is not told by which is better from the first row on.
    """
    best = {item.name: item for item in best_of_each(scored)}

    def differs(item: Scored) -> bool:
        one, other = item.projected, best[item.name].projected
        both = float(np.linalg.norm(one) * np.linalg.norm(other))
        return both > 0.0 and abs(float(one @ other)) < _SAME_DIRECTION * both

    return sorted([*best.values(), *filter(differs, scored)], key=lambda item: -item.gain)


def as_fits(at: Linearisation, scored: Sequence[Scored]) -> list[Fit]:
    """The linear estimate of each effect that shows as a fit of its own, strongest first: what the parameters are
    beside it, and of its covariance the variance of the effect's size alone."""
    count, fits = len(at.twin.parameters), []
    for item in best_of_each(scored):
        if not np.isfinite(item.std):
            continue
        covariance = np.diag(np.append(np.zeros(count), item.std**2))
        moved = item.magnitude * _moved_by(at, item)
        fits.append(replace(at.fit, candidate=Candidate((item.name,)), parameters=at.fit.parameters + moved,
                            magnitudes=np.array([item.magnitude]), objective=at.fit.objective - item.gain,
                            covariance=covariance))  # fmt: skip
    return fits


def _moved_by(at: Linearisation, item: Scored) -> Array:
    """What an effect that is fitted, too, moves the parameters of a fit by, (P,) [their units per unit]."""
    rows, prior_std = at.projected.shape[1], np.array([p.prior_std for p in at.twin.parameters])
    # `without_parameters` left what each parameter moves by beside its prior
    return np.asarray(item.projected[rows : rows + prior_std.size] * prior_std)


@dataclass(frozen=True)
class Chance:
    """Distribution of the largest gain among all hypotheses when none is true."""

    draws: Array
    effective: float

    def p_value(self, gain: float) -> float:
        """Probability that chance alone gives at least this gain."""
        if gain <= 0.0:
            return 1.0
        exceeded = float(np.mean(self.draws >= gain))
        if exceeded * self.draws.size >= 20:
            return exceeded
        return float(min(1.0, self.effective * chdtrc(1, gain)))

    def threshold(self, level: float) -> float:
        """Gain that chance exceeds with probability `level`."""
        low, high = 0.0, 1e4
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.p_value(middle) > level else (low, middle)
        return high


def chance(at: Linearisation, scored: Sequence[Scored], seed: int) -> Chance:
    """Parametric bootstrap of the toleranced healthy machine, in the metric: noise and tolerances at their priors.

    In the augmented space all of that is white, so a draw needs the Gram matrix of the hypotheses alone.
    """
    units, signs = [], []
    if not any(np.any(item.projected) for item in scored):  # a tank that never overflows shows no overflow
        return Chance(np.zeros(1), 0.0)
    for item in scored:
        norm = np.sqrt(item.projected @ item.projected)
        if norm > 0:
            units.append(item.projected / norm)
            signs.append(at.twin.hypotheses[item.name].sign)
    gram = np.stack(units) @ np.stack(units).T
    draws = np.random.default_rng(seed).normal(size=(_DRAWS, len(units))) @ symmetric_root(gram)
    draws = np.where(draws * signs < 0.0, 0.0, draws)
    largest = (draws**2).max(axis=1)
    at_level = np.quantile(largest, 0.98)
    return Chance(largest, float(0.02 / chdtrc(1, at_level)))


def minimum_detectable(scored: Sequence[Scored], gain: float) -> dict[str, float]:
    """Smallest magnitude of each effect whose expected gain reaches a threshold [unit].

    An estimate scatters to both sides of the truth: an effect of that size reaches it in half of such recordings, in
    fewer where it widens its own standard deviation (`_WIDER_BESIDE`).
    """
    smallest: dict[str, float] = {}
    for item in scored:
        value = item.std * float(np.sqrt(gain))
        smallest[item.name] = min(value, smallest.get(item.name, np.inf))
    return smallest


def surely_found(scored: Sequence[Scored], gain: float, least: Mapping[str, float]) -> dict[str, float]:
    """Smallest magnitude of each effect that raises an alarm in 19 of 20 such recordings [unit].

    Its estimate is 1.64 standard deviations too small at most in those, which are wider than they are without it.

    Args:
        scored: effects; gain: that an alarm needs.
        least: name -> smallest estimate that an alarm needs [unit].
    """
    smallest: dict[str, float] = {}
    for item in scored:
        std = _WIDER_BESIDE * item.std
        value = max(std * float(np.sqrt(gain)), least[item.name]) + Z_90 * std
        smallest[item.name] = min(value, smallest.get(item.name, np.inf))
    return smallest


def taken_for(at: Linearisation, scored: Sequence[Scored], gain: float) -> dict[str, Array]:
    """What each effect of its smallest visible size, left out, moves the parameters of a fit by, (P,) [unit each].

    To first order: the effect's response along the parameters' directions, as far as their priors let them go. An
    effect that falls as well as rises is taken to rise.

    Args:
        at: the fit; scored: effects at it.
        gain: as of `minimum_detectable`.
    """
    moved: dict[str, Array] = {}
    for name, size in minimum_detectable(scored, gain).items():
        if not np.isfinite(size):  # it does nothing here: play in the drive of a valve that stands still
            moved[name] = np.zeros(len(at.twin.parameters))
            continue
        item = min((each for each in scored if each.name == name), key=lambda each: each.std)
        falls = at.twin.hypotheses[name].sign < 0.0
        moved[name] = (size if falls else -size) * _moved_by(at, item)
    return moved
