"""Settled points of a diesel engine: calibrated with, searched for what is missing, answered for."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from dieseltwin.api.engines import AnyEngine, diesel_engine
from dieseltwin.api.findings import Asked, Discovered, Question
from dieseltwin.api.reading import Channels, Opened, Source, settled_points
from dieseltwin.api.results import Result, drawn
from dieseltwin.atomic import atomic_folder, check_writable
from dieseltwin.calibration.calibrate import Calibration, read_geometry
from dieseltwin.calibration.calibrate import calibrate as calibrated
from dieseltwin.calibration.discover import Options, PointsDiscovery, discover_points
from dieseltwin.calibration.imply import Answers, contradictions
from dieseltwin.calibration.saved import (
    Repaired,
    answers_of,
    as_repaired_by,
    base_and_geometry,
    calibration_sidecar,
    load_repaired,
    other_points,
    repaired_by,
    write_calibration,
    write_repaired,
)
from dieseltwin.calibration.told_apart import unseen
from dieseltwin.calibration.verdict import details, document
from dieseltwin.discovery.verdict.document import Discrepancy
from dieseltwin.engine import EngineParameters
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.errors import InputError
from dieseltwin.learning.files import learned_engine_of
from dieseltwin.notes import Note, doubts_among, of_reading, warnings_of
from dieseltwin.recordings.channels import INPUTS, SENSORS
from dieseltwin.recordings.reader import write_recording
from dieseltwin.recordings.steady_points import SINCE, STATES, USUAL_CHARGE, SteadyPoints, beside_reference
from dieseltwin.report import calibration as pages
from dieseltwin.report import points as points_pages
from dieseltwin.report.page import write_page
from dieseltwin.report.style import ReportFigure
from dieseltwin.settings.names import refuse_options, unknown_name
from dieseltwin.settings.params import params_sha256
from dieseltwin.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NEEDED = (*INPUTS, *SENSORS, "w_c_kg_s")
SHOWN = 5  # names of a round in the printed lines
DECIDED = 0.5  # of a variance, from which beliefs are said to decide
FAR = 3.0  # standard deviations of the inputs that the engine was calibrated with


# --- calibrate


@dataclass(frozen=True, repr=False)
class Calibrated(Result):
    """An engine calibrated to settled points.

    Attributes:
        found: coefficients with covariance, fits, notes.
        seconds: wall time [s].
    """

    found: Calibration
    seconds: float

    @property
    def engine(self) -> EngineParameters:
        """The calibrated engine."""
        return self.found.engine

    @property
    def sentence(self) -> str:
        return (f"{self.found.points.size} points ({self.found.points.origin}), "
                f"{int(self.found.held_out.sum())} held out")  # fmt: skip

    def table(self) -> pd.DataFrame:
        """One row a submodel: misfit of the fitted and of the held-out points [%], R2, tolerance [%]."""
        rows = {name: {"fit_pct": f.train, "held_out_pct": f.held_out, "median_pct": f.median_held_out,
                       "r2_held_out": f.coefficient_of_determination, "tolerance_pct": 100.0 * f.tolerance}
                for name, f in self.found.fits.items()}
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis("submodel")

    def plot(self, name: str | None = None) -> Figure:
        """`submodels`: measured against predicted, the held-out third in another colour."""
        return drawn(self.found, {"submodels": lambda found: pages.submodels(found).still}, name)

    def save(self, out: str | Path) -> Path:
        """The engine file, its sidecar, a report with figures, and a channel map if an actuator is turned round."""
        out = Path(out)
        check_writable(out)
        with atomic_folder(out.parent) as folder:  # an engine file never stands beside another calibration's numbers
            write_calibration(self.found, folder / out.name)
            pages.calibration_report(self.found, (folder / out.name).with_suffix(".html"))
        return out

    @property
    def warnings(self) -> list[dict[str, Any]]:
        """As in the sidecar."""
        return warnings_of(doubts_among(self.found.notes))

    def beside(self, out: Path) -> tuple[str, ...]:
        """Names of the files that `save` writes beside the engine's, the channel map left out."""
        return calibration_sidecar(out).name, out.with_suffix(".html").name

    def lines(self) -> list[str]:
        found = self.found
        lines = [self.sentence, "submodel              fit %  held out %  R2 held out  tolerance %"]
        lines += [f"{name:20s} {fit.train:6.2f} {fit.held_out:11.2f} {fit.coefficient_of_determination:12.4f} "
                  f"{100 * fit.tolerance:12.2f}" for name, fit in found.fits.items()]
        weak = [c.name for c in found.coefficients if c.verdict == "prior only"]
        if weak:
            lines.append(f"decided by the base engine, not by the points: {', '.join(weak)}")
        return [*lines, *(f"- {note}" for note in found.notes)]


