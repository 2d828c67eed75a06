"""Discovery on a petrol engine's recording: is something left out or a sensor wrong, which, how large, since when.

The shared search (`discovery.search.run`) on a `PetrolTwin`. Effects that the engine file holds already are undone on
the recording first, so that the repaired engine of one discovery leaves nothing for the next.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal

import numpy as np

from dieseltwin.discovery.likelihood.fit import Fit, Linearisation
from dieseltwin.discovery.likelihood.score import without_parameters
from dieseltwin.discovery.options import SearchOptions
from dieseltwin.discovery.search import run as shared
from dieseltwin.discovery.search.courses import schedule_of
from dieseltwin.discovery.search.dating import date_edges
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.interface import Array
from dieseltwin.discovery.verdict.assemble import allowance, details_of_search, finite_only, fit_figures, p_value
from dieseltwin.discovery.verdict.curves import Candidate
from dieseltwin.discovery.verdict.document import (
    Discrepancy,
    FoundEffect,
    Location,
    Provenance,
    RecordingInfo,
    fit_doubts,
    with_warnings,
)
from dieseltwin.discovery.verdict.explained import explained_at
from dieseltwin.discovery.verdict.findings import effects, finite, ranges_of_dates, ranked_location, site_probabilities
from dieseltwin.discovery.verdict.health_value import HealthValue
from dieseltwin.discovery.verdict.reasons import candidate_rows
from dieseltwin.notes import Note, listing
from dieseltwin.petrol.blocks import BLOCK_S
from dieseltwin.petrol.choices import began_rather, likelier_first, next_single, none_at_a_limit, one_fault_a_sensor
from dieseltwin.petrol.effects import NEEDS
from dieseltwin.petrol.lateness import late_channel
from dieseltwin.petrol.parameters import PetrolParameters, PetrolTerm
from dieseltwin.petrol.recording import COLUMNS, PetrolRecording, Signals
from dieseltwin.petrol.renewal import alike, leading, over_time
from dieseltwin.petrol.sentence import found_words, sentence
from dieseltwin.petrol.terms import without_terms
from dieseltwin.petrol.twin import PetrolTwin
from dieseltwin.settings.defaults import default_search
from dieseltwin.settings.search import SearchSettings
from dieseltwin.version import __version__

RENEWALS = 4  # of the scatter about what was found, at most
NEXT = ("single", "variant")  # kinds of a next finding that is said: one name; more of them are for the next discovery
ONSET_SHARE = 0.1  # of the recording, before an effect that `minimum_detectable` speaks of
SPLIT_BY = {
    frozenset(("p_ic_gain", "p_ic_offset")): "p_ic is known at rest, near one value; other ambient pressure would tell",
    frozenset(("p_im_gain", "p_im_offset")): "driving over a wide range of p_im tells gain from offset",
    frozenset(("p_im_gain", "volumetric_efficiency_change")): "wide-open throttle: p_im is p_ic there",
    frozenset(("w_af_gain", "intake_leak")): "high load: a leak vanishes as p_im nears p_amb, a gain does not",
    frozenset(("w_af_gain", "w_af_offset")): "driving over a wide range of air flow tells gain from offset",
}  # fmt: skip

_FAR_LEVEL = 2.5
"""Standard deviations of what is believed of a level, beyond which it is doubtful: beside right names of a foreign
plant they end within 1.6, beside two wrong ones at 2.9 to 3.7."""


@dataclass(frozen=True, kw_only=True)
class PetrolOptions(SearchOptions):
    """What a user may choose.

    Attributes:
        sensors: columns to use, None for all; those that no balance can do without have to be among them.
        map_tolerance: standard deviation of the maps' smooth relative errors, None for the engine's own [-].
    """

    sensors: tuple[str, ...] | None = None
    map_tolerance: float | None = None
    search: SearchSettings = field(default_factory=lambda: default_search().petrol)


@dataclass(frozen=True)
class PetrolDiscovery:
    """What was found.

    Attributes:
        document: schema 1.
        search: everything that the search found out.
        twin: the engine bound to the recording.
        engine: repaired: with what was found among its terms.
        after: (n, C) misfits that the explanation expects.
        sentence: in words.
        time0_s: time stamp of the recording's first row [s]; the twin's time begins there.
        runtime_s: seconds.
    """

    document: Discrepancy
    search: Search
    twin: PetrolTwin
    engine: PetrolParameters
    after: Array
    sentence: str
    time0_s: float
    runtime_s: float

    @property
    def candidates(self) -> list[Candidate]:
        """Every effect that was weighed, with its onset where the verdict has one, strongest first."""
        found = self.search
        if found.kind != "variant":
            return candidate_rows(found)
        fits = {fit.candidate.names[0]: fit for _, fit in reversed(found.variants)}
        rest = [fit for fit in found.singles if fit.candidate.names[0] not in fits]
        return candidate_rows(replace(found, singles=sorted([*fits.values(), *rest], key=lambda fit: fit.objective)))

    @property
    def threshold(self) -> float:
        """Decrease of -2 log likelihood from which a single effect is reported [-]."""
        return self.search.gain_of_alarm


def judge(
    engine: PetrolParameters, signals: Signals, options: PetrolOptions | None = None
) -> tuple[PetrolTwin, Search]:
    """The search on signals whose known effects are undone already.

    A second weighs less where a balance jumps. So does one in which a strong effect shows in short bursts, and then the
    effect weighs itself down: what was found is looked for again with seconds weighed beside it. So is a channel that
    became late, which shows in nothing but jumps.
    """
    options = options or PetrolOptions()
    if options.map_tolerance is not None:
        t = engine.tolerances.model_copy(
            update={"cylinder_field": options.map_tolerance, "throttle_field": options.map_tolerance}
        )
        engine = engine.model_copy(update={"tolerances": t})
    kept = twin, found = _searched(engine, signals, options)
    late = late_channel(found, options.settings().withhold) if found.kind == "healthy" else None
    if late is not None:
        twin, other = _searched(engine, signals, options, [late])
        if other.best is not None:
            kept, found = (twin, other), other
    for _ in range(RENEWALS):
        lead = leading(found)
        if lead is None:
            break
        before = found
        twin, found = _searched(engine, signals, options, over_time(twin, lead))
        if found.best is not None:
            kept = twin, found
        if alike(before, found):
            break
    return kept


def _searched(
    engine: PetrolParameters, signals: Signals, options: PetrolOptions, explained: Sequence[Mapping[str, Array]] = ()
) -> tuple[PetrolTwin, Search]:
    """One search; `explained`: what an earlier one found. An effect below its interest is none."""
    twin = PetrolTwin(engine, signals, options.sensors, explained)
    found = shared.run(twin, options.settings(), laws=False)
    next_single(found)
    if found.best is not None and not found.of_interest(found.best.fit):
        found.kind, found.best, found.variant = "healthy", None, None
    one_fault_a_sensor(found)
    likelier_first(found)
    began_rather(found)
    none_at_a_limit(found)
    return twin, found


def discover_petrol(
    recording: PetrolRecording, engine: PetrolParameters, options: PetrolOptions | None = None
) -> PetrolDiscovery:
    """Judge a recording with a calibrated engine. What the repaired engine would find next is said beside the verdict:
    two faults of different channels add up in no balance, so that the first is explained to the full without it."""
    began = time.perf_counter()
    options = options or PetrolOptions()
    twin, found = judge(engine, without_terms(engine, recording), options)
    date_edges(found)
    explained = explained_at(found)
    after, document = explained.simulated, _document(recording, options, twin, found, explained)
    repaired = engine.model_copy(update={"terms": (*engine.terms, *_terms(recording, document))})
    hidden = () if document.mismatch else (
        minimum_detectable(twin, found, "grows"), minimum_detectable(twin, found, "always")
    )  # fmt: skip
    told = sentence(document, hidden)
    if len(repaired.terms) > len(engine.terms):
        other_twin, other = judge(repaired, without_terms(repaired, recording), options)
        if other.kind in NEXT and other.explained() > found.settings.missing_share * found.explained():
            next_one = _document(recording, options, other_twin, other, explained_at(other))
            document = _with_next(document, next_one, found.explained(), other.explained())
            told = f"{told} Beside it, {found_words(next_one)}: `discover` with the repaired engine tells more."
    return PetrolDiscovery(document, found, twin, repaired, after, told, recording.time0_s,
                           time.perf_counter() - began)  # fmt: skip


def _with_next(document: Discrepancy, next_one: Discrepancy, explained: float, left: float) -> Discrepancy:
    """The document with what the repaired engine would find next.

    Args:
        document: of the first finding.
        next_one: of the next.
        explained, left: gain of each [-].
    """
    share = explained / (explained + left) if explained > 0.0 else 0.0
    fit = document.fit.model_copy(update={"share_explained": share})
    text = f"beside it, {found_words(next_one)}; `discover` with the repaired engine tells more"
    more = [] if document.more_is_missing else fit_doubts(document.model_copy(update={"more_is_missing": True}))[:1]
    document = document.model_copy(update={"fit": fit, "more_is_missing": True})
    return with_warnings(document, [*more, Note(text, "next_effect")])


def _document(
    recording: PetrolRecording, options: PetrolOptions, twin: PetrolTwin, found: Search, explained: Linearisation
) -> Discrepancy:  # fmt: skip
    mismatch = found.kind != "healthy"
    null, at = found.null, found.best or found.null
    used = [c for c in COLUMNS if any(c in NEEDS[name] for name in twin.channels)]
    made = Discrepancy(
        schema=1,
        recording=RecordingInfo(path=recording.path, sha256=recording.sha256,
                                duration_s=float(recording.signals.time_s[-1]), channels=tuple(used)),
        mismatch=mismatch,
        p_value=p_value(found),
        location=_location(recording, found) if mismatch else None,
        effects=tuple(_with_split(e, recording) for e in effects(found)) if mismatch else (),
        health={
            p.name: HealthValue(value=float(at.fit.parameters[j]), std=finite(float(at.fit.std[j])),
                                before=float(null.fit.parameters[j]))
            for j, p in enumerate(twin.parameters)
        },
        fit=fit_figures(found, explained, allowance(found, explained.simulated)),
        minimum_detectable=minimum_detectable(twin, found),
        provenance=Provenance(code_version=__version__, params_sha256=options.sha256),
    )  # fmt: skip
    return with_warnings(made, [*twin.notes(), *fit_doubts(made), *(_far_levels(twin, at.fit) if mismatch else ())])


def _far_levels(twin: PetrolTwin, fit: Fit) -> list[Note]:
    """That what is healthy has to be off by more than anybody believes for what was found to be all."""
    ratios = {p.name: (value, (value - p.value) / p.prior_std)
              for p, value in zip(twin.parameters, fit.parameters, strict=True)}  # fmt: skip
    far = [f"{name} ends at {value:.2g} ({abs(ratio):.2g} standard deviations of what is believed)"
           for name, (value, ratio) in ratios.items() if abs(ratio) > _FAR_LEVEL]  # fmt: skip
    return [Note(f"{listing(far)}: what is named may imitate something else, or have been there the other way round",
                 "residuals")] if far else []  # fmt: skip


def _location(recording: PetrolRecording, found: Search) -> Location:
    variant = found.variant if found.kind == "variant" else None
    if variant is None or variant.onset_s is None:
        return ranked_location(site_probabilities(found))
    first, last = float(found.twin.time_s[0]), variant.until_s
    return ranked_location(
        site_probabilities(found), onset_s=_stamp(recording, variant.onset_s) if variant.onset_s > first else None,
        until_s=None if last is None else _stamp(recording, last), grows=variant.grows,
        **ranges_of_dates(found, partial(_stamp, recording)),
    )  # fmt: skip


def _stamp(recording: PetrolRecording, middle_s: float) -> float:
    """Time stamp at which a block begins [s], by its middle since the recording's start [s]."""
    return recording.time0_s + float(middle_s) - 0.5 * BLOCK_S


