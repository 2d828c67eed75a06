"""Discovery on a recording of the diesel engine: from the file to the document, the repaired engine and the curves."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np

from dieseltwin.discovery.likelihood.circumstances import Estimate, estimates
from dieseltwin.discovery.options import Options
from dieseltwin.discovery.search import preparation, standing
from dieseltwin.discovery.search import run as search
from dieseltwin.discovery.search.circumstances import leading
from dieseltwin.discovery.search.quick_inputs import share_left
from dieseltwin.discovery.search.singles import looked_at
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.diesel_circumstances import LoggedTwin
from dieseltwin.discovery.twins.several import Occasion, SeveralTwin
from dieseltwin.discovery.verdict.another_engine import of_another_engine
from dieseltwin.discovery.verdict.assemble import assemble
from dieseltwin.discovery.verdict.checks import misfit_of
from dieseltwin.discovery.verdict.curves import Discovery
from dieseltwin.discovery.verdict.document import LEFT_OVER, Reference, fit_doubts, with_warnings
from dieseltwin.discovery.verdict.findings import minimum_detectable
from dieseltwin.discovery.verdict.left_out import left_out_notes
from dieseltwin.discovery.verdict.over_recordings import unseen_bias
from dieseltwin.discovery.verdict.unseen import HealthBias
from dieseltwin.engine import EngineParameters
from dieseltwin.learning.ambient import reference_std
from dieseltwin.learning.domain import known_along
from dieseltwin.learning.files import LearnedEngine
from dieseltwin.learning.levels import relative_health_std
from dieseltwin.notes import Note, listing, of_reading
from dieseltwin.recordings.circumstances import DRIFT, TIME_SHIFT, put_right
from dieseltwin.recordings.dates import ORDER, Dated
from dieseltwin.recordings.liveliest import liveliest
from dieseltwin.recordings.reader import Recording

_ROUGH_MAPS = 0.01  # size of the maps' errors from which a finding without a reference carries a note [-]
LOUD = 1.3
"""Root mean square of a channel's residual beyond tolerances, over its noise, that is worth a warning: what is right
leaves 0.9 to 1.05 (four engines of the benchmark's plant, on which it was up to 2.6 with them)."""


@dataclass(frozen=True)
class Prepared:
    """Recordings with health alone fitted: what they could show is known, no name has been thought of.

    Attributes:
        found: the search as it begins; `discover` goes on with a copy.
        otherwise: the same without the valve that stands still, where there is one; None: there is none.
    """

    found: Search
    otherwise: Search | None = None

    @property
    def minimum_detectable(self) -> Mapping[str, float]:
        """Effect -> smallest magnitude that would raise an alarm [unit of the effect]."""
        return minimum_detectable(self.found)

    @property
    def health_bias(self) -> HealthBias:
        """What an effect of that size, unseen, would move health by: effect -> health parameter -> relative change."""
        return unseen_bias(self.found)


def prepare(
    recordings: Recording | Sequence[Dated], engine: EngineParameters, options: Options | None = None,
    learned: LearnedEngine | None = None,
) -> Prepared:  # fmt: skip
    """Health alone fitted, and with it the smallest visible size of each effect on this driving.

    Raises:
        InputError: as `discover`.
    """
    options = options or Options()
    days, settings = _dated(recordings), options.settings()
    found = preparation.prepare(_twin_over(days, engine, options, learned), settings)
    if standing.worth_trying(found):
        valve = standing.standing_valve(_twin_over(days, engine, options, learned), settings)
        if valve is not None:
            return Prepared(
                standing.prepared_beside(_twin_over(days, engine, options, learned), settings, valve), found
            )
    return Prepared(found)


def discover(
    recordings: Recording | Sequence[Dated], engine: EngineParameters, options: Options | None = None,
    learned: LearnedEngine | None = None, prepared: Prepared | None = None, time_s: float | None = None,
    shown: Callable[[Discovery], None] | None = None,
) -> Discovery:  # fmt: skip
    """Detect, locate, name, model, prove.

    Of several recordings of one engine: one verdict, with the health of each. Maps and sensors are the same in all of
    them. What was left out may be of one size in all, begin between two, grow, or come with cold weather.

    Args:
        recordings: one, or several in time order.
        engine: what the twin believes; its terms are part of it.
        options: None for the defaults.
        learned: what is known of the engine from recordings of when it was well; `engine` is then its own.
        prepared: of the same recordings, engine and options, where that was asked before.
        time_s: of the search, after which the best answer so far is given; None: no limit.
        shown: is given the result when its curves are final; what health, sizes and circumstances are under maps off in
            all detail takes a third of the time from there on.

    Raises:
        InputError: no usable sensor, no stretch with the engine running, or recordings without a common set of sensors.
    """
    options = options or Options()
    days = _dated(recordings)
    prepared = prepared or prepare(days, engine, options, learned)
    clock = time.perf_counter() - prepared.found.seconds["prepare"]
    found = _found(prepared, options, time_s)
    others = time.perf_counter() - clock - sum(found.seconds.values())
    then = None if learned is None else relative_health_std(learned)
    result = assemble(days, found, options, _reference(found, learned), time_s, then, shown)
    if learned is not None:
        result = _beside_reference(result, reference_std(learned, options.circumstances))
    runtime = {**found.seconds, "other_searches": max(others, 0.0), "total": time.perf_counter() - clock}
    doubts = [] if learned is not None else _of_rough_maps(options.map_tolerance, result)
    doubts += of_another_engine(found, days) if result.document.mismatch else []
    return replace(_with_doubts(result, found, engine, [day.recording for day in days], doubts), runtime=runtime)


def _beside_reference(result: Discovery, stds: Mapping[str, float]) -> Discovery:
    """The result with weather and charge known no better than those of the reference, by column [unit]: they are told
    by an engine that was learned under these. What is plainly off stays so."""
    told = tuple(
        item.model_copy(update={"std": float(np.hypot(item.std, stds.get(item.name, 0.0)))})
        for item in result.document.circumstances
    )
    return replace(result, document=result.document.model_copy(update={"circumstances": told}))


def _found(prepared: Prepared, options: Options, time_s: float | None) -> Search:
    """The search, and the one without a valve that stands still where that leaves far too much: whichever leaves less.

    A valve takes nearly all of any large misfit: a leak of 50 mm2 that came and went was vanes that stood still.
    """
    began = time.perf_counter()
    found = search.carry_on(prepared.found.anew(), laws=options.law_search, time_s=time_s)
    if prepared.otherwise is None or share_left(found) <= LEFT_OVER:
        return found
    left = None if time_s is None else time_s - (time.perf_counter() - began)
    other = search.carry_on(prepared.otherwise.anew(), laws=options.law_search, time_s=left)
    return min(found, other, key=share_left)


def _of_rough_maps(map_tolerance: float, result: Discovery) -> list[Note]:
    """That a finding beside maps that are off by so much may be what they do, where their errors aren't known."""
    if map_tolerance < _ROUGH_MAPS or not result.document.mismatch:
        return []
    return [Note(f"maps may be off by {100.0 * map_tolerance:.2g} %, and nothing is known of how: of eleven healthy "
                 "engines whose maps are 2 % off three had an alarm; let `dieseltwin learn` learn the engine from "
                 "driving when it was well", "rough_maps")]  # fmt: skip


def loud_channels(result: Discovery) -> list[Note]:
    """A note on channels in which more is left than noise and what the tolerances of maps and sensors explain."""
    curves = result.curves
    left = curves.measured - curves.after - (0.0 if curves.allowed is None else curves.allowed)
    ratios = np.sqrt(np.nanmean(left**2, axis=0)) / curves.sigma
    loud = {name: ratio for name, ratio in zip(curves.channels, ratios, strict=True) if ratio > LOUD}
    if not loud:
        return []
    parts = listing([f"{name} ({ratio:.1f} times its noise)" for name, ratio in loud.items()])
    imitated = any(effect.named for effect in result.document.effects)
    return [Note(f"more than noise is left in {parts}, with maps and sensors as far off as they most likely are"
                 + (": what is named may imitate something else" if imitated else ""), "residuals", tuple(loud))]


def _with_doubts(
    result: Discovery, found: Search, engine: EngineParameters, recordings: Sequence[Recording], more: Sequence[Note]
) -> Discovery:
    """What was done to the recordings on reading, and what is doubtful about the fit and `more`, in the document."""
    several = len(recordings) > 1
    read = (
        of_reading(note, f"{recording.path or 'recording'}: " if several else "")
        for recording in recordings
        for note in recording.notes
    )
    left_out = result.document.left_out
    doubts = [*more, *read, *fit_doubts(result.document), *loud_channels(result), *left_out_notes(left_out)]
    if found.unsettled and result.document.mismatch:
        leads = " and ".join(" + ".join(names) for names in dict.fromkeys(found.unsettled))
        doubts.append(Note(f"more than one explanation: {leads} lead in turns, each with the likelihood about the "
                           "other, so that neither name is given alone", "not_converged"))  # fmt: skip
    problem = misfit_of(engine, result.engine, result.document.fit.chi2_left)
    if problem is not None:
        doubts.append(Note(f"{problem[0]} ({problem[1]} is allowed): no twin of what was recorded", "misfit"))
    return replace(result, document=with_warnings(result.document, doubts))


def as_it_was(
    recording: Recording, engine: EngineParameters, options: Options | None = None, minutes_max: float | None = None,
    learned: LearnedEngine | None = None,
) -> tuple[Recording, EngineParameters, tuple[Estimate, ...]]:  # fmt: skip
    """The recording with its clocks and its ambient put right, the engine with its charge temperature, and what was
    put right; without a verdict.

    Where an effect of the catalogue stands out, the circumstances are what they are beside it: alone they would bend to
    imitate it. Beside a learned engine a barometer that reads 0.3 kPa too much is more than its maps can take.

    Args:
        recording, engine, options, learned: as of `discover`.
        minutes_max: of a longer recording the liveliest stretches tell; None: all of it.

    Raises:
        InputError: no usable sensor, or no stretch with the engine running.
    """
    options = options or Options()
    twin = _twin(recording if minutes_max is None else liveliest(recording, minutes_max), engine, options,
                 learned)  # fmt: skip
    found = looked_at(preparation.prepare(twin, options.settings()))
    moved = found.twin.values if isinstance(found.twin, LoggedTwin) else {}
    shown = tuple(item for item in estimates(leading(found)) if item.circumstance.kind != DRIFT
                  and (item.off if learned is None else item.surely_off))  # fmt: skip
    beside = {item.circumstance.name: item.value for item in shown if item.circumstance.kind != TIME_SHIFT}
    applied = {**moved, **beside}  # clocks of sensors go by whole rows, as the twin took them
    return (*put_right(recording, engine, applied), tuple(item for item in shown if item.circumstance.name in applied))


def _dated(recordings: Recording | Sequence[Dated]) -> Sequence[Dated]:
    """Several recordings as they are; the date of a single one counts for nothing."""
    if isinstance(recordings, Recording):
        return [Dated(recordings, datetime.fromtimestamp(0.0, UTC), ORDER)]
    return recordings


def _twin_over(
    days: Sequence[Dated], engine: EngineParameters, options: Options, learned: LearnedEngine | None
) -> LoggedTwin | SeveralTwin:
    """The twin over one recording or over several, in time order."""
    parts = [_twin(day.recording, engine, options, learned) for day in days]
    if len(parts) == 1:
        return parts[0]
    since = [(day.date - days[0].date).total_seconds() / 86400.0 for day in days]
    return SeveralTwin(parts, [Occasion(at, day.recording.t_amb_k) for at, day in zip(since, days, strict=True)])


def _twin(
    recording: Recording, engine: EngineParameters, options: Options, learned: LearnedEngine | None
) -> LoggedTwin:
    belief = None if learned is None else learned.belief
    beliefs = options.circumstances if learned is None else learned.beliefs(options.circumstances)
    clocks = {} if learned is None else {f"{TIME_SHIFT}:{column}": late for column, late in learned.clocks.items()}
    return LoggedTwin(recording, engine, options.sensors, map_tolerance=options.map_tolerance, belief=belief,
                      beliefs=beliefs, values=clocks, opened=frozenset(clocks))  # fmt: skip


def _reference(found: Search, learned: LearnedEngine | None) -> Reference | None:
    """What the engine was learned from, and how much of the recording lies where all its maps are known."""
    if learned is None:
        return None
    known = known_along(learned.belief, learned.errors, found.twin.variables(found.null.fit.lanes()))
    return Reference(
        recordings=len(learned.recordings), minutes=learned.minutes, points=learned.points,
        domain_share=float(known.all(axis=0).mean()),
    )


__all__ = ["Options", "Prepared", "as_it_was", "discover", "prepare"]