def calibrate_points(
    points: Source | SteadyPoints,
    base: EngineParameters,
    geometry: EngineParameters | Mapping[str, Any] | str | Path | None,
    channels: Channels | None,
    noise_pct: float | None,
    seed: int,
) -> Calibrated:
    """See `calibration.calibrate`.

    Raises:
        InputError: files that can't be used, too few points, swapped columns.
    """
    shape = base if geometry is None else read_geometry(geometry, base)
    source = settled_points(points, channels, shape, NEEDED)
    noise = None if noise_pct is None else {name: noise_pct / 100.0 for name in STATES}
    began = time.perf_counter()
    found = calibrated(source, base, shape, noise=noise, seed=seed, where=str(source.path or "points"))
    return Calibrated(found, time.perf_counter() - began)


# --- discover

_MEAN_MAPS = ("the maps are corrected as they were learned from driving; settled points make no use of how well these "
              "corrections are known, and the repaired engine doesn't hold it")  # fmt: skip


@dataclass(frozen=True, repr=False)
class PointsDiscovered(Discovered):
    """What settled points say that the mean-value model lacks.

    Attributes:
        found: every name that was tried, and the engine with those that were taken.
        asked: the question as JSON types, for `details.json`.
        seconds: wall time of the answer [s].
    """

    own_files = ("implied.parquet", "repaired.yaml", "repaired.steady.json", "report_figures")

    found: PointsDiscovery
    asked: Mapping[str, object]
    seconds: float

    @cached_property
    def document(self) -> Discrepancy:
        return document(self.found)

    @cached_property
    def answers(self) -> Answers:
        """What answers for unmeasured places, one for every formulation."""
        return answers_of(self.found)

    @property
    def engine(self) -> EngineParameters:
        return self.found.engine()

    @property
    def sentence(self) -> str:
        return points_pages.sentence(self.found)

    def plot(self, name: str | None = None) -> Figure:
        """`errors`: of the submodels with and without what was found, point by point; `before_after` over what the laws
        depend on, where there is one; `submodels_repaired`, `implied`."""

        def before_after(found: PointsDiscovery) -> ReportFigure | None:
            series = points_pages.over_arguments(found)
            return None if series is None else series.still

        drawings = {
            "before_after": before_after, "errors": lambda found: points_pages.over_points(found).still,
            "submodels_repaired": lambda found: points_pages.submodels(found).still,
            "implied": lambda found: points_pages.implied_figure((used := found.points.judged).columns,
                                                                 self.answers(used)),
        }  # fmt: skip
        return drawn(self.found, drawings, name)

    def _details(self) -> Mapping[str, Any]:
        return details(self.found, self.asked)

    def _write(self, folder: Path, began: float) -> dict[str, Any]:
        used = self.found.points.judged
        implied = self.answers(used)
        write_repaired(self.found, folder / "repaired.yaml", self.answers)
        _beside(used, implied).to_parquet(folder / "implied.parquet", index=False)
        page = points_pages.points_page(self.found, self.document, self.sentence, implied)
        write_page(page, folder / "report.html", folder / "figures")
        return {"seconds": self.seconds + time.perf_counter() - began, "version": __version__}

    def lines(self) -> list[str]:
        tried = [
            f"round {k}: {points_pages.name_words(name) + since:35s} gain {item.found.gain(fit):8.1f}  "
            f"{fit.magnitudes[0]:.4g} {item.found.twin.hypotheses[name].unit.strip('-')}"
            f"{'  taken' if taken else ''}".rstrip()
            for k, item in enumerate(self.found.rounds, 1) for name, since, fit, taken in item.tried(SHOWN)
        ]  # fmt: skip
        said = self.document
        since = [f"{name} {now.since_reference.text}" for name, now in said.health.items()
                 if now.since_reference is not None]
        health = [f"since the reference: {', '.join(since)}"] if since else []
        return [*tried, "", self.sentence, *health, *(f"note: {doubt.text}" for doubt in said.warnings), *unseen(said)]


