"""Before a name is thought of: noise, health-only fit, tolerances, scores of all hypotheses."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from dieseltwin.discovery.likelihood.between_rows import scatter_about, widened
from dieseltwin.discovery.likelihood.circumstances import circumstance_nuisances
from dieseltwin.discovery.likelihood.fit import (
    Candidate,
    Fit,
    Linearisation,
    first_fit,
    fit_fully,
    settle_local,
    simulate_fits,
)
from dieseltwin.discovery.likelihood.known import KnownErrors
from dieseltwin.discovery.likelihood.learned import (
    LearnedTwin,
    about,
    belief_of,
    learned_nuisances,
    loadings_of,
)
from dieseltwin.discovery.likelihood.metric import ModelScatter, Whitening
from dieseltwin.discovery.likelihood.noise import noise_of
from dieseltwin.discovery.likelihood.nuisance import (
    LEADING,
    Detail,
    Nuisance,
    map_nuisances,
    nuisance_responses,
    sensor_nuisances,
)
from dieseltwin.discovery.likelihood.score import chance, effect_responses, score, secant_sizes
from dieseltwin.discovery.search.bends import bent_windows
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.interface import Array, Lanes, Twin, rows_of
from dieseltwin.errors import InputError
from dieseltwin.learning.belief import Belief
from dieseltwin.recordings.noise import Noise
from dieseltwin.settings.search import SearchSettings

_ALONE_ROUNDS = 6
_GROWTH = 1.0  # of the weight of initial states over a window, above which it is cut
_PARTS = 4
_NEAR = 0.02  # standard deviations between fits whose tolerances act alike: from 0.3 away sizes differ by 0.03
_KINKS = 10  # times that windows are given up because they alone tell a parameter


def prepare(
    twin: Twin, settings: SearchSettings, beside: Fit | None = None, among: Collection[str] | None = None
) -> Search:
    """Noise, health-only fit, tolerances, scores of all hypotheses: everything before a name is thought of.

    Args:
        twin: bound to its recording.
        settings: thresholds.
        beside: an explanation of nearly all: noise, tolerances and scores are then about it (`Search.best`), and the
            health-only fit is in its metric.
        among: only these are scored, where the one that leads is all that is asked; None: all.

    Raises:
        InputError: nothing is left of the catalogue.
    """
    clock = time.perf_counter()
    if not _tried(twin, settings):
        raise InputError("withhold", "every effect that this machine has", "fewer", "leave one or more to be tried")
    readings = twin.measured.copy()
    noise = twin.noise() if isinstance(twin, KnownErrors) else noise_of(twin)
    whitening = _whitening(twin, noise)
    rough = fit_fully(twin, whitening, beside or first_fit(twin), rounds=5)
    start = split_growing(rough)
    if start is not None:
        whitening = _whitening(twin, noise)
        rough = fit_fully(twin, whitening, start, rounds=5)
    scatter = scatter_about(twin, rough.fit.lanes())
    if not isinstance(twin, KnownErrors):
        # correlation can only be told once the signal is explained; only the fast part of the misfit is used
        noise = noise_of(twin, rough.simulated, scatter.windows)
    whitening = _whitening(twin, noise, scatter)
    nuisances = tolerances(twin, rough, settings)
    nuisance = nuisance_responses(twin, rough.fit.lanes(), rough.simulated, nuisances)
    crooked, bent = bent_windows(rough, whitening, nuisances, nuisance, settings.seed)
    scatter = replace(scatter, bent=bent)
    if crooked.any() or bent:
        twin.measured[rows_of(twin, crooked)] = np.nan
        whitening = _whitening(twin, noise, scatter)
    null = settle_local(fit_fully(twin, whitening, rough.fit, nuisance, loadings=loadings_of(nuisances)))
    if scatter.windows:
        scatter, beyond = widened(null, noise, scatter)
        crooked |= beyond
        twin.measured[rows_of(twin, crooked)] = np.nan
        whitening = _whitening(twin, noise, scatter)
        null = settle_local(fit_fully(twin, whitening, null.fit, nuisance, loadings=loadings_of(nuisances)))
    if beside is not None:
        null, alone_tell = _without_kinks(null, lambda: _whitening(twin, noise, scatter))
        crooked |= alone_tell
    found = _scored(null, noise, settings, among)
    if beside is not None:
        alone = replace(null.fit, candidate=Candidate(), magnitudes=np.zeros(0), covariance=None)
        found.best, found.null = null, fit_fully(twin, null.whitening, alone, frozen=null)
    found.left_out, found.nuisances, found.scatter = crooked, nuisances, scatter
    readings -= twin.moved if isinstance(twin, LearnedTwin) else 0.0
    found.hidden = np.where(rows_of(twin, crooked)[:, None], readings, np.nan)
    found.seconds["prepare"] = time.perf_counter() - clock
    return found


def telling_alone(at: Linearisation) -> np.ndarray:
    """(W,) windows that tell more of a parameter than all the others together.

    Where a valve stands still the engine comes to the kink of the EGR flow (both pressures equal), whose slope has no
    limit: a window there claims to know health a thousand times better than all the rest, linearly and wrongly.
    """
    twin = at.twin
    size, channels = at.residual.size, at.residual.shape[1]
    own = at.projected[: len(twin.parameters), :size] ** 2
    shares = np.add.reduceat(own, twin.starts * channels, axis=1)
    return np.asarray((shares > 0.5 * shares.sum(axis=1, keepdims=True)).any(axis=0))


def _without_kinks(at: Linearisation, whitening: Callable[[], Whitening]) -> tuple[Linearisation, np.ndarray]:
    """A fit without the windows that `telling_alone` finds, and which these are, (W,)."""
    twin, found = at.twin, np.zeros(at.twin.starts.size, dtype=bool)
    for _ in range(_KINKS):
        alone = telling_alone(at)
        if not alone.any():
            break
        found |= alone
        twin.measured[rows_of(twin, alone)] = np.nan
        at = settle_local(fit_fully(twin, whitening(), at.fit, at.nuisance_response, loadings=at.loadings))
    return at, found


def _whitening(twin: Twin, noise: Noise, scatter: ModelScatter | None = None) -> Whitening:
    """Whitening by what a calibration knows of each sample, else by stationary noise and further scatter."""
    if isinstance(twin, KnownErrors):
        return twin.whitening()
    return Whitening.of(twin.measured, noise, twin.starts, scatter)


def _tried(twin: Twin, settings: SearchSettings) -> list[tuple[str, float]]:
    """Effects of the catalogue that are tried, and at which sizes."""
    return secant_sizes(twin, [name for name in twin.hypotheses if name not in settings.withhold])


def _scored(
    null: Linearisation, noise: Noise, settings: SearchSettings, among: Collection[str] | None = None
) -> Search:
    twin = null.twin
    wanted = [item for item in _tried(twin, settings) if among is None or item[0] in among]
    scored = score(null, wanted, effect_responses(twin, null, wanted))
    return Search(twin, settings, noise, null.whitening, null, scored, chance(null, scored, settings.seed))


def score_the_rest(found: Search) -> None:
    """Score the effects that weren't when only the leading one was asked."""
    tried, known = _tried(found.twin, found.settings), {item.name for item in found.scored}
    wanted = [item for item in tried if item[0] not in known]
    if wanted:
        more = score(found.null, wanted, effect_responses(found.twin, found.null, wanted))
        found.scored = sorted([*found.scored, *more], key=lambda item: tried.index((item.name, item.size)))
        found.chance = chance(found.null, found.scored, found.settings.seed)


