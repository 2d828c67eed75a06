"""Generic terms at every insertion point: what a model could lack that has no name (docs/discovery.md)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from dieseltwin.discovery.laws.grammar import (
    OPERATOR_AMPLITUDE,
    Factor,
    Form,
    Kind,
    bumps,
    map_arguments,
    operators,
    unit_of,
)
from dieseltwin.discovery.laws.shapes import lagged
from dieseltwin.discovery.likelihood.fit import Fit, Linearisation
from dieseltwin.discovery.likelihood.known import KnownErrors
from dieseltwin.discovery.likelihood.nuisance import signal_responses
from dieseltwin.discovery.likelihood.score import spread, without_parameters
from dieseltwin.discovery.twins.interface import Array, LawScope, Point, Twin, WithExactResponses, law_scope_of

FaultKind = Literal["gain", "offset", "lag"]

LAGS_S = (0.4, 2.0, 8.0)
"""Lags of a reading that are scored by what they do, as at none they have no useful slope [s]."""
_OF_SPEED = (2.0, 3.0)  # powers lost to bearings and to a fluid that is stirred
_LOCAL_WIDTHS = (0.12,)  # of the range driven; the law search has finer ones
_RAREST = 12.0  # largest value of a signal of unit mean square: what acts on fewer samples hangs on a moment
_WIDE = 0.4  # standard deviation over size, above which a change by an amount is none by a share
_STEP = 0.005  # of a point's scale: small enough to be linear
_MATTERS = 3.0  # gain by responses at another fit from which a feature is simulated: a third of what chance leaves
# of a feature's length that parameters and effects of the fit must leave: what is left of a term that is one of them is
# how the machine bends, a direction without a meaning (0.02 of it and less; 0.04 and more of any other term)
_APART = 0.03
_MATTERS_AT_LEAST = 8  # features, which are simulated together


@dataclass(frozen=True)
class Feature:
    """A signal of unit mean square at a point, a function of the point's ports alone.

    Attributes:
        point: index into `Twin.points`; None for a fault of a sensor.
        text: the function in words.
        signal: (n,).
        site: word for the report.
        channel: of the faulty sensor; fault: what is wrong with it, and lag_s: behind which lag it was scored [s].
        form: the same as a law, None for a fault of a sensor.
        effect: hypothesis that says the same by name, where the twin has one.
        outward: it does so where the coefficient is negative: nothing flows in through a hole.
        whole: coefficient with which a lag, dead time or play is there just as it was scored; 0 for what has any size.
    """

    point: int | None
    text: str
    signal: Array
    site: str
    channel: int | None = None
    fault: FaultKind | None = None
    lag_s: float = 0.0
    form: Form | None = None
    effect: str | None = None
    outward: bool = False
    whole: float = 0.0

    @property
    def behind(self) -> bool:
        """Whether only a positive coefficient means anything: nothing runs ahead of its cause."""
        return self.fault == "lag" or (self.form is not None and self.form.operator)


@dataclass(frozen=True)
class Structure:
    """A feature's linear estimate: coefficient in the point's unit, and its gain.

    Attributes:
        response: (n, C) of the readings per unit.
        held: gain without the window that it hangs on most (`score.spread`).
    """

    feature: Feature
    coefficient: float
    gain: float
    response: Array
    held: float


def generic_features(twin: Twin, fit: Fit) -> list[Feature]:
    """One constant per point, one proportional to each port, an amount of what varies widely and is changed by shares
    (injected mass), a hole to the surroundings where a balance has a pressure,
    losses of a shaft; dead time, lag and play of each actuator, lags of fuel and gas, which no function of the moment
    comes near; offset and gain per sensor, and lags of those that may lag."""
    variables = {**twin.variables(fit.lanes()), "time_s": twin.time_s}
    scope = law_scope_of(twin)
    found = []
    for index, point in enumerate(twin.points):
        found.append(Feature(index, "constant", np.ones(twin.time_s.size), point.site, form=Form(point.name)))
        for port in point.ports:
            values = np.asarray(variables[port], dtype=np.float64)
            size = float(np.sqrt(np.mean(values**2)))
            if size > 0 and np.std(values) > 1e-3 * size:
                kind: Kind = "power" if values.min() > 0.0 else "signed_power"
                form = Form(point.name, (Factor(kind, (port,), (size,), 1.0, (unit_of(port, {}),)),))
                found.append(Feature(index, port, values / size, point.site, form=form))
                if port == point.name and point.relative and kind == "power" and np.std(values) > _WIDE * size:
                    amount = Form(point.name, (Factor("power", (port,), (1.0,), -1.0, form.factors[0].units),))
                    found += _of_form(index, f"amount of {port}", amount, point.site, variables)
            if not point.relative and port.startswith("p_") and "p_amb" in variables:
                warm = next((name for name in point.ports if name.startswith("T_")), None)
                hole = _of_form(index, f"hole of {port}", _hole(point.name, port, size, warm, variables), point.site,
                                variables)  # fmt: skip
                found += [replace(f, effect=scope.holes.get(point.name), outward=True) for f in hole]
            if point.unit == "W" and port.startswith("omega"):
                for power in _OF_SPEED:
                    form = Form(point.name, (Factor("signed_power", (port,), (size,), power, (unit_of(port, {}),)),))
                    found += _of_form(index, f"{port}^{power:g}", form, point.site, variables)
        found += _of_operators(index, point, scope, variables)
    ones = np.ones(twin.time_s.size)
    for j, name in enumerate(() if isinstance(twin, KnownErrors) else twin.channels):  # balances are no sensors
        site = f"sensor:{name}"
        lags: tuple[float, ...] = LAGS_S if name in scope.lagging_sensors else ()
        faults: list[tuple[FaultKind, float]] = [("offset", 0.0), ("gain", 0.0), *(("lag", lag) for lag in lags)]
        for fault, lag_s in faults:
            same = (h.name for h in twin.hypotheses.values() if h.site == site and h.name.endswith(f"_{fault}"))
            text = f"lag {lag_s:g}" if fault == "lag" else fault
            found.append(Feature(None, text, ones, site, j, fault, lag_s, effect=next(same, None), whole=lag_s))
    return found


def _of_operators(index: int, point: Point, scope: LawScope, variables: Mapping[str, Array]) -> list[Feature]:
    """Dead times, lags and plays of an actuator; of other quantities the lags that the twin has as effects."""
    command = point.unit == "%"
    if point.name not in variables or not (command or point.name in scope.lags):
        return []
    found: list[Feature] = []
    for factor in operators(point, point.unit if command else unit_of(point.name, scope.units)):
        if (scope.kinds is None or factor.kind in scope.kinds) and (command or factor.kind == "lag"):
            effect = scope.commands.get((factor.kind, point.name)) if command else scope.lags[point.name]
            text = f"{factor.kind.replace('_', ' ')} {factor.shape:g}"
            features = _of_form(index, text, Form(point.name, (factor,), 1.0), point.site, variables)
            found += [replace(feature, effect=effect) for feature in features]
    return found


def local_features(twin: Twin, fit: Fit) -> list[Feature]:
    """Bumps over one argument of each map: what a smooth tolerance doesn't follow, and no constant or power shows."""
    variables = twin.variables(fit.lanes())
    admitted = law_scope_of(twin).variables
    found = []
    for index, point in enumerate(twin.points):
        along = {n: np.asarray(variables[n]) for n in map_arguments(point) if admitted is None or n in admitted}
        for factor in bumps(along, {}, _LOCAL_WIDTHS):
            form = Form(point.name, (factor,))
            found += _of_form(index, factor.text(), form, point.site, variables)
    return [feature for feature in found if np.max(np.abs(feature.signal)) < _RAREST]


