"""From a finished search to the document, the repaired engine and the curves."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

import numpy as np

from dieseltwin.discovery.laws.terms import law_terms_of
from dieseltwin.discovery.likelihood.circumstances import Estimate
from dieseltwin.discovery.likelihood.fit import Fit, Linearisation
from dieseltwin.discovery.options import Options
from dieseltwin.discovery.search.state import Search, occam
from dieseltwin.discovery.twins.diesel import EngineTwin
from dieseltwin.discovery.twins.interface import Array, rows_of
from dieseltwin.discovery.twins.several import SeveralTwin
from dieseltwin.discovery.verdict import findings
from dieseltwin.discovery.verdict.curves import Candidate as CandidateRow
from dieseltwin.discovery.verdict.curves import Curves, Discovery, LawCurve
from dieseltwin.discovery.verdict.document import (
    NONE_OF_THESE,
    Discrepancy,
    Location,
    OutOfTime,
    Provenance,
    RecordingInfo,
    Reference,
)
from dieseltwin.discovery.verdict.document import Fit as FitFigures
from dieseltwin.discovery.verdict.effect_curve import effect_curves
from dieseltwin.discovery.verdict.explained import disagreement, explained_at
from dieseltwin.discovery.verdict.findings import finite, times_since_start
from dieseltwin.discovery.verdict.found_circumstance import FoundCircumstance
from dieseltwin.discovery.verdict.held_out import held_out_scores, held_windows
from dieseltwin.discovery.verdict.observed import observed
from dieseltwin.discovery.verdict.over_recordings import (
    health_places,
    health_values,
    judged,
    onset_of,
    told_apart,
    unseen_bias,
    with_words,
)
from dieseltwin.discovery.verdict.reasons import candidate_rows
from dieseltwin.discovery.verdict.since_reference import no_better_than_then, since_reference
from dieseltwin.discovery.verdict.told import Told, told
from dieseltwin.engine import HEALTH, EngineParameters
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.engine.terms import OneTerm, Term
from dieseltwin.recordings.dates import Dated
from dieseltwin.recordings.reader import Recording
from dieseltwin.version import __version__


def assemble(
    days: Sequence[Dated], found: Search, options: Options, reference: Reference | None = None,
    time_s: float | None = None, then: Array | None = None, shown: Callable[[Discovery], None] | None = None,
) -> Discovery:  # fmt: skip
    """The result of a search on recordings of the engine, one or several that were judged together.

    Health, the repaired engine and its states are those of the last recording.

    Args:
        days: the recordings, in time order; found: the search.
        options: what was asked; reference: what the engine was learned from.
        time_s: limit of the search [s], None where there was none.
        then: (4,) relative standard deviations of health when the reference was recorded [-]; None without one.
        shown: is given the result with health, sizes and circumstances as the search left them, everything else final.
    """
    null, best, mismatch = found.null, found.best, found.kind != "healthy"
    twin = cast(EngineTwin | SeveralTwin, found.twin)
    at = explained_at(found)
    after = at.simulated
    apart = disagreement(found, at)
    since = since_reference(at, found.twin, apart)
    evidence = _evidence(found, after)
    differ = told_apart(found, days) if mismatch else ""
    location = onset_of(findings.location(found, twin, evidence), found, days) if mismatch else None
    allowed, smallest = allowance(found, after), findings.minimum_detectable(found)
    figures = fit_figures(found, at, allowed)
    known = {name: (effect.tolerance, effect.unit) for name, effect in twin.hypotheses.items()}
    known |= {name: (EFFECTS[name].tolerance, EFFECTS[name].unit) for name in smallest if name not in known}
    rows = candidate_rows(found)
    curves = Curves(
        time_s=twin.recording_time_s, channels=twin.channels, measured=twin.measured, before=null.simulated,
        after=after, sigma=found.noise.overall.sigma, evidence_over_time=_by_window(found, evidence),
        evidence_map=dict(twin.conditions), evidence=evidence, candidates=rows, laws=_law_curves(found, twin),
        tolerance={name: size for name, (size, _) in known.items()},
        units={name: unit for name, (_, unit) in known.items()}, held_out=_held_rows(found),
        allowed=allowed, start_s=twin.start_s,
    )  # fmt: skip
    details = details_of_search(found, rows, best)
    starts, local = twin.starts, twin.initial(at.fit.local)
    if isinstance(twin, SeveralTwin):
        starts, local = twin.parts[-1].starts, local[-twin.parts[-1].starts.size :]

    def result(said: Told) -> Discovery:
        parameters = said.fit.parameters[: len(twin.parameters)]
        own = cast(Array, said.fit.covariance)[: apart.size, : apart.size] + np.diag(apart**2)
        covariance = no_better_than_then(own, parameters, then)
        document = Discrepancy(
            schema=1,  # type: ignore[call-arg]  # the alias of schema_version
            recording=_about(days, twin.channels),
            mismatch=mismatch,
            p_value=p_value(found),
            location=location,
            effects=with_words(findings.effects(found, said.fit), differ) if mismatch else (),
            more_is_missing=found.more_is_missing(), too_small=findings.too_small(found),
            health=health_values(found, (parameters, covariance), since),
            fit=figures,
            minimum_detectable=finite_only(smallest), surely_detectable=findings.surely_detectable(found),
            health_bias=unseen_bias(found),
            provenance=Provenance(code_version=__version__, params_sha256=options.sha256), reference=reference,
            out_of_time=OutOfTime(limit_s=time_s or 0.0, unfinished=found.unfinished) if found.unfinished else None,
            recordings=judged(found, days, (parameters, covariance), since, said.sizes),
            circumstances=tuple(found_circumstance(item) for item in said.circumstances),
            left_out=findings.left_out(found, twin),
        )  # fmt: skip
        terms = _terms(found, location, twin, said.fit) if location is not None else ()
        return Discovery(
            document, _engine(twin, parameters, terms), _engine(twin, null.fit.parameters, ()), curves, {}, details,
            starts, local, None if len(days) > 1 else observed(found, (parameters, covariance), since),
        )

    if shown is not None:
        shown(result(Told(at.fit, ())))
    return result(told(found, at, after))


def _about(days: Sequence[Dated], channels: Sequence[str]) -> RecordingInfo:
    """The recording; several are named by the first and the last, and hashed together."""
    recordings = [day.recording for day in days]
    names = [str(item.path.name if item.path else "recording") for item in recordings]
    several = len(recordings) > 1
    return RecordingInfo(
        path=f"{names[0]} to {names[-1]}, {len(names)} recordings" if several else names[0],
        sha256=together_sha256(recordings), duration_s=sum(item.duration_s for item in recordings),
        channels=tuple(channels),
    )  # fmt: skip


def together_sha256(recordings: Sequence[Recording]) -> str:
    """Hash of a recording, or of several whatever their order."""
    if len(recordings) == 1:
        return recordings[0].sha256
    return hashlib.sha256("".join(sorted(item.sha256 for item in recordings)).encode()).hexdigest()


def found_circumstance(estimate: Estimate) -> FoundCircumstance:
    """What a recording says of a circumstance, as the document has it."""
    item = estimate.circumstance
    return FoundCircumstance(
        name=item.plain, value=estimate.value, std=estimate.std, assumed=item.assumed, unit=item.unit, off=estimate.off,
        read=item.read, equivalent_names=item.effects,
        recording=None if item.recording is None else 1 + item.recording,
    )  # fmt: skip


def finite_only(values: Mapping[str, float]) -> dict[str, float]:
    """Without those that are not known."""
    return {name: float(value) for name, value in values.items() if np.isfinite(value)}


def _evidence(found: Search, after: Array) -> Array:
    """Half the decrease of the squared whitened residual at every sample, (n,)."""
    null = found.null
    before = null.metric.project(np.nan_to_num(null.residual)[None])[0]
    later = null.metric.project(np.nan_to_num(found.twin.measured - after)[None])[0]
    n, channels = null.residual.shape
    size = n * channels
    return 0.5 * (before[:size] ** 2 - later[:size] ** 2).reshape(n, channels).sum(axis=1)


def _by_window(found: Search, evidence: Array) -> tuple[Array, Array]:
    starts = found.twin.starts
    ends = np.append(starts[1:], evidence.size)
    time = found.twin.recording_time_s
    middles = np.array([0.5 * (time[a] + time[b - 1]) for a, b in zip(starts, ends, strict=True)])
    return middles, np.add.reduceat(evidence, starts)


def p_value(found: Search) -> float:
    """Probability that chance alone gives as much as the strongest finding."""
    gains = [found.explained(), *(found.gain(fit) for fit in found.singles[:1])]
    if found.kind == "law":
        gains += [item.gain for item in found.everything_unnamed()[:1]]
    return float(np.clip(found.chance.p_value(max(gains, default=0.0)), 0.0, 1.0))


def fit_figures(found: Search, at: Linearisation, allowed: Array | None) -> FitFigures:
    """How well the readings are met before, and after by the explanation.

    Args:
        found: the search; at: the explanation, as `explained_at`.
        allowed: its `allowance`.
    """
    null, after = found.null, at.simulated
    before_nll, after_nll = held_out_scores(found, at)
    whitening = null.whitening
    present = whitening.present

    def chi2(simulated: Array) -> float:
        residual = np.nan_to_num(found.twin.measured - simulated)
        return float((whitening.apply(residual[None])[0] ** 2).sum() / max(present.sum(), 1))

    def rmse(simulated: Array) -> dict[str, float]:
        error = np.where(present, found.twin.measured - simulated, 0.0)
        size = np.sqrt((error**2).sum(axis=0) / np.maximum(present.sum(axis=0), 1))
        return {name: float(value) for name, value in zip(found.twin.channels, size, strict=True)}

    return FitFigures(
        held_out_nll_before=finite(before_nll), held_out_nll_after=finite(after_nll),
        chi2_per_sample_before=chi2(null.simulated), chi2_per_sample_after=chi2(after),
        rmse_before=rmse(null.simulated), rmse_after=rmse(after),
        share_explained=found.share_explained(),
        chi2_per_sample_beyond=chi2(after if allowed is None else after + allowed),
        held_out_rows=int(_held_rows(found).sum()),
    )  # fmt: skip


def allowance(found: Search, simulated: Array) -> Array | None:
    """What the tolerances of maps and sensors most likely take of a residual, (n, C)."""
    null = found.null
    if null.nuisance_response is None:
        return None
    share = null.metric.nuisance_estimate(np.nan_to_num(found.twin.measured - simulated))
    return np.tensordot(share, null.nuisance_response, 1)


def _held_rows(found: Search) -> np.ndarray:
    return rows_of(found.twin, held_windows(found.twin))


def _terms(found: Search, location: Location, twin: EngineTwin | SeveralTwin, fit: Fit) -> tuple[Any, ...]:
    if found.kind == "law":
        since = None if isinstance(twin, SeveralTwin) else location.onset_s
        return () if found.law is None else law_terms_of(found.law, twin.points, since)
    P = len(twin.parameters)
    variant = found.variant if found.kind == "variant" else None
    times: dict[str, Any] = {}  # of a recording by itself
    if not isinstance(twin, SeveralTwin):
        end_s = float(twin.recording_time_s[-1] - twin.start_s)
        times = {"onset_s": location.onset_s, "until_s": location.until_s, "gone_s": location.gone_s,
                 "grown_s": end_s if location.grows else None}  # fmt: skip
    share = 1.0  # of its size, on the last recording
    if variant is not None and variant.profile is not None:
        share = float(variant.schedule[-1])
    if share == 0.0:  # it was mended before
        return ()
    terms = []
    for j, name in enumerate(fit.candidate.names):
        terms.append(
            Term(
                effect=name, magnitude=float(np.clip(share * fit.magnitudes[j], *EFFECTS[name].limits)),
                std=finite(share * float(fit.std[P + j])), **times,
                region=dict(variant.region) if variant is not None and variant.region else None,
                valid_for=findings.valid_for(found),
            )
        )
    return tuple(terms)


def _engine(twin: EngineTwin | SeveralTwin, parameters: Array, terms: tuple[Any, ...]) -> EngineParameters:
    values = {name: float(parameters[j]) for name, j in zip(HEALTH, health_places(twin), strict=True)}
    return twin.engine.replace(**values, terms=with_found(twin.engine.terms, terms))


def with_found(known: Sequence[OneTerm], found: Sequence[OneTerm]) -> tuple[OneTerm, ...]:
    """An engine's terms with those found beside them; the same effect for the same driving is one term, added up."""
    terms = list(known)
    for term in found:
        twins = [k for k, other in enumerate(terms) if _same_but_size(other, term)]
        if not twins or not isinstance(term, Term):
            terms.append(term)
            continue
        other = terms[twins[0]]
        total = float(np.clip(other.magnitude + term.magnitude, *EFFECTS[term.effect].limits))  # type: ignore[union-attr]
        terms[twins[0]] = term.model_copy(update={"magnitude": total})
    return tuple(terms)


