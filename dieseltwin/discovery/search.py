"""The search: health-only fit, scores, refits of every competitive explanation, and the choice among them.

Works on any `Twin`. Gains are decreases of -2 log marginal likelihood over the health-only fit (DISCOVERY.md, "Steps").
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np
from scipy.special import logsumexp

from dieseltwin.discovery import law as law_search
from dieseltwin.discovery.features import Feature, Structure, generic_features, score_features
from dieseltwin.discovery.fit import Candidate, Fit, Linearisation, fit_fully, settle_local, simulate_fits
from dieseltwin.discovery.metric import Metric, Whitening
from dieseltwin.discovery.noise import Noise, estimate_noise
from dieseltwin.discovery.nuisance import Nuisance, Rebased, map_nuisances, nuisance_responses, sensor_nuisances
from dieseltwin.discovery.refit import refit_all
from dieseltwin.discovery.score import (
    Chance,
    Scored,
    best_of_each,
    chance,
    effect_responses,
    score,
    secant_sizes,
)
from dieseltwin.discovery.twin import Array, Twin
from dieseltwin.discovery.variants import Variant, onset_candidates, scan


@dataclass(frozen=True)
class Settings:
    """Thresholds of the search; gains are in units of -2 log likelihood.

    Attributes:
        sensor_gain, sensor_offset: tolerance of every sensor, one standard deviation [-].
        tolerance_factor: on the map tolerances of the twin's points.
        alarm_level: probability of a false alarm by chance alone.
        alarm_gain: a mismatch needs this gain at least, whatever chance says: tolerances are never quite Gaussian.
        alarm_size: and this share of the effect's tolerance of interest.
        second_gain: what a second effect, beyond one, must add.
        variant_gain: what an onset or a region must add.
        hidden_gain: gain of an onset or a region that raises an alarm by itself.
        unnamed_gain: gain of a term without a name that raises an alarm by itself.
        unnamed_sensor_gain: the same of a sensor's fault: these are few.
        law_gain: what a law outside the catalogue must be ahead of the best of the catalogue.
        left_gain: gain of a term without a name beyond the chosen explanation, above which that explanation is refused.
        equivalent_gain: names within this gain of the best can't be told apart: DISCOVERY.md's 9, and what maps that
            are off by their tolerance add to it.
        withhold: effects that the search must do without.
        seed: of the bootstrap.
    """

    sensor_gain: float = 0.005
    sensor_offset: float = 0.003
    tolerance_factor: float = 1.0
    alarm_level: float = 1e-3
    alarm_gain: float = 18.0
    alarm_size: float = 0.8
    second_gain: float = 32.0
    variant_gain: float = 30.0
    hidden_gain: float = 45.0
    unnamed_gain: float = 32.0
    unnamed_sensor_gain: float = 20.0
    law_gain: float = 15.0
    left_gain: float = 60.0
    equivalent_gain: float = 12.0
    withhold: tuple[str, ...] = ()
    seed: int = 0


@dataclass
class Search:
    """Everything that the search found out; `chosen` is the explanation, `null` the health-only fit."""

    twin: Twin
    settings: Settings
    noise: Noise
    whitening: Whitening
    null: Linearisation
    scored: list[Scored]
    chance: Chance
    singles: list[Fit] = field(default_factory=list)
    pairs: list[Fit] = field(default_factory=list)
    scanned: list[Variant] = field(default_factory=list)
    variants: list[tuple[Variant, Fit]] = field(default_factory=list)
    structure: list[Structure] = field(default_factory=list)
    left: list[Structure] = field(default_factory=list)
    best: Linearisation | None = None
    kind: str = "healthy"
    probabilities: dict[str, float] = field(default_factory=dict)
    equivalent: list[tuple[str, ...]] = field(default_factory=list)
    variant: Variant | None = None
    law: law_search.Law | None = None
    refused: str = ""
    nuisances: list[Nuisance] = field(default_factory=list)
    left_out: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    seconds: dict[str, float] = field(default_factory=dict)

    def gain(self, fit: Fit) -> float:
        """Gain of a fit over the health-only fit."""
        return self.null.fit.objective - fit.objective


_REFIT_SHARE = 0.35  # of the best linear gain: weaker hypotheses can't win even when non-linearity moves them
_REFIT_AT_LEAST = 6
_PAIRS = 10
_VARIANTS = 6
_POLISHED = 4  # of the best fits get sensitivities of their own
_REBASED_BELOW = 150.0  # gain; clear cases needn't be verified
_VERIFIED = 3
_TOLERANCE_DRAWS = 2
_CROOKED = 3.0  # squared whitened distance of a window from linear, by one draw of the tolerances
GROWTH = 1.0  # of the weight of initial states over a window, above which it is cut
PARTS = 4
_LEADING = 60.0  # gain within which a fit counts as leading


def prepare(twin: Twin, settings: Settings) -> Search:
    """Noise, health-only fit, tolerances, scores of all hypotheses: everything before a name is thought of."""
    clock = time.perf_counter()
    pieces = np.array([], dtype=int)
    noise = estimate_noise(twin.measured, pieces)
    start = Fit(
        Candidate(), np.array([p.value for p in twin.parameters]), np.zeros(0), twin.first_local(), np.inf, False
    )
    whitening = Whitening.of(twin.measured, noise, twin.starts)
    rough = fit_fully(twin, whitening, start, rounds=5)
    if hasattr(twin, "split"):
        growing = rough.metric.growing(GROWTH)
        if growing.any():
            start = replace(rough.fit, local=twin.split(growing, PARTS, rough.fit.local))
            whitening = Whitening.of(twin.measured, noise, twin.starts)
            rough = fit_fully(twin, whitening, start, rounds=5)
    # correlation can only be told once the signal is explained; only the fast part of the misfit is used
    noise = estimate_noise(twin.measured, pieces, explained=rough.simulated)
    whitening = Whitening.of(twin.measured, noise, twin.starts)
    nuisances = tolerances(twin, rough, settings)
    nuisance = nuisance_responses(twin, rough.fit.lanes(), rough.simulated, nuisances)
    crooked = crooked_windows(rough, whitening, nuisances, nuisance, settings.seed)
    if crooked.any():
        twin.measured[np.repeat(crooked, np.diff(np.append(twin.starts, twin.time_s.size)))] = np.nan
        whitening = Whitening.of(twin.measured, noise, twin.starts)
    null = settle_local(fit_fully(twin, whitening, rough.fit, nuisance))
    names = [name for name in twin.hypotheses if name not in settings.withhold]
    wanted = secant_sizes(twin, names)
    scored = score(null, wanted, effect_responses(twin, null, wanted))
    found = Search(twin, settings, noise, whitening, null, scored, chance(null, scored, settings.seed))
    found.left_out, found.nuisances = crooked, nuisances
    found.seconds["prepare"] = time.perf_counter() - clock
    return found


def tolerances(twin: Twin, at: Linearisation, settings: Settings) -> list[Nuisance]:
    """Directions in which maps and sensors may be off, one standard deviation each."""
    channels = len(twin.channels)
    return [
        *map_nuisances(twin, twin.variables(at.fit.lanes()), settings.tolerance_factor),
        *sensor_nuisances(
            twin, at.simulated, [settings.sensor_gain] * channels, [settings.sensor_offset] * channels
        ),
    ]


def tolerance_responses(twin: Twin, at: Linearisation, settings: Settings) -> Array:
    """Responses (K, n, C) to the tolerances of maps and sensors, per standard deviation."""
    return nuisance_responses(twin, at.fit.lanes(), at.simulated, tolerances(twin, at, settings))


def crooked_windows(
    at: Linearisation, whitening: Whitening, nuisances: Sequence[Nuisance], responses: Array, seed: int
) -> np.ndarray:
    """(W,) windows in which errors of maps within their tolerance don't act linearly, at most a third of all.

    Next to an instability a map error of a few tenths of a percent sends the turbo elsewhere. No linear tolerance
    covers that, and any effect that bends the trajectory the right way would be taken for the cause.
    """
    twin = at.twin
    rng = np.random.default_rng(seed)
    worst = np.zeros(twin.starts.size)
    for _ in range(_TOLERANCE_DRAWS):
        signals: dict[str, Array] = {}
        linear = np.zeros_like(at.simulated)
        for nuisance, response in zip(nuisances, responses, strict=True):
            if nuisance.point is not None and nuisance.signal is not None:
                size = rng.standard_normal()
                name = twin.points[nuisance.point].name
                signals[name] = signals.get(name, np.zeros(twin.time_s.size)) + size * nuisance.signal
                linear += size * response
        if not signals:
            break
        simulated = twin.simulate(at.fit.lanes(signals=signals))[0]
        bend = Metric(whitening, twin.starts, at.local_response, twin.state_scales).without_local(
            (simulated - at.simulated - linear)[None]
        )[0]
        squared = bend[: at.residual.size].reshape(at.residual.shape) ** 2
        worst = np.maximum(worst, np.add.reduceat(squared.sum(axis=1), twin.starts))
    limit = max(_CROOKED, float(np.quantile(worst, 2.0 / 3.0)))
    return worst > limit


def run(twin: Twin, settings: Settings, *, laws: bool = True) -> Search:
    """The whole search.

    Args:
        twin: bound to its recording.
        settings: thresholds.
        laws: look for a law where no name fits.
    """
    found = prepare(twin, settings)
    clock = time.perf_counter()
    ranked = best_of_each(found.scored)
    top = max(ranked[0].gain, 1e-9) if ranked else 0.0
    kept = [s for k, s in enumerate(ranked) if s.gain > _REFIT_SHARE * top or k < _REFIT_AT_LEAST]
    fits = refit_all(found.null, [Candidate((s.name,)) for s in kept], [s.response[None] for s in kept])
    found.singles = sorted(fits, key=lambda fit: fit.objective)
    found.singles = _polish(found, found.singles)
    found.seconds["singles"] = time.perf_counter() - clock

    found.scanned = scan(found.null, found.scored, _VARIANTS)
    hidden = bool(found.scanned) and found.scanned[0].gain > found.settings.hidden_gain
    base = _verify(found) if found.gain(found.singles[0]) < _REBASED_BELOW else found.null
    clock = time.perf_counter()
    found.structure = score_features(base, generic_features(twin, found.null.fit))
    found.seconds["structure"] = time.perf_counter() - clock
    if not _alarm(found, found.singles[0]) and not hidden:
        if _unnamed(found):
            _law(found, laws)
        return found
    found.kind = "single"
    clock = time.perf_counter()
    lead = found.singles[0]
    first = fit_fully(twin, found.whitening, lead, rounds=2, frozen=found.null)
    found.best = first
    _try_variants(found)
    found.seconds["variants"] = time.perf_counter() - clock
    clock = time.perf_counter()
    _try_pairs(found, first)
    found.seconds["pairs"] = time.perf_counter() - clock
    _choose(found, first)
    if found.kind == "law":
        _law(found, laws)
    return found


def _law(found: Search, wanted: bool) -> None:
    """No name fits: a law from the grammar, where one is resolved and asked for."""
    found.kind = "law"
    found.best = None
    if wanted and found.structure[0].feature.channel is None:
        clock = time.perf_counter()
        found.law = law_search.search(found.twin, found.null, found.null.nuisance_response).law
        found.seconds["law"] = time.perf_counter() - clock


def _verify(found: Search) -> Linearisation:
    """Objectives of the health-only fit and of the leading singles with the estimated errors of the maps simulated.

    Returns the health-only linearisation about those errors.
    """
    null = found.null
    base = rebased(found, null.fit)
    if found.gain(found.singles[0]) < 0.7 * found.settings.alarm_gain:
        return base
    changed = {fit.candidate.names: rebased(found, fit).fit for fit in found.singles[:_VERIFIED]}
    null.fit = replace(null.fit, objective=min(base.fit.objective, null.fit.objective))
    singles = [
        replace(fit, objective=changed[fit.candidate.names].objective) if fit.candidate.names in changed else fit
        for fit in found.singles
    ]
    found.singles = sorted(singles, key=lambda fit: fit.objective)
    return base


def rebased(found: Search, fit: Fit, rounds: int = 2) -> Linearisation:
    """A fit about its own estimate of the maps' errors (`nuisance.Rebased`), in the metric of the health-only fit."""
    null = found.null
    at = null
    if null.nuisance_response is None:
        return at
    residual = np.nan_to_num(found.twin.measured - simulate_fits(found.twin, [fit])[0])
    for _ in range(rounds):
        estimate = null.metric.nuisance_estimate(residual)
        twin = Rebased(found.twin, found.nuisances, null.nuisance_response, estimate)
        at = fit_fully(cast(Twin, twin), found.whitening, fit, rounds=3, frozen=null)
        fit, residual = at.fit, np.nan_to_num(at.residual)
    return at