def _with_split(effect: FoundEffect, recording: PetrolRecording) -> FoundEffect:
    """The effect with the driving behind it, and with what would tell it from its equivalents where that is known."""
    known = (text for pair, text in SPLIT_BY.items() if effect.name in pair and pair & set(effect.equivalent_names))
    split = next(known, effect.split_by)
    return effect.model_copy(update={"valid_for": _driven(recording.signals), "split_by": split})


def _driven(s: Signals) -> str:
    """Range of the driving in words."""
    low, high = np.quantile(s.p_im, (0.01, 0.99)) / 1e3
    slow, fast = np.quantile(s.omega_e, (0.01, 0.99))
    return f"p_im {low:.0f}-{high:.0f} kPa, omega_e {slow:.0f}-{fast:.0f} rad/s"


def _terms(recording: PetrolRecording, d: Discrepancy) -> list[PetrolTerm]:
    """What was found by name, for the engine file."""
    where = d.location
    if where is None:
        return []
    grown = recording.time0_s + float(recording.signals.time_s[-1]) if where.grows else None
    return [
        PetrolTerm(effect=e.name, magnitude=e.magnitude, std=e.std, onset_s=where.onset_s, until_s=where.until_s,
                   grown_s=grown, found_in=recording.sha256, valid_for=e.valid_for or "")
        for e in d.effects if e.magnitude is not None
    ]  # fmt: skip