@dataclass(frozen=True)
class PointsQuestion(Question):
    """Settled points, and what their engine was calibrated from.

    Attributes:
        points: inputs and all readings; those of a reference among them.
        base: engine whose coefficients are believed before.
        geometry: engine with the size of this one.
        seed: of the held-out third.
        options: of the search.
    """

    points: SteadyPoints
    base: EngineParameters
    geometry: EngineParameters
    seed: int
    options: Options

    @property
    def asked(self) -> dict[str, object]:
        """The question as JSON types."""
        options = self.options
        count = self.points.size - self.points.judged.size
        return {
            "reference_points": count, "sensors": list(options.sensors) if options.sensors else None,
            "withhold": list(options.withhold), "seed": self.seed,
            "search_sha256": params_sha256(options.search.model_dump(mode="json")), "code_version": __version__,
        }  # fmt: skip

    @property
    def about(self) -> str:
        judged = self.points.judged.size
        beside = f", {self.points.size - judged} of the reference" if judged < self.points.size else ""
        return f"{self.points.path or 'points'}: {judged} points{beside} ..."

    def answer(self) -> PointsDiscovered:
        began = time.perf_counter()
        first = calibrated(self.points, self.base, self.geometry, seed=self.seed,
                           where=str(self.points.path or "points"), believed=self.options.search)
        found = discover_points(first, self.options)
        return PointsDiscovered(found, self.asked, time.perf_counter() - began)


def ask(
    read: Sequence[Opened], engine: AnyEngine | None, channels: Channels | None, question: Asked
) -> PointsQuestion:
    """Read settled points, and the engine file's sidecar where there is one; see `findings.Kind.ask`."""
    (points,) = read
    refuse_options({"--map-tolerance": question.map_tolerance, "--time": question.time_s,
                    "--explain": question.explain}, "for settled points")  # fmt: skip
    sensors, search = tuple(question.sensors or ()), question.settings.search.points
    if isinstance(engine, str | Path) and Path(engine).is_file():
        base, geometry = base_and_geometry(Path(engine))
    else:
        base = geometry = diesel_engine(engine)
    for name in sensors:
        if name not in STATES:
            raise unknown_name("--sensors", name, list(STATES))
    question.check(EFFECTS, search.withhold)
    options = Options(sensors=sensors or None, withhold=tuple(question.withhold or ()), seed=question.random_seed,
                      search=search)
    source = settled_points(points, channels, geometry, NEEDED)
    if isinstance(engine, str | Path) and not question.reference:
        source = as_repaired_by(Path(engine), source)
        source = replace(source, notes=(*source.notes, *other_points(Path(engine), source)))
    if learned_engine_of(engine) is not None:
        source = replace(source, notes=(*source.notes, _MEAN_MAPS))
    well = [settled_points(reference, channels, geometry, NEEDED) for reference in question.reference]
    used = beside_reference(source, well) if well else source
    return PointsQuestion(used, base, geometry, question.random_seed, options)


# --- imply


