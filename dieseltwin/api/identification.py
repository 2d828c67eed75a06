"""Health parameters of a recording, with their uncertainty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from dieseltwin.api.engines import AnyEngine, diesel_engine, rig_of
from dieseltwin.api.folders import IDENTIFICATION, keep_apart
from dieseltwin.api.identified_words import found_words, misfits, text_table, with_tolerances
from dieseltwin.api.reading import Channels, Source, diesel_recording
from dieseltwin.api.results import Result, drawn
from dieseltwin.api.rigs import RigIdentified, identify_rig
from dieseltwin.atomic import atomic_folder, write_json
from dieseltwin.discovery.fit_test import Tolerant, tested
from dieseltwin.discovery.verdict.assemble import found_circumstance
from dieseltwin.engine import MEASURED, EngineParameters
from dieseltwin.errors import InputError
from dieseltwin.identification.identify import identify_segments
from dieseltwin.identification.problem import NoiseLevels, SegmentProblem, problems_from_recording
from dieseltwin.identification.result import Identification, curves_table
from dieseltwin.learning.files import LearnedEngine, learned_engine_of, untold
from dieseltwin.notes import OF_THE_FIT, Note, doubts_among, of_reading, warnings_of
from dieseltwin.recordings.channel_checks import channel_notes
from dieseltwin.recordings.channels import SENSORS, refuse_missing
from dieseltwin.recordings.circumstances import with_charge
from dieseltwin.recordings.guess.machines import DIESEL
from dieseltwin.recordings.reader import CRANKING_RPM, Recording, rows_out_of_range
from dieseltwin.report.beside import begin_beside, ready_beside
from dieseltwin.report.circumstance_words import circumstance_words
from dieseltwin.rigs.recording import RigRecording
from dieseltwin.sealed import sealed_json
from dieseltwin.sensors import relative_noise
from dieseltwin.settings.defaults import deciding_by
from dieseltwin.settings.methods import EXACT, Method, find
from dieseltwin.settings.names import listed, refuse_options, unknown_name
from dieseltwin.settings.params import DEFAULT_PROFILE, Params, load_params
from dieseltwin.surrogates.files import networks_for

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Below, the turbo's seconds do not fit in; above, the health parameters are no longer constants of one segment.
SEGMENT_RANGE_S = (10.0, 3600.0)
MOST_RUNS = 10_000
MOST_ROWS = 1_500_000  # 42 hours at 10 Hz; the bands of the states take a kilobyte a row
OPTIONAL_RESULTS = ("curves.parquet", "report.html", "report.pdf", "figures")  # of another method: they mustn't stay


@dataclass(frozen=True)
class Setup:
    """Where settings and pretrained networks come from, and which sensors are used.

    Attributes:
        models: folder of pretrained networks; None is `models` of the working folder.
        maps: which empirical maps: exact, paper or improved; None is the method's own.
        params: file of settings; None is params.yaml.
        profile: of the settings.
        sensors: columns to use; None takes all that there are, of which the paper's five must be among them.
        fit_test: test whether the twin fits the recording (methods with exact maps; see `discovery.fit_test`).
    """

    models: str | Path | None = None
    maps: str | None = None
    params: str | Path | None = None
    profile: str = DEFAULT_PROFILE
    sensors: Sequence[str] | None = None
    fit_test: bool = True

    def settings(self) -> Params:
        """The settings; raises `InputError` for a file that can't be used."""
        return load_params(self.params, self.profile)

    def networks(self, method: Method) -> dict[str, Any]:
        """Networks for a method; raises `InputError` where they aren't there."""
        return networks_for(method, None if self.models is None else Path(self.models), self.maps)


