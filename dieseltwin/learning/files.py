"""Files of a learned engine: `mine.yaml` that every command takes, and `mine.learned.parquet` with what is known of it.

The repaired engine of a discovery beside a learned one has both files as well. Its YAML holds the health and the
effects that were found, and corrections of the maps on top of the learned ones where the recording moved them; its
Parquet file is that of the engine as it was learned, so that "since the reference" keeps its meaning.

The Parquet file holds one row a coordinate of `learning.belief`: name, unit, mean and its row of the joint covariance,
and in its metadata the base engine, the recordings it rests on (hash, seconds, date, ambient, and their columns, so
that more can be learned later without them) and versions. Neither file says when it was written: the same recordings
in any order make the same bytes.
"""

from __future__ import annotations

import base64
import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from dieseltwin.atomic import write_bytes, write_text
from dieseltwin.engine import HEALTH, EngineParameters, load_engine
from dieseltwin.engine.learned_file import (
    LEARN_AGAIN,
    LEARNED,
    SHA256,
    WITHOUT_THREADS,
    learned_beside,
    learned_bytes,
    replaced_by,
)
from dieseltwin.engine.terms import CorrectionTerm, EffectTerm, LawTerm, OneTerm, corrections_in, without_corrections
from dieseltwin.errors import InputError
from dieseltwin.learning.belief import (
    NOTHING_FURTHER,
    Belief,
    Further,
    coordinate_names,
    coordinate_units,
    prior_belief,
    with_further,
)
from dieseltwin.learning.faults import FaultBeside
from dieseltwin.learning.weather import EXPONENTS, WEATHER, Exponent, OfType, beside_exponents, of_own_weather
from dieseltwin.notes import Note, counted
from dieseltwin.recordings.derived import Made
from dieseltwin.recordings.reader import Recording
from dieseltwin.sealed import sealed_text
from dieseltwin.settings.names import listed
from dieseltwin.settings.search import CircumstanceSettings
from dieseltwin.settings.strict import read_mapping
from dieseltwin.version import __version__

SCHEMA = 1
UNSETTLED = "the engine was learned by a fit that stopped before it converged; intervals may be too narrow, and what \
doesn't fit may be the reference's"
UNTOLD = "the engine's maps are corrected, but nothing says how well the corrections are known (no `learned:` in its \
file): they are taken for exact, so that intervals are too narrow, and nothing is told since the reference; give the \
file of `dieseltwin learn`, or of a discovery beside it"
_MAY_DIFFER = (*HEALTH, *EXPONENTS, "p_amb", "T_amb", "T_im", "terms")  # of a repaired engine, or on another day
_RANGE = "_range"  # in names of limits of the inputs, which are no maps
_KEY = b"dieseltwin.learned"


