"""What raises an alarm: a name, a term without one, or what acts in a part of the driving."""

from __future__ import annotations

import time

from dieseltwin.discovery.laws.features import Structure, generic_features, local_features, score_features
from dieseltwin.discovery.likelihood.circumstances import open_circumstances
from dieseltwin.discovery.likelihood.fit import Fit, Linearisation
from dieseltwin.discovery.likelihood.score import spread, without_parameters
from dieseltwin.discovery.search.by_recording import gained_elsewhere
from dieseltwin.discovery.search.explanations import one_term_gains
from dieseltwin.discovery.search.simulated_errors import verify
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.search.variants import Variant, edge_cost
from dieseltwin.recordings.circumstances import TIME_SHIFT

_REBASED_BELOW = 150.0  # gain; clear cases needn't be verified


def raises_alarm(found: Search, fit: Fit) -> bool:
    """Whether one effect of one size is beyond chance and as large as is of interest."""
    return found.beyond_chance(fit) and found.of_interest(fit)


def clearly_named(found: Search) -> bool:
    """Whether the best name is an alarm that needn't be verified, whatever terms without a name say."""
    lead = found.singles[0]
    return found.gain(lead) >= _REBASED_BELOW and raises_alarm(found, lead)


def score_terms(found: Search, base: Linearisation) -> None:
    """Score terms without a name and bumps of maps by what a health-only fit leaves."""
    found.structure = score_features(base, generic_features(found.twin, found.null.fit))
    found.local = score_features(base, local_features(found.twin, found.null.fit))


def score_unnamed(found: Search) -> tuple[bool, Structure | None]:
    """Score terms without a name: whether the best name is an alarm, and the term that is one by itself."""
    base = verify(found) if found.gain(found.singles[0]) < _REBASED_BELOW else found.null
    clock = time.perf_counter()
    score_terms(found, base)
    found.seconds["structure"] = time.perf_counter() - clock
    unnamed = _unnamed(found)
    named = unnamed is not None and _explained_by_catalogue(found, unnamed)
    return named or raises_alarm(found, found.singles[0]), unnamed


def _unnamed(found: Search) -> Structure | None:
    """The strongest term without a name that raises an alarm by itself, None where none does."""
    settings, needed = found.settings, _named_already(found)
    untimed = {item.column for item in open_circumstances(found.twin) if item.kind == TIME_SHIFT}
    for item in found.lasting():
        channel = None if item.feature.channel is None else found.twin.channels[item.feature.channel]
        # a clock that is open acts to first order, and a lag is what it leaves beyond
        inside = channel is None or (item.feature.fault == "lag" and channel in untimed)
        bar = settings.unnamed_gain if inside else settings.unnamed_sensor_gain
        if item.gain > max(bar, needed):
            return item
    return found.local_ahead(needed)


def _named_already(found: Search) -> float:
    """Gain that a term without a name must have where the strongest name is too small to be of interest.

    What there is of a misfit has a name then, and a term must be ahead of it as of a name of interest: half a
    tolerance of back pressure, 29, was "none of these, in the reading T_em", which explained 27. Whether the name is
    beyond chance makes no difference: p_im 0.25 kPa off, a quarter of what is of interest, 17, was "reading + 0.0015 of
    its mean", whose linear score was 18.03 where 18 is an alarm, in a healthy recording.
    """
    lead = found.singles[0]
    return 0.0 if found.of_interest(lead) else found.gain(lead) + found.settings.law_gain


def _explained_by_catalogue(found: Search, item: Structure) -> bool:
    """Whether the best name says the same as a term: one finding, and it has a name."""
    fit = found.singles[0]
    return (
        found.known_by_name(item) and fit.candidate.names == (item.feature.effect,)
        and found.gain(fit) > item.gain - found.settings.law_gain and found.of_interest(fit)
    )  # fmt: skip


def shown_by_simulation(found: Search) -> bool:
    """Whether a term without a name that is weak by its linear score raises an alarm where it is simulated.

    Far from nothing the score tells too little: a compressor whose flow was 3.4 % short, a name that was withheld, had
    12 and explained 51 beside ambient as published. Simulated, terms on 75 healthy engines explained at most 13.
    """
    settings = found.settings
    linear = max((item.gain for item in found.nameless() if item.feature.form is not None), default=0.0)
    if settings.unnamed_simulated_from is None or linear < settings.unnamed_simulated_from:
        return False
    return one_term_gains(found, max(settings.unnamed_gain, _named_already(found)))


def shown_in_part(found: Search) -> bool:
    """Whether an onset or a region that the linear scan promised keeps its promise when it is simulated."""
    if not found.variants:
        return False
    variant, fit = found.variants[0]
    if found.gain(fit) - edge_cost(variant) <= hidden_bar(found, variant):
        return False
    if variant.profile is not None:
        return gained_elsewhere(found.null, fit) >= found.settings.least_spread
    direction = without_parameters(found.null, found.null.metric.project(variant.response[None]))[0]
    return spread(found.null, direction) >= found.settings.least_spread


def hidden_bar(found: Search, variant: Variant) -> float:
    """Gain from which an effect that doesn't act everywhere and always raises an alarm by itself."""
    return found.settings.hidden_gain if variant.profile is None else found.settings.hidden_profile_gain