def prepared_about(found: Search, fit: Fit) -> Search:
    """As `prepare`, with what is still open of the maps linearised about an explanation, not about health alone; of a
    twin that knows its engine.

    The health-only fit of an engine with a fault bends its maps to the edge of what is believed, where their responses
    are others.
    """
    clock = time.perf_counter()
    residual = np.nan_to_num(found.twin.measured - simulate_fits(found.twin, [fit])[0])
    lanes = fit.lanes()
    # the directions are taken where the estimate was: what was simulated for it is simulated once
    twin, simulated, columns = about(found.twin, lanes, found.nuisances, found.null.metric.nuisance_estimate(residual))
    nuisances = _of_learned(twin, lanes, simulated, found.whitening, columns)
    responses = nuisance_responses(twin, lanes, simulated, nuisances)
    at = fit_fully(twin, found.whitening, found.null.fit, responses, loadings=loadings_of(nuisances))
    renewed = _scored(settle_local(at), found.noise, found.settings)
    renewed.left_out, renewed.nuisances, renewed.scatter = found.left_out, nuisances, found.scatter
    renewed.hidden, renewed.about = found.hidden, fit
    renewed.seconds["prepare"] = found.seconds["prepare"] + time.perf_counter() - clock
    return renewed


def split_growing(at: Linearisation) -> Fit | None:
    """Cut the windows in which initial states grow, where the twin can: the fit on the new windows, None if none do."""
    growing = at.metric.growing(_GROWTH)
    local = at.twin.split(growing, _PARTS, at.fit.local) if growing.any() else None
    return None if local is None else replace(at.fit, local=local)


