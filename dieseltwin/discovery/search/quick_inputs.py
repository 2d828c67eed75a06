"""Inputs that may have moved between rows that are fast enough for an engine that is driven calmly."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dieseltwin.discovery.likelihood.between_rows import WithInputsToOpen
from dieseltwin.discovery.likelihood.metric import Whitening
from dieseltwin.discovery.likelihood.noise import noise_of
from dieseltwin.discovery.search.settled import evidence_of
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.interface import Twin

_NOISE_LEAVES = (0.97, 1.075)  # of chi-square a reading, where an explanation is right


def with_inputs_between_rows(found: Search) -> tuple[Twin | None, bool]:
    """The twin whose inputs may have moved between its rows, where an explanation leaves more or less than its noise;
    and whether what is found with it stands whatever it explains.

    Inputs that move unseen leave errors which differences of rows take for noise in part, and which health and maps
    can't take up: of eight healthy engines of a foreign simulator, driven by a quick pedal and recorded at 5 or 10 Hz,
    all got an alarm and were left with 0.76 to 0.96 or 1.10 to 1.25 of what noise leaves; right names leave 1.02 to
    1.06. Less than noise is left where the noise that differences of rows tell holds more than noise.
    """
    if not isinstance(found.twin, WithInputsToOpen):
        return None, False
    left = share_left(found)
    seen = _NOISE_LEAVES[0] < left < _NOISE_LEAVES[1]
    return None if seen else found.twin.with_inputs_between_rows(), left <= _NOISE_LEAVES[0]


def leaves_more(found: Search) -> bool:
    """Whether an explanation leaves more than noise."""
    return share_left(found) >= _NOISE_LEAVES[1]


def is_made_again(found: Search) -> bool:
    """Whether the search is made with inputs that moved between the rows, whatever law is found without: before one is
    looked for less is left than its noise."""
    if found.kind != "law":
        return False
    other, stands = with_inputs_between_rows(found)
    return stands and other is not None


def share_left(found: Search) -> float:
    """Chi-square a reading that an explanation leaves, maps and sensors as they most likely are beside it.

    The noise is that beside the explanation: beside health alone a large effect that begins was noise in part.
    """
    at, null = found.null if found.best is None else found.best, found.null
    simulated = at.simulated
    if found.law is not None:
        twin, fit = found.law.on(found.twin)
        simulated = twin.simulate(fit.lanes())[0]
    residual = null.without_nuisances(np.nan_to_num(found.twin.measured - simulated))
    measured = found.twin.measured
    whitening = Whitening.of(measured, noise_of(found.twin, measured - residual), found.twin.starts, found.scatter)
    return float((whitening.apply(residual[None])[0] ** 2).sum()) / max(float(whitening.present.sum()), 1.0)


def likelier(one: Search, other: Search, gain: Callable[[Search], float] = Search.explained) -> Search:
    """The search that explains more of the readings that both use, each with its own noise; `gain`: of its find."""
    return other if ahead_of(other, one, gain) > 0.0 else one


def ahead_of(other: Search, one: Search, gain: Callable[[Search], float] = Search.explained) -> float:
    """By how much -2 log likelihood of the readings that two searches use is lower in the first; as of `likelier`."""
    present = one.whitening.present & other.whitening.present

    def evidence(found: Search) -> float:
        return evidence_of(found.null) + 2.0 * found.whitening.log_normaliser(present) - gain(found)

    return evidence(one) - evidence(other)
