"""Effects that begin in the middle of a recording or act in a part of the operating range only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dieseltwin.discovery.fit import Linearisation
from dieseltwin.discovery.score import Scored, without_parameters
from dieseltwin.discovery.twin import Array, Twin

_QUANTILES = (0.25, 0.4, 0.5, 0.6, 0.75)  # of a condition, where a region may end
_ONSETS = 30  # times tried
_LEAST_SHARE = 0.08  # of the samples on either side


@dataclass(frozen=True)
class Variant:
    """A hypothesis that acts at some times only.

    Attributes:
        name: of the effect.
        onset_s: since when [s], or None.
        region: condition -> (low, high) in which it acts, or None.
        schedule: (n,) 1 where it acts, else 0.
        response: (n, C) linear response per unit of magnitude.
        gain: linear gain.
    """

    name: str
    onset_s: float | None
    region: dict[str, tuple[float, float]] | None
    schedule: Array
    response: Array
    gain: float


def _schedules(twin: Twin) -> list[tuple[float | None, dict[str, tuple[float, float]] | None, Array]]:
    n = twin.time_s.size
    found: list[tuple[float | None, dict[str, tuple[float, float]] | None, Array]] = []
    step = max(1, round(twin.starts.size / _ONSETS))
    for start in twin.starts[::step]:
        if _LEAST_SHARE * n < start < (1 - _LEAST_SHARE) * n:
            found.append((float(twin.time_s[start]), None, (np.arange(n) >= start).astype(float)))
    for name, values in twin.conditions.items():
        for edge in np.unique(np.quantile(values, _QUANTILES)):
            above = values >= edge
            if _LEAST_SHARE < above.mean() < 1 - _LEAST_SHARE:
                found.append((None, {name: (float(edge), float(values.max()))}, above.astype(float)))
                found.append((None, {name: (float(values.min()), float(edge))}, (~above).astype(float)))
    return found


def best_variants(at: Linearisation, items: Sequence[Scored], count: int) -> list[Variant]:
    """The strongest variants of some hypotheses, by the part of each response that falls into its time.

    The response of a part is taken as that part of the response: exact for an onset at a window's start (windows start
    anew), nearly so for a region (pressures follow within a second). Refits simulate it in full.
    """
    schedules = _schedules(at.twin)
    if not schedules:
        return []
    masks = np.stack([schedule for _, _, schedule in schedules])
    ranked = []
    for item in items:
        responses = masks[:, :, None] * item.response
        projected = without_parameters(at, at.metric.project(responses))
        information = np.einsum("kr,kr->k", projected, projected)
        push = projected @ at.projected_residual
        low, high = at.twin.hypotheses[item.name].limits
        estimate = np.clip(push / np.maximum(information, 1e-300), low, high)
        gains = estimate * (2.0 * push - estimate * information)
        for k in np.argsort(-gains)[:3]:
            onset, region, schedule = schedules[k]
            ranked.append(Variant(item.name, onset, region, schedule, responses[k], float(gains[k])))
    return sorted(ranked, key=lambda variant: -variant.gain)[:count]
