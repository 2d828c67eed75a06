"""One row a case: what was true, what was said, and how far apart they are. The metrics only count these rows."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from dieseltwin.atomic import write_json
from dieseltwin.challenge import petrol_cases
from dieseltwin.challenge.cases import MAP_RMS, Tier, maps_of
from dieseltwin.challenge.map_errors import MapErrors
from dieseltwin.challenge.own_engine import TIERS
from dieseltwin.challenge.plant_effects import FAMILIES, Fault
from dieseltwin.challenge.run import FAILED, RESULTS
from dieseltwin.challenge.seal import SEALED
from dieseltwin.challenge.stamps import code_sha256
from dieseltwin.discovery.verdict.document import FILE_NAME, NONE_OF_THESE, Discrepancy, load_discrepancy
from dieseltwin.engine import HEALTH, EngineParameters, we2011
from dieseltwin.engine.engine_files import load_engine
from dieseltwin.engine.terms import Term, as_later
from dieseltwin.errors import InputError
from dieseltwin.paths import file_sha256
from dieseltwin.recordings.reader import Recording, read_recording
from dieseltwin.sealed import read_json, sealed_json
from dieseltwin.settings.defaults import default_search

_SCORER = (
    *(f"challenge/{name}.py" for name in (
        "records", "oracle", "laws", "map_errors", "plant", "plant_constants", "plant_effects", "actuators", "sensors"
    )), "engine", "discovery/likelihood", "discovery/twins", "discovery/search/preparation.py", "recordings/noise.py",
    "least_squares.py",
)  # fmt: skip
_OURS = ("a file of `challenge run`", "remove the case's results and run it again")
COUNTED_RATIO = 3.0
"""Detection, sites and names are counted from this magnitude over tolerance on (docs/benchmark.md)."""

SEPARABLE_D = 9.0


@dataclass(frozen=True)
class TrueEffect:
    """One fault: name, site, magnitude and its ratio to the tolerance; `nearest` (name, D) among the other effects
    of the catalogue at the truth, None where not computed."""

    name: str
    site: str
    magnitude: float
    ratio: float
    catalogued: bool
    nearest: tuple[str, float] | None = None

    @property
    def separable(self) -> bool | None:
        """Whether every other effect keeps D >= 9; None where not known."""
        return None if self.nearest is None else self.nearest[1] >= SEPARABLE_D


@dataclass(frozen=True)
class SaidEffect:
    """One reported effect: name, its set (name and equivalents), magnitude and standard deviation."""

    name: str
    names: tuple[str, ...]
    magnitude: float | None
    std: float | None


@dataclass(frozen=True)
class CaseRow:
    """Everything that the metrics need of one case.

    Attributes:
        kind: of the mix; partial: "onset", "region" or None; route: kind of driving.
        truth: faults; said: reported effects, strongest first; problem: why there is no result, else None.
        mismatch, p_value, site: of the document.
        health_true, health_before, health_after: name -> value.
        since_true, since_said: name -> health over that at the reference; what was said with its standard deviation.
        nll_before, nll_after, nll_oracle: per sample on the second recording; `samples` of it.
        oracle_health, oracle_magnitudes: what the oracle estimates, name -> value.
        law_error: of the found law on unseen driving, relative; None where there is none or it can't be told.
        oracle_law_error: of the true form with the oracle's magnitude, likewise: what the recording allows.
        seconds, peak_rss_mib: of the run.
    """

    case: str
    kind: str
    partial: str | None
    route: str
    truth: tuple[TrueEffect, ...]
    withhold: tuple[str, ...]
    problem: str | None = None
    mismatch: bool = False
    p_value: float | None = None
    site: str | None = None
    said: tuple[SaidEffect, ...] = ()
    health_true: Mapping[str, float] = field(default_factory=dict)
    health_before: Mapping[str, float] = field(default_factory=dict)
    health_after: Mapping[str, float] = field(default_factory=dict)
    nll_before: float | None = None
    nll_after: float | None = None
    nll_oracle: float | None = None
    since_true: Mapping[str, float] = field(default_factory=dict)
    since_said: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    oracle_health: Mapping[str, float] = field(default_factory=dict)
    oracle_magnitudes: Mapping[str, float] = field(default_factory=dict)
    samples: int = 0
    law_error: float | None = None
    oracle_law_error: float | None = None
    seconds: float | None = None
    peak_rss_mib: float | None = None

    @property
    def ratio(self) -> float:
        """Largest magnitude over tolerance; 0 for a healthy machine."""
        return max((effect.ratio for effect in self.truth), default=0.0)

    @property
    def withheld(self) -> bool:
        """Whether the tool could not know the effect's name."""
        return self.kind == "withheld"

    @property
    def said_none(self) -> bool:
        """Whether `none_of_these` was reported first."""
        return bool(self.said) and self.said[0].name == NONE_OF_THESE

    @property
    def named(self) -> frozenset[str]:
        """Every reported name, equivalents included."""
        return frozenset(name for effect in self.said for name in effect.names)

    def document(self) -> dict[str, Any]:
        """JSON types."""
        return asdict(self)


