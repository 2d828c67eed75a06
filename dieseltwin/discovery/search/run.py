"""The search: health-only fit, scores, refits of every competitive explanation, and the choice among them.

Works on any `Twin`. Gains are decreases of -2 log marginal likelihood over the health-only fit (docs/discovery.md).
"""

from __future__ import annotations

import time
from collections.abc import Sequence

from dieseltwin.discovery.laws.features import Structure, generic_features, local_features, score_features
from dieseltwin.discovery.laws.sensor import best_law
from dieseltwin.discovery.likelihood.fit import Candidate, Fit, Linearisation, fit_fully
from dieseltwin.discovery.likelihood.learned import belief_of
from dieseltwin.discovery.likelihood.refit import nearer, refit_all
from dieseltwin.discovery.likelihood.score import best_of_each, spread, without_parameters
from dieseltwin.discovery.search.by_recording import Start, gained_elsewhere, refitted, starts_by_recording
from dieseltwin.discovery.search.circumstances import (
    ROUNDS,
    in_assumed_weather,
    in_weather_of,
    under_circumstances,
    weather_is_settled,
)
from dieseltwin.discovery.search.explanations import (
    beyond_law,
    choose,
    choose_so_far,
    one_term_gains,
    pair_beats_single,
    polish,
    try_more_pairs,
    try_pairs,
)
from dieseltwin.discovery.search.preparation import (
    prepare,
    prepared_about,
    recentred,
    tolerance_responses,
    verify,
)
from dieseltwin.discovery.search.renewal import BENDS, about_the_leader
from dieseltwin.discovery.search.settled import evidence_of
from dieseltwin.discovery.search.standing import explain_standing
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.search.variant_fits import scan_all, try_variants
from dieseltwin.discovery.search.variants import Variant, edge_cost
from dieseltwin.discovery.time_limit import OutOfTimeError, time_limit
from dieseltwin.discovery.twins.interface import Twin
from dieseltwin.settings.search import SearchSettings

STAGES = ("terms without a name", "onsets and regions", "two effects", "a law")
"""What is looked at behind single effects, in this order."""

_REFIT_SHARE = 0.35  # of the best linear gain: weaker hypotheses can't win even when non-linearity moves them
_UNSTUCK_ROUNDS = 6
_RENEWALS = 3  # about the leading explanation, until it stays the same
_WEATHERS = 3  # in which a name is tried that isn't enough in that of before
_WITHIN = 1.25  # times the name's gain: what explains more than that isn't the weather's doing
_REBASED_BELOW = 150.0  # gain; clear cases needn't be verified


def run(
    twin: Twin, settings: SearchSettings, *, laws: bool = True, time_s: float | None = None, starts: Sequence[Fit] = ()
) -> Search:
    """The whole search.

    Args:
        twin: bound to its recording.
        settings: thresholds.
        laws, time_s, starts: as of `carry_on`, the limit from here on.
    """
    began = time.perf_counter()
    found = prepare(twin, settings)
    left = None if time_s is None else time_s - (time.perf_counter() - began)
    return carry_on(found, laws=laws, time_s=left, starts=starts)


def carry_on(
    found: Search, *, laws: bool = True, time_s: float | None = None, starts: Sequence[Fit] = ()
) -> Search:
    """The search from where `prepare` leaves it, which is used up by it.

    Args:
        found: as `prepare` made it.
        laws: look for a law where no name fits.
        time_s: after so many seconds the best answer so far is given; the refits of single effects are always
            finished. None: no limit.
        starts: fits of single effects that lie near their minima, where that is far from the fit without any.
    """
    if found.standing:
        explain_standing(found)
        return found
    began = time.perf_counter()
    found = _with_names(found, starts)
    left = None if time_s is None else time_s - (time.perf_counter() - began)
    try:
        with time_limit(left):
            _explain(found)
            found = _in_own_weather(found)
            if found.kind == "law" and laws:
                found = _with_law(found)
    except OutOfTimeError:
        found.unfinished = STAGES[STAGES.index(found.stage) :]
        if found.kind != "law" and (found.kind != "healthy" or raises_alarm(found, found.singles[0])):
            choose_so_far(found)
    return found


def _with_names(found: Search, starts: Sequence[Fit]) -> Search:
    """Refits of single effects, about the leading one where what was learned of the maps bends."""
    found = looked_at(found, starts)
    clock = time.perf_counter()
    found, by_recording = refitted(found, starts_by_recording(found))
    found.seconds["by_recording"] = time.perf_counter() - clock
    return _about_leading_name(found, by_recording)


def _about_leading_name(found: Search, starts: Sequence[Start] = ()) -> Search:
    """Single effects with what was learned of the maps about the one that leads; as they are where nothing was."""
    for renewal in range(_RENEWALS):
        lead = _lead(found)
        if belief_of(found.twin) is None or found.gain(lead) < BENDS:
            break
        unsettled = found.unsettled
        found, starts = refitted(_with_singles(prepared_about(found, lead), found.singles), starts)
        found.unsettled = unsettled
        both = [lead.candidate.names, _lead(found).candidate.names]
        if both[0] == both[1]:
            break
        if renewal == _RENEWALS - 1:
            found.unsettled = both
    return found