@dataclass(frozen=True)
class LearnedEngine:
    """What is known of one engine, and from what.

    Attributes:
        base: the engine before anything was learned.
        belief: mean and joint covariance.
        map_rms: size of the maps' errors that was believed before [-].
        recordings: of the engine when it was known to be well, sorted by hash.
        domain: point -> lowest and highest of each argument where the belief was cut to less than half.
        misfits: hash -> squared whitened residual a reading.
        prior: what was believed before any recording, where engines of the same type say it; None for the usual.
        further: errors of the maps beyond the usual ones that the recordings ask for; they are part of what is
            believed, and of no `prior`.
        clocks: column -> how late it is recorded, of those whose clock is off in these recordings [s].
        converged: whether the fit of all recordings came to rest; else the covariance may be too small.
        suspected: by what the recordings look as if the engine hadn't been well, a sentence each.
        repaired: the engine as its file has it, where that isn't how it was learned: with the health and the effects
            that a discovery found since; None for the engine as it was learned. The belief is that of learning.
        faults: the main faults as the recordings say them where no map is off by more than usual; none where an earlier
            version learned it.
        exponents: of the compressor by name, where recordings in different weather or engines of its type show them.
        of_type: what engines of the same type say of the compressor; None where nothing is believed of them.
    """

    base: EngineParameters
    belief: Belief
    map_rms: float
    recordings: tuple[Recording, ...]
    domain: dict[str, dict[str, tuple[float, float]]]
    misfits: dict[str, float]
    prior: Belief | None = None
    further: Further = NOTHING_FURTHER
    clocks: Mapping[str, float] = field(default_factory=dict)
    converged: bool = True
    suspected: tuple[str, ...] = ()
    repaired: EngineParameters | None = None
    faults: tuple[FaultBeside, ...] = ()
    exponents: Mapping[str, Exponent] = field(default_factory=dict)
    of_type: OfType | None = None

    @property
    def errors(self) -> float:
        """Size of the maps' errors that is believed with these recordings [-]."""
        return self.map_rms * self.further.size

    @property
    def believed(self) -> Belief:
        """What was believed before any recording, of maps as rough and as far off as these."""
        usual = prior_belief(self.base, self.map_rms) if self.prior is None else self.prior
        return with_further(usual, self.map_rms, self.further)

    @property
    def engine(self) -> EngineParameters:
        """The engine with its mean health, and the mean corrections of its maps among its terms; what was found since
        is in it where it was repaired."""
        if self.repaired is not None:
            return self.repaired
        health = {name: float(value) for name, value in zip(HEALTH, self.belief.health, strict=True)}
        term = CorrectionTerm(coefficients=tuple(float(value) for value in self.belief.coefficients))
        return self.in_its_weather(self.base).replace(**health, terms=(*self.base.terms, term))

    def in_its_weather(self, engine: EngineParameters) -> EngineParameters:
        """An engine whose compressor's maps are of the weather of these recordings."""
        return of_own_weather(engine, self.recordings, self.exponents, self.of_type)

    def beliefs(self, beliefs: CircumstanceSettings) -> CircumstanceSettings:
        """What is believed of a recording's circumstances, with what these recordings show of the compressor."""
        return beside_exponents(beliefs, self.exponents)

    @property
    def found(self) -> tuple[EffectTerm | LawTerm, ...]:
        """Terms that the engine has and wasn't learned with; corrections of maps aren't among them."""
        return tuple(term for term in without_corrections(self.engine.terms) if term not in self.base.terms)

    @property
    def moved(self) -> np.ndarray | None:
        """By how much the maps' corrections differ from those that were learned, (K,) [-]; None where they don't."""
        now = None if self.repaired is None else corrections_in(self.repaired.terms)
        if now is None or np.array_equal(now, self.belief.coefficients):
            return None
        return np.asarray(now - self.belief.coefficients)

    @property
    def doubts(self) -> tuple[str, ...]:
        """What is doubtful about what was learned, a sentence each: whoever is judged by it has to know."""
        return (*(() if self.converged else (UNSETTLED,)), *self.suspected)

    @property
    def minutes(self) -> float:
        """Of all driving with the engine running [min]."""
        return sum(item.running_s for item in self.recordings if not item.standing) / 60.0

    @property
    def points(self) -> int:
        """Number of settled points."""
        return sum(len(item.pieces()) for item in self.recordings if item.standing)

    @property
    def heard(self) -> str:
        """What it rests on, "20.0 minutes of 2 recordings and 97 settled points"."""
        driven = sum(not item.standing for item in self.recordings)
        parts = [f"{self.minutes:.1f} minutes of {counted(driven, 'recording')}"] if driven else []
        return " and ".join(parts + ([counted(self.points, "settled point")] if self.points else []))


def save_learned(learned: LearnedEngine, path: Path) -> Path:
    """Write `path` (YAML) and, beside it, the Parquet file that it names; returns the latter.

    Until the YAML stands, what it named before is kept beside it: killed at any moment, one of both can be read.

    Raises:
        InputError: a place that cannot be written to.
    """
    target = learned_beside(path)
    content, before = _parquet(learned), replaced_by(target)
    if (kept := _named_now(path)) is not None:
        write_bytes(before, kept)
    write_bytes(target, content)
    values: dict[str, Any] = learned.engine.model_dump(mode="json")
    values["terms"] = [term.model_dump(mode="json") for term in _written_terms(learned)]
    values |= {LEARNED: target.name, SHA256: hashlib.sha256(content).hexdigest()}
    text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True, default_flow_style=None, width=100)
    made = "Learned by `dieseltwin learn`"
    if learned.repaired is not None:
        made = "Repaired by `dieseltwin discover`; learned by `dieseltwin learn`"
    heading = f"# {made} from {learned.heard}; --engine accepts it.\n"
    write_text(path, sealed_text(heading + text))
    before.unlink(missing_ok=True)
    return target