@dataclass(frozen=True)
class Scoring:
    """What the scorer asks of the tool's library.

    Attributes:
        held_out_nll: (engine, recording) -> negative log-likelihood per sample.
        fit_oracle: (recording, engine, terms) -> engine.
        separability: (recording, engine, term) -> name -> D.
        law_error: (result folder, clean held-out signals, fault, true health) -> error of the found law, or None.
        error_of: (terms, clean held-out signals, fault, true health) -> error of given terms.
        with_plant_maps: (engine, plant's maps) -> engine of an oracle that knows them; None where it doesn't.
    """

    held_out_nll: Callable[[EngineParameters, Recording], float]
    fit_oracle: Callable[..., EngineParameters]
    separability: Callable[..., Mapping[str, float]]
    law_error: Callable[[Path, pd.DataFrame, Fault, Mapping[str, float]], float | None]
    error_of: Callable[[Sequence[Any], pd.DataFrame, Fault, Mapping[str, float]], float]
    with_plant_maps: Callable[[EngineParameters, MapErrors], EngineParameters] | None = None

    @classmethod
    def of_the_tool(cls, tier: Tier) -> Scoring:
        """The functions of `dieseltwin.challenge.oracle` at the maps' tolerance of a tier, and the law's error of
        `challenge.laws`. In the own-engine tiers the oracle knows the plant's maps, and effects count as separable
        where they would be by a twin that knows them as well as the main tier's does."""
        from dieseltwin.challenge import oracle as scoring
        from dieseltwin.challenge.laws import error_of, law_error

        own = tier in TIERS
        met, apart = (scoring.MAPS_MET, MAP_RMS["main"]) if own else (MAP_RMS[tier], MAP_RMS[tier])
        return cls(
            scoring.held_out_nll, partial(scoring.fit_oracle, map_tolerance=met),
            partial(scoring.separability, map_tolerance=apart), law_error, error_of,
            scoring.with_plant_maps if own else None,
        )  # fmt: skip


def engine_terms(faults: Sequence[Fault]) -> tuple[Any, ...]:
    """The faults as terms of the tool's engine files."""
    return tuple(
        Term(effect=f.effect, magnitude=f.magnitude, onset_s=f.onset_s, region=dict(f.region) if f.region else None)
        for f in faults
    )


def case_row(folder: Path, answers: Mapping[str, Any], scoring: Scoring) -> CaseRow:
    """Compare the result of one case with its answers."""
    faults = [Fault.of(effect) for effect in answers["effects"]]
    row = diesel_row(folder, answers)
    if row.problem is not None:
        return row
    computed = _computed(folder, folder / RESULTS / row.case, answers, faults, scoring)
    near = computed.pop("nearest", None)
    if near is not None:
        row = replace(row, truth=tuple(replace(e, nearest=(str(near[0]), float(near[1]))) for e in row.truth))
    return replace(row, **computed)