@dataclass(frozen=True, repr=False)
class Identified(Result):
    """The health parameters of a recording.

    Attributes:
        found: estimates of every segment and run.
        problems: the segments.
        notes: what was left out, and what is doubtful; one sentence each.
        provenance: seed, hashes of the settings and of the recording, its name.
        tolerant: health fitted beside tolerances of maps and sensors, which no interval of `found` contains; empty
            where that fit wasn't made or doesn't hold (see `fit_test.Examined`).
    """

    found: Identification
    problems: tuple[SegmentProblem, ...]
    notes: tuple[str, ...]
    provenance: Mapping[str, str | int]
    tolerant: Mapping[str, Tolerant] = field(default_factory=dict)

    @property
    def sentence(self) -> str:
        words = found_words(self.document)
        doubt = "The twin doesn't fit this recording (see `dieseltwin discover`). " if self._misfits else ""
        if not doubt and any(note.code == "misfit" for note in self._left):
            doubt = "The fit leaves more than the noise, so that the intervals are too narrow. "
        return f"{doubt}{self.found.method}, {len(self.problems)} segments: {'; '.join(words)}."

    @cached_property
    def document(self) -> dict[str, Any]:
        """Content of `identification.json` but for its warnings."""
        return with_tolerances(self.found.to_json(), self.tolerant)

    def table(self) -> pd.DataFrame:
        """One row a parameter: mean, std, low and high (90 % interval), bound, unit, segments behind it; mean and std
        beside tolerances of maps and sensors, and over the value when the engine was learned, where there are any."""
        document = self.document
        rows = {}
        for name, entry in document["parameters"].items():
            low, high = entry["interval_90"] or (None, None)
            used = sum(bool(segment["parameters"][name]["identifiable"]) for segment in document["segments"])
            beside = document["with_tolerances"].get(name, {})
            since = beside.get("since_reference", {})
            rows[name] = {"mean": entry["mean"], "std": entry["std"], "low": low, "high": high,
                          "bound": entry["bound"], "unit": entry["unit"], "segments": used,
                          "tolerant_mean": beside.get("mean"), "tolerant_std": beside.get("std"),
                          "since_reference": since.get("value"), "since_reference_std": since.get("std")}
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis("parameter")

    def plot(self, name: str | None = None) -> Figure:
        """`parameters` (estimates of every segment), `states`, `flows` or `empirical` over time."""
        from dieseltwin.report import timeseries, violins  # loads matplotlib
        from dieseltwin.report.inputs import results_of

        drawings = {"parameters": violins.violins, "states": timeseries.states, "flows": timeseries.flows,
                    "empirical": timeseries.empirical}
        return drawn(results_of(self.found, self.problems, self.document), drawings, name)

    def save(self, out: str | Path) -> Path:
        """identification.json, runtime.json, states.parquet, report.html, figures/; curves.parquet if any."""
        keep_apart(out, IDENTIFICATION)
        with atomic_folder(out, owned=OPTIONAL_RESULTS) as folder:
            name = str(self.provenance.get("recording", ""))
            states = self.found.states  # worked out once, before the figures want them in a process of their own
            told = {**self.document, "warnings": self.warnings}
            drawn_beside = begin_beside(_write_page, self.found, self.problems, told, folder, name)
            write_json(folder / IDENTIFICATION, sealed_json(told))
            runtime = {**self.found.runtime(), **self.provenance, "notes": list(self.notes)}
            write_json(folder / "runtime.json", sealed_json(runtime))
            states.to_parquet(folder / "states.parquet", index=False, write_page_checksum=True)
            curves = curves_table(self.found)
            if curves is not None:
                curves.to_parquet(folder / "curves.parquet", index=False, write_page_checksum=True)
            drawn_beside()
        return Path(out)

    @property
    def warnings(self) -> list[dict[str, Any]]:
        """All that is doubtful, as in identification.json: code, text, affects."""
        return warnings_of([*self.notes, *self._left])

    @cached_property
    def _left(self) -> list[Note]:
        """What the fits themselves show."""
        return misfits(self.document)

    @property
    def _misfits(self) -> list[Note]:
        return [note for note in doubts_among(self.notes) if note.code in OF_THE_FIT]

    def lines(self) -> list[str]:
        """That the twin doesn't fit, where it doesn't; the table as text, and the other notes."""
        first = self._misfits
        return [*first, *text_table(self.document), *(n for n in self.notes if n not in first), *self._left]


def _load_page() -> None:
    import dieseltwin.report.html
    import dieseltwin.report.inputs  # noqa: F401
    from dieseltwin.report import style

    style.load()


def _write_page(
    found: Identification, problems: Sequence[SegmentProblem], document: Mapping[str, Any], folder: Path, recording: str
) -> None:
    """The page, and its figures as SVG (charts) and PNG (time series); the truth needn't be known.

    The paper's printed run times stay out: they belong to the comparison of methods.
    """
    from dieseltwin.report.encoding import drawn_in_two
    from dieseltwin.report.html import identification_page, identification_sections  # loads matplotlib
    from dieseltwin.report.inputs import results_of
    from dieseltwin.report.page import write_page

    results = results_of(found, problems, document, about={"recording": recording} if recording else None)
    page = identification_page(results, identification_sections(results, drawn_in_two))
    write_page(page, folder / "report.html", folder / "figures")


