"""Machines that are no engines: simulated, fitted, searched for what is missing."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from dieseltwin.api.engines import AnyEngine, rig_of
from dieseltwin.api.findings import Asked, Discovered, Question, channels_sha256, machine
from dieseltwin.api.reading import Channels, Opened, Source, rig_recording
from dieseltwin.api.results import Result, drawn
from dieseltwin.atomic import atomic_folder, write_json
from dieseltwin.discovery.verdict.document import Discrepancy
from dieseltwin.discovery.verdict.explain import Known, answers
from dieseltwin.errors import InputError
from dieseltwin.notes import READING, Note
from dieseltwin.rigs.discover import discover_rig
from dieseltwin.rigs.fitting import fitted_surely
from dieseltwin.rigs.parameters import RigParameters, save_rig
from dieseltwin.rigs.recording import RigRecording
from dieseltwin.rigs.rounds import Options, RigDiscovery
from dieseltwin.rigs.simulate import run_error, simulate_rig
from dieseltwin.rigs.twin import model_of
from dieseltwin.rigs.verdict import HOLD, LEFT, LONG_STEPS, UNEXPLAINED, details, document, sentence, unseen
from dieseltwin.settings.names import refuse_options
from dieseltwin.settings.params import params_sha256
from dieseltwin.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure

UNTOLD = 0.9  # of what was believed beforehand: a deviation that a recording left as wide


def _over_readings(result: Result, rig: RigParameters, recording: RigRecording, name: str | None) -> Figure:
    """`readings`: a machine in free runs beside what was recorded."""
    from dieseltwin.report.over_time import beside_readings

    frame = simulate_rig(rig, recording)
    return drawn(result, {"readings": lambda _: beside_readings(frame, recording.readings)}, name)


@dataclass(frozen=True, repr=False)
class RigDiscovered(Discovered):
    """What a rig's file leaves out of a recording.

    Attributes:
        question: what was asked.
        found: every round, and the machine with what was taken.
    """

    question: RigQuestion
    found: RigDiscovery

    @cached_property
    def document(self) -> Discrepancy:
        return document(self.found)

    @property
    def engine(self) -> RigParameters:
        return self.found.repaired

    @property
    def sentence(self) -> str:
        return sentence(self.found, self.document)

    def lines(self) -> list[str]:
        codes = {LONG_STEPS, HOLD, READING} | ({LEFT, UNEXPLAINED} if self.document.mismatch else set())
        said = [doubt for doubt in self.document.warnings if doubt.code in codes]  # the sentence says the others
        notes = [Note(doubt.text, doubt.code) for doubt in said]
        unexplained = UNEXPLAINED in [doubt.code for doubt in self.document.warnings]
        return [self.sentence, *notes, *filter(None, ["" if unexplained else unseen(self.found)])]

    def plot(self, name: str | None = None) -> Figure:
        """`readings`: the repaired machine in free runs beside what was recorded."""
        return _over_readings(self, self.engine, self.found.recording, name)

    def _details(self) -> Mapping[str, Any]:
        return details(self.found, self.question.asked)

    def _write(self, folder: Path, began: float) -> dict[str, Any]:
        from dieseltwin.report.page import write_page
        from dieseltwin.report.rigs import rig_page  # matplotlib takes longer to load than a rig to simulate

        save_rig(self.engine, folder / "engine.yaml")
        page = rig_page(self.found, self.document, self.sentence)
        write_page(page, folder / "report.html", folder / "figures")
        return {"seconds": self.found.seconds, **machine()}


def catalogue_of(rig: RigParameters) -> Mapping[str, Known]:
    """Effects that the rig's file names, by name."""
    return {h.name: h for h in model_of(rig).hypotheses}


@dataclass(frozen=True)
class RigQuestion(Question):
    """A recording of a rig, and the rig.

    Attributes:
        recording: what was recorded.
        rig: what the twin believes.
        options: of the search.
        asked: the question as JSON types.
    """

    recording: RigRecording
    rig: RigParameters
    options: Options
    asked: Mapping[str, Any]

    @property
    def about(self) -> str:
        return f"{self.recording.path}: {len(self.recording.time_s)} samples of {self.rig.name} ..."

    @property
    def catalogue(self) -> Mapping[str, Known]:
        return catalogue_of(self.rig)

    def answered_in(self, folder: Path) -> bool:
        return answers(folder, self.asked, self.recording.sha256)

    def answer(self) -> RigDiscovered:
        return RigDiscovered(self, discover_rig(self.recording, self.rig, self.options))