def _same_but_size(one: OneTerm, other: OneTerm) -> bool:
    if not (isinstance(one, Term) and isinstance(other, Term)):
        return False
    size = {"magnitude", "std", "valid_for"}
    return one.model_dump(exclude=size) == other.model_dump(exclude=size)


def _law_curves(found: Search, twin: EngineTwin | SeveralTwin) -> list[LawCurve]:
    if found.best is not None and found.kind not in ("law", "healthy"):
        return effect_curves(found.best, twin.engine)
    curve = None if found.law is None else found.law.curve
    if curve is None or found.law is None:
        return []
    law = found.law
    return [
        LawCurve(
            name=NONE_OF_THESE, x_name=law.argument, x=curve.x, curve=curve.y, low=curve.low, high=curve.high,
            points_x=curve.points_x, points_y=curve.points_y, points_std=curve.points_std, unit=law.unit,
        )
    ]  # fmt: skip


def details_of_search(found: Search, rows: list[CandidateRow], best: Linearisation | None) -> dict[str, Any]:
    """What a search is worth keeping for `details.json`."""
    noise = found.noise.overall
    return {
        "kind": found.kind,
        "threshold": found.chance.threshold(found.settings.alarm_level),
        "equivalent_gain": found.settings.equivalent_gain,
        "noise": {
            name: {"sigma": float(s), "rho": float(r)}
            for name, s, r in zip(found.twin.channels, noise.sigma, noise.rho, strict=True)
        },
        "windows": int(found.twin.starts.size),
        "converged": {"before": bool(found.null.fit.converged), "after": bool((best or found.null).fit.converged)},
        "singles": [_fit_row(found, fit) for fit in found.singles[:12]],
        "pairs": [_fit_row(found, fit) for fit in found.pairs[:6]],
        "variants": [
            {**_fit_row(found, fit), **times_since_start(found.twin, v), "region": v.region, "profile": v.profile}
            for v, fit in found.variants[:4]
        ],
        "unnamed": [
            {
                "site": item.feature.site, "over": item.feature.text, "gain": float(item.gain),
                "point": None if item.feature.point is None else found.twin.points[item.feature.point].name,
            }
            for item in found.structure[:8]
        ],
        "candidates": [dict(row) for row in rows],
    }  # fmt: skip


def _fit_row(found: Search, fit: Fit) -> dict[str, Any]:
    P = len(found.twin.parameters)
    return {
        "names": list(fit.candidate.names), "magnitudes": [float(m) for m in fit.magnitudes],
        "std": [finite(float(s)) for s in fit.std[P:]], "gain": float(found.gain(fit)),
        "log_evidence": float(occam(found, fit)), "converged": bool(fit.converged),
    }  # fmt: skip