def _in_own_weather(found: Search) -> Search:
    """The search again in the weather that the best name asks for, where that name isn't enough in the weather of
    before; that search where it is enough there, else the first one."""
    if found.kind != "law" or not raises_alarm(found, found.singles[0]):
        return found  # two names are left as they are: weather takes the place of a true second one as readily
    more = [item.gain for item in (*found.nameless()[:1], *found.local[:1])]
    if max(more, default=0.0) > _WITHIN * found.gain(found.singles[0]):
        return found
    chosen, here = found, found
    name = found.singles[0].candidate.names
    for _ in range(_WEATHERS):
        other = in_weather_of(here, here.singles[0])
        if other is None:
            break
        here = _explained_anew(other, found.settings)
        if here.singles[0].candidate.names != name:
            break
        if here.kind == "single":
            chosen = here
    return chosen


def _explained_anew(twin: Twin, settings: SearchSettings) -> Search:
    """The search of a twin under other circumstances, up to a law."""
    found = _about_leading_name(_with_singles(prepare(twin, settings)))
    _explain(found)
    return found


def _explain(found: Search) -> None:
    """Everything beyond single effects but a law: what has no name, onsets and regions, two effects."""
    twin, settings = found.twin, found.settings
    found.stage = "terms without a name"
    found.scanned = scan_all(found.null, found.scored, settings.least_share)
    tried = [*found.scanned, *(variant for variant, _ in found.variants)]
    once = [variant for variant in tried if not variant.gone]  # many parts follow the driving where a map is off
    hidden = any(variant.gain > _hidden_bar(found, variant) for variant in once)
    base = verify(found) if found.gain(found.singles[0]) < _REBASED_BELOW else found.null
    clock = time.perf_counter()
    found.structure = score_features(base, generic_features(twin, found.null.fit))
    found.local = score_features(base, local_features(twin, found.null.fit))
    found.seconds["structure"] = time.perf_counter() - clock
    unnamed = _unnamed(found)
    alarm = raises_alarm(found, found.singles[0]) or (unnamed is not None and _explained_by_catalogue(found, unnamed))
    clock = time.perf_counter()
    if alarm or hidden:
        found.stage = "onsets and regions"
        try_variants(found)
    found.seconds["variants"] = time.perf_counter() - clock
    if not alarm and not (hidden and _shown(found)):
        if unnamed is not None or _shown_by_simulation(found):
            _nameless(found)
        return
    found.kind, found.stage = "single", "two effects"
    first = recentred(found, found.singles[0])
    found.best = first
    clock = time.perf_counter()
    try_pairs(found, first)
    widened = pair_beats_single(found)
    if widened:  # which two is another question: the strongest by itself may be neither
        try_more_pairs(found)
    _choose_settled(found, first)
    if found.refused in ("single", "pair") and not widened and try_more_pairs(found):
        found.refused = ""
        _choose_settled(found, first)
    found.seconds["pairs"] = time.perf_counter() - clock
    if found.kind == "law":
        _nameless(found)


def _choose_settled(found: Search, first: Linearisation) -> None:
    """The choice among all, with what was learned of the maps about the explanation that leads."""
    choose(found, None if about_the_leader(found) else first)


def _lead(found: Search) -> Fit:
    """The leading explanation so far: of one size, or one that differs between recordings."""
    return min([found.singles[0], *(fit for _, fit in found.variants[:1])], key=lambda fit: fit.objective)


def looked_at(found: Search, starts: Sequence[Fit] = ()) -> Search:
    """A prepared search with its single effects, under the circumstances that the recording shows; `starts`: as of
    `carry_on`."""
    found = _with_singles(found, starts)
    before = found
    for _ in range(ROUNDS):
        other = under_circumstances(found)
        if other is None:
            return found
        before, found = found, _with_singles(prepare(other, found.settings))
    both = [_lead(each) for each in (before, found)]
    if both[0].candidate.names != both[1].candidate.names and under_circumstances(found) is not None:
        found.unsettled = [fit.candidate.names for fit in both]
    return found


def _with_singles(found: Search, before: Sequence[Fit] = ()) -> Search:
    """Refits of every competitive single effect.

    Args:
        found: scored.
        before: fits of single effects with another likelihood: where one of them is nearer to its minimum, it is the
            start. (About an explanation the health-only fit lies far from every minimum, and a refit from there may
            stop short of it in windows whose initial states turn round.)
    """
    clock = time.perf_counter()
    ranked = best_of_each(found.scored)
    top = max(ranked[0].gain, 1e-9) if ranked else 0.0
    kept = [s for k, s in enumerate(ranked) if s.gain > _REFIT_SHARE * top or k < found.settings.refits]
    fits = refit_all(found.null, [Candidate((s.name,)) for s in kept], [s.response[None] for s in kept])
    promising = [found.settings.unstick and s.gain > found.settings.alarm_gain for s in kept]
    fits = [_unstuck(found, fit) if more else fit for more, fit in zip(promising, fits, strict=True)]
    found.singles = sorted(nearer(found.null, fits, before), key=lambda fit: fit.objective)
    found.singles = polish(found, found.singles)
    found.seconds["singles"] = time.perf_counter() - clock
    return found