def minimum_detectable(
    twin: PetrolTwin, found: Search, how: Literal["begins", "grows", "always"] = "begins"
) -> dict[str, float]:
    """Smallest magnitude that this recording could show, had it begun after a tenth of it, had it grown from there to
    that size at the end, which slow drifts of the balances take up, or had it been there from the first row on, which
    the recording's own levels take up [unit of the effect]."""
    first = float(twin.time_s[0])
    began = first if how == "always" else first + ONSET_SHARE * float(twin.time_s[-1] - twin.time_s[0])
    later = schedule_of(twin, began, None, grows=how == "grows")
    result: dict[str, float] = {}
    for item in found.scored:
        vector = without_parameters(found.null, found.null.metric.project((later[:, None] * item.response)[None]))[0]
        known = float(vector @ vector)
        if known > 0.0:
            size = max(float(np.sqrt(found.settings.hidden_gain / known)), twin.hypotheses[item.name].tolerance)
            result[item.name] = min(size, result.get(item.name, np.inf))
    return finite_only(result)


def details(found: PetrolDiscovery, options: Mapping[str, object]) -> dict[str, Any]:
    """Content of `details.json`: what was asked, every candidate with its reason, what could be seen."""
    search = found.search
    searched = details_of_search(search, found.candidates, search.best)
    for row in searched["variants"]:
        for key in ("onset_s", "until_s"):
            if row[key] is not None:
                row[key] += found.time0_s - 0.5 * BLOCK_S
    return {
        "sentence": found.sentence, "recording_sha256": found.document.recording.sha256, "options": dict(options),
        "alarm": found.threshold, "notes": [], "laws": [],
        "minimum_detectable": dict(found.document.minimum_detectable),
        **searched,
    }  # fmt: skip
