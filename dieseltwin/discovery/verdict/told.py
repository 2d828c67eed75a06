"""What a recording says of health, sizes and circumstances under the chosen explanation, maps off in all their detail.

Names are compared beside the leading modes of a map's error. What those leave out, a twentieth of a tolerance, moved
health by up to ten of the deviations that they leave, and the weather by four: some samples next to a kink (the EGR
valve's flow begins where both pressures are equal) tell health so sharply that the smallest error of a map counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from dieseltwin.discovery.laws.final_fit import about_itself
from dieseltwin.discovery.likelihood.circumstances import (
    Estimate,
    at_estimates,
    circumstance_nuisances,
    estimates,
)
from dieseltwin.discovery.likelihood.fit import Fit, Linearisation, fit_fully
from dieseltwin.discovery.likelihood.known import KnownErrors
from dieseltwin.discovery.likelihood.learned import belief_of
from dieseltwin.discovery.likelihood.nuisance import FINE, Nuisance, Rebased, nuisance_responses
from dieseltwin.discovery.search.preparation import telling_alone, tolerance_responses, tolerances
from dieseltwin.discovery.search.standing import scattered
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.interface import Array, Twin
from dieseltwin.discovery.verdict.explained import disagreement_of_circumstances
from dieseltwin.discovery.verdict.over_recordings import Sizes, sizes_of_all

_ROUNDS = 3
_PLACES = (2, 3)  # at which maps and weather are taken linearly, at least and at most
_SETTLED = 0.5  # standard deviations between two places that count as the same
_MOST_NUMBERS = 50_000_000  # of responses in all detail: 400 MB, five recordings of ten minutes


@dataclass(frozen=True)
class Told:
    """What an explanation says.

    Attributes:
        fit: parameters and sizes, with their covariance.
        circumstances: of the recording, where a column doesn't give them.
        sizes: of every effect in each of several recordings, freed beside each other in the same fit.
    """

    fit: Fit
    circumstances: tuple[Estimate, ...]
    sizes: tuple[Sizes, ...] = ()


def told(found: Search, at: Linearisation, after: Array) -> Told:
    """What the chosen explanation says.

    Args:
        found: the search.
        at: the explanation, as `explained.explained_at`; beside a law health is the law's, as it is, and known as well
            as fine maps let it be.
        after: (n, C) readings of the explanation.
    """
    apart = disagreement_of_circumstances(found, at)
    if found.kind == "law":
        places = beside_fine_maps(found, found.null, found.twin.measured - after)
        return Told(_law_beside_fine_maps(found, at), _mean([place.circumstances for place in places], apart))
    # along a valley of positions and health a further fit would go anywhere
    places = [_told_at(at, None)] if found.stood_always() else beside_fine_maps(found, at)
    fit = at.fit if places[0].fit is at.fit else _together(places, found.widening)
    sizes = tuple(_sizes_together(each, found.widening) for each in zip(*(p.sizes for p in places), strict=True))
    if found.standing:
        fit = _within_reach(fit, found, scattered(found))
    return Told(fit, _mean([place.circumstances for place in places], apart, found.widening), sizes)


def _within_reach(fit: Fit, found: Search, more: float) -> Fit:
    """A valve's position no better known than others are likely, and no worse than anywhere it can be."""
    covariance = cast(Array, fit.covariance).copy()
    low, high = found.twin.hypotheses[fit.candidate.names[0]].limits
    covariance[-1, -1] = min(covariance[-1, -1] + more**2, (high - low) ** 2 / 12.0)
    return replace(fit, covariance=covariance)


def beside_fine_maps(found: Search, at: Linearisation, residual: Array | None = None) -> list[Told]:
    """What fits say with maps that may be off in all the detail that is believed, linearised at several places.

    The maps' errors and the weather that a fit estimates are simulated, and all responses worked out anew there:
    beside the samples next to a kink half a tolerance of a map moves the engine to the other side. Where a fit about
    its own estimate says something else than the one before, linear isn't good enough anywhere, and how far they are
    apart is how well each of them is known beside its own standard deviation.

    Args:
        found: the search.
        at: an explanation. It comes back alone where its errors are no smooth ones of maps, or too many.
        residual: (n, C) that circumstances are read from; None: what each fit leaves.
    """
    return _places(found, at, residual) or [_told_at(at, residual)]


def _told_at(at: Linearisation, residual: Array | None) -> Told:
    """What one fit says; `residual` as of `beside_fine_maps`."""
    return Told(at.fit, estimates(at, residual), tuple(sizes_of_all(at)))


