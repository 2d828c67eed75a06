"""The petrol engine: calibrated on a fault-free recording, searched for what is missing."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from dieseltwin.api.engines import AnyEngine, named, petrol_base
from dieseltwin.api.findings import Asked, Discovered, Question, channels_sha256, machine
from dieseltwin.api.reading import Channels, Made, Opened, Source, petrol_recording
from dieseltwin.api.results import Result, drawn
from dieseltwin.discovery.verdict.document import Discrepancy, with_warnings
from dieseltwin.discovery.verdict.explain import Known, answers, plain
from dieseltwin.errors import InputError
from dieseltwin.notes import Note, warnings_of
from dieseltwin.petrol.calibrate import SubmodelFit
from dieseltwin.petrol.calibrate import calibrate as calibrated
from dieseltwin.petrol.discover import PetrolDiscovery, PetrolOptions, details, discover_petrol
from dieseltwin.petrol.effects import HYPOTHESES, NEEDS
from dieseltwin.petrol.parameters import PetrolParameters, save_petrol
from dieseltwin.petrol.recording import COLUMNS, SURROUNDINGS, PetrolRecording, pooled, rows_of
from dieseltwin.recordings.channel_checks import series_notes
from dieseltwin.recordings.shared_rows import refuse_shared, share_known
from dieseltwin.report import petrol as pages
from dieseltwin.report.page import write_page
from dieseltwin.settings.names import listed, refuse_options, unknown_name
from dieseltwin.settings.params import params_sha256
from dieseltwin.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TOLERANCE_RANGE = (0.0, 0.1)  # of the maps [-]; with more, nothing is left to find


@dataclass(frozen=True, repr=False)
class PetrolDiscovered(Discovered):
    """What the twin leaves out of a petrol engine's recording.

    Attributes:
        question: what was asked.
        found: document, repaired engine and the search.
    """

    question: PetrolQuestion
    found: PetrolDiscovery

    @cached_property
    def document(self) -> Discrepancy:
        return with_warnings(self.found.document, [*self.question.notes, *recording_notes(self.question.recording)])

    @property
    def engine(self) -> PetrolParameters:
        return self.found.engine

    @property
    def sentence(self) -> str:
        return self.found.sentence

    def lines(self) -> list[str]:
        return [self.sentence, *(f"note: {doubt.text}" for doubt in self.document.warnings)]

    def plot(self, name: str | None = None) -> Figure:
        """`residuals_over_time`, `over_pressure` or `candidates`."""
        drawings = {"residuals_over_time": lambda found: pages.balances_over_time(found).still,
                    "over_pressure": lambda found: pages.over_pressure(found).still, "candidates": pages.candidates}
        return drawn(self.found, drawings, name)

    def _details(self) -> Mapping[str, Any]:
        return plain(details(self.found, self.question.asked))  # type: ignore[no-any-return]

    def _write(self, folder: Path, began: float) -> dict[str, Any]:
        save_petrol(self.engine, folder / "engine.yaml")
        told = replace(self.found, document=self.document)
        write_page(pages.petrol_page(told), folder / "report.html", folder / "figures")
        return {"seconds": self.found.runtime_s + time.perf_counter() - began, **machine()}


@dataclass(frozen=True)
class PetrolQuestion(Question):
    """A recording of a petrol engine, and the calibrated engine.

    Attributes:
        recording: what was recorded.
        parameters: calibrated.
        options: of the search.
        asked: the question as JSON types.
        notes: what is doubtful about the references that the engine was learned from.
    """

    recording: PetrolRecording
    parameters: PetrolParameters
    options: PetrolOptions
    asked: Mapping[str, Any]
    notes: tuple[Note, ...] = ()

    @property
    def about(self) -> str:
        return f"{self.recording.path}: {self.recording.signals.time_s[-1]:.0f} s ..."

    @property
    def catalogue(self) -> Mapping[str, Known]:
        return HYPOTHESES

    def answered_in(self, folder: Path) -> bool:
        return answers(folder, self.asked, self.recording.sha256)

    def answer(self) -> PetrolDiscovered:
        return PetrolDiscovered(self, discover_petrol(self.recording, self.parameters, self.options))


def ask(
    read: Sequence[Opened], engine: AnyEngine | None, channels: Channels | None, question: Asked
) -> PetrolQuestion:
    """Check a recording of a petrol engine; see `findings.Kind.ask`. With references it is learned from them first.

    Raises:
        InputError: a file or an option that can't be used, an engine without maps, references beside maps, a recording
            that is in the references.
    """
    (recording,) = read
    parameters = None if engine is None else petrol_base(engine)
    if parameters is None:
        raise InputError("engine", "no petrol engine", "a petrol engine", "name it or its file")
    engine_file = Path(engine) if isinstance(engine, str | Path) else None
    refuse_options({"--time": question.time_s}, "for a petrol engine")
    options = _options(question)
    question.check(HYPOTHESES, options.search.withhold)
    _check(options)
    judged = petrol_recording(recording, absent=_left_out(options))
    notes = tuple(alarms_when_learned(parameters))
    reference = [petrol_recording(item, channels) for item in question.reference]
    if reference and parameters.calibrated:
        raise InputError("--reference", f"beside {named(engine, parameters)}, which has its maps already",
                         "an engine without maps, which are learned from the references first",
                         f"leave --reference out, or name {PetrolParameters().name} or the file of volumes as --engine")
    if reference:
        rows, *known = (rows_of(item.signals) for item in (judged, *reference))
        refuse_shared(judged.path, share_known(rows, known))
        learned = learn_petrol(reference, parameters, channels)
        parameters, engine_file = learned.engine, None
        notes = tuple(Note(note["text"], "reference") for note in learned.warnings)
    if not parameters.calibrated:
        told = named(engine, parameters)
        raise InputError("--engine", f"{told}, which isn't calibrated yet", "a petrol engine with its maps",
                         f"`dieseltwin learn HEALTHY --engine {told} --out FILE` first and name FILE, or give a "
                         "fault-free recording as --reference")  # fmt: skip
    content = parameters.model_dump_json().encode() if engine_file is None else engine_file.read_bytes()
    asked = {
        "sensors": options.sensors, "withhold": list(options.withhold), "map_tolerance": options.map_tolerance,
        "seed": options.seed, "engine_sha256": sha256(content).hexdigest(), "code_version": __version__,
        "search_sha256": params_sha256(options.search.model_dump(mode="json")),
        "channels_sha256": channels_sha256(channels),
    }  # fmt: skip
    if reference:
        asked["reference_sha256"] = [item.sha256 for item in reference]
    return PetrolQuestion(judged, parameters, options, asked, notes)


def _options(asked: Asked) -> PetrolOptions:
    """What was asked for as the search takes it."""
    sensors = None if asked.sensors is None else tuple(asked.sensors)
    search = asked.settings.search.petrol
    return PetrolOptions(sensors=sensors, withhold=tuple(asked.withhold or ()), map_tolerance=asked.map_tolerance,
                         seed=asked.random_seed, search=search)


def _left_out(options: PetrolOptions) -> tuple[str, ...]:
    """Columns of the surroundings that aren't to be used: the recording needn't have them."""
    return tuple(c for c in SURROUNDINGS if options.sensors is not None and c not in options.sensors)


def _check(options: PetrolOptions) -> None:
    """Refuse an unknown column, a column that no verdict can do without, a tolerance out of range."""
    used = options.sensors
    for column in used or ():
        if column not in COLUMNS:
            raise unknown_name("--sensors", column, list(COLUMNS))
    needed = [c for c in (*NEEDS["cylinder"], *NEEDS["throttle"]) if used is not None and c not in used]
    if needed:
        raise InputError("--sensors", f"no {listed(list(dict.fromkeys(needed)))}", listed(list(COLUMNS)),
                         "only p_amb_pa and t_amb_k can be left out: the air's balances need all others")
    low, high = TOLERANCE_RANGE
    if options.map_tolerance is not None and not low <= options.map_tolerance <= high:
        raise InputError("--map-tolerance", f"{options.map_tolerance:g}", f"{low:g} to {high:g}", "choose another")


@dataclass(frozen=True, repr=False)
class PetrolCalibrated(Result):
    """A petrol engine calibrated on a fault-free recording.

    Attributes:
        notes: what is doubtful about the recording.
        engine: the calibrated engine, with verdicts on fault-free pieces that its maps did not see.
        fits: of each balance on held-out stretches.
        unjudged: how many further fault-free pieces can't be judged.
    """

    engine: PetrolParameters
    fits: tuple[SubmodelFit, ...]
    notes: tuple[Note, ...] = ()
    unjudged: int = 0

    @property
    def warnings(self) -> list[dict[str, Any]]:
        """Of the recording, and alarms on pieces that ought to be without fault."""
        return warnings_of(self._said)

    @property
    def _said(self) -> list[Note]:
        return [*self.notes, *alarms_when_learned(self.engine)]

    @property
    def sentence(self) -> str:
        return f"{self.engine.name}: {pages.false_alarms(self.engine.pieces, self.unjudged)}."

    def table(self) -> pd.DataFrame:
        """One row a balance: robust standard deviation of the held-out misfit [%], and the number of blocks."""
        rows = {f.name: {"steady_pct": 100.0 * f.steady, "all_pct": 100.0 * f.all_blocks, "blocks": f.blocks}
                for f in self.fits}
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis("balance")

    def plot(self, name: str | None = None) -> Figure:
        """`pieces`: the strongest effect in each fault-free piece."""
        return drawn(self, {"pieces": lambda s: pages.fault_free_pieces(s.engine.pieces)}, name)

    def save(self, out: str | Path) -> Path:
        """The engine file."""
        return save_petrol(self.engine, out)

    def beside(self, out: Path) -> tuple[str, ...]:
        """Names of the files that `save` writes beside the engine's: none."""
        return ()

    def lines(self) -> list[str]:
        return [*pages.calibration_lines(self.fits, self.engine.pieces, self.unjudged), *self._said]


