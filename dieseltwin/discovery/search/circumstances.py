"""Which circumstances of a recording are plainly not as assumed: found before a name is thought of, and put right.

A channel that is late, or a fuel signal that reads wrongly, bends every fit, and some effect of the catalogue always
follows it a little. So what circumstances explain is weighed against the best single effect: by the marginal
likelihood, each with its prior. Where an effect explains as much, the effect stays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np

from dieseltwin.discovery.laws.features import generic_features, score_features
from dieseltwin.discovery.likelihood.circumstances import (
    WithCircumstances,
    away_from_assumed,
    from_the_middle,
    label_of,
    nuisance_covariance,
    open_circumstances,
)
from dieseltwin.discovery.likelihood.fit import PROMISED, Fit, Linearisation
from dieseltwin.discovery.likelihood.learned import belief_of
from dieseltwin.discovery.likelihood.score import score, without_parameters
from dieseltwin.discovery.search.preparation import score_the_rest
from dieseltwin.discovery.search.settled import Settled, by_leaving_out, by_taking_in, evidence_of, settle
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.search.variants import scan
from dieseltwin.discovery.twins.interface import Array, OverRecordings, Twin
from dieseltwin.recordings.channels import AMBIENT
from dieseltwin.recordings.circumstances import CORRECTED, DRIFT, SCALE, TIME_SHIFT, Circumstance

ROUNDS = 3  # of looking again under what was found

_MOVED = 0.6  # standard deviations of its prior, up to which a circumstance is taken linearly
_MOVED_UNREAD = 0.15  # the same of ambient or charge without a column: 3.6 kPa and 10 K away health was off by 6 std
_BESIDE = 2.0  # times as far beside an effect
_LINEAR = 0.7  # of a gain that shifts reach by simulation, at least, is seen in their responses
_FARTHEST = 3.0  # standard deviations of its prior that a sensor's clock is looked for by whole rows
_BENT = 60.0  # gain that circumstances may have by how the machine bends, whatever they explain linearly
_ALIKE = 3.0  # times the gain of an alarm for an effect that acts nearly as the clock of an input
_CATALOGUE = 2  # effects at once that the catalogue explains by itself


def under_circumstances(found: Search, *, well: bool = False) -> Twin | None:
    """The twin under circumstances that a prepared search shows to be others than its twin has; None where none are.

    Args:
        found: as `prepare` made it; with single effects, where any are to be thought of.
        well: the engine is known to be well: what an effect of the catalogue would do as well is no effect, and weather
            that columns give stays.
    """
    twin = found.twin
    if not isinstance(twin, WithCircumstances) or not twin.circumstances:
        return None
    rest = [item for item in twin.circumstances if not item.unknown and item.name not in twin.opened]
    off = _plainly_off(found, twin, rest, well) if rest else None
    if off is None and not well:
        off = _misread(found, twin)
    return off if off is not None or (well and weather_is_read(twin)) else _moved(found, twin)


def weather_is_read(twin: WithCircumstances) -> bool:
    """Whether columns give the ambient of all that the twin was recorded under."""
    return all(item.read for item in twin.circumstances if item.plain in AMBIENT)


def same_circumstances(one: Twin, other: Twin) -> bool:
    """Whether two twins of one recording are under the same circumstances."""
    if not (isinstance(one, WithCircumstances) and isinstance(other, WithCircumstances)):
        return False
    return dict(one.values) == dict(other.values) and one.opened == other.opened


def leading(found: Search) -> Linearisation:
    """The best single effect where it raises an alarm, else health alone; in the common metric."""
    if not found.singles or found.gain(found.singles[0]) < found.settings.alarm_gain:
        return found.null
    return Linearisation(found.twin, found.whitening, found.singles[0], found.null)


def _moved(found: Search, twin: WithCircumstances) -> Twin | None:
    """The twin about the estimates of what is open, where these are far from where it is.

    From there on they are believed to be there. Beside a learned engine what a column gives stays where it is: it is
    linear as far as its sensor may be off, and a first explanation that lacks a second one would bend it (a clogged
    air filter beside another fault was met by an ambient 17 K from its reading).
    """
    lead = leading(found)
    held = belief_of(found.twin) is not None
    items = [item for item in movable(twin) if not (held and item.read)]
    shares = shares_of(found, found.null, items)
    moves = np.any(np.abs(shares) >= [bar_of(item) for item in items])
    tried = moves and _may_say_it_all(found, lead, items, shares)
    alone = settle(found, twin, found.null.fit, items, {}) if tried else None
    if alone and (lead is found.null or alone.evidence < evidence_of(lead) + _needed_beside(found, lead, items)):
        values = alone.values  # beside an effect: they may be all that it says
    elif lead is found.null:
        return None
    else:
        beside = shares_of(found, lead, items)
        if not np.any(np.abs(beside) >= [_bar_beside(item) for item in items]):
            return None
        values = {
            item.name: twin.values.get(item.name, item.assumed) + item.std * float(share)
            for item, share in zip(items, beside, strict=True)
        }
    other = cast(WithCircumstances, twin.under({**twin.values, **values}, twin.opened))
    far = any(abs(other.values[i.name] - twin.values.get(i.name, i.assumed)) > bar_of(i) * i.std for i in items)
    return cast(Twin, other) if far else None  # sensors' clocks go by whole rows


def _needed_beside(found: Search, lead: Linearisation, items: Sequence[Circumstance]) -> float:
    """By how much circumstances must explain more beside the best single effect than without it, for it to stay."""
    alike = {name for item in items if item.drives for name in item.effects}
    return found.settings.alarm_gain * (_ALIKE if alike & set(lead.fit.candidate.names) else 1.0)


def _may_say_it_all(found: Search, lead: Linearisation, items: Sequence[Circumstance], shares: Array) -> bool:
    """Whether open circumstances, simulated where the health-only fit has them (`shares`), could explain what the best
    single effect does. That fit has them linearly: simulated they explained up to as much again, and 18 where 4 was."""
    if lead is found.null:
        return True
    at = _places(found, items)
    covariance = found.null.metric.nuisance_covariance()[np.ix_(at, at)]
    linear = float(shares @ np.linalg.solve(covariance, shares))
    return found.gain(lead.fit) - found.settings.alarm_gain < max(_BENT, PROMISED * linear)


def bar_of(item: Circumstance) -> float:
    """How far from where the twin has it a circumstance is linear enough, in standard deviations of its prior.

    An input has its kinks at its rows: fuel 0.07 s off was a fuel lag of 0.09 s.
    """
    return _MOVED_UNREAD if item.kind == CORRECTED or not (item.kind or item.read) or item.drives else _MOVED


def _bar_beside(item: Circumstance) -> float:
    """The same beside an effect.

    A wrong effect bends the circumstances, and the charge most readily: in the place of a leak that was withheld one
    moved it by 3 K, and the leak's law left more than half of the misfit.
    """
    close = item.kind == CORRECTED or (item.plain in AMBIENT and not item.read) or item.drives
    return _BESIDE * (_MOVED_UNREAD if close else _MOVED)


def movable(twin: WithCircumstances) -> list[Circumstance]:
    """What is open and can be simulated elsewhere than where the twin has it."""
    return [item for item in open_circumstances(cast(Twin, twin)) if item.kind not in (DRIFT, SCALE)]


def shares_of(found: Search, at: Linearisation, items: Sequence[Circumstance]) -> Array:
    """Estimates of open circumstances under a fit, from where the twin has them, in standard deviations of priors."""
    places = _places(found, items)
    share = found.null.metric.nuisance_estimate(np.nan_to_num(at.residual))[places]
    away = away_from_assumed(cast(WithCircumstances, found.twin), items)
    if not away.any():
        return share
    return np.asarray(share - nuisance_covariance(at)[np.ix_(places, places)] @ away)


def _places(found: Search, items: Sequence[Circumstance]) -> list[int]:
    """Of open circumstances among a search's nuisances."""
    labels = [nuisance.label for nuisance in found.nuisances]
    return [labels.index(label_of(item)) for item in items]


