"""Fits of health and circumstances together, and which of the circumstances such a fit needs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from dieseltwin.discovery.likelihood.circumstances import WithCircumstances, label_of
from dieseltwin.discovery.likelihood.fit import Fit, Linearisation, fit_fully
from dieseltwin.discovery.likelihood.metric import Whitening
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.interface import Array
from dieseltwin.recordings.circumstances import Circumstance

_FIT_ROUNDS = 12  # 2000 m high, 20 K colder and with all clocks off is some ten of the longest steps away
_LARGEST_STEP = 0.8  # of a prior's standard deviation in one round: farther, responses are others
_SETTLED = 0.1  # of a prior's standard deviation; the rest is linear


@dataclass(frozen=True)
class Settled:
    """Circumstances fitted together with the health parameters.

    Attributes:
        values: name -> value [unit].
        evidence: -2 log marginal likelihood, less the number of readings.
        at: the fit, with the circumstances as its last nuisances and the readings as if all were as assumed.
    """

    values: dict[str, float]
    evidence: float
    at: Linearisation


def evidence_of(at: Linearisation) -> float:
    """-2 log marginal likelihood of a fit, less the number of readings."""
    return at.fit.objective + at.metric.log_determinant - float(at.whitening.present.sum())


def settle(
    found: Search, base: WithCircumstances, start: Fit, items: Sequence[Circumstance], near: Mapping[str, float]
) -> Settled:
    """Fit of health and circumstances: Gauss-Newton, the engine simulated anew under each estimate.

    Args:
        found: its noise and its nuisances of maps and sensors are kept.
        base: its twin.
        start: where to begin.
        items: what is free; other circumstances stay as the twin has them.
        near: name -> value to begin at.
    """
    maps = _other_responses(found, items)
    names = [item.name for item in items]
    std = np.array([item.std for item in items])
    assumed = np.array([item.assumed for item in items])
    values = np.array([near.get(item.name, base.values.get(item.name, item.assumed)) for item in items])
    fit, best = start, None
    for turn in range(_FIT_ROUNDS):
        twin = base.under({**base.values, **dict(zip(names, values, strict=True))}, base.opened, like=True)
        changed = cast(WithCircumstances, twin)
        whitening = Whitening.of(twin.measured, found.noise, twin.starts, found.scatter)
        simulated = twin.simulate(fit.lanes())[0]
        responses = std[:, None, None] * changed.circumstance_responses(fit.lanes(), simulated, names)
        applied = np.array([changed.values[name] for name in names])
        twin.measured = twin.measured + np.tensordot((applied - assumed) / std, responses, 1)  # so the priors hold
        both = np.concatenate([maps, responses])
        at = fit_fully(twin, whitening, fit, rounds=1, frozen=Linearisation(twin, whitening, fit, None, both))
        share = at.metric.nuisance_estimate(np.nan_to_num(at.residual))[len(maps) :]
        settled = Settled(dict(zip(names, assumed + share * std, strict=True)), evidence_of(at), at)
        if best is None or settled.evidence < best.evidence:
            best = settled
        step = np.clip(assumed / std + share - values / std, -_LARGEST_STEP, _LARGEST_STEP)
        if turn and np.abs(step).max() < _SETTLED:
            break
        values, fit = values + step * std, at.fit
    return cast(Settled, best)


def _other_responses(found: Search, items: Sequence[Circumstance]) -> Array:
    """Responses (K, n, C) of the nuisances that are none of these circumstances."""
    if found.null.nuisance_response is None:
        return np.zeros((0, *found.twin.measured.shape))
    labels = {label_of(item) for item in items}
    kept = [nuisance.label not in labels for nuisance in found.nuisances]
    return found.null.nuisance_response[np.array(kept, dtype=bool)]


def _marginal(settled: Settled, rest: Sequence[Circumstance]) -> Callable[[Sequence[int]], float]:
    """What gives the evidence (the larger the better) of a fit with some of its last nuisances, by their places in the
    rest; 0 where it has none.

    Args:
        settled: a fit with everything free.
        rest: its last nuisances, which may be left out.
    """
    at = settled.at
    if at.nuisance_response is None:
        return lambda some: 0.0
    columns, gram = at.joint()
    push = columns @ at.metric.without_local(np.nan_to_num(at.residual)[None])[0]
    first = len(gram) - len(rest)

    def evidence(some: Sequence[int]) -> float:
        index = [*range(first), *(first + k for k in some)]
        part = gram[np.ix_(index, index)]
        return float(push[index] @ np.linalg.solve(part, push[index]) - np.linalg.slogdet(part)[1])

    return evidence


def by_leaving_out(settled: Settled, rest: Sequence[Circumstance]) -> list[Circumstance]:
    """Those of the last nuisances that the marginal likelihood wants, by leaving out one after another; as of
    `_marginal`."""
    evidence = _marginal(settled, rest)
    kept = list(range(len(rest)))
    here = evidence(kept)
    while kept:
        value, worst = max((evidence([k for k in kept if k != out]), out) for out in kept)
        if value < here:
            break
        kept.remove(worst)
        here = value
    return [rest[k] for k in kept]


def by_taking_in(settled: Settled, rest: Sequence[Circumstance]) -> list[Circumstance]:
    """The same by taking in one after another."""
    evidence = _marginal(settled, rest)
    kept = list[int]()
    here = evidence(kept)
    while len(kept) < len(rest):
        value, best = max((evidence([*kept, k]), k) for k in range(len(rest)) if k not in kept)
        if value < here:
            break
        kept.append(best)
        here = value
    return [rest[k] for k in kept]
