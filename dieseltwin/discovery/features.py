"""Generic terms at every insertion point: what a model could lack that has no name (DISCOVERY.md, steps 2 and 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dieseltwin.discovery.fit import Fit, Linearisation
from dieseltwin.discovery.nuisance import signal_responses
from dieseltwin.discovery.score import without_parameters
from dieseltwin.discovery.twin import Array, Twin

_STEP = 0.005  # of a point's scale: small enough to be linear


@dataclass(frozen=True)
class Feature:
    """A signal of unit mean square at a point, a function of the point's ports alone.

    Attributes:
        point: index into `Twin.points`.
        text: the function in words.
        signal: (n,).
    """

    point: int
    text: str
    signal: Array


@dataclass(frozen=True)
class Structure:
    """A feature's linear estimate: coefficient in the point's unit, its std, and its gain."""

    feature: Feature
    coefficient: float
    std: float
    gain: float
    response: Array


def generic_features(twin: Twin, fit: Fit) -> list[Feature]:
    """One constant per point, and one proportional to each port."""
    variables = twin.variables(fit.lanes())
    found = []
    for index, point in enumerate(twin.points):
        found.append(Feature(index, "constant", np.ones(twin.time_s.size)))
        for port in point.ports:
            values = np.asarray(variables[port], dtype=np.float64)
            size = float(np.sqrt(np.mean(values**2)))
            if size > 0 and np.std(values) > 1e-3 * size:
                found.append(Feature(index, port, values / size))
    return found


def score_features(at: Linearisation, features: Sequence[Feature]) -> list[Structure]:
    """Linear gains of all features, strongest first."""
    if not features:
        return []
    twin = at.twin
    scales = np.array([twin.points[f.point].scale for f in features])
    signals = np.stack([f.signal for f in features]) * (_STEP * scales)[:, None]
    responses = signal_responses(twin, at.fit.lanes(), at.simulated, [f.point for f in features], signals)
    responses /= (_STEP * scales)[:, None, None]
    projected = without_parameters(at, at.metric.project(responses))
    found = []
    for feature, vector, response in zip(features, projected, responses, strict=True):
        information = float(vector @ vector)
        if information > 0:
            push = float(vector @ at.projected_residual)
            found.append(Structure(feature, push / information, information**-0.5, push * push / information, response))
    return sorted(found, key=lambda item: -item.gain)