def _linear_gain(at: Linearisation, twin: WithCircumstances, items: Sequence[Circumstance]) -> float:
    """What circumstances would explain beyond a fit, by their responses there."""
    responses = twin.circumstance_responses(at.fit.lanes(), at.simulated, [item.name for item in items])
    responses *= np.array([item.std for item in items])[:, None, None]
    vectors = without_parameters(at, at.metric.project(responses))
    push = vectors @ at.pulled_residual
    return float(push @ np.linalg.solve(vectors @ vectors.T + np.eye(len(items)), push))


def _rival(found: Search, at: Linearisation, enough: float) -> float:
    """What the catalogue, or a term without a name, would add to the best single effect; looked for up to `enough`."""
    if at is found.null:
        return 0.0
    gain = _second(found, at)
    if found.in_short and gain < max(enough, found.settings.alarm_gain):
        score_the_rest(found)
        gain = _second(found, at)
    if gain < enough:
        timed = scan(found.null, found.scored, 1, found.settings.least_share)
        gain = max(gain, *(item.gain - found.gain(at.fit) for item in timed), 0.0)
    if gain < enough:
        # a slow sensor is late as well: its lag is looked for where the clock that was found is tried without
        terms = [feature for feature in generic_features(found.twin, at.fit) if feature.fault != "lag"]
        gain = max(gain, *(item.held for item in score_features(at, terms)), 0.0)
    return gain