def alarms_when_learned(engine: PetrolParameters) -> list[Note]:
    """What is doubtful about the recordings that an engine was learned from: pieces of them that raise an alarm."""
    alarms, pieces = sum(piece.alarm for piece in engine.pieces), len(engine.pieces)
    if not alarms:
        return []
    raise_one = "raises" if alarms == 1 else "raise"
    return [Note(f"{alarms} of {pieces} pieces that the engine was learned from {raise_one} an alarm: not all of them "
                 "are without fault, or its maps don't hold", "false_alarms")]  # fmt: skip


def calibrate_petrol(
    recording: Source | PetrolRecording, base: PetrolParameters, channels: Channels | None = None
) -> PetrolCalibrated:
    """See `calibration.calibrate`; of a base that is calibrated the maps are fitted anew.

    Raises:
        InputError: a recording that is too short, has no idling or lacks columns.
    """
    return learn_petrol([recording], base.model_copy(update={"cylinder": None, "throttle": None}), channels)


def learn_petrol(
    recordings: Sequence[Source | Made], base: PetrolParameters, channels: Channels | None = None
) -> PetrolCalibrated:
    """See `learning.learn`: what the recordings say together, as if they were one with gaps.

    Effects among the terms of the base are left out of the new engine: recordings of when it was well hold none.

    Raises:
        InputError: recordings that are too short together, share driving, have no idling or lack columns.
    """
    sources = [petrol_recording(item, channels) for item in recordings]
    together = pooled(sources)
    engine, fits, unjudged = calibrated(together.signals, base.model_copy(update={"terms": ()}), together.sha256)
    notes = [note for item in sources for note in recording_notes(item)]
    if base.terms:
        dropped = listed(list(dict.fromkeys(term.effect for term in base.terms)))
        notes.append(Note(f"{dropped} among the terms of {base.name} left out: the recordings are taken to be without "
                          "fault", "terms_left_out"))  # fmt: skip
    return PetrolCalibrated(engine, tuple(fits), tuple(notes), unjudged)


def recording_notes(recording: PetrolRecording) -> list[Note]:
    """Faults that the channels show by themselves, with the file's time stamps, and what was taken in their place."""
    signals = recording.signals
    sensors = {"p_ic_pa": signals.p_ic, "p_im_pa": signals.p_im, "w_af_kg_s": signals.W_af}
    found = {name: values for name, values in sensors.items() if name in recording.columns}
    taken = [f"{column} as {value:g} {COLUMNS[column][2]}" for column, value in SURROUNDINGS.items()
             if column not in recording.columns]
    notes = [Note(f"not recorded and taken {listed(taken)}: the flow of a leak goes with it", "not_recorded")]
    shown = series_notes(recording.time0_s + signals.time_s, found, signals.omega_e)
    return [*recording.notes, *(notes if taken else []), *shown]
