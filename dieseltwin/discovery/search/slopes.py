"""Names by their derivative, where nothing has a name by the response to a size of interest.

An effect is scored, and its refit begins, by what a size of interest does. In a nearly unstable window that size may
take the machine to the other side of an edge where the true one, beside other health, doesn't: 1.5 % of a turbine's
efficiency gained 18 linearly where its derivative gains 105, so that the name wasn't refitted at all.
"""

from __future__ import annotations

from dieseltwin.discovery.likelihood.fit import Candidate
from dieseltwin.discovery.likelihood.refit import refit_all
from dieseltwin.discovery.likelihood.score import effect_responses, score, secant_sizes
from dieseltwin.discovery.search.explanations import polish
from dieseltwin.discovery.search.simulated_errors import verified
from dieseltwin.discovery.search.singles import REFIT_SHARE
from dieseltwin.discovery.search.state import Search

_SHARE = 0.02  # of the size at which an effect is scored
_STRAIGHT = 1.5  # times its gain by that size: what a name gains by its derivative more than that is worth a refit


def refit_by_slopes(found: Search) -> bool:
    """Refit names by their derivative where that promises much more; whether another name leads by it."""
    known: dict[str, float] = {}
    before = [(item.name, item.gain) for item in found.scored]
    for name, gain in (*before, *((fit.candidate.names[0], found.gain(fit)) for fit in found.singles)):
        known[name] = max(gain, known.get(name, 0.0))
    smooth = [name for name in known if found.twin.hypotheses[name].smooth]
    wanted = [(name, _SHARE * size) for name, size in secant_sizes(found.twin, smooth)]
    if not wanted:
        return False
    scored = score(found.null, wanted, effect_responses(found.twin, found.null, wanted))
    gains = [*(item.gain for item in scored), *(item.gain for item in found.everything_unnamed())]
    least = REFIT_SHARE * max(gains)
    bent = [item for item in scored if item.gain > max(least, _STRAIGHT * known[item.name])]
    if not bent:
        return False
    lead = found.singles[0]
    fits = refit_all(found.null, [Candidate((item.name,)) for item in bent], [item.response[None] for item in bent])
    fits = verified(found, polish(found, sorted(fits, key=lambda fit: fit.objective)))  # as the others are compared
    either = sorted([*found.singles, *fits], key=lambda fit: fit.objective)
    best = {fit.candidate.names: fit for fit in reversed(either)}
    found.singles = sorted(best.values(), key=lambda fit: fit.objective)
    return found.singles[0].candidate.names != lead.candidate.names