@dataclass(frozen=True, repr=False)
class Implied(Result):
    """Every quantity that nobody measured, for each point.

    Attributes:
        points: what was given.
        quantities: implied columns, each with `<column>_std` where it has one.
        notes: what is doubtful, one line each.
    """

    points: SteadyPoints
    quantities: pd.DataFrame
    notes: tuple[Note, ...]

    @property
    def sentence(self) -> str:
        names = [str(name) for name in self.quantities if not str(name).endswith("_std")]
        return f"{len(self.quantities)} points, {', '.join(names)}"

    def table(self) -> pd.DataFrame:
        """Row of the file, what was given, what is implied."""
        return _beside(self.points, self.quantities)

    def plot(self, name: str | None = None) -> Figure:
        """`implied`: four quantities with their standard deviations over the air flow."""
        columns = {str(column): values.to_numpy() for column, values in self.table().items()}
        return drawn(self, {"implied": lambda s: points_pages.implied_figure(columns, s.quantities)}, name)

    def save(self, out: str | Path) -> Path:
        """The table as .csv or .parquet."""
        return write_recording(self.table(), out)

    @property
    def warnings(self) -> list[dict[str, Any]]:
        """Of the notes."""
        return warnings_of(self.notes)

    def lines(self) -> list[str]:
        return [self.sentence, *self.notes]


def imply(
    points: Source | SteadyPoints, engine: PointsDiscovered | str | Path, *, channels: Channels | None = None
) -> Implied:
    """Say, for each point, every quantity that nobody measured, with its standard deviation.

    Args:
        points: a file, a table or what `read` gave; the inputs are needed, readings help.
        engine: what `discover` found on points, or the repaired.yaml that it wrote.
        channels: channel map for foreign names and units.

    Raises:
        InputError: files that can't be used, an engine that wasn't repaired on points.
    """
    repaired = _repaired(engine)
    answers = repaired.answers
    source = repaired.acting(settled_points(points, channels, answers.first.model.engine, INPUTS))
    if "exhaust_flap" in answers.first.values and "u_flap_pct" not in source:
        raise InputError(f"{source.path or 'points'}: column u_flap_pct", "none",
                         "this column: the engine has an exhaust flap", "add the flap's position")
    straight = source.with_columns(**{column: 100.0 - source[column] for column in repaired.turned})
    notes = [*contradictions(straight, answers.first.misfit(straight)),
             *outside(straight, answers.first.guess.centre, answers.first.guess.spread)]  # fmt: skip
    decided = [f"{column} ({100 * share:.0f} %)" for column, share in answers.disagreement(straight).items()
               if share > DECIDED]
    if decided:
        notes.insert(0, Note("beliefs decide (share of the variance that formulations of the unmeasured places "
                             f"disagree about): {', '.join(decided)}", "not_identifiable"))  # fmt: skip
    return Implied(source, answers(straight), (*map(of_reading, source.notes), *notes))


def _repaired(engine: PointsDiscovered | str | Path) -> Repaired:
    if isinstance(engine, str | Path):
        return load_repaired(Path(engine))
    if not isinstance(engine, PointsDiscovered):
        raise InputError("engine", f"a {type(engine).__name__}", "what `discover` found on points, or its file",
                         "run `dieseltwin discover POINTS --engine engine.yaml --out DIR` first")  # fmt: skip
    return repaired_by(engine.found, engine.answers)


def outside(source: SteadyPoints, centre: np.ndarray, spread: np.ndarray) -> list[Note]:
    """One line if points lie beyond `FAR` standard deviations of the inputs that the engine was calibrated with."""
    far = (np.abs(source.inputs() - centre) > FAR * spread).any(axis=1)
    if not far.any():
        return []
    return [Note(f"{int(far.sum())} points lie far from those of the calibration: extrapolated", "extrapolated")]


def _beside(points: SteadyPoints, implied: pd.DataFrame) -> pd.DataFrame:
    """The implied quantities beside what was given; an implied column stands in for a given one."""
    given: Mapping[str, np.ndarray] = {"row": points.row, **points.columns}
    frame = pd.DataFrame({name: values for name, values in given.items() if not name.startswith((SINCE, USUAL_CHARGE))})
    return pd.concat([frame.drop(columns=[c for c in implied if c in frame]), implied], axis=1)