def _second(found: Search, at: Linearisation) -> float:
    """What the best of the scored effects would add to a fit."""
    known = set(at.fit.candidate.names)
    others = [item for item in found.scored if item.name not in known]
    second = score(at, [(i.name, i.size) for i in others], np.stack([i.response for i in others])) if others else []
    return max((item.gain for item in second), default=0.0)


def _ahead_of_rivals(found: Search, twin: WithCircumstances, at: Linearisation, enough: float) -> float:
    """Evidence that other circumstances have to have beside the best single effect: what another effect or a term would
    add to it, and a lead; looked for up to `enough`."""
    beliefs = twin.beliefs
    rival = _rival(found, at, enough)
    return max(beliefs.evidence, rival + beliefs.ahead if rival > found.settings.alarm_gain else 0.0)


def _plainly_off(
    found: Search, twin: WithCircumstances, rest: Sequence[Circumstance], well: bool
) -> Twin | None:
    """The twin under the circumstances that add more to the best single effect than any other; None where none do."""
    lead = leading(found)
    by_rows = _clocks_by_rows(lead, twin, rest)
    linear = _linear_gain(lead, twin, rest)
    if linear < twin.beliefs.evidence and not by_rows:
        return None
    reached = np.inf if by_rows else linear / _LINEAR
    needed = _ahead_of_rivals(found, twin, lead, reached)
    if reached < needed:
        return None
    best = _chosen(found, twin, lead.fit, rest, by_rows)
    if best is None or evidence_of(lead) - best[0].evidence < needed:
        return None
    settled, chosen = best
    if lead is not found.null:  # the effect itself may be nothing but these circumstances
        alone = _chosen(found, twin, found.null.fit, rest, _clocks_by_rows(found.null, twin, rest))
        if alone is not None and alone[0].evidence < settled.evidence + _needed_beside(found, lead, chosen):
            settled, chosen = alone
    if not well and _said_by_catalogue(chosen, settled.values):
        return None
    opened = twin.opened | {item.name for item in chosen}
    other = twin.under({**twin.values, **settled.values}, opened)
    delay = _delay(settled, chosen, other)
    if delay is None:
        return other
    near = {**settled.values, delay.name: settled.values[delay.name] - float(settled.at.fit.magnitudes[0])}
    settled = settle(found, twin, found.null.fit, [*movable(twin), *chosen], near)
    return twin.under({**twin.values, **settled.values}, opened)


def _misread(found: Search, twin: WithCircumstances) -> Twin | None:
    """The twin with columns of the weather believed no more than none, where that adds more to the best single effect
    than any other does; None where every column is near to what the recording shows.

    A placeholder (101.3 kPa at 1500 m) that is believed as a barometer holds what is found away from the truth.
    """
    lead = leading(found)
    read = [item for item in movable(twin) if item.read and item.plain in AMBIENT]
    far = [
        item.name for item, share in zip(read, shares_of(found, lead, read), strict=True)
        if abs(share) * item.std > item.notable
    ]  # fmt: skip
    if not far:
        return None
    opened = twin.opened | frozenset(far)
    other = cast(WithCircumstances, twin.under(twin.values, opened, like=True))
    settled = settle(found, other, lead.fit, movable(other), {})
    gain = evidence_of(lead) - settled.evidence
    if gain < _ahead_of_rivals(found, twin, lead, gain):
        return None
    return twin.under({**twin.values, **settled.values}, opened)


def _delay(settled: Settled, chosen: Sequence[Circumstance], other: Twin) -> Circumstance | None:
    """The clock beside which a fit has a delay of the same command, which `other` leaves to that clock; None for none.

    What the delay held would be missing there: a valve whose clock was 0.19 s early was given one 0.14 s late beside a
    dead time of 0.37 s, and without that a play of 2 % that it hadn't.
    """
    gone = set(settled.at.fit.candidate.names) - set(other.hypotheses)
    return next((item for item in chosen if gone & set(item.effects)), None)