@dataclass(frozen=True)
class IdentificationQuestion:
    """A recording cut into segments and checked, ready to be identified.

    Attributes:
        problems: the segments.
        method, runs, seed: as asked, or those of the settings.
        settings: of the run.
        networks: that the method needs.
        notes: what is doubtful or left out, one sentence each.
        recording: what was read; segment_s, sensors: as asked.
        tested: engine, sensors and what is known of it that the fit is tested with; None without a test.
        recording_name: for people, "" for one made in memory.
    """

    problems: tuple[SegmentProblem, ...]
    method: str
    runs: int
    seed: int
    settings: Params
    networks: Mapping[str, Any]
    notes: tuple[str, ...]
    recording: Recording
    segment_s: float | None
    sensors: tuple[str, ...] | None
    tested: tuple[EngineParameters, tuple[str, ...], LearnedEngine | None] | None
    recording_name: str = ""

    def getting_ready(self) -> AbstractContextManager[None]:
        """While it lasts, a second process has the drawing library at hand for `save`."""
        return ready_beside(_load_page)

    def answer(self) -> Identified:
        """Test whether the twin fits the recording, under the circumstances that it shows; identify every segment."""
        config, problems = self.settings.identify, self.problems
        doubts: list[Note] = []
        tolerant: Mapping[str, Tolerant] = {}
        if self.tested is not None:
            with deciding_by(self.settings):
                fit = tested(self.recording, *self.tested, minutes_max=self.settings.discover.minutes_max)
            doubts, tolerant = list(fit.notes), fit.health
            if fit.shown:
                words = " and ".join(circumstance_words(found_circumstance(item)) for item in fit.shown)
                doubts.append(Note(f"{words}; identified as such", "circumstances",
                                   tuple(dict.fromkeys(item.circumstance.column for item in fit.shown))))  # fmt: skip
                cut = problems_of(fit.recording, fit.engine, self.settings, self.segment_s, self.sensors)
                problems = tuple(_usable(cut, fit.recording)[0])
        found = identify_segments(problems, self.method, self.runs, self.seed, config=config, **self.networks)
        provenance: dict[str, str | int] = {
            "params_sha256": self.settings.sha256, "recording_sha256": self.recording.sha256, "seed": self.seed,
            **({"recording": self.recording_name} if self.recording_name else {}),
        }  # fmt: skip
        return Identified(found, problems, (*doubts, *self.notes), provenance, tolerant)


def identify(
    recording: Source | Recording | RigRecording,
    engine: AnyEngine | None = None,
    *,
    channels: Channels | None = None,
    method: str = "classical",
    runs: int | None = None,
    segment_s: float | None = None,
    seed: int | None = None,
    setup: Setup | None = None,
) -> Identified | RigIdentified:
    """Find A_egrmax, A_vgtmax, eta_sc and h_tot in a recording, with their uncertainty; of a rig all its parameters.

    Args:
        recording: a file, a table or what `read` gave.
        engine: name, file or parameters, at whose health parameters the search starts; the published engine without it.
        channels: channel map for foreign names and units.
        method: one of `settings.methods.names()`.
        runs: independent starts a segment; None takes the settings' number for this method.
        segment_s: length of a segment [s]; None takes the settings'.
        seed: of everything random; None takes the settings'.
        setup: where settings and pretrained networks come from, and which sensors are used.

    Raises:
        InputError: anything that can't be used.
    """
    rig = rig_of(engine)
    if rig is not None:
        refuse_options({"channels": channels, "runs": runs, "segment_s": segment_s, "seed": seed, "setup": setup},
                       f"for {rig.name}")  # fmt: skip
        return identify_rig(recording, rig)
    return ask(recording, engine, channels=channels, method=method, runs=runs, segment_s=segment_s, seed=seed,
               setup=setup).answer()  # fmt: skip