def _hole(point: str, port: str, size: float, warm: str | None, variables: Mapping[str, Array]) -> Form:
    """A nozzle to the surroundings; its flow falls with the root of the temperature where the point touches one."""
    if warm is None:
        return Form(point, (Factor("orifice", (port, "p_amb"), (size, 1.0), 1.0, ("Pa", "Pa")),))
    typical = float(np.median(variables[warm]))
    names, units = (port, "p_amb", warm), ("Pa", "Pa", "K")
    return Form(point, (Factor("orifice", names, (size, 1.0, typical), 1.0, units),))


def _of_form(index: int, text: str, form: Form, site: str, variables: Mapping[str, Array]) -> list[Feature]:
    signal = np.asarray(form.value(variables), dtype=np.float64)
    size = float(np.sqrt(np.mean(signal**2)))
    whole = size if form.operator else 0.0
    return [Feature(index, text, signal / size, site, form=form, whole=whole)] if size > 0 else []


def score_features(at: Linearisation, features: Sequence[Feature]) -> list[Structure]:
    """Linear gains of all features, strongest first."""
    return _scored(at, features, _responses(at, features)) if features else []


def scored_since(at: Linearisation, structure: Sequence[Structure], since_s: float) -> list[Structure]:
    """Scores of scored features if they act from a time on only [s], strongest first; exact at a window's start."""
    acts = (at.twin.time_s >= since_s).astype(np.float64)
    responses = np.stack([item.response for item in structure]) * acts[:, None]
    return _scored(at, [item.feature for item in structure], responses)


