"""Explanations compared with the errors of maps that each one asks for simulated, not taken out linearly.

Next to a kink (no flow back through the EGR valve at p_em = p_im) or where a window is nearly unstable, the tolerances
take up linearly what no simulation of them does. For a weak misfit that decides: what is ahead there is compared
again: single effects, pairs, what acts in parts and terms without a name (faults of sensors without one stay linear).
With single effects alone compared so, the pair of a right name with another one was ahead of it by what the right name
had lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from dieseltwin.discovery.laws.refit import Refit
from dieseltwin.discovery.laws.twin import LawTwin, Placed
from dieseltwin.discovery.likelihood.circumstances import at_estimates
from dieseltwin.discovery.likelihood.fit import Fit, Linearisation, fit_fully, simulate_fits
from dieseltwin.discovery.likelihood.learned import belief_of, rebased_learned
from dieseltwin.discovery.likelihood.nuisance import Rebased
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.interface import Twin

_VERIFIED = 3  # of the leading fits
_BEHIND = 40.0  # gain by which a single effect may be behind and yet ahead, or as likely, with its errors simulated
_VERIFIED_FROM = 0.7  # of the gain of an alarm
_REBASINGS = 2  # of a fit about its own estimate of the maps' errors


def verify(found: Search) -> Linearisation:
    """Objectives of the health-only fit and of the leading singles with the estimated errors of the maps simulated.

    Returns the health-only linearisation about those errors, and in the weather that it estimates: what that leaves
    when it is taken linearly would be taken for a term without a name. Names are compared where each has its own
    weather, linearly, as no refit of a few rounds comes as far along with it as the health-only fit.
    """
    null = found.null
    beside = rebased(found, null.fit, in_weather=True)
    if found.gain(found.singles[0]) < _VERIFIED_FROM * found.settings.alarm_gain:
        return beside
    base = rebased(found, null.fit)
    done = _in_turn(found, found.singles, _BEHIND)  # all before anything is changed: time may be over
    null.fit = replace(null.fit, objective=min(base.fit.objective, null.fit.objective))
    found.simulated_errors = bool(found.nuisances)
    found.singles = sorted([*done, *found.singles[len(done) :]], key=lambda fit: fit.objective)
    return beside


def verified(found: Search, fits: Sequence[Fit]) -> list[Fit]:
    """Fits of another kind, best first, with the objectives by which the single effects are compared; in that order.

    One after the other until the best is one whose errors were simulated; where many lead, those that are left lose as
    little as any of the others did.
    """
    if not found.simulated_errors or not fits:
        return list(fits)
    done = _in_turn(found, fits, 0.0)
    lost = max(min(after.objective - before.objective for after, before in zip(done, fits, strict=False)), 0.0)
    return [*done, *(replace(fit, objective=fit.objective + lost) for fit in fits[len(done) :])]


def gain_of_term(found: Search, refit: Refit) -> float:
    """Gain of a term without a name, as the single effects are compared."""
    if not found.simulated_errors:
        return refit.gain
    return found.null.fit.objective - rebased(found, refit.fit, laws=refit.twin.laws).fit.objective


def _in_turn(found: Search, fits: Sequence[Fit], reach: float) -> list[Fit]:
    """The first of some fits, best first, with their errors simulated, until the next is behind one by more than
    `reach`."""
    done = [_with_errors(found, fits[0])]
    for fit in fits[1:_VERIFIED]:
        if fit.objective > min(other.objective for other in done) + reach:
            break
        done.append(_with_errors(found, fit))
    return done


def _with_errors(found: Search, fit: Fit) -> Fit:
    """A fit with the objective that it has with its errors simulated."""
    return replace(fit, objective=rebased(found, fit).fit.objective)


def rebased(found: Search, fit: Fit, in_weather: bool = False, laws: Sequence[Placed] = ()) -> Linearisation:
    """A fit about its own estimate of the maps' errors (`nuisance.Rebased`), in the metric of the health-only fit.

    Args:
        found: the search.
        fit: of its twin, with `laws` added.
        in_weather: about the weather that it estimates as well.
        laws: what is added to the twin.
    """
    null = found.null
    at = null
    if null.nuisance_response is None:
        return at
    residual = np.nan_to_num(found.twin.measured - simulate_fits(_under(found.twin, laws), [fit])[0])
    for _ in range(_REBASINGS):
        estimate = null.metric.nuisance_estimate(residual)
        twin = found.twin
        if belief_of(twin) is not None:
            twin = rebased_learned(twin, found.nuisances, estimate)
        else:
            if in_weather:
                twin = at_estimates(twin, found.nuisances, null.nuisance_response, estimate)
            twin = cast(Twin, Rebased(twin, found.nuisances, null.nuisance_response, estimate))
        at = fit_fully(_under(twin, laws), found.whitening, fit, rounds=3, frozen=null)
        fit, residual = at.fit, np.nan_to_num(at.residual)
    return at


def _under(twin: Twin, laws: Sequence[Placed]) -> Twin:
    return cast(Twin, LawTwin(twin, laws)) if laws else twin
