"""Fits of effects that begin in the middle, go again, grow, act in a part of the driving or differ by recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dieseltwin.discovery.likelihood.fit import Candidate, Fit, Linearisation
from dieseltwin.discovery.likelihood.refit import refit_all
from dieseltwin.discovery.likelihood.score import Scored, best_of_each, score, ways_of_each
from dieseltwin.discovery.search.courses import (
    at_times,
    coming_and_going,
    courses,
    first_of_each_course,
    has_parts,
    moved,
)
from dieseltwin.discovery.search.pauses import in_parts, in_the_same_parts
from dieseltwin.discovery.search.preparation import in_own_metrics
from dieseltwin.discovery.search.simulated_errors import verified
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.search.variants import (
    SECOND_EDGE,
    Variant,
    edge_cost,
    redated,
    rescan,
    same_region,
    scan,
)
from dieseltwin.discovery.time_limit import OutOfTimeError
from dieseltwin.discovery.twins.interface import Twin
from dieseltwin.discovery.twins.onset_times import ONSET_REACHES_S, times_about

_VARIANTS = 6  # that begin or act in a part of the driving are refitted
_DATINGS = 2  # another effect that leads between the same edges has them moved for itself
_RIVALS = 4  # other effects that act in the best region, or in the best parts of the time
_RESCANS = ((3, 0.04), (2, 0.02), (1, 0.01))  # of so many leading regions, about their own refits, ever finer
_POLISHED = 4  # of the leading effects
_ALL_ALONG = 2  # of the leading effects that are there all along are tried in parts, too
_PARTS = 3  # times that their parts are looked for, at the size found before
_LEADING_SHARE = 0.7  # of the best gain; refits of regions move far


def scan_all(at: Linearisation, scored: Sequence[Scored], least_share: float) -> list[Variant]:
    """The strongest variants of all kinds, strongest first; arguments as of `scan`."""
    found = [*scan(at, scored, _VARIANTS, least_share), *courses(at, scored, least_share)]
    return sorted(found, key=lambda variant: -variant.gain)


def try_variants(found: Search) -> None:
    """Effects that begin in the middle or act in a part of the operating range only."""
    _refit_parts(found)
    try:
        fits = verified(found, [fit for _, fit in found.variants])
    except OutOfTimeError:
        found.variants = []  # they can't be compared with what was verified
        raise
    found.variants = in_order(found, [(v, fit) for (v, _), fit in zip(found.variants, fits, strict=True)])


def _refit_parts(found: Search) -> None:
    top = found.gain(found.singles[0]) if found.singles else 0.0
    often = coming_and_going(found.null, found.scored, found.settings.least_share)
    _refit_variants(found, [v for v in (*found.scanned, *often) if v.gain > 0.5 * top])
    _try_parts(found)
    if not found.variants:
        return
    best, fit = found.variants[0]
    if found.gain(fit) < top + 0.5 * freedom_cost(found, best):
        return
    if best.onset_s is not None:
        _date_anew(found)
        for _ in range(_DATINGS):
            dated = _times_of_leader(found)
            if found.variants[0][0].name == dated:
                break
            _try_parts(found)
        _polish_variants(found)
        if found.settings.in_own_metrics(found.gain(found.variants[0][1])):
            _compare_leaders(found)
        return
    known = {v.name for v, _ in found.variants}
    rivals = same_region(found.null, found.scored, best)
    _refit_variants(found, [v for v in rivals if v.name not in known and v.gain > 0.5 * best.gain][:_RIVALS])
    _polish_variants(found)
    for count, fine in _RESCANS:
        if count == 1:  # the edges are known by now: other effects between the same ones
            _refit_variants(found, [
                v for v in same_region(found.null, found.scored, found.variants[0][0])
                if v.name != found.variants[0][0].name
            ][:_RIVALS])  # fmt: skip
            _polish_variants(found)
        for variant, fit in _leaders(found)[:count]:
            other = rescan(found.null, variant, fit, fine)
            if other.region != variant.region:
                _refit_variants(found, [other], fit)
        _polish_variants(found)


def _try_parts(found: Search) -> None:
    """The leading effects once more, and the one that is there all along, where they come and go more than once."""
    if not has_parts(found.twin):
        return
    leaders = _leaders(found) if found.variants else []
    pairs = [(variant, fit) for variant, fit in leaders if variant.onset_s is not None and not variant.grows]
    known = {variant.name for variant, _ in pairs}
    items = {item.name: item for item in best_of_each(found.scored)}
    for fit in found.singles[:_ALL_ALONG]:
        (name,) = fit.candidate.names
        if name not in known and name in items:
            pairs.append((_all_along(found.twin, items[name]), fit))
    new = []
    for variant, fit in pairs:
        for _ in range(_PARTS):
            share = 0.5 * found.settings.missing_share  # a pause has two edges
            other = in_parts(found.null, variant, fit, max(SECOND_EDGE, share * found.gain(fit)))
            if other is None or np.array_equal(other.schedule, variant.schedule):
                break
            candidate = Candidate((other.name,), {other.name: other.schedule})
            start = replace(fit, candidate=candidate)
            variant, fit = other, found.refitted(start, 3)
            new.append((variant, fit))
    found.variants = in_order(found, [*found.variants, *new])


def _all_along(twin: Twin, item: Scored) -> Variant:
    """An effect that is there from the first row to the last as a variant."""
    return Variant(item.name, float(twin.time_s[0]), None, np.ones(twin.time_s.size), item.response, item.gain)


def _times_of_leader(found: Search) -> str:
    """Move the edges of the leading effect until they fit best, and try the others between the same ones; its name."""
    for reach in ONSET_REACHES_S:
        for best in first_of_each_course([variant for variant, _ in found.variants]):
            near = [[] if edge is None else times_about(found.twin, edge, reach)
                    for edge in (best.onset_s, best.until_s)]
            _refit_courses(found, moved(found.twin, best, *near))
    best, _ = found.variants[0]
    if best.until_s is not None or best.grows or best.gone:  # the same since its onset: it may not be refitted yet
        _refit_courses(found, [at_times(found.twin, best, float(best.onset_s or 0.0), None, False)])
        best, _ = found.variants[0]  # the times are known by now: other effects at the same ones
    if best.gone:  # another effect's best part of the time may be none of these
        likely = in_the_same_parts(found.null, found.scored, best)
        _refit_variants(found, [variant for variant in likely if variant.name != best.name][:_RIVALS])
        best, _ = found.variants[0]
    others = {v.name: v for v, _ in reversed(found.variants) if v.onset_s is not None and v.name != best.name}
    same = float(best.onset_s or 0.0), best.until_s, best.grows, best.gone
    _refit_courses(found, [at_times(found.twin, variant, *same) for variant in others.values()])
    return best.name


def _date_anew(found: Search) -> None:
    """Onsets of the leading effects by their responses at the sizes found; the scan takes effects linearly."""
    dated = []
    for variant, fit in _leaders(found):
        if variant.onset_s is not None and not (variant.until_s or variant.grows or variant.gone):
            other = redated(found.null, variant.name, float(fit.magnitudes[0]), found.settings.least_share)
            if abs(float(other.onset_s or 0.0) - variant.onset_s) > ONSET_REACHES_S[0]:
                dated.append(other)
    _refit_variants(found, dated)


def freedom_cost(found: Search, variant: Variant) -> float:
    """What a variant must be ahead of an effect of one size everywhere and always [units of gain]."""
    if variant.profile is not None:
        return found.settings.profile_gain
    return found.settings.variant_gain + edge_cost(variant)


def in_order(found: Search, pairs: Sequence[tuple[Variant, Fit]]) -> list[tuple[Variant, Fit]]:
    """Variants with their fits, best first."""
    def cost(variant: Variant, fit: Fit) -> float:  # a large effect is never met exactly, least of all in a part
        inside = variant.until_s is not None and float(variant.onset_s or 0.0) > found.twin.time_s[0]
        share = found.settings.missing_share * (int(inside) + len(variant.gone))
        return freedom_cost(found, variant) + share * max(found.gain(fit), 0.0)

    return sorted(pairs, key=lambda pair: pair[1].objective + cost(*pair))


def _leaders(found: Search) -> list[tuple[Variant, Fit]]:
    """The best variant of each of the leading effects."""
    best: dict[str, tuple[Variant, Fit]] = {}
    for variant, fit in found.variants:
        best.setdefault(variant.name, (variant, fit))
    limit = _LEADING_SHARE * found.gain(found.variants[0][1])
    return [pair for pair in best.values() if found.gain(pair[1]) > limit][:_POLISHED]


def _polish_variants(found: Search) -> None:
    leaders = _leaders(found)
    rest = [pair for pair in found.variants if all(pair[1] is not fit for _, fit in leaders)]
    polished = [(variant, found.refitted(fit, 3)) for variant, fit in leaders]
    found.variants = in_order(found, [*rest, *polished])


def _compare_leaders(found: Search) -> None:
    """The leading variants in the order of their own metrics."""
    leaders = _leaders(found)
    rest = [pair for pair in found.variants if all(pair[1] is not fit for _, fit in leaders)]
    variants = {variant.name: variant for variant, _ in leaders}
    compared = in_own_metrics(found, [fit for _, fit in leaders])
    same = {fit.candidate.names[0] for fit in compared}  # what they were beside has moved with them
    rest = [pair for pair in rest if pair[0].name not in same]
    found.variants = in_order(found, [*((variants[f.candidate.names[0]], f) for f in compared), *rest])


def _refit_courses(found: Search, variants: Sequence[Variant]) -> None:
    """Refits of variants with other edges than those of the scan, by the part of the response that explains most: what
    was there until then and begins now would go uphill by that of before."""
    ways: dict[str, list[Scored]] = {}
    for item in ways_of_each(found.scored):
        ways.setdefault(item.name, []).append(item)
    told = []
    for variant in variants:
        own = ways[variant.name]
        parts = np.stack([variant.schedule[:, None] * way.response for way in own])
        scored = score(found.null, [(way.name, way.size) for way in own], parts) if len(own) > 1 else []
        best = max(scored, key=lambda item: item.gain).response if scored else parts[0]
        told.append(replace(variant, response=best))
    _refit_variants(found, told)


def _refit_variants(found: Search, variants: Sequence[Variant], near: Fit | None = None) -> None:
    """Refits of variants, added to those that are known; `near`: the fit of a variant that is nearly the same."""
    if not variants:
        return
    candidates = [Candidate((v.name,), {v.name: v.schedule}) for v in variants]
    if near is None:
        fits = refit_all(found.null, candidates, [v.response[None] for v in variants])
    else:
        base = Linearisation(found.twin, found.whitening, near, found.null)
        response = base.jacobian[-1:]
        fits = refit_all(base, candidates, [response for _ in variants])
    found.variants = in_order(found, [*found.variants, *zip(variants, fits, strict=True)])
