"""Does the twin fit a recording at all? The detection step of discovery alone, in seconds: is anything beyond noise and
tolerances, and what does it look like. No name is proved here, that is `discover`'s work. What the fit behind it says
of health, with tolerances of maps and sensors in its intervals, comes along."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from scipy.special import chdtri  # of scipy.stats, whose import takes half a second, only this is wanted

from dieseltwin.discovery.discover import as_it_was
from dieseltwin.discovery.likelihood.circumstances import Estimate
from dieseltwin.discovery.likelihood.fit import within_limits
from dieseltwin.discovery.likelihood.score import as_fits
from dieseltwin.discovery.options import Options
from dieseltwin.discovery.recording_faults import Suspicion, recording_faults, suspicions
from dieseltwin.discovery.search.preparation import prepare
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.diesel import EngineTwin
from dieseltwin.discovery.twins.diesel_circumstances import beside_its_compressor
from dieseltwin.discovery.twins.interface import Array
from dieseltwin.discovery.verdict.explained import disagreement
from dieseltwin.discovery.verdict.health_value import SinceReference
from dieseltwin.discovery.verdict.over_recordings import health_values
from dieseltwin.discovery.verdict.since_reference import no_better_than_then, since_reference
from dieseltwin.engine import HEALTH, EngineParameters
from dieseltwin.errors import InputError
from dieseltwin.learning.files import LearnedEngine
from dieseltwin.learning.levels import relative_health_std
from dieseltwin.notes import OF_THE_FIT, Note
from dieseltwin.recordings.between_rows import rows_are_slow, rows_may_be_slow
from dieseltwin.recordings.columns import Columns
from dieseltwin.recordings.reader import Recording
from dieseltwin.sensors import MEASURED, SENSORS
from dieseltwin.settings.defaults import default_search

LONGEST_PART_S = 600.0
"""A longer recording is tested in parts of at most this length [s], so that memory stays bounded."""

SHORTEST_S = 60.0
"""Less running time can't be tested: six windows, each of which spends an unknown state [s]."""

FEWEST_SENSORS = 3
BEST_SENSOR = 0.002
"""Noise of the best sensor, as a share of its channel's level [-], and never below its `floor`. It is added to every
channel: nothing else would hide the errors of integration steps and of windows' starts in a simulation without noise,
whose quick moves can't be told from noise. What an instrument really has is several times as much."""

ALARM_GAIN = 16.0
"""Gain of a fault or an effect from which the twin doesn't fit. The largest of 24 clean recordings was 6.6."""

QUICK_GAIN = 1000.0
"""Gain that inputs between rows can't reach: healthy engines under a quick pedal had up to 524 at 5 and 10 Hz."""

SURE_GAIN = 60.0  # above, a finding may hang on one window: a sensor that fails for ten seconds has failed
LEAST_SPREAD = 0.5  # share of its gain that a finding below that keeps without its best window
LEAST_SIZE = 0.8  # of its size of interest
CHI2_SLACK = 0.25  # noise is known to some per cent alone
CHI2_SIGMA = 6.0  # standard deviations of a chi-square beyond that
SLOW_ROWS = 10  # readings whose mean tells slow structure from white noise
SLOW_SLACK = 0.3
AT_LIMIT = 1e-3  # of a health parameter, its distance from the limit of the search below which it stands there
WINDOW_LEVEL = 1e-9  # probability of a window's chi-square by chance
WINDOW_LEAST = 4.0  # chi-square a reading of a window that counts: next to an instability 3.6 was met without a fault


@dataclass(frozen=True)
class Suspect:
    """What a misfit looks like: in words, its gain, and the columns that it is about."""

    words: str
    gain: float
    affects: tuple[str, ...]


@dataclass(frozen=True)
class Excess:
    """What a channel leaves beyond its noise.

    Attributes:
        channel: column.
        times: root of chi-square per reading of the whole, of the worst window, or of slow structure [-].
        since_s, until_s: the worst window, or the whole part [s].
    """

    channel: str
    times: float
    since_s: float
    until_s: float