def _clocks_by_rows(at: Linearisation, twin: WithCircumstances, rest: Sequence[Circumstance]) -> dict[str, float]:
    """Name -> value [s] of sensors' clocks with which readings moved by whole rows meet a fit better than as recorded.

    Readings are put right by whole rows, and beside an effect a clock's response may not promise half of one: a flow
    0.25 s late was fitted as 0.04 s, where from a row on it explains 700 more.
    """
    parts = at.twin.parts if isinstance(at.twin, OverRecordings) else (at.twin,)
    ends = np.cumsum([part.time_s.size for part in parts])
    measured, channels = at.residual + at.simulated, at.twin.channels
    clocks = [item for item in rest if item.kind == TIME_SHIFT and item.column in channels]
    row_s = {item.name: float(np.median(np.diff(parts[item.recording or 0].time_s))) for item in clocks}
    most = {item.name: int(_FARTHEST * item.std / row_s[item.name]) for item in clocks}
    gains: dict[str, dict[int, float]] = {item.name: {} for item in clocks}
    farthest = max(most.values(), default=0)
    unmoved = _squares(at, measured)
    for rows in range(-farthest, farthest + 1):
        moved = np.roll(measured, -rows, axis=0)
        gain = np.where(np.isfinite(moved) & np.isfinite(measured), unmoved - _squares(at, moved), 0.0)
        for item in clocks:
            if abs(rows) > most[item.name]:
                continue
            part, end = parts[item.recording or 0], int(ends[item.recording or 0])
            inside = slice(end - part.time_s.size + most[item.name], end - most[item.name])
            gains[item.name][rows] = float(gain[inside, channels.index(item.column)].sum())
    starts = {}
    for item in clocks:
        own = gains[item.name]
        best = max(own, key=lambda rows: own[rows])
        if own[best] > twin.beliefs.evidence:
            starts[item.name] = twin.values.get(item.name, item.assumed) + best * row_s[item.name]
    return starts


def _squares(at: Linearisation, measured: Array) -> Array:
    """Whitened misfit (n, C) of readings at a fit, squared; what isn't there has none."""
    return at.whitening.apply(np.nan_to_num(measured - at.simulated)).reshape(measured.shape) ** 2


def _chosen(
    found: Search, twin: WithCircumstances, start: Fit, rest: Sequence[Circumstance], near: Mapping[str, float]
) -> tuple[Settled, list[Circumstance]] | None:
    """Fit with those circumstances that the marginal likelihood wants, from near some; None where it wants none.

    Where it wants several clocks, none of the others is trusted to be in time either.
    """
    unknown = movable(twin)
    everything = settle(found, twin, start, [*unknown, *rest], near)
    chosen = by_leaving_out(everything, rest)
    if not chosen:
        return None
    if len(chosen) >= twin.beliefs.several:
        few = _few_clocks(found, twin, everything, unknown, rest, near)
        return (everything, list(rest)) if few is None else few
    near = {name: everything.values[name] for name in (*(item.name for item in unknown), *near)}
    return settle(found, twin, everything.at.fit, [*unknown, *chosen], near), chosen


def _few_clocks(
    found: Search, twin: WithCircumstances, everything: Settled, unknown: Sequence[Circumstance],
    rest: Sequence[Circumstance], near: Mapping[str, float],
) -> tuple[Settled, list[Circumstance]] | None:  # fmt: skip
    """The few clocks that explain as much as all of them do; None where there are none.

    All clocks off by the same shows nowhere, so that the others share what one of them is off by, and none can be left
    out alone: where a dead time of 0.43 s had no name, nine clocks were off.
    """
    few = by_taking_in(everything, rest)
    if not few or len(few) >= twin.beliefs.several:
        return None
    items = [*unknown, *rest]
    values = np.array([everything.values[item.name] for item in items])
    values, _ = from_the_middle(twin, items, values, np.eye(len(items)))
    counted = dict(zip((item.name for item in items), values, strict=True))
    settled = settle(found, twin, everything.at.fit, [*unknown, *few], {**near, **counted})
    return (settled, few) if settled.evidence < everything.evidence else None


def _said_by_catalogue(chosen: Sequence[Circumstance], values: Mapping[str, float]) -> bool:
    """Whether one or two effects do the same, so that it is theirs to be told."""
    late = any(item.column.startswith("u_") and values[item.name] > item.assumed for item in chosen)
    return len(chosen) <= _CATALOGUE and all(item.effects for item in chosen) and not late  # no dead time is negative