def _unnamed(found: Search) -> bool:
    """Whether a term without a name raises an alarm by itself."""
    if not found.structure:
        return False
    item = found.structure[0]
    settings = found.settings
    sensor = item.feature.channel is not None
    return item.gain > (settings.unnamed_sensor_gain if sensor else settings.unnamed_gain)


def _alarm(found: Search, fit: Fit) -> bool:
    gain = found.gain(fit)
    threshold = max(found.settings.alarm_gain, found.chance.threshold(found.settings.alarm_level))
    tolerances = [found.twin.hypotheses[name].tolerance for name in fit.candidate.names]
    large = all(
        abs(m) >= found.settings.alarm_size * t for m, t in zip(fit.magnitudes, tolerances, strict=True)
    )
    return bool(gain >= threshold and large)


def _polish(found: Search, fits: Sequence[Fit], count: int = _POLISHED) -> list[Fit]:
    """Full refits of the leading fits; the rest as they are."""
    best = fits[0].objective
    out = []
    for k, fit in enumerate(fits):
        if k < count and fit.objective < best + _LEADING and found.gain(fit) > 4.0:
            polished = fit_fully(found.twin, found.whitening, fit, rounds=3, frozen=found.null).fit
            out.append(polished)
        else:
            out.append(fit)
    return sorted(out, key=lambda fit: fit.objective)


