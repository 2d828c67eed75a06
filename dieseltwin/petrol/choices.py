"""Choices among explanations that are a petrol engine's own: what the shared search leaves open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dieseltwin.discovery.likelihood.fit import Candidate, Fit
from dieseltwin.discovery.search.alarms import raises_alarm
from dieseltwin.discovery.search.courses import at_times
from dieseltwin.discovery.search.explanations import choose
from dieseltwin.discovery.search.preparation import in_own_metrics, recentred
from dieseltwin.discovery.search.state import Search, set_probabilities
from dieseltwin.discovery.search.variants import Variant
from dieseltwin.petrol.effects import LOG_PRIOR

AT_LIMIT = 1e-3  # of a limit: so near a size is at it
_MIRROR_ROUNDS = 8


def next_single(found: Search) -> None:
    """Where the size of the best single effect goes as soon as the tolerances are those about itself, it explained
    nothing: the next one that raises an alarm and keeps its size."""
    while found.kind == "single" and found.best is not None and not found.of_interest(found.best.fit):
        rest = [fit for fit in found.singles if fit.candidate.names != found.best.fit.candidate.names]
        if not rest or not raises_alarm(found, rest[0]):
            return
        found.singles = rest
        found.best = recentred(found, rest[0])
        set_probabilities(found, "single")


def one_fault_a_sensor(found: Search) -> None:
    """Of a gain and an offset of one sensor the better one alone: known near one value they only balance each other,
    and what both together leave says nothing of what one does."""

    def of_one_sensor(fit: Fit) -> bool:
        return len({found.twin.hypotheses[name].site for name in fit.candidate.names}) == 1

    if found.kind == "pair" and found.best is not None:
        if of_one_sensor(found.best.fit) and found.of_interest(found.singles[0]):
            found.kind, found.best = "single", recentred(found, found.singles[0])
            set_probabilities(found, "single")
    elif found.refused == "pair" and of_one_sensor(found.pairs[0]) and found.of_interest(found.singles[0]):
        found.pairs, found.refused = [fit for fit in found.pairs if not of_one_sensor(fit)], ""
        choose(found, None)
        if found.kind == "law":
            found.best = None


def likelier_first(found: Search) -> None:
    """Of explanations that can't be told apart the one that is likelier beforehand; all of them stay reported."""
    if found.best is None:
        return
    prior = {key: sum(LOG_PRIOR.get(name, 0.0) for name in key.split(" + ")) for key in found.probabilities}
    weights = {key: value * float(np.exp(prior[key])) for key, value in found.probabilities.items()}
    total = sum(weights.values())
    found.probabilities = {key: value / total for key, value in weights.items()}
    best = max(found.equivalent, key=lambda names: found.probabilities.get(" + ".join(names), 0.0), default=())
    pool: list[tuple[Variant | None, Fit]] = [(None, fit) for fit in (*found.singles, *found.pairs)]
    if found.kind == "variant":
        pool = list(found.variants)
    likelier = next((pair for pair in pool if pair[1].candidate.names == best), None)
    if likelier is not None and best != found.best.fit.candidate.names and found.of_interest(likelier[1]):
        found.variant, fit = likelier
        found.best = recentred(found, fit)


def none_at_a_limit(found: Search) -> None:
    """A name whose best size is the largest that is possible explains nothing: it would be larger still."""
    if found.best is None:
        return
    fit = found.best.fit
    limits = np.array([found.twin.hypotheses[name].limits for name in fit.candidate.names])
    if np.any((limits != 0.0) & (np.abs(fit.magnitudes[:, None] - limits) <= AT_LIMIT * np.abs(limits))):
        found.kind, found.best, found.variant = "law", None, None


def began_rather(found: Search) -> None:
    """Of what was there from the start and is gone, and the opposite that began then, the latter where both explain as
    much: they differ by levels alone, and recordings of what goes by itself are rarer than of what comes."""
    variant, best = found.variant, found.best
    if found.kind != "variant" or variant is None or best is None or variant.until_s is None or variant.grows:
        return
    fit = best.fit
    if float(variant.onset_s or 0.0) > found.twin.time_s[0] or found.twin.hypotheses[variant.name].sign:
        return
    other = at_times(found.twin, variant, variant.until_s, None, False)
    start = replace(fit, candidate=Candidate(fit.candidate.names, {variant.name: other.schedule}),
                    magnitudes=-fit.magnitudes)  # fmt: skip
    both = [fit, found.refitted(start, _MIRROR_ROUNDS)]
    if found.settings.in_own_metrics(found.gain(fit)):
        both = in_own_metrics(found, both)
    opposite = next(f for f in both if f.candidate.schedules[variant.name] is other.schedule)
    if opposite.objective < min(f.objective for f in both) + found.settings.equivalent_gain:
        found.variant, found.best = other, recentred(found, opposite)
        found.variants = [(other, opposite), *found.variants]
