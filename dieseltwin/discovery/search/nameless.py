"""The law that is looked for where no name fits, and since when it is there."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from itertools import chain, islice

import numpy as np

from dieseltwin.discovery.laws.features import Structure, scored_since
from dieseltwin.discovery.laws.search import Law
from dieseltwin.discovery.laws.sensor import Resolved, laws_in_turn
from dieseltwin.discovery.likelihood.fit import Linearisation
from dieseltwin.discovery.search.courses import has_parts
from dieseltwin.discovery.search.explanations import beyond_law
from dieseltwin.discovery.search.preparation import tolerance_responses
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.search.sums import best_onset
from dieseltwin.discovery.time_limit import is_limited


def look_for_law(found: Search) -> None:
    """A law where one is resolved, and what it leaves: one that is there from the first row on, or, where that explains
    more by what an onset must add, from later on.

    A report takes as many simulations as a search. Where the first law from later on is ahead of the first one from the
    beginning and leaves nothing, the latter isn't reported, nor looked for at further points. Under a time limit what
    is found first is reported first: it may be all that there is time for.
    """
    clock = time.perf_counter()
    terms = found.everything_unnamed()
    laws = _laws(found, terms, None)
    least = found.settings.variant_gain
    later: Iterator[Resolved] = iter(())
    if terms and has_parts(found.twin):
        since_s = best_onset(found.null, terms, found.settings.least_share)
        scored = scored_since(found.null, terms, since_s)
        if scored and scored[0].gain > terms[0].gain + 0.5 * least:
            later = _laws(found, scored, since_s)
    if is_limited():
        first: list[Resolved] = []
        begun: list[Resolved] = []
    else:
        first, begun = _first(laws), _first(later)
    ahead = bool(begun) and begun[0].score > least + _score(first)
    if ahead:
        take_law(found, begun)
    if ahead and found.law is not None:
        if found.more_is_missing():
            take_law(found, chain(first, laws), found.law.score - least)
            take_law(found, later, found.law.score + (least if found.law.since_s is None else 0.0))
    else:
        take_law(found, chain(first, laws))
        take_law(found, chain(begun, later), least + (0.0 if found.law is None else found.law.score))
    found.seconds["law"] = time.perf_counter() - clock


def _laws(found: Search, terms: Sequence[Structure], since_s: float | None) -> Iterator[Resolved]:
    """Laws that are there from a time on, in the order in which they are looked for."""
    return laws_in_turn(found.twin, found.null, terms,
                        lambda here: tolerance_responses(here.twin, here, found.settings), since_s)  # fmt: skip


def _first(laws: Iterator[Resolved]) -> list[Resolved]:
    """The first one, if there is any, which is reported once however often it is asked."""
    return [replace(law, report=cache(law.report)) for law in islice(laws, 1)]


def _score(laws: Sequence[Resolved]) -> float:
    return laws[0].score if laws else 0.0


def take_law(found: Search, laws: Iterable[Resolved], least: float = -np.inf) -> None:
    """The first of some laws, and what it leaves, in place of a known one if it explains more than `least`.

    Where it leaves more than it should, points whose linear gains are small are looked at, too: what a large effect
    does isn't linear. A back pressure, 28 % of the best one's, was a law of the turbine's efficiency.
    """
    for resolved in laws:
        law = resolved.report() if resolved.score > least else None
        if law is not None:
            found.law, least = law, law.score
            found.left, found.left_local = beyond_law(found, law)
        if not found.more_is_missing():
            break


def law_about_itself(found: Search, law: Law) -> Linearisation:
    """A law of a search, linearised about itself; its parameters stand behind those of the twin."""
    null, (twin, fit) = found.null, law.on(found.twin)
    try:
        return Linearisation(twin, null.whitening, fit, None, null.nuisance_response, null.loadings)
    except np.linalg.LinAlgError:  # the machine runs away with some tolerance there
        return Linearisation(twin, null.whitening, fit, null)
