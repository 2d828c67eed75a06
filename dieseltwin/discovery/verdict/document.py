"""What discovery says, as one strict document: `discrepancy.json`, schema 1 (docs/discovery.md).

SI units, no NaN, no keys beyond the schema; whatever else is worth keeping goes into `details.json`, and times into
`runtime.json`. A document that contradicts itself (a healthy one with effects, a name without a magnitude) can't be
built.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator

from dieseltwin.atomic import write_json
from dieseltwin.discovery.verdict.found_circumstance import FoundCircumstance, Name
from dieseltwin.discovery.verdict.health_value import HealthValue, NotNegative
from dieseltwin.discovery.verdict.left_out import LeftOut
from dieseltwin.engine.courses import Spans
from dieseltwin.errors import InputError
from dieseltwin.notes import Note, warnings_of
from dieseltwin.sealed import TOO_DEEP, opened_json, sealed_json
from dieseltwin.settings.strict import FrozenModel, where_told
from dieseltwin.symbols import INPUT_COLUMNS

SCHEMA = 1
NOTED_CHI2 = 4.0  # per sample of the repaired fit, twice the noise: worth a warning
LEFT_OVER = 1.2  # the same, worth a word; and beyond what tolerances take a warning: right names left 0.94 to 1.1 there
NONE_OF_THESE = "none_of_these"
FILE_NAME = "discrepancy.json"
_ROUNDING = 1e-6  # of probabilities that sum to one

Probability = Annotated[float, Field(ge=0.0, le=1.0)]
Range = tuple[float, float]


class RecordingInfo(FrozenModel):
    """The recording that was judged: where it lies, its SHA-256, its length [s], the sensor columns that were used."""

    path: str
    sha256: str
    duration_s: NotNegative
    channels: tuple[Name, ...]


class Alternative(FrozenModel):
    """Another place where the mismatch may sit, with its probability."""

    site: Name
    probability: Probability


class FoundRegion(FrozenModel):
    """A box of operating conditions [rpm, mg/cycle, %, %] with its share of the evidence [-]."""

    n_e_rpm: Range
    u_delta_mg: Range
    u_egr_pct: Range
    u_vgt_pct: Range
    share_of_evidence: Probability

    @model_validator(mode="after")
    def _ordered(self) -> FoundRegion:
        for name in INPUT_COLUMNS:
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name} runs from {low:g} to {high:g}: the lower end comes first")
        return self


class Location(FrozenModel):
    """Where the mismatch enters the model, in which driving, and since when [s from the recording's first row].

    `only_in`: the conditions in which alone it acts, by their columns, None where such a range is open at that end; and
    `regions`: the box that holds most of the evidence, whether it acts outside or not.
    `until_s`: before when, where it went again. `grows`: its size grows evenly from nothing at the onset to what is
    stated, at the recording's end. `gone_s`: spans in between in which it was gone. They are there where they are so.
    `onset_range_s`, `until_range_s`: within two standard deviations, of one recording by itself.
    Of several recordings: date of the first that shows it, and of the last one before, where that is known.
    """

    site: Name
    probability: Probability
    alternatives: tuple[Alternative, ...] = ()
    regions: tuple[FoundRegion, ...] = ()
    onset_s: float | None = None
    onset_range_s: Range | None = where_told()
    until_s: float | None = where_told()
    until_range_s: Range | None = where_told()
    grows: bool = where_told(False)
    gone_s: Spans = where_told(())
    onset_date: str | None = None
    onset_after: str | None = None
    only_in: dict[Name, tuple[float | None, float | None]] = where_told({})

    @model_validator(mode="after")
    def _consistent(self) -> Location:
        sites = [self.site, *(other.site for other in self.alternatives)]
        _no_repeats(sites, "site")
        total = self.probability + sum(other.probability for other in self.alternatives)
        if total > 1.0 + _ROUNDING:
            raise ValueError(f"the probabilities of the sites sum to {total:.4g}, more than 1")
        return self


class FoundEffect(FrozenModel):
    """One thing that the twin left out: a name of the catalogue, or `none_of_these` with the law found for it, if any.

    `magnitude` and `std` are in `unit`; a catalogue effect has all of them (`std` null where it can't be told),
    `none_of_these` has no magnitude. The reported set of names is `names`. `since_row`: of settled points, the data row
    of the file from which on it is there.
    """

    name: Name
    probability: Probability
    equivalent_names: tuple[Name, ...] = ()
    law: str | None
    magnitude: float | None
    std: NotNegative | None
    unit: str | None
    valid_for: str | None = None
    split_by: str | None = None
    over_recordings: str | None = None
    since_row: int | None = where_told(ge=1)

    @model_validator(mode="after")
    def _consistent(self) -> FoundEffect:
        _no_repeats([self.name, *self.equivalent_names], "name")
        if self.name == NONE_OF_THESE:
            if self.equivalent_names:
                raise ValueError("none_of_these has no equivalent names: it says that no name fits")
            if self.magnitude is not None or self.std is not None:
                raise ValueError("none_of_these has no magnitude: the numbers stand in its law")
        elif NONE_OF_THESE in self.equivalent_names:
            raise ValueError("none_of_these is no equivalent of a name")
        elif self.magnitude is None or self.unit is None or self.law is None:
            raise ValueError(f"{self.name} needs a law, a magnitude and a unit")
        return self

    @property
    def named(self) -> bool:
        """Whether it has a name of the catalogue."""
        return self.name != NONE_OF_THESE

    @property
    def names(self) -> tuple[str, ...]:
        """The reported set: the name and what can't be told from it."""
        return (self.name, *self.equivalent_names)


class Reference(FrozenModel):
    """What the engine was learned from: number of recordings, their minutes, the settled points among them, and the
    share of the judged recording's samples in which every map is known from them."""

    recordings: int = Field(ge=1)
    minutes: NotNegative
    points: int = Field(default=0, ge=0)
    domain_share: Probability


class SizeValue(FrozenModel):
    """Size of an effect in one recording, in the effect's unit."""

    value: float
    std: NotNegative | None


class JudgedRecording(FrozenModel):
    """One of several recordings judged together: path, date and how that is known, ambient, health, size of effects."""

    path: str
    sha256: str
    duration_s: NotNegative
    date: str
    date_from: str
    p_amb_pa: float
    t_amb_k: float
    health: dict[Name, HealthValue]
    magnitudes: dict[Name, SizeValue] = Field(default_factory=dict)


class Fit(FrozenModel):
    """How well readings are met before and after: negative log-likelihood per row of the held-out part, chi-square per
    reading (`beyond`: of what is left with maps, sensors and weather as far off as they most likely are), rms residual
    per channel [unit of the column], and the share of the misfit that is explained [-]. Null where not known."""

    held_out_nll_before: float | None
    held_out_nll_after: float | None
    chi2_per_sample_before: NotNegative | None
    chi2_per_sample_after: NotNegative | None
    rmse_before: dict[Name, NotNegative]
    rmse_after: dict[Name, NotNegative]
    share_explained: Probability | None = None
    chi2_per_sample_beyond: NotNegative | None = None
    held_out_rows: int | None = where_told()

    @property
    def held_out_gain(self) -> float | None:
        """Log-likelihood of the whole held-out part that is gained; None where that isn't known."""
        if self.held_out_rows is None or self.held_out_nll_before is None or self.held_out_nll_after is None:
            return None
        return self.held_out_rows * (self.held_out_nll_before - self.held_out_nll_after)

    @property
    def chi2_left(self) -> float | None:
        """Chi-square per sample that no tolerance takes up; all that is left where that isn't known."""
        return self.chi2_per_sample_after if self.chi2_per_sample_beyond is None else self.chi2_per_sample_beyond

    @property
    def beyond_tolerances(self) -> bool:
        """Whether more is left than noise, maps and sensors leave: beside quiet sensors tolerances alone leave much."""
        return (self.chi2_left or 0.0) > (NOTED_CHI2 if self.chi2_per_sample_beyond is None else LEFT_OVER)


class Provenance(FrozenModel):
    """What wrote the document."""

    code_version: str
    params_sha256: str


class Doubt(FrozenModel):
    """Something doubtful about the recording or the answer: a stable word, a sentence, and the columns it is about."""

    code: Name
    text: Name
    affects: tuple[Name, ...] = ()


class OutOfTime(FrozenModel):
    """A discovery that its time limit [s] ended, and what the search hadn't finished."""

    limit_s: NotNegative
    unfinished: tuple[Name, ...]


class Discrepancy(FrozenModel):
    """The whole document. Healthy: `mismatch` false, no effects, no location. Two effects: strongest first.

    `out_of_time`: the search was ended before it was through. `more_is_missing`: what the effects leave is beyond noise
    and tolerances. `too_small`: of a healthy one, the name that explains what differs by more than chance, and is
    smaller than what is of interest. `minimum_detectable`: size at which half of such recordings show an effect.
    `surely_detectable`: of a healthy one, the size of interest that 19 of 20 would have shown. `health_bias`: what an
    effect of its `minimum_detectable` size, unseen, would move health by: effect -> parameter -> relative change [-].
    """

    schema_version: Literal[1] = Field(1, alias="schema")
    recording: RecordingInfo
    mismatch: bool
    p_value: Probability
    location: Location | None
    effects: tuple[FoundEffect, ...]
    more_is_missing: bool = False
    health: dict[Name, HealthValue]
    fit: Fit
    minimum_detectable: dict[Name, NotNegative]
    provenance: Provenance
    surely_detectable: dict[Name, NotNegative] = where_told({})
    health_bias: dict[Name, dict[Name, float]] = where_told({})
    too_small: FoundEffect | None = where_told()
    reference: Reference | None = where_told()
    circumstances: tuple[FoundCircumstance, ...] = where_told(())
    recordings: tuple[JudgedRecording, ...] = where_told(())
    warnings: tuple[Doubt, ...] = ()
    out_of_time: OutOfTime | None = where_told()
    left_out: LeftOut | None = where_told()

    @model_validator(mode="after")
    def _consistent(self) -> Discrepancy:
        if self.mismatch and (self.location is None or not self.effects):
            raise ValueError("a mismatch needs a location and at least one effect (none_of_these is one)")
        if not self.mismatch and (self.location is not None or self.effects):
            raise ValueError("without a mismatch there is no location and no effect")
        if self.more_is_missing and not self.mismatch:
            raise ValueError("without a mismatch nothing more is missing")
        if self.too_small is not None and self.mismatch:
            raise ValueError("a mismatch is an effect as large as is of interest")
        _no_repeats([effect.name for effect in self.effects], "effect")
        return self

    def to_json(self) -> dict[str, Any]:
        """The document as JSON types, keys as in the file; what is told of several recordings is there with those."""
        content: dict[str, Any] = self.model_dump(mode="json", by_alias=True)
        if not self.recordings:
            for item in content.get("circumstances", ()):
                del item["recording"]
            for part in (*content["effects"], *([content["location"]] if content["location"] else [])):
                for key in ("over_recordings", "onset_date", "onset_after"):
                    part.pop(key, None)
        return content

    def write(self, path: str | Path) -> Path:
        """Write `discrepancy.json` atomically; strict JSON."""
        return write_json(path, sealed_json(self.to_json()))


def with_warnings(document: Discrepancy, notes: Iterable[str]) -> Discrepancy:
    """The document with notes added to its warnings, each once."""
    both = [*document.warnings, *(Doubt(**warning) for warning in warnings_of(notes))]
    return document.model_copy(update={"warnings": tuple(dict.fromkeys(both))})


def fit_doubts(document: Discrepancy) -> list[Note]:
    """Notes about the fit that a document itself calls for."""
    words = "what was found doesn't explain all of the misfit: more is missing, so sizes and names may be off"
    notes = [Note(words, "more_is_missing")] if document.more_is_missing else []
    if not document.fit.beyond_tolerances:
        return notes
    if (chi2 := document.fit.chi2_per_sample_after or 0.0) > NOTED_CHI2:
        notes.append(Note(f"the repaired twin leaves {chi2**0.5:.2g} times the noise", "misfit"))
    else:
        left = f"{document.fit.chi2_per_sample_beyond:.2f} of chi-square per sample is left, where noise leaves 1"
        notes.append(Note(f"{left}, even with maps and sensors as far off as they most likely are", "misfit"))
    return notes


def _no_repeats(names: list[str], what: str) -> None:
    if repeated := [name for name, count in Counter(names).items() if count > 1]:
        raise ValueError(f"{what} {repeated[0]!r} is given twice")


def _refuse_constant(text: str) -> Any:
    raise ValueError(f"{text} is no JSON")


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    _no_repeats([key for key, _ in pairs], "key")
    return dict(pairs)


def parse_discrepancy(text: str, where: str = FILE_NAME) -> Discrepancy:
    """A document from strict JSON text.

    Args:
        text: the file's content.
        where: its name, for messages.

    Raises:
        InputError: not strict JSON (NaN, a key twice), another schema, an unknown or missing key, a contradiction.
    """
    again = "write it again with `dieseltwin discover`"
    try:
        content = json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=_unique_keys)
    except (ValueError, RecursionError) as error:  # JSONDecodeError is a ValueError
        got = TOO_DEEP if isinstance(error, RecursionError) else str(error)
        raise InputError(where, got, "strict JSON: numbers without NaN, every key once", again) from None
    content = opened_json(content, where, again)
    if not isinstance(content, dict):
        raise InputError(where, f"a {type(content).__name__}", "an object with the keys of schema 1", again)
    if content.get("schema") != SCHEMA or isinstance(content.get("schema"), bool):
        raise InputError(f"{where}: schema", repr(content.get("schema")), f"schema {SCHEMA}", again)
    try:
        return Discrepancy.model_validate_json(json.dumps(content), strict=True)
    except ValidationError as error:
        problem = min(error.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")
    place = ".".join([where, *(str(part) for part in problem["loc"])]) if problem["loc"] else where
    got = {"missing": "nothing", "extra_forbidden": "a key that the schema doesn't have"}.get(
        problem["type"], repr(problem["input"])[:80]
    )
    raise InputError(place, got, problem["msg"].removeprefix("Value error, "), again)


def load_discrepancy(path: str | Path) -> Discrepancy:
    """Read `discrepancy.json`, given itself or the folder that holds it.

    Raises:
        InputError: no such file, or content that `parse_discrepancy` refuses.
    """
    path = Path(path)
    path = path / FILE_NAME if path.is_dir() else path
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(str(path), "no such file", f"a folder with {FILE_NAME}", "check the path") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(str(path), error, "a readable file in UTF-8", "check the file") from None
    return parse_discrepancy(text, str(path))