def _written_terms(learned: LearnedEngine) -> tuple[OneTerm, ...]:
    """Terms of the engine file: all but the learned corrections, which are in the other file and added to these."""
    if learned.repaired is None:
        return learned.base.terms
    moved = learned.moved
    on_top = () if moved is None else (CorrectionTerm(coefficients=tuple(map(float, moved))),)
    return (*without_corrections(learned.repaired.terms), *on_top)


def _named_now(path: Path) -> bytes | None:
    """Content of the file that an engine file names; None where there is no such file, or nothing that can be read."""
    if not path.is_file():
        return None
    try:
        document = read_mapping(path)
        return learned_bytes(path, document) if LEARNED in document else None
    except InputError:
        return None


def untold(engine: EngineParameters, learned: LearnedEngine | None) -> list[Note]:
    """That corrections of an engine's maps are taken for exact, where nothing says how well they are known."""
    return [Note(UNTOLD, "reference")] if learned is None and corrections_in(engine.terms) is not None else []


def going_on(name: str, base: EngineParameters, before: LearnedEngine | None) -> list[str]:
    """Notes where learning goes on from an engine that isn't as it was learned.

    Args:
        name: of the engine, for people.
        base: that is learned.
        before: what was learned of it; None for nothing.

    Raises:
        InputError: effects that were found since.
    """
    as_learned = "name the file that `dieseltwin learn` wrote"
    if before is None:
        if not untold(base, None):
            return []
        return [f"note: the maps of {name} are corrected without a word of how well that is known: learning begins "
                "there, and as large errors are believed about them as of maps without corrections"]  # fmt: skip
    if before.found:
        effects = [term.point if isinstance(term, LawTerm) else term.slot for term in before.found]
        raise InputError("--engine", f"{name}, repaired by {listed(list(dict.fromkeys(effects)))}",
                         "the engine as it was learned", as_learned)  # fmt: skip
    if before.repaired is None:
        return []
    return [f"note: {name} holds health or ambient of its own, which isn't learned from: it goes on from what was "
            "learned before"]  # fmt: skip


def seal_of(path: Path) -> str:
    """Hash of what an engine file knows of its engine; "" for a file that nothing was learned for."""
    return str(read_mapping(path).get(SHA256, ""))


def load_learned(path: Path) -> LearnedEngine | None:
    """What an engine file knows of its engine; None for a file that nothing was learned for.

    Raises:
        InputError: the Parquet file that it names is missing, changed or not readable; a parameter was changed since.
    """
    document = read_mapping(path)
    if LEARNED not in document:
        return None
    known = _parsed(learned_bytes(path, document), path.with_name(str(document[LEARNED])))
    engine = load_engine(path)
    if WEATHER[0] not in document:  # an earlier version wrote it
        engine = known.in_its_weather(engine)
    base = known.in_its_weather(known.base)
    for name in type(engine).model_fields:
        got, value = getattr(engine, name), getattr(base, name)
        if got != value and name not in _MAY_DIFFER and not name.endswith(_RANGE):
            raise InputError(f"{path}: {name}", _in_digits(got), f"{_in_digits(value)}, with which it was learned",
                             "change the base, and learn again with --engine naming that")  # fmt: skip
    return known if engine == known.engine else replace(known, repaired=engine)


