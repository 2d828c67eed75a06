"""Explanations of a mismatch beyond one constant effect, and the choice among all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from dieseltwin.discovery.laws.features import (
    Structure,
    generic_features,
    local_features,
    score_what_is_left,
    scored_since,
)
from dieseltwin.discovery.laws.final_fit import signals_of
from dieseltwin.discovery.laws.search import Law
from dieseltwin.discovery.laws.twin import LawTwin
from dieseltwin.discovery.laws.unnamed import leading_refits
from dieseltwin.discovery.likelihood.fit import Candidate, Fit, Linearisation
from dieseltwin.discovery.likelihood.refit import refit_all, widen
from dieseltwin.discovery.likelihood.score import Scored, best_of_each, effect_responses, score, secant_sizes, spread
from dieseltwin.discovery.search.courses import has_parts
from dieseltwin.discovery.search.preparation import in_own_metrics, recentred, tolerance_responses
from dieseltwin.discovery.search.simulated_errors import gain_of_term, verified
from dieseltwin.discovery.search.state import Search, set_probabilities
from dieseltwin.discovery.search.sums import best_onset
from dieseltwin.discovery.search.variant_fits import freedom_cost
from dieseltwin.discovery.search.variants import Variant
from dieseltwin.discovery.twins.interface import Twin, WithSignals

_PAIRS = 10
_OTHER_LEADS = 3  # of pairs, behind the best single effect
_SECONDS = 4  # that join each of them
_TRIED = 12  # of which these are the best
_UNDERSTATED = 2.0  # times its linear gain: what an effect adds to another one where it is simulated, at most
_POLISHED = 4  # of the best fits get sensitivities of their own
_POLISHED_SHARE = 0.6  # of the best gain: fits that far behind are polished too
_POLISH_ROUNDS = 8
_LEADING = 60.0  # gain within which a fit counts as leading


def _pair_gains(found: Search, items: Sequence[Scored]) -> list[tuple[float, Scored, Scored]]:
    """Linear gain of every pair of hypotheses at the health-only fit, strongest first."""
    vectors = np.stack([s.projected for s in items])
    gram = vectors @ vectors.T
    push = vectors @ found.null.pulled_residual
    signs = [found.twin.hypotheses[s.name].sign for s in items]
    out = []
    for i in range(len(items)):
        for j in range(i + 1, len(items)):
            a, b, c = gram[i, i], gram[j, j], gram[i, j]
            determinant = a * b - c * c
            if determinant < 1e-6 * a * b or a == 0.0 or b == 0.0:
                continue
            x = (b * push[i] - c * push[j]) / determinant
            y = (a * push[j] - c * push[i]) / determinant
            if signs[i] * x < 0.0 or signs[j] * y < 0.0:
                continue
            out.append((float(x * push[i] + y * push[j]), items[i], items[j]))
    return sorted(out, key=lambda item: -item[0])


def _beyond(found: Search, at: Linearisation, most: int | None = None) -> list[Scored]:
    """What every other effect would add to a fit of one, strongest first; `most`: of as many that add most by the
    responses that they have beside health alone, which turn little. None: of all."""
    without = {*found.settings.withhold, *at.fit.candidate.names}
    names = [name for name in found.twin.hypotheses if name not in without]
    others = [item for item in found.scored if item.name not in without]
    if most is not None and others:
        sizes = [(item.name, item.size) for item in others]
        judged = best_of_each(score(at, sizes, np.stack([item.response for item in others])))
        names = [item.name for item in judged[:most]]
    wanted = secant_sizes(found.twin, names)
    return best_of_each(score(at, wanted, effect_responses(found.twin, at, wanted))) if wanted else []


def try_pairs(found: Search, first: Linearisation) -> None:
    """Two effects: the best pairs of the linear table, and what the residual of the best single asks for."""
    lead = first.fit.candidate.names[0]
    beyond = _beyond(found, first)
    found.second_effect_gain = beyond[0].gain if beyond else 0.0
    found.spreads = {item.name: spread(first, item.projected) for item in beyond}
    items = best_of_each(found.scored)
    by_name = {s.name: s for s in items}
    ranked = _pair_gains(found, items)
    pairs: dict[tuple[str, ...], tuple[Scored, Scored]] = {}
    worth_it = 0.5 * found.settings.second_gain
    single = found.gain(found.singles[0])
    nothing_left = bool(beyond) and beyond[0].gain < worth_it and single > 0
    if nothing_left and (not ranked or ranked[0][0] < single + worth_it):
        return
    seconds = [item for item in beyond[: _PAIRS // 2] if item.gain > worth_it]
    known = {tuple(sorted((lead, item.name))) for item in seconds}
    for gain, a, b in ranked[:_PAIRS]:
        if gain > single - _LEADING:
            key = tuple(sorted((a.name, b.name)))
            if key not in known:
                pairs[key] = (by_name[key[0]], by_name[key[1]])
    # what joins the best single starts from its fit: from the health-only fit a chord may find no step down at all
    fits: list[Fit] = []
    if seconds:
        fits = _joined(Linearisation(found.twin, found.whitening, found.singles[0], found.null), seconds)
    if pairs:
        responses = [np.stack([a.response, b.response]) for a, b in pairs.values()]
        fits += refit_all(found.null, [Candidate(key) for key in pairs], responses)
    if fits:
        found.pairs = _polished_pairs(found, fits)


def _joined(base: Linearisation, seconds: Sequence[Scored]) -> list[Fit]:
    """Refits of a single effect with each of some others, from its own fit on."""
    candidates = [Candidate((*base.fit.candidate.names, item.name)) for item in seconds]
    return refit_all(base, candidates, [np.stack([base.jacobian[-1], item.response]) for item in seconds])


def try_more_pairs(found: Search) -> bool:
    """Pairs about the refits of the other leading effects; whether the best pair is a better one now.

    Two strong effects bend the linear table, and the strongest by itself may be neither of them.
    """
    known = {tuple(sorted(fit.candidate.names)) for fit in found.pairs}
    before = found.gain(found.pairs[0]) if found.pairs else -np.inf
    least = max(before, found.gain(found.singles[0])) - _LEADING
    fits: list[Fit] = []
    for lead in found.singles[1 : 1 + _OTHER_LEADS]:
        name, own = lead.candidate.names[0], found.gain(lead)
        base = Linearisation(found.twin, found.whitening, lead, found.null)
        ranked = _beyond(found, base, _TRIED)[:_SECONDS]
        seconds = [item for item in ranked
                   if tuple(sorted((name, item.name))) not in known and own + _UNDERSTATED * item.gain > least]
        if not seconds:
            continue
        known |= {tuple(sorted((name, item.name))) for item in seconds}
        fits += _joined(base, seconds)
    if not fits:
        return False
    found.pairs = sorted([*found.pairs, *_polished_pairs(found, fits)], key=lambda fit: fit.objective)
    return found.gain(found.pairs[0]) > before + found.settings.left_ahead


def _polished_pairs(found: Search, fits: Sequence[Fit]) -> list[Fit]:
    """Fits of two effects, the leading ones refitted fully, best first, as single effects are compared."""
    fits = verified(found, polish(found, sorted(fits, key=lambda fit: fit.objective), 3))
    return sorted(fits, key=lambda fit: fit.objective)


def _best_pair(found: Search) -> Fit | None:
    return next((fit for fit in found.pairs if found.of_interest(fit)), None)


def pair_beats_single(found: Search) -> bool:
    """Whether two effects explain more than one by what the second costs."""
    pair = _best_pair(found)
    return pair is not None and found.gain(pair) - pair_bar(found, pair) > found.gain(found.singles[0])


def pair_bar(found: Search, pair: Fit) -> float:
    """What two effects must be ahead of the best single one."""
    lead, settings = found.singles[0].candidate.names[0], found.settings
    added = [name for name in pair.candidate.names if name != lead]
    if len(added) > 1:
        return settings.other_pair_gain
    held = found.spreads.get(added[0], 0.0) >= settings.least_spread
    return settings.second_gain if held else settings.hanging_second_gain


def choose(found: Search, first: Linearisation | None, beside: tuple[str, ...] = ()) -> None:
    """One effect, one that acts at times, two, or none of these: the gain of each less what its freedom costs.

    Args:
        found: with all fits.
        first: the best single effect about itself, where that is known already.
        beside: two effects that explain enough, but not surely both. What either leaves alone is the other's, and
            refuses no name.
    """
    settings = found.settings
    best, kind, fit, variant = leading_kind(found)
    later = _unnamed_since(found, variant)
    ahead = best + settings.law_gain + settings.variant_gain
    if _nameless_is_ahead(found, best) or any(_is_ahead(found, terms, ahead, since_s) for since_s, terms in later):
        found.kind = "law"
        return
    found.kind, found.variant = kind, variant
    found.best = first if kind == "single" and first is not None else recentred(found, fit)
    left = look_at_what_is_left(found, found.best)
    if _leaves_too_much(found, fit, best, beside) or _one_later_term_explains_more(found, best, later):
        found.refused, found.kind = kind, "law"
        return
    found.widening = max(1.0, left / settings.chance_leaves)
    widen(found.best, found.widening)
    if kind == "pair" and not _both_are_sure(found, found.best.fit):
        found.pairs = [other for other in found.pairs if other is not fit]
        choose(found, first, fit.candidate.names)
        return
    set_probabilities(found, kind)


def single_stands(found: Search) -> bool:
    """Whether the best single effect is enough where nothing else with a name explains more."""
    fit = found.singles[0]
    value = found.gain(fit)
    if _nameless_is_ahead(found, value):
        return False
    found.best = recentred(found, fit)
    look_at_what_is_left(found, found.best)
    return not _leaves_too_much(found, fit, value)


def _nameless_is_ahead(found: Search, value: float) -> bool:
    """Whether a term without a name, or a bump of a map, gains more than names of such a value.

    By its linear score; where names are compared with their errors simulated, so is what seems ahead of them: in a
    nearly unstable window the offset of the vanes was 116 linearly, as a term without a name 98, and 72 simulated.
    """
    bar = value + found.settings.law_gain
    bump = found.local_ahead(bar)
    terms = sorted([*found.nameless(), *([] if bump is None else [bump])], key=lambda item: -item.gain)
    return _is_ahead(found, terms, bar)


def _is_ahead(found: Search, terms: Sequence[Structure], bar: float, since_s: float | None = None) -> bool:
    """Whether one of some terms gains more; faults of sensors, which aren't simulated, by their linear score."""
    ahead = [item for item in terms if item.gain > bar]
    if not found.simulated_errors or any(item.feature.form is None for item in ahead):
        return bool(ahead)
    return one_term_gains(found, bar, ahead, since_s)