def score_what_is_left(
    at: Linearisation, features: Sequence[Feature], before: Sequence[Structure]
) -> list[Structure]:
    """Linear gains beside an explanation, strongest first, of the features that may gain something there.

    Which these are is judged by the responses that they had without the explanation, `before`: a response turns little
    from one fit to another, and what a feature gains by it alone can't come near what decides.
    """
    known = {_key(item.feature): item.response for item in before if item.response.shape == at.simulated.shape}
    old = [feature for feature in features if _key(feature) in known]
    if not old:
        return score_features(at, features)
    judged = _scored(at, old, np.stack([known[_key(feature)] for feature in old]))
    idle = {_key(item.feature) for item in judged[_MATTERS_AT_LEAST:] if item.gain < _MATTERS}
    idle |= {_key(feature) for feature in old if feature.behind} - {_key(item.feature) for item in judged}
    return score_features(at, [feature for feature in features if _key(feature) not in idle])


def _key(feature: Feature) -> tuple[int | None, int | None, str]:
    return feature.point, feature.channel, feature.text


def _responses(at: Linearisation, features: Sequence[Feature]) -> Array:
    """Responses of the readings to features, a unit of each, (F, n, C)."""
    twin = at.twin
    responses = np.zeros((len(features), *at.simulated.shape))
    inside = [k for k, f in enumerate(features) if f.point is not None]
    if inside:
        points = [int(features[k].point) for k in inside]  # type: ignore[arg-type]
        steps = _STEP * np.array([twin.points[p].scale for p in points])
        signals = np.stack([features[k].signal for k in inside]) * steps[:, None]
        responses[inside] = signal_responses(twin, at.fit.lanes(), at.simulated, points, signals, linear=True)
        responses[inside] /= steps[:, None, None]
    for k, feature in enumerate(features):
        if feature.channel is not None:
            true = at.simulated[:, feature.channel]
            responses[k, :, feature.channel] = _of_fault(feature, true, twin.time_s)
    return responses


def _of_fault(feature: Feature, true: Array, time_s: Array) -> Array:
    """Response of a reading (n,) to a unit of its fault; of a lag, in the middle between none and the scored one."""
    if feature.fault == "lag":
        return (lagged(true, time_s, feature.lag_s) - true) / feature.lag_s
    return true if feature.fault == "gain" else np.full_like(true, np.mean(true))


def _scored(at: Linearisation, features: Sequence[Feature], responses: Array) -> list[Structure]:
    """Linear gains, strongest first. What replaces a quantity counts as far as it replaces it: a hundredth of a lag of
    2 s is no lag of 0.02 s, which a clock takes up, but a slow drift (a healthy engine's "reading 0.015 s behind")."""
    directions = at.metric.project(responses)
    apart = 0.0 if isinstance(at.twin, WithExactResponses) else _APART
    projected = without_parameters(at, directions)
    found = []
    for feature, direction, vector, response in zip(features, directions, projected, responses, strict=True):
        information = float(vector @ vector)
        if information > apart**2 * float(direction @ direction):
            push = float(vector @ at.pulled_residual)
            if feature.behind and push <= 0.0:
                continue
            coefficient = push / information
            if feature.whole:
                least, most = (share * feature.whole for share in OPERATOR_AMPLITUDE)
                coefficient = min(max(coefficient, least), most)
            gain = coefficient * (2.0 * push - coefficient * information)
            if feature.whole and gain <= 0.0:
                continue
            held = gain * spread(at, vector)
            found.append(Structure(feature, coefficient, gain, response, held))
    return sorted(found, key=lambda item: -item.gain)
