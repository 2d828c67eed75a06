"""What a recording of a healthy engine was made under: clocks and weather, found before anything is learned from it.

A channel that is 0.2 s late was learned as maps that are off by a tenth, and weather that no column gives as maps that
differ from day to day. What is found stays open, with its prior, in what the recording then says.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from dieseltwin.discovery.likelihood.circumstances import WithCircumstances, from_the_middle
from dieseltwin.discovery.likelihood.metric import Metric
from dieseltwin.discovery.search.circumstances import ROUNDS, under_circumstances
from dieseltwin.discovery.search.preparation import prepare
from dieseltwin.discovery.search.quick_inputs import leaves_more, likelier
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.diesel_circumstances import LoggedTwin
from dieseltwin.discovery.twins.interface import Array, Lanes
from dieseltwin.engine import EngineParameters
from dieseltwin.learning.weather import EXPONENTS, Exponent
from dieseltwin.recordings.circumstances import CORRECTED, DRIFT, TIME_SHIFT, Circumstance, kind_of
from dieseltwin.recordings.reader import Recording
from dieseltwin.settings.defaults import default_search
from dieseltwin.settings.search import CircumstanceSettings

_FAR = 0.6  # of a prior's standard deviation (5 kPa, 9 K): nearer weather is left to the fit of all recordings
_NEAR = 0.15  # of a prior's standard deviation (1.2 kPa, 2 K, 0.02 s): farther, responses are others
_SHARPEST = 0.005  # s; the middle clock, from which the others count, has no deviation of its own
_SURE = 4.0  # standard deviations that a clock of the engine's recordings is off
_STRANGE = 4.0  # standard deviations of its prior beyond which weather is another fault's (32 kPa, 60 K; a charge 40 K)


def recorded_twin(
    recording: Recording, engine: EngineParameters, map_rms: float, beliefs: CircumstanceSettings | None = None,
    between_rows: bool | None = None,
) -> LoggedTwin:  # fmt: skip
    """The twin of a recording of a healthy engine, under the circumstances that it shows.

    Inputs may have moved between its rows where clocks seem to be off or more than noise is left, and that explains
    more. Taken for straight, they were clocks, rougher maps, effects, or a misfit that refused a healthy engine.

    Args:
        recording, engine: as read, and as believed before; map_rms: size of its maps' errors [-].
        beliefs: of the circumstances, None for those of params.yaml.
        between_rows: whether inputs may have moved between the rows, where a fit before has told; None asks.

    Raises:
        InputError: no usable sensor, or no stretch with the engine running.
    """
    twin = LoggedTwin(recording, engine, map_tolerance=map_rms, beliefs=beliefs)
    if between_rows:
        twin = twin.with_inputs_between_rows() or twin
    found = _examined(twin)
    asked = between_rows is None and (_clocks_seem_off(found) or leaves_more(found))
    if asked and (quick := twin.with_inputs_between_rows()) is not None:
        other = _examined(quick)
        if likelier(found, other, lambda _: 0.0) is other:
            twin, found = quick, other
    shown = found.twin
    if not isinstance(shown, LoggedTwin):
        return twin
    values = {item.name: shown.asked.get(item.name, item.assumed) for item in open_of(shown)}
    far = {item.name for item in open_of(shown) if item.kind or abs(values[item.name] - item.assumed) > _FAR * item.std}
    return twin.under({name: value for name, value in values.items() if name in far}, shown.opened)


def _examined(twin: LoggedTwin) -> Search:
    """The fit of health alone under the circumstances that a recording of a healthy engine shows."""
    found = prepare(twin, default_search().driving)
    for _ in range(ROUNDS):
        other = under_circumstances(found, well=True)
        if other is None:
            break
        found = prepare(other, found.settings)
    return found


def _clocks_seem_off(found: Search) -> bool:
    return isinstance(found.twin, WithCircumstances) and any(kind_of(name) == TIME_SHIFT for name in found.twin.opened)


def open_of(twin: WithCircumstances) -> tuple[Circumstance, ...]:
    """What stays open of a reference: clocks that were found to be off, ambient and charge that no column gives, and
    what the compressor does in weather that isn't the mean of all recordings.

    A charge of another temperature is one product with the level of eta_vol. It has to be open even so: two pieces of a
    reference whose charges are 5 K apart would be met by a map that is off in between, and known too well.
    """
    unread = {item.column for item in twin.circumstances if not item.kind and not item.read}
    weather = (item for item in twin.circumstances if item.kind in ("", DRIFT) and item.column in unread)
    compressor = (item for item in twin.circumstances if item.kind == CORRECTED)
    return (*weather, *compressor, *(item for item in twin.circumstances if item.name in twin.opened))


@dataclass(frozen=True)
class Clock:
    """A channel's clock as a recording shows it: late by `value` with a standard deviation `std` [s]."""

    column: str
    value: float
    std: float


@dataclass(frozen=True)
class Weather:
    """Weather or charge of a recording as its readings ask for it.

    Attributes:
        column: that would give it; value: [unit]; unit: unit.
        deviations: how many standard deviations of what is believed it lies away.
    """

    column: str
    value: float
    unit: str
    deviations: float