def _unnamed_since(found: Search, variant: Variant | None) -> list[tuple[float, list[Structure]]]:
    """Terms without a name that begin later, scored: since when all of them fit best [s], and since an effect begins
    or ends.

    Against an effect with an edge where it fits best, a term that is there from the first row on has no chance. What
    ended may as well be the opposite that began: 9 % less of a thermocouple's reading was walls that had been warm.
    """
    if not found.structure or not has_parts(found.twin):
        return []
    first_s = float(found.twin.time_s[0])
    times = [best_onset(found.null, found.structure, found.settings.least_share)]
    if variant is not None and variant.onset_s is not None and not variant.grows and not variant.gone:
        times += [t for t in (variant.onset_s, variant.until_s) if t is not None and t > first_s]
    scored = ((t, found.nameless(scored_since(found.null, found.structure, t))) for t in dict.fromkeys(times))
    return [(t, terms) for t, terms in scored if terms]


def _leaves_too_much(found: Search, fit: Fit, value: float, beside: tuple[str, ...] = ()) -> bool:
    """Whether what names leave, or a term without one instead of them, refuses them.

    Args:
        found: `kind` says what they are, `best` is about them, `left` and `left_local` are what that leaves.
        fit: theirs.
        value: its gain less what its freedom costs.
        beside: as of `choose`.
    """
    settings, names = found.settings, cast(Linearisation, found.best).fit.candidate.names
    place = {"single": 0, "pair": 1}.get(found.kind, 2)
    share = settings.left_share[place] * found.gain(fit)
    limit = max(settings.left_gain[place], share)
    # what a name's own law leaves says that its size or its shape is off, not that it is another's
    held = max((item.held for item in found.left if item.feature.effect not in names), default=0.0)
    ahead = held - _second_gain(found) if held > limit and found.kind != "pair" else np.inf
    bumps = max((item.held for item in found.left_local), default=0.0)
    left = found.left[0].gain if found.left else 0.0
    enough = found.kind == "single" and names[0] in beside
    return not enough and (
        (held > limit and ahead > settings.left_ahead)
        or bumps > max(settings.local_gain, share)
        or (left >= settings.rivals_from and _one_term_explains_more_than_names(found, value))
    )