def _try_variants(found: Search) -> None:
    """Effects that begin in the middle or act in a part of the operating range only."""
    top = found.gain(found.singles[0]) if found.singles else 0.0
    variants = [v for v in found.scanned[:_VARIANTS] if v.gain > 0.5 * top]
    if variants:
        _refit_variants(found, variants)
        best = found.variants[0][0]
        if best.onset_s is not None:
            for reach, count in ((8.0, 5), (2.0, 5)):
                best, fit = found.variants[0]
                _refit_variants(found, [
                    replace(best, onset_s=t, schedule=(found.twin.time_s >= t).astype(float))
                    for t in onset_candidates(found.twin, float(best.onset_s or 0.0), reach, count)
                ], fit)  # fmt: skip


def _refit_variants(found: Search, variants: Sequence[Variant], start: Fit | None = None) -> None:
    """Refits of variants, added to those that are known; from `start` if it has the same effect."""
    del start
    candidates = [Candidate((v.name,), {v.name: v.schedule}) for v in variants]
    fits = refit_all(found.null, candidates, [v.response[None] for v in variants])
    pairs = [*found.variants, *zip(variants, fits, strict=True)]
    found.variants = sorted(pairs, key=lambda pair: pair[1].objective)


def _pair_gains(found: Search) -> list[tuple[float, Scored, Scored]]:
    """Linear gain of every pair of hypotheses at the health-only fit, strongest first."""
    items = best_of_each(found.scored)
    vectors = np.stack([s.projected for s in items])
    gram = vectors @ vectors.T
    push = vectors @ found.null.projected_residual
    sided = [found.twin.hypotheses[s.name].limits[0] >= 0.0 for s in items]
    out = []
    for i in range(len(items)):
        for j in range(i + 1, len(items)):
            a, b, c = gram[i, i], gram[j, j], gram[i, j]
            determinant = a * b - c * c
            if determinant < 1e-6 * a * b or a == 0.0 or b == 0.0:
                continue
            x = (b * push[i] - c * push[j]) / determinant
            y = (a * push[j] - c * push[i]) / determinant
            if (sided[i] and x < 0) or (sided[j] and y < 0):
                continue
            out.append((float(x * push[i] + y * push[j]), items[i], items[j]))
    return sorted(out, key=lambda item: -item[0])