def tolerances(
    twin: Twin, at: Linearisation, settings: SearchSettings, detail: Detail = LEADING
) -> list[Nuisance]:
    """Directions in which maps, sensors and circumstances may be off, one standard deviation each."""
    if isinstance(twin, KnownErrors):
        return twin.nuisances(at.fit.lanes())
    channels = len(twin.channels)
    if belief_of(twin) is not None:
        return _of_learned(twin, at.fit.lanes(), at.simulated, at.whitening)
    return [
        *map_nuisances(twin, twin.variables(at.fit.lanes()), settings.tolerance_factor, detail),
        *sensor_nuisances(
            twin, at.simulated, [settings.sensor_gain] * channels, [settings.sensor_offset] * channels
        ),
        *circumstance_nuisances(twin, at.fit.lanes(), at.simulated),
    ]


def _of_learned(
    twin: Twin, lanes: Lanes, simulated: Array, whitening: Whitening, columns: Array | None = None
) -> list[Nuisance]:
    """`tolerances` of a twin that knows its engine; `columns`: as `learned_nuisances` takes them."""
    belief = cast(Belief, belief_of(twin))
    return [
        *learned_nuisances(twin, belief, lanes, simulated, whitening, columns),
        *circumstance_nuisances(twin, lanes, simulated, belief.mean.size),
    ]


def tolerance_responses(
    twin: Twin, at: Linearisation, settings: SearchSettings, detail: Detail = LEADING, linear: bool = False
) -> Array:
    """Responses (K, n, C) to the tolerances of maps and sensors, per standard deviation.

    `linear`: as of `nuisance_responses`.
    """
    own = tolerances(twin, at, settings, detail)
    return nuisance_responses(twin, at.fit.lanes(), at.simulated, own, linear)


def in_own_metrics(found: Search, fits: Sequence[Fit]) -> list[Fit]:
    """Leading fits, best first, with the differences of their objectives as each one's own nuisances make them.

    The best keeps the objective that it had, so that the list compares with fits in the common metric.
    """
    own = [recentred(found, fit) for fit in fits]
    values = [at.fit.objective + at.metric.log_determinant for at in own]
    best = int(np.argmin(values))
    level = min(fit.objective for fit in fits) - values[best]
    moved = [replace(at.fit, objective=level + value) for at, value in zip(own, values, strict=True)]
    return sorted(moved, key=lambda fit: fit.objective)


def recentred(found: Search, fit: Fit) -> Linearisation:
    """A fit with initial states and tolerances linearised about itself, not about the health-only fit.

    Where the missing effect is large the two differ: the metric of the health-only fit gives magnitudes off by up to a
    tenth with intervals three times too narrow, and leaves structure that isn't there. Its objective is of its own.
    """
    twin = found.twin
    if found.about is not None and _is_near(found.about, fit):
        own, responses = found.nuisances, found.null.nuisance_response
    else:
        at = Linearisation(twin, found.whitening, fit, found.null)
        own = tolerances(twin, at, found.settings)
        responses = nuisance_responses(twin, at.fit.lanes(), at.simulated, own)
    return settle_local(fit_fully(twin, found.whitening, fit, responses, rounds=4, loadings=loadings_of(own)))


def _is_near(one: Fit, other: Fit) -> bool:
    """Whether an explanation is so near to another fit of it that tolerances taken about one are those about both."""
    known, schedules = one.candidate.schedules, other.candidate.schedules
    if one.candidate.names != other.candidate.names or known.keys() != schedules.keys():
        return False
    if not all(np.array_equal(own, schedules[name]) for name, own in known.items()):
        return False
    away = np.concatenate([other.parameters - one.parameters, other.magnitudes - one.magnitudes])
    return bool(np.all(np.abs(away) < _NEAR * np.nan_to_num(other.std)))


def lower_without(found: Search, lead: Fit) -> Linearisation:
    """The health-only fit, from where an effect's refit ended, where that is lower: what it failed to explain isn't the
    effect's."""
    start = replace(lead, candidate=Candidate(), magnitudes=np.zeros(0))
    other = fit_fully(found.twin, found.whitening, start, rounds=_ALONE_ROUNDS, frozen=found.null)
    return other if other.fit.objective < found.null.fit.objective else found.null