def ask(
    read: Sequence[Opened], engine: AnyEngine | None, channels: Channels | None, question: Asked
) -> RigQuestion:
    """Check a recording of a rig; see `findings.Kind.ask`.

    Raises:
        InputError: a file or an option that can't be used, a recording without a reading.
    """
    (recording,) = read
    rig = rig_of(engine)
    if rig is None:
        raise InputError("engine", "no rig", "a rig", "name the rig's file")
    refuse_options({"--sensors": question.sensors, "--map-tolerance": question.map_tolerance,
                    "--reference": tuple(question.reference) or None, "--time": question.time_s},
                   f"for {rig.name}")  # fmt: skip
    search, withhold = question.settings.search.rigs, tuple(question.withhold or ())
    question.check(rig.effects)
    asked = {
        "withhold": list(withhold), "seed": question.random_seed, "code_version": __version__,
        "engine_sha256": sha256(rig.model_dump_json().encode()).hexdigest(),
        "search_sha256": params_sha256(search.model_dump(mode="json")), "channels_sha256": channels_sha256(channels),
    }  # fmt: skip
    options = Options(withhold=withhold, seed=question.random_seed, search=search)
    return RigQuestion(rig_recording(recording, rig, all_readings=True), rig, options, asked)


@dataclass(frozen=True, repr=False)
class RigIdentified(Result):
    """A rig's parameters, and the sizes of its terms, fitted to a recording.

    Attributes:
        engine: the rig with them.
        recording: that it was fitted to.
        seconds: wall time.
        off: column -> root mean square error of the fitted rig's free runs [unit of the reading].
        notes: what reading did to the recording.
    """

    engine: RigParameters
    recording: RigRecording
    seconds: float
    off: Mapping[str, float]
    notes: tuple[Note, ...] = ()

    @property
    def sentence(self) -> str:
        rows = self.table()
        values = (f"{n} {m:.4g} ± {s:.2g}" for n, m, s in zip(rows.index, rows["mean"], rows["std"], strict=True))
        return f"{self.engine.name}: {', '.join(values)}."

    def lines(self) -> list[str]:
        off = ", ".join(f"{name} {size:.3g}" for name, size in self.off.items())
        untold = [name for name, p in self.engine.parameters.items() if not (p.std or 0.0) <= UNTOLD * p.prior_std]
        said = [self.sentence, f"error of free runs (rms): {off}"]
        if untold:
            said.append(f"note: this recording says next to nothing of {', '.join(untold)}: what stands there is what "
                        "was believed before")
        return [*said, *self.notes]

    def table(self) -> pd.DataFrame:
        """One row a parameter or term: mean, standard deviation in the size of the misfit, unit."""
        rows = {name: {"mean": p.value, "std": p.std, "unit": p.unit} for name, p in self.engine.parameters.items()}
        rows |= {t.effect: {"mean": t.magnitude, "std": t.std, "unit": self.engine.effects[t.effect].unit}
                 for t in self.engine.terms}  # fmt: skip
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis("parameter")

    def plot(self, name: str | None = None) -> Figure:
        """`readings`: the fitted machine in free runs beside what was recorded."""
        return _over_readings(self, self.engine, self.recording, name)

    def save(self, out: str | Path) -> Path:
        """engine.yaml with the fitted values, runtime.json."""
        with atomic_folder(out, owned=("engine.yaml", "runtime.json")) as folder:
            save_rig(self.engine, folder / "engine.yaml")
            write_json(folder / "runtime.json", {"seconds": self.seconds, **machine()})
        return Path(out)


def identify_rig(recording: Source | RigRecording, rig: RigParameters) -> RigIdentified:
    """Fit a rig's parameters to a recording.

    Raises:
        InputError: what can't be used.
    """
    began = time.perf_counter()
    source = rig_recording(recording, rig, all_readings=True)
    found = fitted_surely(rig, source)[0]
    off = dict(zip(rig.readings, map(float, run_error(found, source)), strict=True))
    return RigIdentified(found, source, time.perf_counter() - began, off, source.notes)