def diesel_row(folder: Path, answers: Mapping[str, Any]) -> CaseRow:
    """What was true and what was said of one diesel engine, its health too; enough for settled points."""
    row = verdict_row(folder, answers, truth=lambda _: tuple(_true_effect(Fault.of(e)) for e in answers["effects"]))
    return replace(
        row, health_true={k: float(v) for k, v in answers["health"].items()},
        since_true={k: float(v) for k, v in answers.get("since_reference", {}).items()},
    )  # fmt: skip


def verdict_row(
    folder: Path, answers: Mapping[str, Any], truth: Callable[[Mapping[str, Any]], tuple[TrueEffect, ...]]
) -> CaseRow:
    """What was true and what was said of one case, of any machine: nothing that needs its engine.

    Args:
        folder: of the benchmark; answers: of the case; truth: what the answers say was wrong.
    """
    name = str(answers["case"])
    result = folder / RESULTS / name
    row = CaseRow(name, answers["kind"], answers["partial"], answers["route"], truth(answers),
                  tuple(answers["withhold"]))  # fmt: skip
    if not (result / FILE_NAME).is_file():
        problem = "not run"
        if (result / FAILED).is_file():
            problem = str(read_json(result / FAILED, *_OURS)["error"])
        return replace(row, problem=problem)
    runtime = read_json(result / "runtime.json", *_OURS)
    return replace(row, **said(load_discrepancy(result)), seconds=runtime["seconds"],
                   peak_rss_mib=runtime["peak_rss_mib"])  # fmt: skip


def petrol_truth(answers: Mapping[str, Any]) -> tuple[TrueEffect, ...]:
    """What was wrong with a petrol engine."""
    known = [(e["effect"], float(e["magnitude"]), petrol_cases.FAMILIES[e["effect"]]) for e in answers["effects"]]
    return tuple(TrueEffect(name, f.site, size, abs(size) / f.tolerance, True) for name, size, f in known)


def said(document: Discrepancy) -> dict[str, Any]:
    """What a document says, as fields of `CaseRow`."""
    location = document.location
    return {
        "mismatch": document.mismatch, "p_value": document.p_value,
        "site": None if location is None else location.site,
        "said": tuple(SaidEffect(e.name, e.names, e.magnitude, e.std) for e in document.effects),
        "health_before": {k: v.before for k, v in document.health.items() if k in HEALTH},
        "health_after": {k: v.value for k, v in document.health.items() if k in HEALTH},
        "since_said": {
            k: (v.since_reference.value, v.since_reference.std) for k, v in document.health.items() if v.since_reference
        },
    }  # fmt: skip


def oracle_row(row: CaseRow) -> CaseRow:
    """The same case answered by a fit that is told the true form of the effect."""
    said = tuple(SaidEffect(e.name, (e.name,), row.oracle_magnitudes.get(e.name), None) for e in row.truth)
    since = {
        name: (row.oracle_health[name] / row.health_true[name] * change, 0.0)
        for name, change in row.since_true.items() if name in row.oracle_health
    }  # fmt: skip
    return replace(
        row, said=said, mismatch=bool(row.truth), nll_after=row.nll_oracle,
        health_after=row.oracle_health, problem=None if row.oracle_health or not row.truth else "no oracle",
        site=row.truth[0].site if row.truth else None, seconds=None, law_error=None, since_said=since,
    )  # fmt: skip


def _true_effect(fault: Fault) -> TrueEffect:
    family = FAMILIES[fault.effect]
    return TrueEffect(fault.effect, family.site, fault.magnitude, fault.ratio, family.catalogued)


def _kept(cache: Path) -> dict[str, Any]:
    """What was kept, nothing where it isn't whole: it is computed again then."""
    try:
        return read_json(cache, "what `challenge score` kept", "remove it")
    except InputError:
        return {}


