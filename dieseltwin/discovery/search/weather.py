"""The twin in another weather, or with a clock in time: what a name, or a law, that was found asks for."""

from __future__ import annotations

from typing import cast

import numpy as np

from dieseltwin.discovery.likelihood.circumstances import WithCircumstances, away_from_assumed
from dieseltwin.discovery.likelihood.fit import Fit, Linearisation
from dieseltwin.discovery.search.circumstances import bar_of, movable, shares_of, weather_is_read
from dieseltwin.discovery.search.settled import settle
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.interface import OverRecordings, Twin
from dieseltwin.recordings.circumstances import TIME_SHIFT, Circumstance

_UNSETTLED = 0.03  # of a prior's standard deviation (0.2 kPa, 0.5 K): beside a name weather is followed up to here
_CHARGE_UNSETTLED = 0.15  # where columns give the ambient: 1.5 K, half a per cent of the flow into the cylinders


def in_weather_of(found: Search, fit: Fit) -> Twin | None:
    """The twin in the weather, simulated, that an explanation asks for; None where it is there, or columns say it.

    Names and terms without one are compared where weather acts linearly, about what the health-only fit made of it.
    From 1 kPa away a leak of the exhaust was 4 mm2 short, and left more than a term without a name did.
    """
    twin = found.twin
    if not isinstance(twin, WithCircumstances):
        return None
    items = _guessed(twin)  # a barometer stays where it is
    if not items:
        return None
    values = settle(found, twin, fit, items, {}).values
    other = twin.under({**twin.values, **values}, twin.opened)
    here = [twin.values.get(item.name, item.assumed) for item in items]
    bar = _CHARGE_UNSETTLED if weather_is_read(twin) else _UNSETTLED
    far = any(abs(values[i.name] - at) > bar * i.std for i, at in zip(items, here, strict=True))
    return other if far else None


def in_assumed_weather(found: Search) -> Twin | None:
    """The twin in the weather as assumed, where no column gives it and the twin is elsewhere; None where it is there.

    The fit without any effect follows with the weather what an effect does. From there a loss of the charge cooler's
    was a sum of two wrong terms, 8 K of its charge among them.
    """
    twin = found.twin
    if not isinstance(twin, WithCircumstances):
        return None
    guessed = {item.name for item in _guessed(twin)} & set(twin.values)
    if not guessed:
        return None
    return twin.under({name: value for name, value in twin.values.items() if name not in guessed}, twin.opened)


def with_reading_in_time(found: Search) -> Twin | None:
    """The twin in which a reading that lags by the law found isn't late as well; None where its clock isn't open.

    A slow sensor is late, too, and a late clock is found before a law is thought of: 1.83 s of a thermocouple's lag
    were 0.69 s late and a lag of 1.1 s.
    """
    twin = found.twin
    if found.law is None or not isinstance(twin, WithCircumstances):
        return None
    lagging = {fault.channel for fault in found.law.faults if fault.kind == "lag"}
    late = {i.name for i in twin.circumstances if i.kind == TIME_SHIFT and i.column in lagging} & twin.opened
    if not late:
        return None
    return twin.under({name: value for name, value in twin.values.items() if name not in late}, twin.opened - late)


def is_guessed(twin: Twin) -> bool:
    """Whether columns don't give the whole ambient of a twin of one recording."""
    single = isinstance(twin, WithCircumstances) and not isinstance(twin, OverRecordings)
    return single and not weather_is_read(cast(WithCircumstances, twin))


def cost_of_weather(twin: Twin) -> float:
    """-2 log density of the weather that a twin is in, over that of what was assumed, or read."""
    if not isinstance(twin, WithCircumstances):
        return 0.0
    weather = [item for item in movable(twin) if not item.kind]
    return float(np.sum(np.square(away_from_assumed(twin, weather))))


def weather_is_settled(found: Search) -> bool:
    """Whether a law that was found leaves the weather that no column gives where the twin has it, near enough."""
    twin = found.twin
    if found.law is None or not isinstance(twin, WithCircumstances):
        return found.law is not None
    with_law, fit = found.law.on(cast(Twin, twin))
    items = _guessed(twin)
    shares = shares_of(found, Linearisation(with_law, found.whitening, fit, found.null), items)
    return bool(np.all(np.abs(shares) < [bar_of(item) for item in items]))


def _guessed(twin: WithCircumstances) -> list[Circumstance]:
    """Weather that no column gives."""
    return [item for item in movable(twin) if not item.kind and not item.read]