@dataclass(frozen=True)
class Exponents:
    """The compressor's exponents as a recording shows them.

    Attributes:
        names: (K,) of what is open of them, nothing in the weather of the maps.
        values: (K,) [-]; covariance: (K, K) at given coordinates of the engine.
        by_coordinate: (K, D) what they change by with a coordinate [inverse units].
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
    by_coordinate: Array


class Conditions:
    """The open circumstances of one recording, as directions of its likelihood.

    Attributes:
        items: what is open.
    """

    def __init__(self, twin: LoggedTwin) -> None:
        self.items = open_of(twin)

    def responses(self, twin: LoggedTwin, lanes: Lanes) -> Array:
        """Responses (K, n, C) to one prior standard deviation of each, next to one lane."""
        if not self.items:
            return np.zeros((0, *twin.measured.shape))  # without a simulation
        found = twin.circumstance_responses(lanes, twin.measured, [item.name for item in self.items])
        return np.asarray(np.array([item.std for item in self.items])[:, None, None] * found)

    def applied(self, twin: LoggedTwin) -> Array:
        """(K,) how far the twin has each from what is assumed, in standard deviations of its prior."""
        return np.array([(twin.values.get(i.name, i.assumed) - i.assumed) / i.std for i in self.items])

    def moved(self, twin: LoggedTwin, estimate: Array) -> LoggedTwin | None:
        """The twin under an estimate (K,), in standard deviations from what is assumed; None where it is there."""
        far = [
            (item, item.assumed + item.std * float(at)) for item, at, now in
            zip(self.items, estimate, self.applied(twin), strict=True) if item.kind != DRIFT and abs(at - now) > _NEAR
        ]  # fmt: skip
        if not far:
            return None
        other = twin.under({**twin.values, **{item.name: value for item, value in far}}, twin.opened, like=True)
        return other if any(other.values[item.name] != twin.values.get(item.name) for item, _ in far) else None

    def strange(self, estimate: Array) -> tuple[Weather, ...]:
        """Weather and charge that lie where next to nobody drives: estimate (K,) as of `moved`."""
        return tuple(
            Weather(item.column, item.assumed + item.std * float(at), item.unit, abs(float(at)))
            for item, at in zip(self.items, estimate, strict=True) if not item.kind and abs(at) > _STRANGE
        )  # fmt: skip

    def exponents(self, metric: Metric, estimate: Array, columns: Array) -> Exponents:
        """Exponents of the compressor beside coordinates whose responses are `columns` (D, n, C); the others as of
        `clocks`."""
        at = [k for k, item in enumerate(self.items) if item.kind == CORRECTED]
        names = tuple(self.items[k].column for k in at)
        if not at:
            return Exponents(names, np.zeros(0), np.zeros((0, 0)), np.zeros((0, len(columns))))
        std = np.array([self.items[k].std for k in at])
        values = np.array([self.items[k].assumed for k in at]) + std * estimate[at]
        covariance = metric.nuisance_covariance()[np.ix_(at, at)] * np.outer(std, std)
        moved = np.stack([metric.nuisance_estimate(column)[at] for column in columns], axis=1)
        return Exponents(names, values, covariance, -std[:, None] * moved)

    def clocks(self, twin: LoggedTwin, metric: Metric, estimate: Array) -> tuple[Clock, ...]:
        """Clocks that are open, as a fit says them: `metric` with the responses, (K,) estimate as of `moved`."""
        if not any(item.kind == TIME_SHIFT for item in self.items):
            return ()
        scale = np.array([item.std for item in self.items])
        values = np.array([item.assumed for item in self.items]) + scale * estimate
        covariance = metric.nuisance_covariance() * np.outer(scale, scale)
        values, covariance = from_the_middle(twin, self.items, values, covariance)
        std = np.sqrt(np.maximum(np.diag(covariance), _SHARPEST**2))
        rows = zip(self.items, values.tolist(), std.tolist(), strict=True)
        return tuple(Clock(item.column, value, sd) for item, value, sd in rows if item.kind == TIME_SHIFT)


def exponents_together(
    found: Sequence[Exponents], covariance: Array, believed: Mapping[str, Exponent]
) -> dict[str, Exponent]:
    """Exponents of one compressor by name, as its recordings together show them; none where all are in one weather.

    Each recording has them as its own, with what was believed before; here they are the same, and that counts once.

    Args:
        found: of each recording; covariance: (D, D) of the coordinates; believed: before, by name.
    """
    names = [name for own in found for name in own.names]
    if not names:
        return {}
    known = [name for name in EXPONENTS if name in names]
    by_coordinate = np.concatenate([own.by_coordinate for own in found])
    whole = by_coordinate @ covariance @ by_coordinate.T + block_diag(*(own.covariance for own in found if own.names))
    same = np.equal.outer(names, known).astype(np.float64)
    before = np.array([believed[name].std for name in known]) ** -2.0
    again = np.diag((same.sum(axis=0) - 1.0) * before)
    precision = np.linalg.inv(whole)
    together = np.linalg.inv(same.T @ precision @ same - again)
    push = same.T @ precision @ np.concatenate([own.values for own in found])
    push -= again @ [believed[name].value for name in known]
    rows = zip(known, (together @ push).tolist(), np.sqrt(np.diag(together)).tolist(), strict=True)
    return {name: Exponent(value, std) for name, value, std in rows}


def clocks_of_all(found: Sequence[Sequence[Clock]]) -> Mapping[str, float]:
    """Column -> how late it is recorded [s], of clocks that the recordings together show to be off."""
    columns = sorted({clock.column for clocks in found for clock in clocks})
    late = {}
    for column in columns:
        own = [clock for clocks in found for clock in clocks if clock.column == column]
        weights = np.array([clock.std**-2 for clock in own])
        value = float(weights @ [clock.value for clock in own] / weights.sum())
        if abs(value) > _SURE * weights.sum() ** -0.5:
            late[column] = value
    return late


__all__ = [
    "Clock", "Conditions", "Exponents", "Weather", "clocks_of_all", "exponents_together", "open_of", "recorded_twin",
]  # fmt: skip
