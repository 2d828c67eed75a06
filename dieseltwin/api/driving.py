"""Discovery on a recording of the diesel engine."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Container, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dieseltwin.api import driving_page
from dieseltwin.api.engines import PUBLISHED, AnyEngine, diesel_engine
from dieseltwin.api.findings import Asked, Discovered, Question, channels_sha256, machine, sha256_if_there
from dieseltwin.api.reading import Channels, Opened, as_engine, over_time
from dieseltwin.api.results import drawn
from dieseltwin.atomic import write_text
from dieseltwin.discovery import discover as core
from dieseltwin.discovery.options import Options
from dieseltwin.discovery.verdict.assemble import together_sha256
from dieseltwin.discovery.verdict.checks import check_engine, check_fit, check_recording, check_sensitivity
from dieseltwin.discovery.verdict.curves import Discovery
from dieseltwin.discovery.verdict.document import Discrepancy, with_warnings
from dieseltwin.discovery.verdict.explain import Known, answers, details_of, plain
from dieseltwin.discovery.verdict.implied import implied_frame
from dieseltwin.engine import HEALTH, EngineParameters, we2011
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.engine.learned_file import learned_beside
from dieseltwin.errors import InputError
from dieseltwin.learning.files import LearnedEngine, learned_engine_of, save_learned, untold
from dieseltwin.notes import Note, of_reading
from dieseltwin.recordings.channels import SENSORS
from dieseltwin.recordings.circumstances import TIME_SHIFT, kind_of, put_right
from dieseltwin.recordings.dates import MODIFIED, ORDER, Dated, in_time_order
from dieseltwin.recordings.liveliest import liveliest, minutes_of
from dieseltwin.recordings.named_columns import Imported
from dieseltwin.recordings.reader import Recording, read_recording
from dieseltwin.recordings.shared_rows import overlap, refuse_overlapping, refuse_shared
from dieseltwin.report.beside import begin_ahead, begin_beside, ready_beside
from dieseltwin.report.circumstance_words import alike_words, blameless_words, circumstances_words, compressor_words
from dieseltwin.report.discovery_words import sentence as in_words
from dieseltwin.report.visible_words import visible_table
from dieseltwin.sealed import sealed_text
from dieseltwin.settings.names import listed
from dieseltwin.settings.params import params_sha256
from dieseltwin.version import __version__

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

ENGINE_FILE = "engine.yaml"
_REPORT_S = 5.0  # of a time limit that document, figures and page need
TOLERANCE_RANGE = (0.0, 0.05)  # map tolerance [-]; with more, nothing is left to find


@dataclass(frozen=True, repr=False)
class DrivingDiscovered(Discovered):
    """What the twin leaves out of a recording.

    Attributes:
        question: what was asked.
        found: document, repaired engine and curves.
        seconds: wall time of the answer [s].
    """

    own_files = (ENGINE_FILE, learned_beside(Path(ENGINE_FILE)).name, "implied.parquet")

    question: DrivingQuestion
    found: Discovery
    seconds: float

    @cached_property
    def document(self) -> Discrepancy:
        document = self.found.document
        if document.out_of_time is not None:  # the search knows what was left for it
            told = document.out_of_time.model_copy(update={"limit_s": self.question.time_s})
            document = document.model_copy(update={"out_of_time": told})
        read = self.question.recording.columns
        found = [*circumstance_notes(document), *_column_notes(document, read), *_time_notes(document)]
        return with_warnings(document, [*self.question.notes, *found])

    @property
    def engine(self) -> EngineParameters:
        return self.found.engine

    @property
    def known(self) -> LearnedEngine | None:
        """What was learned of the engine, whose repaired one is `engine`; None where nothing was."""
        learned = self.question.known
        return None if learned is None else replace(learned, repaired=self.engine)

    @property
    def sentence(self) -> str:
        return in_words(self.document)

    def plot(self, name: str | None = None) -> Figure:
        """`candidates`, `evidence_time`, `law`, `health`, `minimum_detectable` or `score`; of several recordings also
        `over_recordings`."""
        from dieseltwin.report import discovery_figures, over_recordings

        drawings = {
            "candidates": discovery_figures.candidates, "evidence_time": discovery_figures.evidence_time,
            "law": discovery_figures.law_curves, "health": discovery_figures.health,
            "minimum_detectable": discovery_figures.minimum_detectable, "score": discovery_figures.score,
            "over_recordings": over_recordings.trends,
        }  # fmt: skip
        return drawn(self.found, drawings, name)

    def by_recording(self) -> pd.DataFrame:
        """One row for each of several recordings, SI units: date, ambient, health, health since the reference, and the
        size of each effect, with their standard deviations; none of one recording."""
        from dieseltwin.report.over_recordings import frame

        return frame(self.document)

    def _details(self) -> Mapping[str, Any]:
        return details_of(self.found, self.question.asked, list(self.question.notes))

    def _write(self, folder: Path, began: float) -> dict[str, Any]:
        if self.known is None:
            write_text(folder / ENGINE_FILE, engine_yaml(self.engine))
        else:
            save_learned(self.known, folder / ENGINE_FILE)
        written = begin_beside(driving_page.write, replace(self.found, document=self.document), folder)
        stds = {n: v.std for n, v in self.document.health.items() if v.std is not None and n in HEALTH}
        sensors = self.question.options.sensors
        judged, whole = self.question.recording, self.question.whole
        starts, local = (self.found.starts, self.found.local) if whole is judged else (None, None)
        last = [c for c in self.document.circumstances if c.recording in (None, len(self.document.recordings))]
        apart = [c for c in last if c.off or kind_of(c.name) == TIME_SHIFT]
        source, _ = put_right(whole, self.engine, {item.name: item.value for item in apart})
        implied = implied_frame(source, self.engine, stds, sensors=sensors, starts=starts, local=local)
        implied.to_parquet(folder / "implied.parquet", index=False, write_page_checksum=True)
        written()
        seconds = self.seconds + time.perf_counter() - began
        return {**plain(self.found.runtime), "seconds": seconds, **machine()}

    def lines(self) -> list[str]:
        return ["", self.sentence, *compressor_words(self.document)]


@dataclass(frozen=True)
class DrivingQuestion(Question):
    """A recording of the diesel engine, checked.

    Attributes:
        recording: what is judged.
        whole: what was recorded: the same, or longer (`liveliest`).
        parameters: what the twin believes.
        options: of the search; its sensors are those that are there.
        asked: the question as JSON types: what has to agree for old results to be an answer to it.
        notes: what is doubtful about the recording, one sentence each.
        began: clock when it was asked [s].
        known: what was learned of the engine from recordings of when it was well.
        time_s: of the whole discovery [s]; None: as long as it takes.
        days: all recordings in time order, where several are judged together; `recording` is then the last.
    """

    recording: Recording
    parameters: EngineParameters
    options: Options
    asked: Mapping[str, Any]
    notes: tuple[str, ...]
    began: float
    whole: Recording
    known: LearnedEngine | None = None
    time_s: float | None = None
    days: tuple[Dated, ...] = ()

    @property
    def about(self) -> str:
        sensors = ", ".join(self.options.sensors or ())
        if self.days:
            hours = sum(day.recording.duration_s for day in self.days) / 3600.0
            span = f"{self.days[0].day} to {self.days[-1].day}"
            return f"{len(self.days)} recordings, {span}: {hours:.2g} h, {sensors} ..."
        return f"{self.recording.path or 'recording'}: {self.recording.duration_s:.0f} s, {sensors} ..."

    @cached_property
    def prepared(self) -> core.Prepared:
        """What the recordings could show."""
        return core.prepare(self.days or self.recording, self.parameters, self.options, self.known)

    @property
    def smallest(self) -> Mapping[str, float]:
        """Effect -> smallest magnitude that the recordings could show [unit of the effect]."""
        return self.prepared.minimum_detectable

    def _check_sensitivity(self) -> None:
        limits = {name: max(map(abs, effect.limits)) for name, effect in EFFECTS.items()}
        check_sensitivity(self.recording, self.smallest, limits)

    def preview(self) -> Iterator[str]:
        self._check_sensitivity()
        yield from self.notes
        yield from visible_table(self.smallest, self.prepared.health_bias, len(self.days))

    @property
    def catalogue(self) -> Mapping[str, Known]:
        return EFFECTS

    def getting_ready(self) -> AbstractContextManager[None]:
        return ready_beside(driving_page.load)

    def answered_in(self, folder: Path) -> bool:
        judged = [day.recording for day in self.days] or [self.recording]
        if self.known is not None and not learned_beside(folder / ENGINE_FILE).is_file():
            return False
        return answers(folder, self.asked, together_sha256(judged))

    def answer(self) -> DrivingDiscovered:
        self._check_sensitivity()
        left = None
        if self.time_s is not None:
            left = max(0.0, self.time_s - _REPORT_S - (time.perf_counter() - self.began))
        judged = self.days or self.recording
        found = core.discover(judged, self.parameters, self.options, self.known, self.prepared, left,
                              shown=lambda known: begin_ahead(driving_page.draw_ahead, known))
        check_fit(self.recording, self.parameters, found.engine, found.document.fit.chi2_left)
        return DrivingDiscovered(self, found, time.perf_counter() - self.began)


def _time_notes(document: Discrepancy) -> list[Note]:
    if document.out_of_time is None:
        return []
    unfinished = ", ".join(document.out_of_time.unfinished)
    return [Note(f"the time was over before the search was through: not finished are {unfinished}", "out_of_time")]


def ask(
    read: Sequence[Opened],
    engine: AnyEngine | None,
    channels: Channels | None,
    question: Asked,
    known: LearnedEngine | None = None,
) -> DrivingQuestion:
    """Check recordings, one or several, and what is asked of them; see `findings.Kind.ask`.

    Args:
        channels: part of the question.
        known: the engine that the file `engine` holds, where it has been loaded.

    Raises:
        InputError: any file or option that can't be used, a recording or an engine that can't carry a verdict.
    """
    recordings = [over_time(item) for item in read]
    learned, doubts = (known, ()) if known is not None else _known(engine, channels, question)
    began = time.perf_counter()
    if learned is not None and question.map_tolerance is not None:
        raise InputError("--map-tolerance", f"{question.map_tolerance:g}", "none with a learned engine, whose"
                         " file says how well each map is known", "leave it out")  # fmt: skip
    asked = _asked(engine, channels, question)
    if learned is not None:
        asked["reference_sha256"] = [item.sha256 for item in learned.recordings]
    parameters = diesel_engine(engine) if learned is None else learned.engine
    wholes = [_checked(recording, parameters) for recording in recordings]
    most = question.settings.minutes_max
    sources = [whole if most is None else liveliest(whole, minutes_of(whole, len(wholes), most)) for whole in wholes]
    days = in_time_order(sources) if len(sources) > 1 else ()
    refuse_overlapping(wholes, overlap)
    notes: list[Note] = [*doubts, *untold(parameters, learned), *_date_notes(days)]
    if learned is not None and not question.reference:  # else `learn` has said so
        notes += [Note(doubt, "reference") for doubt in learned.doubts]
    sensors = []
    for source, whole in zip(sources, wholes, strict=True):
        used, own = check_recording(source, parameters, asked["sensors"])
        where = f"{source.path or 'recording'}: " if days else ""
        own = [note for note in own if not (days and note.code == "short")]  # together they are longer
        notes += [of_reading(note, where) for note in (*source.notes, *own)]
        notes += _length_notes(where, source, whole)
        sensors.append(used)
        if learned is not None:
            refuse_shared(str(source.path or "recording"), overlap(learned.recordings, source))
    common = tuple(name for name in sensors[0] if all(name in used for used in sensors))
    if left := sorted({name for used in sensors for name in used} - set(common)):
        notes.append(Note(f"{listed(left)} is not in all recordings and isn't used", "reading", tuple(left)))
    options = Options(sensors=common, withhold=tuple(asked["withhold"]), map_tolerance=asked["map_tolerance"],
                      seed=question.random_seed, search=question.settings.search.driving,
                      circumstances=question.settings.search.circumstances)
    last = days[-1].recording if days else sources[0]
    whole = next(whole for source, whole in zip(sources, wholes, strict=True) if source is last)
    return DrivingQuestion(
        last, parameters, options, asked, tuple(notes), began, whole, learned, asked["time_s"], days
    )


def _known(
    engine: AnyEngine | None, channels: Channels | None, question: Asked
) -> tuple[LearnedEngine | None, Sequence[Note]]:
    """What is known of the engine, from its file or from references, and what is doubtful about these."""
    if not question.reference:
        return learned_engine_of(engine), ()
    from dieseltwin.api.learning import known_engine  # with what calibration needs, a third of a second

    return known_engine(engine, question.reference, channels, question.sensors)


def _length_notes(where: str, judged: Recording, whole: Recording) -> list[Note]:
    """That a part of a long recording is judged, where it is."""
    if judged is whole:
        return []
    of_all = f"{judged.running_s / 60.0:.0f} of {whole.running_s / 60.0:.0f} minutes with the engine running"
    return [Note(f"{where}judged by {of_all}, the liveliest stretches, spread over the recording;"
                 " `discover.minutes_max` of params.yaml says how many", "long")]  # fmt: skip


def _date_notes(days: Sequence[Dated]) -> list[Note]:
    """How the dates of several recordings are known, where nothing in the recordings or their names says it."""
    kinds = {day.date_from for day in days}
    if MODIFIED in kinds:
        count = sum(day.date_from == MODIFIED for day in days)
        return [Note(f"the dates of {count} of {len(days)} recordings are those of their files, which copying may have "
                     "changed; a date in the name (2026-03-14) counts for more", "dates")]  # fmt: skip
    if ORDER in kinds:
        return [Note("the recordings have no dates; they are taken to be a day apart in the order given", "dates")]
    return []


def circumstance_notes(document: Discrepancy) -> list[Note]:
    """What the recording was made under and doesn't say, and what looks like an effect that was found."""
    off = tuple(dict.fromkeys(item.name.rpartition(":")[2] for item in document.circumstances if item.off))
    words = circumstances_words(document)
    notes = [Note(f"{words}; judged as such, {blameless_words(document)}", "circumstances", off)] if off else []
    return [*notes, *(Note(text, "circumstances") for text in alike_words(document))]