@dataclass(frozen=True)
class Tolerant:
    """A health parameter fitted beside tolerances of maps and sensors, and its standard deviation [its unit].

    Attributes:
        since_reference: over what it was when the engine was learned; None without that.
    """

    value: float
    std: float
    since_reference: SinceReference | None = None


@dataclass(frozen=True)
class Examined:
    """What the test says of a recording.

    Attributes:
        notes: that, where and how the twin doesn't fit; none where it does.
        health: of the same fit; empty where nothing could be tested, where the twin doesn't fit, and where it is too
            far from the engine file for the search.
    """

    notes: tuple[Note, ...]
    health: Mapping[str, Tolerant]


def examine(
    recording: Recording, engine: EngineParameters, sensors: Sequence[str], learned: LearnedEngine | None = None
) -> Examined:
    """Test whether the twin fits, and fit health beside tolerances.

    Args:
        recording: what was recorded.
        engine: what the twin believes; its health parameters are fitted.
        sensors: columns that count.
        learned: what is known of the engine from recordings of when it was well; `engine` is then its own.
    """
    parts = [(part, there) for part in _parts(recording) if len(there := _reading(part, sensors)) >= FEWEST_SENSORS]
    if not parts:
        return _untested(f"that takes {SHORTEST_S:g} s of running engine and {FEWEST_SENSORS} sensors")
    bar = ALARM_GAIN + 2.0 * float(np.log(len(parts)))  # as many chances as parts
    suspected: list[Suspect] = []
    left: list[Excess] = []
    health: list[Mapping[str, Tolerant]] = []
    for part, there in parts:
        try:
            found, looks, beyond = _looked_at(part, engine, there, bar, learned)
        except InputError as error:  # terms of the engine that the effects of the catalogue can't stand beside
            return _untested(str(error))
        except np.linalg.LinAlgError:
            note = Note("the twin can't follow this recording at all: see `dieseltwin discover`", "misfit")
            return Examined((note,), {})
        suspected += looks
        left += beyond
        health.append(_health(found, learned))
    notes = []
    if suspected:
        first = max(suspected, key=lambda item: item.gain)
        notes.append(Note(f"the twin doesn't fit this recording: as with {first.words} (misfit {first.gain:.3g}, "
                          f"{bar:.0f} is the mark); its parameters may be wrong, see `dieseltwin discover`", "misfit",
                          first.affects))  # fmt: skip
    if left:
        worst = max(left, key=lambda item: item.times)
        names = tuple(dict.fromkeys(item.channel for item in left))
        notes.append(Note(f"{', '.join(names)}: the fit leaves more than noise, {worst.times:.2g} times it in "
                          f"{worst.channel} from {worst.since_s:.5g} to {worst.until_s:.5g} s; its parameters may be "
                          "wrong, see `dieseltwin discover`", "residuals", names))  # fmt: skip
    # beside a misfit health is bent to imitate what is missing, and its interval would promise what it can't hold
    return Examined(tuple(notes), {} if notes else _together(health))


def _untested(why: str) -> Examined:
    return Examined((Note(f"whether the twin fits isn't tested: {why}", "untested"),), {})


def _health(found: Search, learned: LearnedEngine | None) -> dict[str, Tolerant]:
    """Health of the fit of one part; none where a parameter ended at the limit of what the search allows, so far from
    the engine file's that the fit isn't where the readings would have it.

    Its standard deviations contain tolerances, and what effects would change that may go unseen; none is known better
    than when it was learned, as a map's level and a health parameter are one product.
    """
    fit = found.null.fit
    around = (fit.parameters * (1.0 + AT_LIMIT), fit.parameters * (1.0 - AT_LIMIT))
    if not all(np.array_equal(each, within_limits(found.twin, each, (), np.zeros(0))[0]) for each in around):
        return {}
    found.singles = as_fits(found.null, found.scored)
    apart = disagreement(found, found.null)
    then = None if learned is None else relative_health_std(learned)
    covariance = no_better_than_then(cast(Array, fit.covariance) + np.diag(apart**2), fit.parameters, then)
    told = health_values(found, (fit.parameters, covariance), since_reference(found.null, found.twin, apart))
    return {name: Tolerant(one.value, cast(float, one.std), one.since_reference) for name, one in told.items()}


