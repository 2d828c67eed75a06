"""Learning an engine from recordings of when it was known to be well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from dieseltwin.api.engines import AnyEngine, diesel_engine, named, petrol_base
from dieseltwin.api.petrol import PetrolCalibrated, learn_petrol
from dieseltwin.api.reading import Channels, Made, Source, of_a_healthy_engine, several
from dieseltwin.api.reference_faults import alike_line, hidden_line, suspected_faults
from dieseltwin.api.results import Result, drawn
from dieseltwin.api.siblings import siblings_of, what_they_say
from dieseltwin.discovery.reference.evidence import Learned
from dieseltwin.discovery.reference.learn import learn_engine
from dieseltwin.discovery.verdict.checks import check_recording, check_rows
from dieseltwin.engine import HEALTH, MEASURED, EngineParameters
from dieseltwin.engine.map_corrections import ARGUMENTS, CORRECTED_POINTS, basis
from dieseltwin.errors import InputError
from dieseltwin.learning.belief import HEALTH_AT, about_corrections, is_about_corrections, prior_belief
from dieseltwin.learning.domain import KNOWN_SHARE, functions_on_maps, share_of_box, uncertainty_along
from dieseltwin.learning.files import LearnedEngine, going_on, learned_engine_of, save_learned, seal_of
from dieseltwin.learning.levels import health_covariance
from dieseltwin.learning.weather import exponent_words, of_own_weather
from dieseltwin.notes import Note, of_reading
from dieseltwin.paths import YAML_ENDINGS
from dieseltwin.petrol.parameters import PetrolParameters
from dieseltwin.recordings.columns import Columns
from dieseltwin.recordings.reader import Recording
from dieseltwin.recordings.shared_rows import distinct, overlap, refuse_overlapping
from dieseltwin.recordings.standing import of_all_weathers
from dieseltwin.report import quantities
from dieseltwin.report.discovery_words import magnitude_words
from dieseltwin.report.learned import corrections
from dieseltwin.settings.defaults import default_learn
from dieseltwin.settings.names import refuse_options

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_FAR_OFF = 3.0  # times what is believed of a map, of a correction: by chance one map in some hundred engines
_UNTOLD = 0.9  # of the variance of health that was believed, from which on nothing was learned of it
_WHOLE = 0.95  # of a box that is known, from which on none of it is said to be unknown
MAP_ERRORS = (0.001, 0.1)


@dataclass(frozen=True, repr=False)
class LearnedResult(Result):
    """What is known of an engine.

    Attributes:
        known: the engine with mean and covariance of its health, maps and sensors.
        found: how the fit went, and by what the reference itself looks faulty.
        notes: what is doubtful about the recordings, one sentence each.
        read: file that is known further, and its seal as it was read; None where nothing was learned before.
    """

    known: LearnedEngine
    found: Learned
    notes: tuple[str, ...]
    read: tuple[Path, str] | None = None

    @property
    def engine(self) -> EngineParameters:
        """The engine as it was learned; the result itself, or its file, also says how surely: give `discover` those."""
        return self.known.engine

    @property
    def sentence(self) -> str:
        maps = self.table()
        learned = ", ".join(f"{point} by {row.corrected_pct:.1f} %" for point, row in maps.iterrows())
        return f"Learned from {self.known.heard}; maps corrected: {learned or 'none'}."

    def table(self) -> pd.DataFrame:
        """One row a map: what was believed of its error before, the correction, how well it is known now (rms) [%]."""
        rows = {row.point: {"believed_pct": 100.0 * row.believed, "corrected_pct": 100.0 * row.corrected,
                            "known_to_pct": 100.0 * row.known_to} for row in corrected_maps(self.known)}
        return pd.DataFrame.from_dict(
            rows, orient="index", columns=["believed_pct", "corrected_pct", "known_to_pct"]
        ).rename_axis("map")

    def plot(self, name: str | None = None) -> Figure:
        """`maps`: belief before, correction, and what is left unknown, for every map."""
        return drawn(self.table(), {"maps": corrections}, name)

    def save(self, out: str | Path) -> Path:
        """Write the engine file and, beside it, what it rests on.

        Raises:
            InputError: no .yaml, a place that can't be written to, or a file that more was learned into meanwhile.
        """
        if Path(out).suffix.lower() not in YAML_ENDINGS:
            raise InputError(f"save({str(out)!r})", "another ending", ", ".join(YAML_ENDINGS), "choose one of them")
        path, seal = self.read or (None, "")
        if path is not None and Path(out).resolve() == path and path.is_file() and seal_of(path) != seal:
            raise InputError(str(out), "a learned engine that isn't the one read", "the file as it was when this began",
                             "learn again with --engine naming it, or choose another --out")  # fmt: skip
        save_learned(self.known, Path(out))
        return Path(out)

    def lines(self) -> list[str]:
        """For people: notes, then health and every map."""
        return [*self.notes, *summary(self.known)]


def learn(
    recordings: Source | Made | Sequence[Source | Made],
    engine: AnyEngine | None = None,
    *,
    channels: Channels | None = None,
    sensors: Sequence[str] | None = None,
    map_error: float | None = None,
    siblings: str | Path | Sequence[str | Path] = (),
) -> LearnedResult | PetrolCalibrated:
    """Learn an engine's own maps, health and sensors from ordinary driving.

    A petrol engine's maps are all of its own: it is calibrated on all recordings together.

    Args:
        recordings: of the engine when it was known to be well, files or tables, over time or settled points in any
            mix; one that comes twice counts once.
        engine: the base, or the file of an engine that was learned before, which is then known further.
        channels: channel map of the recordings.
        sensors: columns to use; None is all that there are, which must be the paper's five at least.
        map_error: size of the maps' errors that is believed [-]; None takes that of params.yaml.
        siblings: files of learned engines of the same type; what their maps have in common is believed of this one.

    Raises:
        InputError: a recording that can't be used or that isn't of this engine, none at all, another size of errors
            than the engine or a sibling was learned with, a sibling that nothing was learned of or of another base.
    """
    recordings, siblings = several(recordings), several(siblings)
    if not recordings:
        raise InputError("HEALTHY", "no recording", "one or more of the engine when it was well", "name them")
    petrol = None if engine is None else petrol_base(engine)
    if petrol is not None:
        refuse_options({"--map-error": map_error, "--siblings": siblings or None, "--sensors": sensors},
                       "for a petrol engine")  # fmt: skip
        if petrol.calibrated:
            raise InputError("--engine", f"{named(engine, petrol)}, which has its maps", "a petrol engine without maps",
                             f"name {PetrolParameters().name} or the file of volumes, and all recordings at once")
        return learn_petrol(recordings, petrol, channels)
    return _learn_diesel(recordings, engine, channels, sensors, map_error, siblings)


def _learn_diesel(
    recordings: Sequence[Source | Made], engine: AnyEngine | None, channels: Channels | None,
    sensors: Sequence[str] | None, map_error: float | None = None, siblings: Sequence[str | Path] = (),
) -> LearnedResult:  # fmt: skip
    low, high = MAP_ERRORS
    if map_error is not None and not low <= map_error <= high:
        raise InputError("--map-error", f"{map_error:g}", f"{low:g} to {high:g}", "choose another")
    file = Path(engine).resolve() if isinstance(engine, str | Path) and Path(engine).is_file() else None
    read = None if file is None else (file, seal_of(file))
    before = learned_engine_of(engine)
    base = diesel_engine(engine) if before is None else before.base
    notes = going_on(str(engine) if isinstance(engine, str | Path) else "the engine", base, before)
    if before is not None and map_error is not None and map_error != before.map_rms:
        raise InputError("--map-error", f"{map_error:g}", f"{before.map_rms:g}, as {engine} says", "leave it out")
    settings = default_learn()
    size = before.map_rms if before is not None else settings.map_error if map_error is None else map_error
    base, about = about_corrections(base, size)
    began = before is not None and before.prior is not None and is_about_corrections(before.prior, base, size)
    if siblings and (about is not None or began):
        raise InputError("--siblings", "beside an engine whose maps are corrected", "siblings of the base as it was",
                         "name the engine without corrections, or leave the siblings out")  # fmt: skip
    sources: list[Recording] = []
    for item in recordings:
        days = of_a_healthy_engine(item, channels, base)
        whole = of_all_weathers(days)
        used, doubts = check_recording(whole, base, sensors)
        notes += [of_reading(note, f"{whole.path or 'recording'}: ") for note in (*whole.notes, *doubts)]
        for source in days:
            if sensors is not None:
                source = replace(source, columns=Columns({
                    name: values for name, values in source.columns.items() if name not in MEASURED or name in used}))
            sources.append(source)
    earlier = () if before is None else before.recordings
    known_rows = {item.rows_sha256 for item in earlier}
    together = [*earlier, *(item for item in distinct(sources) if item.rows_sha256 not in known_rows)]
    check_rows(*together)
    refuse_overlapping(together, overlap, first=len(earlier))
    others = siblings_of(siblings, base, size, [*sources, *earlier])
    if others and before is not None and before.prior is not None:
        notes.append("note: what engines of its type told of it before is not counted any more: the siblings named now "
                     "say it, so name all of them")  # fmt: skip
    prior, of_type = what_they_say(others.values(), of_own_weather(base, together), size) if others else (about, None)
    known, found = learn_engine(sources, base, size, before, settings, prior, of_type)
    _check_misfits(known, found.misfit_marks(settings))
    _check_told(known)
    least = settings.suspicious_gain
    suspected = [*_suspected(found, [*sources, *known.recordings]),
                 *suspected_faults(known, least, bool(found.suspicions))]  # fmt: skip
    known = replace(known, suspected=(*_far_off(known), *suspected))
    notes += [f"note: --siblings {name}: {doubt}; what the type has in common is learned from it all the same, "
              "so leave it out if it wasn't well" for name, one in others.items() for doubt in one.doubts]  # fmt: skip
    notes += [f"note: {doubt}" for doubt in known.doubts]
    return LearnedResult(known, found, tuple(notes), read)


def known_engine(
    engine: AnyEngine | None, reference: Sequence[Source | Recording], channels: Channels | None,
    sensors: Sequence[str] | None = None,
) -> tuple[LearnedEngine, Sequence[Note]]:  # fmt: skip
    """What recordings of an engine when it was well tell of it, and notes.

    Raises:
        InputError: as `learn`.
    """
    result = _learn_diesel(reference, engine, channels, sensors)
    return result.known, [Note(note.removeprefix("note: "), "reference") for note in result.notes]


def learned_summary(engine: Path) -> list[str]:
    """`summary` of an engine file; nothing where it wasn't learned.

    Raises:
        InputError: a file that can't be used.
    """
    known = learned_engine_of(engine)
    return [] if known is None else summary(known)


def summary(learned: LearnedEngine) -> list[str]:
    """What is known, as lines of text: health, and of every map how much it was corrected, how well, and where."""
    belief = learned.belief
    std = np.sqrt(np.diag(health_covariance(learned)))
    lines = [f"learned from {learned.heard}"]
    lines += [
        f"  {name:<10}{_in_its_unit(name, value):>17} ± {100 * s / value:.2g} %, {100 * (value / then - 1):+.1f} % "
        "from the base"
        for name, value, s, then in zip(HEALTH, belief.health, std, learned.base.health(), strict=True)
    ]
    lines += exponent_words(learned.exponents, learned.of_type)
    further = learned.further
    rough, of_ratio = (100.0 * learned.errors * v**0.5 for v in (further.rough, further.of_ratio))
    if further.size > 1.0:
        lines.append(f"  its maps are off by more than usual: errors of {100.0 * learned.errors:.2g} % are believed, "
                     f"not {100.0 * learned.map_rms:.2g} %")  # fmt: skip
    if further.smooth > 1.0:
        lines.append(f"  they are smoother than usual: {further.smooth:.3g} times the correlation length is believed")
    if rough > 0.0:
        lines.append(f"  its maps are rougher than usual: further errors of {rough:.2g} % with half the correlation "
                     "are believed")  # fmt: skip
    if of_ratio > 0.0:
        lines.append("  its turbine's efficiency is off by more than speed and pressures say: further errors of "
                     f"{of_ratio:.2g} % over the blade speed ratio are believed")  # fmt: skip
    least = default_learn().suspicious_gain
    lines += alike_line(learned, least)
    known = {row.point: row for row in corrected_maps(learned)}
    for point in CORRECTED_POINTS:
        if point not in known:
            lines.append(f"  {point:<10}nothing is known of this map beyond what was believed")
            continue
        row = known[point]
        ranges = ", ".join(
            f"{argument} {_as_read(argument, low)} to {_in_its_unit(argument, high)}"
            for argument, (low, high) in ((a, learned.domain[point][a]) for a in ARGUMENTS[point])
        )
        where = f"for {ranges}" if row.share > _WHOLE else f"in {100 * row.share:.0f} % of {ranges}"
        lines.append(f"  {point:<10}corrected by {100 * row.corrected:.1f} % rms, known to {100 * row.known_to:.2g} %, "
                     f"{where}")  # fmt: skip
    return [*lines, *hidden_line(learned, least)]


def _as_read(name: str, value: float) -> str:
    """A value [SI] of the nomenclature in the unit that an engineer reads, four digits: "10160" rad/s."""
    return f"{float(f'{value * quantities.factor(name):.4g}'):g}"


def _in_its_unit(name: str, value: float) -> str:
    """The same with its unit, "425.6 mm²"."""
    return quantities.before_unit(name, _as_read(name, value))


@dataclass(frozen=True)
class CorrectedMap:
    """A map of which something was learned; sizes are root mean squares over where it is known [-].

    Attributes:
        point: what it corrects.
        believed: its error, as believed before.
        corrected: the correction.
        known_to: standard deviation that is left.
        share: part that is known of the box of the learned domain, from the lowest to the highest argument [-].
    """

    point: str
    believed: float
    corrected: float
    known_to: float
    share: float


def corrected_maps(learned: LearnedEngine, about: np.ndarray | None = None) -> list[CorrectedMap]:
    """Every map of which something was learned, where the belief was cut to less than half; `about`: coefficients (K,)
    from which the corrections count, None for none."""
    belief, functions = learned.belief, basis()
    corrections = belief.coefficients if about is None else belief.coefficients - about
    tables = functions_on_maps(learned.base)
    uncertain = uncertainty_along(belief, tables)
    prior = uncertainty_along(prior_belief(learned.base, learned.errors), tables)
    rows = []
    for m, point in enumerate(CORRECTED_POINTS):
        if point in learned.domain:
            inside, at = uncertain[m] < KNOWN_SHARE * learned.errors, functions.maps == m  # as `domain_of`
            parts = (prior[m][inside], corrections[at] @ tables[at][:, inside], uncertain[m][inside])
            believed, corrected, known_to = (float(np.sqrt(np.mean(part**2))) for part in parts)
            rows.append(CorrectedMap(point, believed, corrected, known_to, share_of_box(inside)))
    return rows


def _check_misfits(known: LearnedEngine, marks: Sequence[float]) -> None:
    """Refuse recordings that aren't explained with all maps corrected; the one that fits worst is named, of those of
    now before earlier ones. A recording of another engine bends the maps that it shares, and the others' misfit grows.

    Args:
        marks: largest misfit of each of the recordings, in their order.
    """
    misfits = [known.misfits[one.sha256] for one in known.recordings]
    each = zip(known.recordings, misfits, marks, strict=True)
    strange = [item for item in each if not item[1] <= item[2]]  # NaN, too
    if strange:
        worst, misfit, mark = max(
            strange, key=lambda item: (item[0].path is not None, np.nan_to_num(item[1] / item[2], nan=np.inf)))
        raise InputError(
            str(worst.path or "recording"),
            f"{misfit**0.5:.2f} times the noise is left with all maps corrected",
            f"up to {mark**0.5:.2f} for a healthy engine of this kind",
            "check that it is this engine, that it was well, and that its columns and units are right",
        )  # fmt: skip


def _check_told(known: LearnedEngine) -> None:
    """Refuse recordings of which nothing came to be known: a fit that ended where the simulation runs away in every
    window left the engine as it was believed to be, without a misfit and without a word."""
    before, after = (np.diag(belief.covariance)[HEALTH_AT] for belief in (known.believed, known.belief))
    if np.all(after > _UNTOLD * before):
        first = next((item for item in known.recordings if item.path is not None), known.recordings[0])
        raise InputError(
            str(first.path or "recording"), "nothing that tells health or maps: the fit ended where no stretch of it "
            "can be simulated", "driving of this engine when it was well",
            "check its columns, units and clocks, and try other recordings of it",
        )  # fmt: skip


def _far_off(known: LearnedEngine) -> list[str]:
    """That maps had to be corrected by far more than what is believed of them, the worst one."""
    off = max(corrected_maps(known, known.believed.coefficients), key=lambda row: row.corrected, default=None)
    if off is None or off.corrected <= _FAR_OFF * known.map_rms:
        return []
    return [
        f"the map of {off.point} is corrected by {100 * off.corrected:.0f} % rms where {100 * known.map_rms:g} %"
        " was believed before it was recorded: another engine than the base, a sensor that reads wrongly or a fault in "
        "the reference; where the maps may be off by so much, --map-error "
        f"{min(off.corrected, MAP_ERRORS[1]):.2f} says so"
    ]


def _suspected(found: Learned, sources: Sequence[Recording]) -> list[str]:
    """By what the recordings look faulty themselves, or another engine's; `sources`: those with names first."""
    strange = [
        f"{item.column} of the reference would be {item.value:.4g} {item.unit}, {item.deviations:.1f} standard "
        "deviations from what is believed: another displacement than the engine file's, or a sensor that reads wrongly"
        for item in found.strange
    ]
    if not found.suspicions:
        return strange
    first = found.suspicions[0]
    size = magnitude_words(first.name, first.magnitude, first.std, first.unit, extra=False, digits=2)
    others = ", ".join(item.name for item in found.suspicions[1:4])
    told = f" (or {others})" if others else ""
    if first.alone is not None:
        one = next(item for item in sources if item.sha256 == first.alone)
        began = "" if one.began is None else f" of {one.began:%Y-%m-%d}"
        name = one.path or f"one of the recordings that it was learned from before{began}"
        return [
            *strange,
            f"{name} looks like {first.name} of {size}{told}, the others don't ({np.sqrt(first.gain):.1f} standard "
            "deviations): leave it out if the engine wasn't well then; it is now part of what counts as healthy"
        ]
    return [
        *strange,
        f"the reference itself looks like {first.name} of {size}{told}: more than errors of maps explain "
        f"({np.sqrt(first.gain):.1f} standard deviations); it is now part of what counts as healthy, and its end would "
        "look like a fault"
    ]