def _column_notes(document: Discrepancy, columns: Container[str]) -> list[Note]:
    """That a column of the weather reads wrongly, where the recording shows another one."""
    off = [item for item in document.circumstances if item.off and item.name in columns]
    bends = "may read wrongly, which bends all that is found: judge the recording again without it"
    said = ((True, bends), (False, "reads wrongly and was left out, as if it weren't recorded"))
    named = [(tuple(dict.fromkeys(item.name for item in off if item.read == read)), words) for read, words in said]
    return [Note(f"{listed(names)} {words}", "wrong_column", names) for names, words in named if names]


def _asked(engine: AnyEngine | None, channels: Channels | None, question: Asked) -> dict[str, Any]:
    withhold, sensors, settings = question.withhold or (), question.sensors, question.settings
    question.check(EFFECTS, settings.search.driving.withhold)
    map_tolerance = settings.map_tolerance if question.map_tolerance is None else question.map_tolerance
    low, high = TOLERANCE_RANGE
    if not low <= map_tolerance <= high:  # not so for NaN either
        raise InputError("--map-tolerance", f"{map_tolerance:g}", f"{low:g} to {high:g}", "choose another")
    time_s = settings.time_s if question.time_s is None else question.time_s
    if time_s is not None and not 0.0 < time_s < math.inf:
        raise InputError("--time", f"{time_s:g}", "a positive number of seconds", "choose another or leave it out")
    if sensors is not None and not sensors:
        raise InputError("--sensors", "no name", f"columns such as {','.join(SENSORS)}", "name some or leave it out")
    return {
        "sensors": None if sensors is None else sorted(set(sensors)), "withhold": sorted(set(withhold)),
        "map_tolerance": map_tolerance, "seed": question.random_seed, "time_s": time_s,
        "minutes_max": settings.minutes_max, "engine_sha256": _engine_sha256(engine),
        "channels_sha256": channels_sha256(channels),
        "search_sha256": params_sha256(settings.search.model_dump(mode="json", include={"driving", "circumstances"})),
        "code_version": __version__,
    }  # fmt: skip