def _unstuck(found: Search, fit: Fit) -> Fit:
    """A refit that found no way down, with sensitivities of its own; any other as it is.

    Next to a kink the response to a size of interest may point the wrong way (a pressure read low beside one read
    high), and a chord along it leads uphill in every length.
    """
    if fit.converged or found.gain(fit) > 0.0:
        return fit
    return fit_fully(found.twin, found.whitening, fit, rounds=_UNSTUCK_ROUNDS, frozen=found.null).fit


def _nameless(found: Search) -> None:
    """No name fits."""
    found.kind, found.stage, found.best = "law", STAGES[-1], None


def _with_law(found: Search) -> Search:
    """The search with a law from the grammar where no name fits and one is resolved: first in the weather as it was
    assumed, then, where the law asks for another, in that of the fit without any; whichever explains more."""
    other = in_assumed_weather(found)
    if other is None:
        _law(found)
        return found
    here = _explained_anew(other, found.settings)
    if here.kind == "law":
        _law(here)
        if here.law is not None and weather_is_settled(here):
            return here
    _law(found)
    return min((found, here), key=_evidence_with_law) if here.kind == "law" else found


def _evidence_with_law(found: Search) -> float:
    return evidence_of(found.null) - (0.0 if found.law is None else found.law.score)


def _law(found: Search) -> None:
    """A law where one is resolved, and what it leaves.

    Where it leaves more than it should, points whose linear gains are small are looked at, too: what a large effect
    does isn't linear. A back pressure, 28 % of the best one's, was a law of the turbine's efficiency.
    """
    clock = time.perf_counter()
    for everywhere in (False, True):
        law = best_law(
            found.twin, found.null, found.everything_unnamed(),
            lambda here: tolerance_responses(here.twin, here, found.settings), everywhere,
        )  # fmt: skip
        if law is None or (found.law is not None and law.score <= found.law.score):
            break
        found.law = law
        found.left, found.left_local = beyond_law(found, law)
        if not found.more_is_missing():
            break
    found.seconds["law"] = time.perf_counter() - clock


def _shown(found: Search) -> bool:
    """Whether an onset or a region that the linear scan promised keeps its promise when it is simulated."""
    if not found.variants:
        return False
    variant, fit = found.variants[0]
    if found.gain(fit) - edge_cost(variant) <= _hidden_bar(found, variant):
        return False
    if variant.profile is not None:
        return gained_elsewhere(found.null, fit) >= found.settings.least_spread
    direction = without_parameters(found.null, found.null.metric.project(variant.response[None]))[0]
    return spread(found.null, direction) >= found.settings.least_spread


def _hidden_bar(found: Search, variant: Variant) -> float:
    """Gain from which an effect that doesn't act everywhere and always raises an alarm by itself."""
    return found.settings.hidden_gain if variant.profile is None else found.settings.hidden_profile_gain


def _unnamed(found: Search) -> Structure | None:
    """The strongest term without a name that raises an alarm by itself, None where none does."""
    settings, needed = found.settings, _named_already(found)
    for item in found.lasting():
        bar = settings.unnamed_gain if item.feature.channel is None else settings.unnamed_sensor_gain
        if item.gain > max(bar, needed):
            return item
    return found.local_ahead(needed)


def _named_already(found: Search) -> float:
    """Gain that a term without a name must have where a name that is too small to be of interest is beyond chance.

    The misfit has a name then, and a term must be ahead of it as a law of a name of interest: half a tolerance of
    back pressure, 29, was "none of these, in the reading T_em", which explained 27.
    """
    lead = found.singles[0]
    if not found.beyond_chance(lead) or found.of_interest(lead):
        return 0.0
    return found.gain(lead) + found.settings.law_gain


def _shown_by_simulation(found: Search) -> bool:
    """Whether a term without a name that is weak by its linear score raises an alarm where it is simulated.

    Far from nothing the score tells too little: a compressor whose flow was 3.4 % short, a name that was withheld, had
    12 and explained 51 beside ambient as published. Simulated, terms on 75 healthy engines explained at most 13.
    """
    settings = found.settings
    linear = max((item.gain for item in found.nameless() if item.feature.form is not None), default=0.0)
    if settings.unnamed_simulated_from is None or linear < settings.unnamed_simulated_from:
        return False
    return one_term_gains(found, max(settings.unnamed_gain, _named_already(found)))


def _explained_by_catalogue(found: Search, item: Structure) -> bool:
    """Whether the best name says the same as a term: one finding, and it has a name."""
    fit = found.singles[0]
    return (
        found.known_by_name(item) and fit.candidate.names == (item.feature.effect,)
        and found.gain(fit) > item.gain - found.settings.law_gain and found.of_interest(fit)
    )  # fmt: skip


def raises_alarm(found: Search, fit: Fit) -> bool:
    """Whether one effect of one size is beyond chance and as large as is of interest."""
    return found.beyond_chance(fit) and found.of_interest(fit)