def ask(
    recording: Source | Recording | RigRecording,
    engine: AnyEngine | None = None,
    *,
    channels: Channels | None = None,
    method: str = "classical",
    runs: int | None = None,
    segment_s: float | None = None,
    seed: int | None = None,
    setup: Setup | None = None,
) -> IdentificationQuestion:
    """Read and check all that `identify` needs, and identify nothing yet; arguments and errors are those of it."""
    setup = setup or Setup()
    chosen = find(method, "--method")
    chosen.check_installed()
    settings = setup.settings()
    runs, seed = settings.identify.runs_of(method) if runs is None else runs, settings.seed if seed is None else seed
    if not 1 <= runs <= MOST_RUNS:
        raise InputError("--runs", runs, f"1 or more, up to {MOST_RUNS}", "choose another number")
    if segment_s is not None and not SEGMENT_RANGE_S[0] <= segment_s <= SEGMENT_RANGE_S[1]:
        raise InputError("--segment", f"{segment_s:g} s", "{:g} to {:g} s".format(*SEGMENT_RANGE_S), "choose another")
    parameters, known = diesel_engine(engine), learned_engine_of(engine)
    needed = MEASURED[:3] if chosen.needs.maps == EXACT else SENSORS
    used = SENSORS if setup.sensors is None else _checked(setup.sensors, needed, method)
    source = diesel_recording(recording, channels, parameters, sensors=needed)
    refuse_missing(str(source.path or "recording"), source.columns, used, len(needed))
    if source.time_s.size > MOST_ROWS:
        raise InputError(str(source.path or "recording"), f"{source.time_s.size} rows", f"at most {MOST_ROWS}",
                         "cut it, or average it down to 10 Hz")
    masked = None if setup.sensors is None else used
    problems, left_out = _usable(problems_of(source, parameters, settings, segment_s, masked), source)
    networks = setup.networks(chosen)
    without = [Note(f"without {name}: {DIESEL.costs[name]}", "missing_sensor", (name,))
               for name in SENSORS if name not in used]
    fitted = tuple(used) if masked is not None else tuple(name for name in MEASURED if name in source.columns)
    notes = (*_notes(source, parameters, known), *channel_notes(source, fitted), *without, *left_out)
    whole = setup.fit_test and chosen.needs.maps == EXACT
    fit_with = (with_charge(parameters, source), fitted, known) if whole else None
    return IdentificationQuestion(tuple(problems), method, runs, seed, settings, networks, notes, source,
                                  segment_s, masked, fit_with, source.path.name if source.path else "")  # fmt: skip


def sensors_of(source: Recording) -> tuple[str, ...] | None:
    """Sensors that `Setup` has to name for this recording: None where it has the paper's five, which then go with
    whatever else there is, else those of the five that it has."""
    there = tuple(name for name in SENSORS if name in source.columns)
    return None if there == SENSORS else there


def problems_of(
    source: Recording, parameters: EngineParameters, settings: Params, segment_s: float | None = None,
    sensors: Sequence[str] | None = None,
) -> list[SegmentProblem]:  # fmt: skip
    """Segments of the recording as estimation problems; noise is the settings' share of the whole recording's means."""
    missing = np.full(source.time_s.shape, np.nan)
    signals = np.column_stack([source.columns.get(name, missing) for name in MEASURED])
    signals = signals[source.columns["n_e_rpm"] >= CRANKING_RPM]  # a standing engine would lower the means
    noise = NoiseLevels.from_signals(signals, relative=relative_noise(settings.noise))
    duration_s = settings.identify.segment_s if segment_s is None else segment_s
    return problems_from_recording(source, parameters, noise=noise, duration_s=duration_s, channels=sensors)


def _checked(sensors: Sequence[str], needed: Sequence[str], method: str) -> tuple[str, ...]:
    """The sensors that were named; `needed`: those that the method can't do without.

    Raises:
        InputError: an unknown name, one of the states missing, or a method of the paper, which needs all five.
    """
    for name in sensors:
        if name not in MEASURED:
            raise unknown_name("--sensors", name, list(MEASURED))
    absent = [name for name in needed if name not in sensors]
    if absent:
        raise InputError(f"--sensors {','.join(sensors)}", f"no {absent[0]}",
                         f"{listed(needed)} at least for {method}", "add it")
    return tuple(sensors)


def _usable(problems: list[SegmentProblem], source: Recording) -> tuple[list[SegmentProblem], list[Note]]:
    """Segments whose states can be started, and a note for each one left out.

    Raises:
        InputError: none is left.
    """
    usable, notes = [], []
    for problem in problems:
        dead = [name for i, name in enumerate(MEASURED[:3]) if not problem.observed[:, i].any()]
        if dead:
            notes.append(Note(f"{problem.name} left out: no reading of {', '.join(dead)}", "left_out", dead))
        else:
            usable.append(problem)
    if not usable:
        raise InputError(f"{source.path or 'recording'}: {', '.join(MEASURED[:3])}",
                         "no segment with readings of all three", "at least one",
                         "record longer or ask for longer segments")
    return usable, notes


def _notes(source: Recording, parameters: EngineParameters, known: LearnedEngine | None) -> list[Note]:
    ranges = parameters.input_ranges
    out = [Note(f"{count} of {len(source.time_s)} rows of {name} are outside the engine's range "
                f"{ranges[name][0]:g} to {ranges[name][1]:g}", "out_of_range", (name,))
           for name, count in rows_out_of_range(source.columns, ranges).items()]  # fmt: skip
    return [*untold(parameters, known), *map(of_reading, source.notes), *out]
