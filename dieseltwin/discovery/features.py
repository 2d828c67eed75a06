"""Generic terms at every insertion point: what a model could lack that has no name (DISCOVERY.md, steps 2 and 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dieseltwin.discovery.fit import Fit, Linearisation
from dieseltwin.discovery.nuisance import signal_responses
from dieseltwin.discovery.score import without_parameters
from dieseltwin.discovery.twin import Array, Twin
from dieseltwin.engine.terms import LawGroup

_STEP = 0.005  # of a point's scale: small enough to be linear


@dataclass(frozen=True)
class Feature:
    """A signal of unit mean square at a point, a function of the point's ports alone.

    Attributes:
        point: index into `Twin.points`; None for a fault of a sensor.
        text: the function in words.
        signal: (n,).
        site: word for the report.
        channel: of the faulty sensor.
    """

    point: int | None
    text: str
    signal: Array
    site: str
    channel: int | None = None


@dataclass(frozen=True)
class Structure:
    """A feature's linear estimate: coefficient in the point's unit, its std, and its gain."""

    feature: Feature
    coefficient: float
    std: float
    gain: float
    response: Array


def generic_features(twin: Twin, fit: Fit) -> list[Feature]:
    """One constant per point, one proportional to each port, a hole to the surroundings where a balance has a pressure;
    offset and gain per sensor."""
    variables = twin.variables(fit.lanes())
    found = []
    for index, point in enumerate(twin.points):
        found.append(Feature(index, "constant", np.ones(twin.time_s.size), point.site))
        for port in point.ports:
            values = np.asarray(variables[port], dtype=np.float64)
            size = float(np.sqrt(np.mean(values**2)))
            if size > 0 and np.std(values) > 1e-3 * size:
                found.append(Feature(index, port, values / size, point.site))
            if not point.relative and port.startswith("p_") and "p_amb" in variables:
                hole = LawGroup(kind="orifice", variables=(port, "p_amb"))
                flow = values * hole.value({port: values, "p_amb": np.asarray(variables["p_amb"])})
                size = float(np.sqrt(np.mean(flow**2)))
                if size > 0:
                    found.append(Feature(index, f"hole of {port}", flow / size, point.site))
    ones = np.ones(twin.time_s.size)
    for j, name in enumerate(twin.channels):
        found.append(Feature(None, "offset", ones, f"sensor:{name}", j))
        found.append(Feature(None, "gain", ones, f"sensor:{name}", j))
    return found


def score_features(at: Linearisation, features: Sequence[Feature]) -> list[Structure]:
    """Linear gains of all features, strongest first."""
    if not features:
        return []
    twin = at.twin
    responses = np.zeros((len(features), *at.simulated.shape))
    inside = [k for k, f in enumerate(features) if f.point is not None]
    if inside:
        points = [int(features[k].point) for k in inside]  # type: ignore[arg-type]
        steps = _STEP * np.array([twin.points[p].scale for p in points])
        signals = np.stack([features[k].signal for k in inside]) * steps[:, None]
        responses[inside] = signal_responses(twin, at.fit.lanes(), at.simulated, points, signals)
        responses[inside] /= steps[:, None, None]
    for k, feature in enumerate(features):
        if feature.channel is not None:
            j = feature.channel
            responses[k, :, j] = at.simulated[:, j] if feature.text == "gain" else np.mean(at.simulated[:, j])
    projected = without_parameters(at, at.metric.project(responses))
    found = []
    for feature, vector, response in zip(features, projected, responses, strict=True):
        information = float(vector @ vector)
        if information > 0:
            push = float(vector @ at.projected_residual)
            found.append(Structure(feature, push / information, information**-0.5, push * push / information, response))
    return sorted(found, key=lambda item: -item.gain)