def _together(parts: Sequence[Mapping[str, Tolerant]]) -> dict[str, Tolerant]:
    """Mean of the parts, weighted by their certainty, with the mean of their standard deviations: all have the same
    maps and sensors, whose errors more driving doesn't average away. None where a part says nothing."""
    if not all(parts):
        return {}
    together = {}
    for name in HEALTH:
        now = _mean([part[name] for part in parts])
        since = [told for part in parts if (told := part[name].since_reference) is not None]
        then = dict(zip(("value", "std"), _mean(since), strict=True)) if since else None
        together[name] = Tolerant(*now, None if then is None else SinceReference(**then))
    return together


def _mean(parts: Sequence[Tolerant | SinceReference]) -> tuple[float, float]:
    std = np.array([part.std for part in parts])
    return tuple(np.average([[part.value for part in parts], std], axis=1, weights=1.0 / std**2).tolist())


@dataclass(frozen=True)
class Tested:
    """A recording and an engine after the test.

    Attributes:
        recording, engine: as they were given, or put right where the recording shows that it was made under other
            circumstances and the twin doesn't fit without them.
        shown: these circumstances, none where nothing was put right.
        notes: what doesn't fit even so.
        health: beside tolerances, as of `Examined`.
    """

    recording: Recording
    engine: EngineParameters
    shown: tuple[Estimate, ...]
    notes: tuple[Note, ...]
    health: Mapping[str, Tolerant]


def tested(
    recording: Recording, engine: EngineParameters, sensors: Sequence[str], learned: LearnedEngine | None = None,
    minutes_max: float | None = None,
) -> Tested:  # fmt: skip
    """Test whether the twin fits; where it doesn't, under the circumstances that the recording shows.

    Args:
        recording, engine, sensors, learned: as of `examine`.
        minutes_max: of a longer recording the liveliest stretches show circumstances; None: all of it.
    """
    first = examine(recording, engine, sensors, learned)
    if any(note.code in OF_THE_FIT for note in first.notes):
        there = tuple(name for name in sensors if name in recording.columns)
        right, under, shown = as_it_was(recording, engine, Options(sensors=there), minutes_max, learned)
        if shown:
            again = examine(right, under, sensors, learned)
            return Tested(right, under, shown, again.notes, again.health)
    return Tested(recording, engine, (), first.notes, first.health)


def _parts(recording: Recording) -> Iterator[Recording]:
    """The recording in stretches of equal length; those with too little running time are left out."""
    count = max(1, int(np.ceil(recording.duration_s / LONGEST_PART_S)))
    edges = np.linspace(recording.time_s[0], recording.time_s[-1], count + 1)[1:-1]
    for rows in np.split(np.arange(recording.time_s.size), np.searchsorted(recording.time_s, edges)):
        if rows.size < 2:
            continue
        columns = {name: values[rows] for name, values in recording.columns.items()}
        part = replace(
            recording, time_s=recording.time_s[rows], columns=Columns(columns), cut_from_s=recording.start_s
        )
        step = float(np.median(np.diff(part.time_s)))
        if part.running_s + step >= SHORTEST_S:
            yield part


def _reading(part: Recording, sensors: Sequence[str]) -> list[str]:
    """The sensors that read anything there."""
    return [name for name in sensors if name in part.columns and np.isfinite(part.columns[name]).any()]


def _looked_at(
    part: Recording, engine: EngineParameters, sensors: Sequence[str], bar: float, learned: LearnedEngine | None
) -> tuple[Search, Sequence[Suspect], Sequence[Excess]]:
    """The fit of a part, what it looks as if were wrong, and what it leaves.

    Where rows are so far apart that a quick pedal moves unseen between them, a misfit that goes when it may have is
    none. A fault stays: calm inputs are believed to be straight from row to row.
    """
    first = _searched(part, engine, sensors, bar, learned, between_rows=False)
    misfit = max((suspect.gain for suspect in first[1]), default=0.0)
    quick = rows_may_be_slow(part.time_s) and not rows_are_slow(part.time_s)
    if not (quick and any(first[1:])) or misfit > QUICK_GAIN:
        return first
    again = _searched(part, engine, sensors, bar, learned, between_rows=True)
    return first if any(again[1:]) else again