def _engine_sha256(engine: AnyEngine | None) -> str | None:
    """Hash of an engine's file, or of its parameters; None for the published one."""
    if engine is None or engine == PUBLISHED:
        return None
    if isinstance(engine, str | Path):
        return sha256_if_there(engine)
    parameters = as_engine(engine)
    if parameters == we2011.PARAMETERS:
        return None
    return hashlib.sha256(parameters.model_dump_json().encode()).hexdigest()


def _checked(recording: Imported | Recording, parameters: EngineParameters) -> Recording:
    """The recording; where it can't be one of this engine, the air balance says so better than a unit would."""
    if isinstance(recording, Recording):
        return recording
    try:
        return read_recording(recording, engine=parameters, sensors=())
    except InputError:
        size = we2011.PARAMETERS.replace(p_amb=parameters.p_amb, T_amb=parameters.T_amb)
        try:
            source = read_recording(recording, engine=size, sensors=())
        except InputError:
            source = None
        if source is not None:
            check_engine(source, parameters)
        raise


def engine_yaml(engine: EngineParameters) -> str:
    """The repaired engine as YAML that --engine accepts, terms included."""
    import yaml

    values = engine.model_dump(mode="json")
    body = yaml.safe_dump(values, sort_keys=False, allow_unicode=True, default_flow_style=None, width=100)
    return sealed_text(f"# Repaired by `dieseltwin discover`; --engine accepts it.\n{body}")