def _one_later_term_explains_more(
    found: Search, value: float, later: Sequence[tuple[float, Sequence[Structure]]]
) -> bool:
    """Whether one of the terms without a name that begin later explains more than names of such a value, by what an
    onset must add as well, where these leave enough to look."""
    left = found.left[0].gain if found.left else 0.0
    if left < found.settings.rivals_from:
        return False
    value += found.settings.variant_gain
    return any(_one_term_explains_more_than_names(found, value, terms, since_s) for since_s, terms in later)


def look_at_what_is_left(found: Search, best: Linearisation) -> float:
    """The terms without a name beyond an explanation, and the gain of the strongest: a confident lie nearly fits."""
    found.left = score_what_is_left(best, generic_features(found.twin, best.fit), found.structure)
    found.left_local = score_what_is_left(best, local_features(found.twin, best.fit), found.local)
    return found.left[0].gain if found.left else 0.0


def _both_are_sure(found: Search, pair: Fit) -> bool:
    """Whether the size of either of two effects is told, beside the other and what both leave.

    Their gain is that of a fit in the metric of health alone. Linearised about themselves, in a misfit that they don't
    explain, the second may be hardly there: warm ports were a warm intake and 3.2 +- 1.4 % of the injectors' fuel.
    """
    std = pair.std[len(found.twin.parameters) :]
    return bool((np.abs(pair.magnitudes) >= found.settings.second_size_std * std).all())