def _computed(
    folder: Path, result: Path, answers: Mapping[str, Any], faults: Sequence[Fault], scoring: Scoring
) -> dict[str, Any]:
    """Held-out scores, separability and the law's error; kept beside the result, since they take seconds a case."""
    cache = result / "scored.json"
    if cache.is_file():
        kept = _kept(cache)
        if kept.get("of") == _stamp(result):
            return dict(kept["values"])
    name = str(answers["case"])
    values: dict[str, Any] = {}
    recording = read_recording(folder / name / "recording.csv")
    later = read_recording(folder / SEALED / f"{name}_held_out.csv")
    catalogued = all(FAMILIES[f.effect].catalogued for f in faults)
    truth = we2011.PARAMETERS.replace(**{k: float(v) for k, v in answers["health"].items()})
    if scoring.with_plant_maps is not None:
        truth = scoring.with_plant_maps(truth, maps_of(answers, we2011.PARAMETERS.model_dump()))
    healthy_too = scoring.with_plant_maps is not None  # whose change since the reference the oracle tells as well
    values["samples"] = int(later.time_s.size)
    values["nll_before"] = float(scoring.held_out_nll(_lasting(load_engine(result / "engine_before.yaml")), later))
    values["nll_after"] = float(scoring.held_out_nll(_lasting(load_engine(result / "engine.yaml")), later))
    if (faults or healthy_too) and catalogued:
        oracle = scoring.fit_oracle(recording, truth, engine_terms(faults))
        values["nll_oracle"] = float(scoring.held_out_nll(_lasting(oracle), later))
        values["oracle_health"] = {name: float(getattr(oracle, name)) for name in HEALTH}
        values["oracle_magnitudes"] = {
            term.effect: float(term.magnitude) for term in oracle.terms if isinstance(term, Term)
        }
    if len(faults) == 1 and catalogued:
        distances = dict(scoring.separability(recording, truth, engine_terms(faults)[0]))
        distances.pop(faults[0].effect, None)
        for withheld in answers["withhold"]:  # the tool could not take it for a name that it doesn't know
            distances.pop(withheld, None)
        if distances:
            other = min(distances, key=lambda k: distances[k])
            values["nearest"] = [other, float(distances[other])]
    values |= _law_errors(folder, result, answers, faults, scoring, values.get("oracle_magnitudes", {}))
    with_numbers = {k: (None if isinstance(v, float) and not np.isfinite(v) else v) for k, v in values.items()}
    write_json(cache, sealed_json({"of": _stamp(result), "values": with_numbers}))
    return with_numbers


def _law_errors(
    folder: Path, result: Path, answers: Mapping[str, Any], faults: Sequence[Fault], scoring: Scoring,
    oracle: Mapping[str, float],
) -> dict[str, Any]:  # fmt: skip
    """Errors of the found law and of the true form with the oracle's magnitude, in withheld cases."""
    if answers["kind"] != "withheld":
        return {}
    fault, health = faults[0], answers["health"]
    clean = pd.read_parquet(folder / SEALED / f"{answers['case']}_held_out_clean.parquet")
    errors = [scoring.law_error(result, clean, fault, health), None]
    told = oracle.get(fault.effect)
    if told is not None:
        errors[1] = scoring.error_of(engine_terms([replace(fault, magnitude=told)]), clean, fault, health)
    fine = [None if error is None or not np.isfinite(error) else float(error) for error in errors]
    return {"law_error": fine[0], "oracle_law_error": fine[1]}


def _stamp(result: Path) -> str:
    """What scores of a result depend on: its files, the scorer's code, the settings that its fits look up."""
    files = [file_sha256(result / name) for name in (FILE_NAME, "engine.yaml", "engine_before.yaml")]
    settings = hashlib.sha256(default_search().model_dump_json().encode()).hexdigest()
    return " ".join([*files, code_sha256(*_SCORER), settings])


def _lasting(engine: EngineParameters) -> EngineParameters:
    """The engine on a later recording."""
    return engine.replace(terms=as_later(engine.terms))