def _searched(
    part: Recording, engine: EngineParameters, sensors: Sequence[str], bar: float, learned: LearnedEngine | None,
    *, between_rows: bool,
) -> tuple[Search, Sequence[Suspect], Sequence[Excess]]:
    columns = {**part.columns, **{name: _with_noise(part.columns[name], name) for name in sensors}}
    noisy = replace(part, columns=Columns(columns))
    twin = EngineTwin(noisy, engine, sensors) if learned is None else beside_its_compressor(
        noisy, engine, sensors, learned.belief, learned.beliefs(default_search().circumstances)
    )  # fmt: skip
    twin.between_rows = between_rows
    found = prepare(twin, Options().settings())
    faults = suspicions(found.null, recording_faults(twin, found.null))
    return found, tuple(_beyond(found, faults, bar)), tuple(_excess(found))


def _with_noise(values: Array, column: str) -> Array:
    """Readings (n,) of a sensor's column with the noise of the best sensor besides their own."""
    channel = MEASURED.index(column)
    least = max(BEST_SENSOR * float(np.nanmean(np.abs(values))), SENSORS[channel].floor)
    return values + least * np.random.default_rng(channel).standard_normal(values.size)


def _beyond(found: Search, faults: Sequence[Suspicion], bar: float) -> Iterator[Suspect]:
    """Effects and faults that stand out by their gain, at a size that matters."""
    hypotheses = found.twin.hypotheses
    for item in found.scored:
        hypothesis = hypotheses[item.name]
        if item.gain >= bar and abs(item.magnitude) >= LEAST_SIZE * hypothesis.tolerance:
            column = hypothesis.site.removeprefix("sensor:")
            yield Suspect(f"the effect {item.name}", item.gain, (column,) if column != hypothesis.site else ())
    for fault in faults:
        lasting = fault.gain >= SURE_GAIN or fault.held >= LEAST_SPREAD * fault.gain
        if fault.gain >= bar and lasting and abs(fault.size) >= LEAST_SIZE * fault.fault.least:
            yield Suspect(fault.fault.words(fault.size), fault.gain, (fault.fault.column,))


def _excess(found: Search) -> Iterator[Excess]:
    """Channels whose residual is beyond what noise leaves: over all, slowly, or in a window."""
    twin, at = found.twin, found.null
    present = at.whitening.present
    residual = at.projected_residual[: present.size].reshape(present.shape)
    edges = np.append(twin.starts, len(residual))
    time = twin.recording_time_s
    for j, name in enumerate(twin.channels):
        there = present[:, j]
        rest = residual[there, j]
        if rest.size < 5 * SLOW_ROWS:
            continue
        whole = (name, float(time[0]), float(time[-1]))
        for chi, count, slack in ((np.mean(rest**2), rest.size, CHI2_SLACK), (*_slow(rest), SLOW_SLACK)):
            if chi > 1.0 + slack + CHI2_SIGMA * np.sqrt(2.0 / count):
                yield Excess(whole[0], float(np.sqrt(chi)), *whole[1:])
        squares = np.add.reduceat(np.where(there, residual[:, j] ** 2, 0.0), twin.starts)
        counts = np.add.reduceat(there.astype(np.int64), twin.starts)
        allowed = np.maximum((1.0 + CHI2_SLACK) * chdtri(np.maximum(counts, 1), WINDOW_LEVEL), WINDOW_LEAST * counts)
        for w in np.flatnonzero(squares > allowed):
            since, until = float(time[edges[w]]), float(time[edges[w + 1] - 1])
            yield Excess(name, float(np.sqrt(squares[w] / counts[w])), since, until)


def _slow(rest: Array) -> tuple[float, int]:
    """Mean square of the means of `SLOW_ROWS` neighbours, 1 where they are independent; and how many there are."""
    count = rest.size // SLOW_ROWS
    means = rest[: count * SLOW_ROWS].reshape(count, SLOW_ROWS).mean(axis=1)
    return float(SLOW_ROWS * np.mean(means**2)), count
