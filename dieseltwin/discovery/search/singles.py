"""Single effects: refits of every competitive one, under the circumstances that a recording shows and, where what was
learned of the maps bends, about the one that leads."""

from __future__ import annotations

import time
from collections.abc import Collection, Sequence

from dieseltwin.discovery.likelihood.fit import Candidate, Fit
from dieseltwin.discovery.likelihood.learned import belief_of
from dieseltwin.discovery.likelihood.refit import nearer, refit_all
from dieseltwin.discovery.likelihood.score import best_of_each
from dieseltwin.discovery.search.by_recording import Start, refitted, starts_by_recording
from dieseltwin.discovery.search.circumstances import ROUNDS, under_circumstances
from dieseltwin.discovery.search.explanations import polish
from dieseltwin.discovery.search.leader import contenders, is_enough
from dieseltwin.discovery.search.preparation import lower_without, prepare, prepared_about, score_the_rest
from dieseltwin.discovery.search.renewal import BENDS
from dieseltwin.discovery.search.state import Search

REFIT_SHARE = 0.35  # of the best linear gain: weaker hypotheses can't win even when non-linearity moves them
_UNSTUCK_ROUNDS = 6
_RENEWALS = 3  # about the leading explanation, until it stays the same


def with_names(found: Search, starts: Sequence[Fit]) -> Search:
    """Refits of single effects, about the leading one where what was learned of the maps bends."""
    found = looked_at(found, starts)
    clock = time.perf_counter()
    found, by_recording = refitted(found, starts_by_recording(found))
    found.seconds["by_recording"] = time.perf_counter() - clock
    return about_leading_name(found, by_recording)


def about_leading_name(found: Search, starts: Sequence[Start] = ()) -> Search:
    """Single effects with what was learned of the maps about the one that leads; as they are where nothing was."""
    for renewal in range(_RENEWALS):
        if found.in_short and found.gain(_lead(found)) < BENDS:
            found = _with_all(found)
        lead = _lead(found)
        if belief_of(found.twin) is None or found.gain(lead) < BENDS:
            break
        before = found
        found, starts = refitted(with_singles(prepared_about(found, lead), found.singles), starts)
        found.unsettled, found.earlier = before.unsettled, before.earlier
        both = [lead.candidate.names, _lead(found).candidate.names]
        if both[0] == both[1]:
            break
        if renewal == _RENEWALS - 1:
            found.unsettled = both
    return found


def _lead(found: Search) -> Fit:
    """The leading explanation so far: of one size, or one that differs between recordings."""
    return min([found.singles[0], *(fit for _, fit in found.variants[:1])], key=lambda fit: fit.objective)


def looked_at(found: Search, starts: Sequence[Fit] = ()) -> Search:
    """A prepared search with its single effects, under the circumstances that the recording shows; `starts`: as of
    `carry_on`. Where all are compared anew about the leading one (`leader`), the others may not be refitted fully."""
    found = with_singles(found, starts, to_lead=True)
    before, names = found, _names(found)
    for _ in range(ROUNDS):
        other = under_circumstances(found)
        if other is None:
            return found
        before, found = found, prepare(other, found.settings, among=names if found.in_short else None)
        found = with_singles(found, to_lead=True, only=contenders(before) if before.in_short else None)
        if not before.in_short:
            names = _names(found)
        if before.in_short and not found.in_short:
            found = _with_all(found)
        found.earlier = [*before.earlier, before]
    both = [_lead(each) for each in (before, found)]
    if both[0].candidate.names != both[1].candidate.names and under_circumstances(found) is not None:
        found.unsettled = [fit.candidate.names for fit in both]
    return found


def _names(found: Search) -> frozenset[str]:
    return frozenset(name for fit in found.singles for name in fit.candidate.names)


def _with_all(found: Search) -> Search:
    """A search of which only the leading effect was asked, with all of them."""
    score_the_rest(found)
    return with_singles(found, found.singles)


def with_singles(
    found: Search, before: Sequence[Fit] = (), *, to_lead: bool = False, only: Collection[str] | None = None
) -> Search:
    """Refits of every competitive single effect.

    Args:
        found: scored.
        before: fits of single effects with another likelihood: where one of them is nearer to its minimum, it is the
            start. (About an explanation the health-only fit lies far from every minimum, and a refit from there may
            stop short of it in windows whose initial states turn round.)
        to_lead: where all are compared anew about the leading one, what can't come near to it isn't refitted fully.
        only: of which one leads; None: of any.
    """
    clock = time.perf_counter()
    ranked = best_of_each(found.scored)
    top = max(ranked[0].gain, 1e-9) if ranked else 0.0
    kept = [s for k, s in enumerate(ranked) if s.gain > REFIT_SHARE * top or k < found.settings.refits]
    kept = [s for s in kept if only is None or s.name in only] or kept
    fits = refit_all(found.null, [Candidate((s.name,)) for s in kept], [s.response[None] for s in kept])
    promising = [found.settings.unstick and s.gain > found.settings.alarm_gain for s in kept]
    fits = [_unstuck(found, fit) if more else fit for more, fit in zip(promising, fits, strict=True)]
    found.singles = sorted(nearer(found.null, fits, before), key=lambda fit: fit.objective)
    to_lead = to_lead and is_enough(found, found.singles)
    found.in_short = to_lead
    found.singles = polish(found, found.singles, near=to_lead)
    if not found.null.fit.converged:
        found.null = lower_without(found, found.singles[0])
    found.seconds["singles"] = time.perf_counter() - clock
    return found


def _unstuck(found: Search, fit: Fit) -> Fit:
    """A refit that found no way down, with sensitivities of its own; any other as it is.

    Next to a kink the response to a size of interest may point the wrong way (a pressure read low beside one read
    high), and a chord along it leads uphill in every length.
    """
    if fit.converged or found.gain(fit) > 0.0:
        return fit
    return found.refitted(fit, _UNSTUCK_ROUNDS)