def _try_pairs(found: Search, first: Linearisation) -> None:
    """Two effects: the best pairs of the linear table, and what the residual of the best single asks for."""
    names = [name for name in found.twin.hypotheses if name not in found.settings.withhold]
    lead = first.fit.candidate.names[0]
    wanted = secant_sizes(found.twin, [name for name in names if name != lead])
    if not wanted:
        return
    beyond = best_of_each(score(first, wanted, effect_responses(found.twin, first, wanted)))
    by_name = {s.name: s for s in best_of_each(found.scored)}
    pairs: dict[tuple[str, ...], tuple[Scored, Scored]] = {}
    if beyond and beyond[0].gain < 0.5 * found.settings.second_gain and found.gain(found.singles[0]) > 0:
        # nothing left to explain at the best single fit
        enough = _pair_gains(found)[:1]
        if not enough or enough[0][0] < found.gain(found.singles[0]) + 0.5 * found.settings.second_gain:
            return
    for item in beyond[: _PAIRS // 2]:
        if item.gain > 0.4 * found.settings.second_gain:
            key = tuple(sorted((lead, item.name)))
            pairs[key] = (by_name[key[0]], by_name[key[1]])
    for gain, a, b in _pair_gains(found)[:_PAIRS]:
        if gain > found.gain(found.singles[0]) - _LEADING:
            key = tuple(sorted((a.name, b.name)))
            pairs[key] = (by_name[key[0]], by_name[key[1]])
    if not pairs:
        return
    candidates = [Candidate(key) for key in pairs]
    responses = [np.stack([a.response, b.response]) for a, b in pairs.values()]
    fits = sorted(refit_all(found.null, candidates, responses), key=lambda fit: fit.objective)
    found.pairs = _polish(found, fits, 3)


def _choose(found: Search, first: Linearisation) -> None:
    settings = found.settings
    single = found.gain(found.singles[0])
    options: list[tuple[float, str, Fit | None, Variant | None]] = [(single, "single", first.fit, None)]
    if found.variants:
        variant, fit = found.variants[0]
        options.append((found.gain(fit) - settings.variant_gain, "variant", fit, variant))
    pair = next(
        (
            fit
            for fit in found.pairs
            if all(
                abs(m) >= settings.alarm_size * found.twin.hypotheses[name].tolerance
                for name, m in zip(fit.candidate.names, fit.magnitudes, strict=True)
            )
        ),
        None,
    )
    if pair is not None:
        options.append((found.gain(pair) - settings.second_gain, "pair", pair, None))
    best, kind, fit, variant = max(options, key=lambda option: option[0])
    if found.structure and found.structure[0].gain > best + settings.law_gain:
        found.kind = "law"
        return
    found.kind, found.variant = kind, variant
    if fit is not None and kind != "single":
        found.best = fit_fully(found.twin, found.whitening, fit, rounds=3, frozen=found.null)
    if found.best is not None:  # a confident lie is what nearly fits: look at what the explanation leaves
        found.left = score_features(found.best, generic_features(found.twin, found.best.fit))
        if found.left and found.left[0].gain > settings.left_gain:
            found.refused = kind
    _probabilities(found, kind)


def occam(found: Search, fit: Fit) -> float:
    """Log evidence of a fit up to a constant: half its gain less what the precision of its magnitudes costs.

    Magnitudes are believed log-uniform between their tolerance and 30 times it.
    """
    value = 0.5 * found.gain(fit)
    stds = fit.std[len(found.twin.parameters) :]
    for magnitude, std in zip(np.abs(fit.magnitudes), stds, strict=True):
        if np.isfinite(std) and std > 0 and magnitude > 0:
            value += float(np.log(np.sqrt(2 * np.pi) * min(std, magnitude) / (magnitude * np.log(30.0))))
    return value


def _probabilities(found: Search, kind: str) -> None:
    """Probabilities of the names of the chosen kind, and who can't be told apart."""
    pool = found.pairs if kind == "pair" else [f for _, f in found.variants] if kind == "variant" else found.singles
    if not pool:
        return
    keys = [" + ".join(fit.candidate.names) for fit in pool]
    evidence = np.array([occam(found, fit) for fit in pool])
    weights = np.exp(evidence - logsumexp(evidence))
    found.probabilities = {}
    for key, weight in zip(keys, weights, strict=True):
        found.probabilities[key] = found.probabilities.get(key, 0.0) + float(weight)
    best = min(fit.objective for fit in pool)
    seen: list[tuple[str, ...]] = []
    for fit in pool:
        if fit.objective - best < found.settings.equivalent_gain and fit.candidate.names not in seen:
            seen.append(fit.candidate.names)
    found.equivalent = seen


__all__ = ["Feature", "Search", "Settings", "prepare", "replace", "run"]