def _second_gain(found: Search) -> float:
    """What the best other name would gain beside the chosen explanation: what the catalogue says isn't nameless."""
    if found.best is None or (found.kind == "single" and found.second_effect_gain is not None):
        return found.second_effect_gain or 0.0
    return next((item.gain for item in _beyond(found, found.best)), 0.0)


def leading_kind(found: Search) -> tuple[float, str, Fit, Variant | None]:
    """Gain less what the freedom costs, kind, fit and variant of the best explanation with names."""
    options: list[tuple[float, str, Fit, Variant | None]] = [
        (found.gain(found.singles[0]), "single", found.singles[0], None)
    ]
    if found.variants:
        timed, timed_fit = found.variants[0]
        options.append((found.gain(timed_fit) - freedom_cost(found, timed), "variant", timed_fit, timed))
    pair = _best_pair(found)
    if pair is not None:
        options.append((found.gain(pair) - pair_bar(found, pair), "pair", pair, None))
    return max(options, key=lambda option: option[0])


def choose_so_far(found: Search) -> None:
    """The best explanation with names among those that were fitted; what it leaves isn't looked at."""
    _, found.kind, fit, found.variant = leading_kind(found)
    found.best = recentred(found, fit)
    set_probabilities(found, found.kind)


def beyond_law(found: Search, law: Law) -> tuple[list[Structure], list[Structure]]:
    """What a law leaves: terms without a name and bumps of maps beside it, strongest first.

    The law's signal is held: at its best fit a change of its own coefficient gains nothing.
    """
    twin, fit = law.on(found.twin)
    if isinstance(twin, LawTwin):
        twin = cast(Twin, WithSignals(found.twin, signals_of(twin, fit.lanes())))
        fit = replace(fit, parameters=law.parameters)
    at = Linearisation(twin, found.whitening, fit)
    responses = tolerance_responses(twin, at, found.settings)
    at = Linearisation(twin, found.whitening, fit, None, responses)
    kinds = generic_features(twin, fit), local_features(twin, fit)
    return score_what_is_left(at, kinds[0], found.structure), score_what_is_left(at, kinds[1], found.local)


def one_term_gains(
    found: Search, needed: float, later: Sequence[Structure] | None = None, since_s: float | None = None
) -> bool:
    """Whether one term without a name, refitted by simulation as names are, gains more than is needed; `later`: of
    terms scored as being there from a time on [s]."""
    terms = found.nameless() if later is None else later
    refits = leading_refits(found.twin, found.whitening, found.null, terms, needed, since_s)
    return any(refit.gain > needed and gain_of_term(found, refit) > needed for refit in refits)


def _one_term_explains_more_than_names(
    found: Search, value: float, later: Sequence[Structure] | None = None, since_s: float | None = None
) -> bool:
    """Whether one term without a name, refitted as names are, explains more than the chosen names.

    A wrong name may leave nothing about itself, where maps take up the rest, and still be far behind: a compressor's
    loss in the place of friction that was withheld left 5 and was behind by 28. By chance a term that is wrong is ahead
    of a right name by x with a probability below exp(-x/2) (likelihood ratio): 5e-4 at 15 for each of a dozen terms
    refitted. Of 138 explanations with right names none was behind by more than 7.
    """
    needed = value + max(found.settings.law_gain, found.settings.missing_share * value)
    return one_term_gains(found, needed, later, since_s)


def polish(found: Search, fits: Sequence[Fit], count: int = _POLISHED, near: bool = False) -> list[Fit]:
    """Full refits of the leading fits; the rest as they are. Large effects take many steps, and rank wrongly before.

    `near`: what can't come near to the best one is followed no farther than to where that is plain.
    """
    reach = max(_LEADING, _POLISHED_SHARE * found.gain(fits[0]))
    best = fits[0].objective
    ahead, out = np.inf, []
    for k, fit in enumerate(fits):
        if k < count and fit.objective < best + reach and found.gain(fit) > 4.0:
            out.append(found.refitted(fit, _POLISH_ROUNDS, ahead))
            ahead = min(ahead, out[-1].objective + _LEADING) if near else ahead
        else:
            out.append(fit)
    out.sort(key=lambda fit: fit.objective)
    if len(out[0].candidate.names) == 1 and found.settings.in_own_metrics(found.gain(out[0])):
        out[:count] = in_own_metrics(found, out[:count])
    return out