def _places(found: Search, at: Linearisation, residual: Array | None) -> list[Told]:
    """As `beside_fine_maps`; none where the explanation stays as it is."""
    places: list[Told] = []
    own = _fine_maps(found, at)
    if own is None:
        return places
    try:
        responses = nuisance_responses(at.twin, at.fit.lanes(), at.simulated, own, linear=True)
        fine = fit_fully(at.twin, at.whitening, at.fit, responses, rounds=_ROUNDS)
        while len(places) < _PLACES[0] or (len(places) < _PLACES[1] and _apart(*places[-2:]) > _SETTLED):
            estimate = fine.metric.nuisance_estimate(np.nan_to_num(fine.residual))
            own, responses = _responses_about(at.twin, fine.fit, own, responses, estimate)
            there = _at(at.twin, own, responses, estimate)  # the readings by these responses, too
            fine = fit_fully(there, at.whitening, fine.fit, responses, rounds=_ROUNDS)
            if found.standing and telling_alone(fine).any():
                break  # at a kink: what is said there is linear and wrong
            places.append(_told_at(fine, residual))
    except np.linalg.LinAlgError:
        pass  # the machine runs away with some tolerance there: what was told until then counts
    return places


def _fine_maps(found: Search, at: Linearisation) -> list[Nuisance] | None:
    """All directions in which maps may be off; None where errors are no smooth ones of maps, or too many."""
    if belief_of(at.twin) is not None or isinstance(at.twin, KnownErrors):
        return None
    own = tolerances(at.twin, at, found.settings, FINE)
    return None if len(own) * at.simulated.size > _MOST_NUMBERS else own


def _law_beside_fine_maps(found: Search, at: Linearisation) -> Fit:
    """The fit of a law, each of its values known as well as maps let it be that may be off in all their detail.

    The values stay, as the law's terms belong to them; how far they are from those of the fit with all detail counts.
    """
    if found.law is None or at.nuisance_response is None or _fine_maps(found, found.null) is None:
        return at.fit

    fine = about_itself(
        at, lambda here: tolerance_responses(here.twin, here, found.settings, FINE, linear=True), passes=1
    )
    apart = fine.fit.parameters - at.fit.parameters
    return replace(at.fit, covariance=cast(Array, fine.fit.covariance) + np.outer(apart, apart))


def _at(twin: Twin, own: Sequence[Nuisance], responses: Array, estimate: Array) -> Twin:
    """The twin with estimated errors of maps and in the estimated weather."""
    return cast(Twin, Rebased(at_estimates(twin, own, responses, estimate), own, responses, estimate))


def _responses_about(
    twin: Twin, fit: Fit, own: Sequence[Nuisance], responses: Array, estimate: Array
) -> tuple[list[Nuisance], Array]:
    """Directions and responses (K, n, C) about an estimate (K,), from those about another place."""
    there, lanes = _at(twin, own, responses, estimate), fit.lanes()
    simulated = there.simulate(lanes)[0]
    weather = circumstance_nuisances(there, lanes, simulated)  # they are the last
    own = [*own[: len(own) - len(weather)], *weather]
    return own, nuisance_responses(there, lanes, simulated, own, linear=True)


def _apart(before: Told, after: Told) -> float:
    """The farthest that two fits of one explanation are apart, in standard deviations of the latter."""

    def values(place: Told) -> Array:
        weather = [item.value for item in place.circumstances]
        return np.concatenate([place.fit.parameters, place.fit.magnitudes, weather])

    std = np.concatenate([after.fit.std, [item.std for item in after.circumstances]])
    return float(np.max(np.abs(values(after) - values(before)) / np.maximum(std, 1e-300)))


def _together(places: Sequence[Told], widening: float) -> Fit:
    """Mean of fits of one explanation, their scatter in its covariance beside what one of them states, widened."""
    last = places[-1].fit
    values = np.stack([np.concatenate([place.fit.parameters, place.fit.magnitudes]) for place in places])
    mean, count = values.mean(axis=0), last.parameters.size
    spread = np.atleast_2d(np.cov(values.T)) if len(places) > 1 else 0.0
    covariance = widening * cast(Array, last.covariance) + spread
    return replace(last, parameters=mean[:count], magnitudes=mean[count:], covariance=covariance)


def _sizes_together(said: Sequence[Sizes], widening: float) -> Sizes:
    """Sizes of several fits as one, as `_together`."""
    values = np.stack([item.values for item in said])
    spread = np.atleast_2d(np.cov(values.T)) if len(said) > 1 else 0.0
    return Sizes(values.mean(axis=0), widening * said[-1].covariance + spread)


def _mean(said: Sequence[Sequence[Estimate]], apart: Array, widening: float = 1.0) -> tuple[Estimate, ...]:
    """Estimates of several fits as one. In the standard deviations are their scatter beside what one of them states,
    widened, and how far explanations are apart (K,), in standard deviations of priors."""
    values = np.array([[item.value for item in each] for each in said])
    spread = values.std(axis=0, ddof=1) if len(said) > 1 else np.zeros(values.shape[1])
    return tuple(
        replace(
            item, value=float(value),
            std=float(np.linalg.norm([np.sqrt(widening) * item.std, more, item.circumstance.std * other])),
        )
        for item, value, more, other in zip(said[-1], values.mean(axis=0), spread, apart, strict=True)
    )