def _in_digits(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def learned_engine_of(engine: object) -> LearnedEngine | None:
    """What is known of an engine: of the file that is named, or with what `learn` gave, or `discover` beside a learned
    engine; None where nothing is."""
    known = getattr(engine, "known", engine)
    if isinstance(known, LearnedEngine):
        return known
    return load_learned(Path(engine)) if isinstance(engine, str | Path) and Path(engine).is_file() else None


def _parquet(learned: LearnedEngine) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    def rows(matrix: np.ndarray) -> pa.Array:
        return pa.array([list(row) for row in matrix], type=pa.list_(pa.float64()))

    columns = {
        "name": list(coordinate_names()), "unit": list(coordinate_units()), "mean": learned.belief.mean,
        "std": np.sqrt(np.diag(learned.belief.covariance)), "covariance": rows(learned.belief.covariance),
    }  # fmt: skip
    if learned.prior is not None:
        columns |= {"mean_before": learned.prior.mean, "covariance_before": rows(learned.prior.covariance)}
    table = pa.table(columns)
    about = {
        "schema": SCHEMA, "code_version": __version__, "map_rms": learned.map_rms, "domain": learned.domain,
        "further": asdict(learned.further), "clocks": dict(learned.clocks), "converged": learned.converged,
        "suspected": list(learned.suspected), "faults": [asdict(item) for item in learned.faults],
        "exponents": {name: asdict(item) for name, item in learned.exponents.items()},
        "of_type": None if learned.of_type is None else asdict(learned.of_type),
        "base": learned.base.model_dump(mode="json"),
        "recordings": [
            {
                "sha256": item.sha256, "seconds": item.duration_s, "p_amb_pa": item.p_amb_pa, "t_amb_k": item.t_amb_k,
                "began": None if item.began is None else item.began.isoformat(), "misfit": learned.misfits[item.sha256],
                "made": [[column, dict(needs)] for column, needs in item.made.follows.items()],  # in their order
                **({"standing": True} if item.standing else {}),
            }
            for item in learned.recordings
        ],
    }  # fmt: skip
    metadata = {_KEY: json.dumps(about, sort_keys=True, allow_nan=False).encode()}
    for item in learned.recordings:
        buffer = io.BytesIO()
        item.frame().to_parquet(buffer, index=False, compression="zstd")
        metadata[item.sha256.encode()] = base64.b64encode(buffer.getvalue())
    sink = io.BytesIO()
    pq.write_table(table.replace_schema_metadata(metadata), sink, compression="zstd")
    return sink.getvalue()


def _parsed(content: bytes, where: Path) -> LearnedEngine:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(io.BytesIO(content), **WITHOUT_THREADS)
        metadata = table.schema.metadata or {}
        about = json.loads(metadata[_KEY])
    except (pa.ArrowException, OSError, KeyError, ValueError):
        raise InputError(str(where), "not readable", "what `dieseltwin learn` wrote", LEARN_AGAIN) from None
    further = {key: float(value) for key, value in about.get("further", {}).items()}
    if (about["schema"] != SCHEMA or tuple(table["name"].to_pylist()) != coordinate_names()
            or not set(further) <= set(asdict(NOTHING_FURTHER))):  # fmt: skip
        version = f"other corrections, written by version {about['code_version']}"
        raise InputError(str(where), version, "those of this program", LEARN_AGAIN)
    belief = Belief(np.array(table["mean"]), np.array(table["covariance"].to_pylist()))
    base = EngineParameters(**about["base"])
    prior = None
    if "mean_before" in table.column_names:
        prior = Belief(np.array(table["mean_before"]), np.array(table["covariance_before"].to_pylist()))
    known = [(row, metadata[row["sha256"].encode()]) for row in about["recordings"]]
    return LearnedEngine(
        base, belief, float(about["map_rms"]), tuple(_recording(row, data) for row, data in known),
        {point: {k: (v[0], v[1]) for k, v in ends.items()} for point, ends in about["domain"].items()},
        {row["sha256"]: float(row["misfit"]) for row, _ in known}, prior, Further(**further),
        dict(about.get("clocks", {})), bool(about.get("converged", True)),
        tuple(about.get("suspected", ())), faults=tuple(FaultBeside(**item) for item in about.get("faults", ())),
        exponents=_exponents(about.get("exponents", {})), of_type=_of_type(about.get("of_type")),
    )  # fmt: skip


def _exponents(row: Mapping[str, Mapping[str, float]]) -> dict[str, Exponent]:
    return {name: Exponent(**item) for name, item in row.items()}


def _of_type(row: dict[str, Any] | None) -> OfType | None:
    return None if row is None else OfType(_exponents(row["exponents"]), row["p_cmap"], row["T_cmap"])


def _recording(row: dict[str, Any], data: bytes) -> Recording:
    frame = pd.read_parquet(io.BytesIO(base64.b64decode(data)), **WITHOUT_THREADS)
    columns = {name: frame[name].to_numpy() for name in frame}
    began = None if row.get("began") is None else datetime.fromisoformat(row["began"])
    return Recording(columns["time_s"], columns, row["p_amb_pa"], row["t_amb_k"], None, row["sha256"], began=began,
                     made=Made(dict(row.get("made", ()))), standing=bool(row.get("standing", False)))
