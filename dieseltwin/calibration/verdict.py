"""The document (schema 1) of what settled points call for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dieseltwin.calibration.calibrate import Calibration
from dieseltwin.calibration.coefficients import WEAR, worn
from dieseltwin.calibration.discover import PointsDiscovery, Round
from dieseltwin.calibration.likelihood import balance_deviation
from dieseltwin.calibration.rough_maps import rough_maps_notes
from dieseltwin.calibration.scatter import Scatter
from dieseltwin.calibration.steady_model import ROWS
from dieseltwin.calibration.told_apart import equivalent, fits_of, sensor_notes, split_by
from dieseltwin.discovery.likelihood.score import minimum_detectable
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.verdict.document import (
    NONE_OF_THESE,
    Discrepancy,
    Fit,
    FoundEffect,
    FoundRegion,
    Location,
    Provenance,
    RecordingInfo,
    Reference,
    fit_doubts,
    with_warnings,
)
from dieseltwin.discovery.verdict.explain import plain
from dieseltwin.discovery.verdict.explained import disagreement
from dieseltwin.discovery.verdict.findings import finite, none_of_these, ranked_location, valid_for
from dieseltwin.discovery.verdict.health_value import HealthValue, SinceReference
from dieseltwin.discovery.verdict.reasons import candidate_rows
from dieseltwin.discovery.verdict.unseen import health_bias
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.engine.terms import Term
from dieseltwin.notes import Note, doubts_among
from dieseltwin.recordings.channels import INPUTS
from dieseltwin.recordings.steady_points import JUDGED, STATES
from dieseltwin.settings.names import listed
from dieseltwin.version import __version__

PLACES = {
    "p_es": "the pressure behind the turbine (a valve, brake or filter in the exhaust)",
    "p_bc": "the pressure before the compressor", "T_im": "the temperature of the charge",
}  # fmt: skip
MOST_CHI2 = 100.0  # of one balance of one point: a wild reading has a note of its own
_COLUMN = {"compressor_flow": "w_c_kg_s", "egr_flow": "w_egr_kg_s", "exhaust_temperature": "t_em_k"}


def _probabilities(item: Round) -> dict[str, float]:
    """Of the single names of a round by their gains, which sum to one."""
    fits = fits_of(item)
    gains = np.array([0.5 * item.found.gain(fit) for fit in fits])
    weights = np.exp(np.maximum(gains - gains.max(), -60.0))
    names = [fit.candidate.names[0] for fit in fits]
    return {name: float(w / weights.sum()) for name, w in zip(names, weights, strict=True)}


def shares(result: PointsDiscovery) -> list[tuple[tuple[str, ...], float]]:
    """Names of each round that was taken, and the share of the misfit beyond tolerances which it takes away [-]; that
    of a later round counts in what the earlier ones left."""
    found, left = [], 1.0
    for item, after in zip(result.rounds, [*result.rounds[1:], None], strict=True):
        share = _share(item, after)
        if item.taken and share is not None:
            names = dict.fromkeys(name if name in EFFECTS else NONE_OF_THESE for name in item.names)
            found.append((tuple(names), left * share))
            left *= 1.0 - share
    return found


def _share(item: Round, after: Round | None) -> float | None:
    """Share of a round's misfit that its names take away [-]; of a name that the search itself let go: by its gain, and
    of one that begins at a point: beside what the next round sees."""
    found = item.found
    if item.onset is not None and after is not None:
        gain = found.gain(item.onset.fit)
        left = max((term.held for term in after.found.everything_unnamed()), default=0.0)
        return gain / (gain + max(left - found.settings.chance_leaves, 0.0))
    if item.onset is None and found.best is not None and found.best.fit.candidate.names == item.names:
        return found.share_explained()
    gain = max((found.gain(fit) for fit in fits_of(item) if fit.candidate.names == item.names), default=0.0)
    return gain / max(found.null.fit.objective - found.twin.measured.size, gain, 1.0)


def _effects(result: PointsDiscovery) -> tuple[FoundEffect, ...]:
    """What was found, strongest first; what has no name of the catalogue is one entry, with its law."""
    entries: list[FoundEffect] = []
    laws: list[str] = []
    for item in result.rounds:
        for name in (n for n in item.names if item.taken and n in result.effects):
            magnitude, std = result.effects[name]
            hypothesis = item.found.twin.hypotheses[name]
            if name not in EFFECTS:
                column, _, fault = name.partition(":")
                size = f"{magnitude:+.4g} ± {std:.2g}"
                law = f"{column}: reading (1 {size})" if fault == "gain" else \
                    f"{column}: reading {size} {hypothesis.unit}"
                laws.append(law if item.onset is None else f"{law} since data row {item.onset.row}")
                continue
            law = hypothesis.law
            own = next(t.shape for t in result.terms() if isinstance(t, Term) and t.effect == name)
            if own:
                law += "; " + ", ".join(f"{key} = {value:.4g}" for key, value in own.items())
            others = equivalent(item, name)
            entries.append(FoundEffect(
                name=name, probability=_probabilities(item).get(name, 1.0) if len(item.names) == 1 else 1.0,
                equivalent_names=others, law=law, magnitude=magnitude, std=finite(std),
                unit=hypothesis.unit, valid_for=valid_for(item.found),
                since_row=None if item.onset is None else item.onset.row,
                split_by=split_by(name, others, result.calibration.model.extra),
            ))  # fmt: skip
    if result.more_is_missing:
        laws.append(result.law.text if result.law is not None else "more is missing; no law is resolved")
        if result.scatter is not None:
            laws.append(scatter_words(result.scatter))
    if laws:
        entries.append(none_of_these("; ".join(laws)))
    return tuple(entries)


def scatter_words(scatter: Scatter) -> str:
    """What differs from point to point, for people."""
    text = f"{scatter.site} differs from point to point by {scatter.std:.1%} beyond what was recorded"
    if scatter.beside is None or scatter.beside_std is None:
        return text
    return f"{text}, or {PLACES[scatter.beside]} does by {scatter.beside_std:.1%}"


def _location(result: PointsDiscovery) -> Location:
    first = result.first
    found = first.found
    weights: dict[str, float] = {}
    for name, probability in _probabilities(first).items():
        site = found.twin.hypotheses[name].site
        weights[site] = weights.get(site, 0.0) + probability
    if first.taken:
        site = found.twin.hypotheses[next(name for name in first.names if name in result.effects)].site
    elif result.law is not None and (result.scatter is None or result.law.gain > result.scatter.gain):
        site = result.law.site
    elif result.scatter is not None:
        site = result.scatter.site
    else:
        site = found.structure[0].feature.site
    weights.setdefault(site, 0.0)
    if not first.taken:
        weights = {site: 1.0}
    return ranked_location(weights, site, regions=(_region(result),))


def document(result: PointsDiscovery) -> Discrepancy:
    """`discrepancy.json` of settled points: duration 0, onsets by data rows; names not of the catalogue are laws."""
    points = result.calibration.points.judged
    first, onset = result.rounds[0].found, result.rounds[0].onset
    gain = first.gain(first.singles[0]) if onset is None else \
        first.gain(onset.fit) - first.settings.variant_gain  # what it must add for its choice
    health = _health(result)
    chi2_before, chi2_after = _chi2(result)
    made = Discrepancy(
        schema=1,  # type: ignore[call-arg]  # the alias of schema_version
        recording=RecordingInfo(path=str(points.path.name if points.path else "points"), sha256=points.sha256,
                                duration_s=0.0, channels=tuple(name for name in STATES if name in points)),
        mismatch=result.mismatch,
        p_value=float(np.clip(first.chance.p_value(gain), 0.0, 1.0)),
        location=_location(result) if result.mismatch else None,
        effects=_effects(result) if result.mismatch else (),
        more_is_missing=result.more_is_missing,
        reference=_reference(result),
        health=health,
        fit=Fit(held_out_nll_before=result.nll_before, held_out_nll_after=result.nll_after,
                chi2_per_sample_before=chi2_before, chi2_per_sample_after=chi2_after,
                rmse_before=_rmse(result, before=True), rmse_after=_rmse(result, before=False),
                share_explained=sum(share for _, share in shares(result)) if result.effects else None),
        minimum_detectable={name: float(size) for name, size in
                            minimum_detectable(first.scored, first.settings.alarm_gain).items()
                            if np.isfinite(size) and name in EFFECTS},
        health_bias=_health_bias(first),
        provenance=Provenance(code_version=__version__, params_sha256=result.options.sha256),
    )  # fmt: skip
    doubts = [*doubts_among(result.calibration.notes), *fit_doubts(made), *_law_notes(result, health),
              *_pipe_notes(result), *sensor_notes(result),
              *rough_maps_notes(result.rough, result.rough_named, result.options.search)]  # fmt: skip
    return with_warnings(made, doubts)


def _health(result: PointsDiscovery) -> dict[str, HealthValue]:
    """Health as it is now, and against the reference where there is one.

    A law without a name is held as it was found, and health trades off against it: with a turbine flow that falls by
    16 % comes a turbine that is opened by 20 %. So what health changes by with the law counts as its deviation, too,
    and what it would change by with an effect that may be there unseen.
    """
    engine, before = result.engine(), worn(result.calibration.engine, result.calibration.start)
    apart = apart_by_law(result) or _apart_by_what_goes_unseen(result)
    found = result.repaired.estimate
    place = {c.name: i for i, c in enumerate(found.coefficients)}
    health = {}
    for name, wear in WEAR.items():
        slope, since = np.zeros(len(place)), None
        value, (moved, moved_since) = float(getattr(engine, name)), apart.get(name, (0.0, 0.0))
        if wear in place:
            factor = 1.0 + float(found.theta[place[wear]])
            slope[place[wear]] = getattr(result.repaired.engine, name)
            own = found.covariance[place[wear], place[wear]]
            since = SinceReference(value=factor, std=float(np.sqrt(own + moved_since**2)))
        if name in place:
            slope[place[name]] = 1.0 if since is None else since.value
        std = float(np.sqrt(slope @ found.covariance @ slope + moved**2)) if name in place else None
        health[name] = HealthValue(value=value, std=std, before=float(getattr(before, name)), since_reference=since)
    return health


def apart_by_law(result: PointsDiscovery) -> dict[str, tuple[float, float]]:
    """Health parameter -> by how much it is another with the law that has no name than without it: itself [its unit],
    and its quotient to the reference's [-]. None of them without such a law."""
    without = result.before_law
    if without is None:
        return {}
    ways = [(worn(each.engine, each.start), each.start) for each in (result.repaired, without)]
    return {name: (float(getattr(ways[0][0], name) - getattr(ways[1][0], name)),
                   float(ways[0][1].get(wear, 0.0) - ways[1][1].get(wear, 0.0))) for name, wear in WEAR.items()}


def _apart_by_what_goes_unseen(result: PointsDiscovery) -> dict[str, tuple[float, float]]:
    """The same as `apart_by_law` for an effect that may be there without an alarm; none where more is missing."""
    found = result.rounds[-1].found
    if found.kind != "healthy":
        return {}
    names = [parameter.name for parameter in found.twin.parameters]
    moved = dict(zip(names, map(float, disagreement(found, found.null)), strict=True))
    return {name: (moved[name], 0.0) if name in moved else
            (getattr(result.repaired.engine, name) * moved.get(wear, 0.0), moved.get(wear, 0.0))
            for name, wear in WEAR.items()}  # fmt: skip


def _health_bias(found: Search) -> dict[str, dict[str, float]]:
    """What an effect of its smallest visible size, unseen, would move health by, since the reference where there is
    one."""
    at = dict(zip((p.name for p in found.twin.parameters), found.null.fit.parameters, strict=True))
    names = list(at)
    since = {name: (names.index(wear), 1.0 + float(at[wear])) for name, wear in WEAR.items() if wear in at}
    return health_bias(found, {**{name: (names.index(name), float(at[name])) for name in WEAR if name in at}, **since})


def _law_notes(result: PointsDiscovery, health: Mapping[str, HealthValue]) -> list[Note]:
    """Health that can't be told from a law without a name: another by more than its own deviation with it."""
    found = result.repaired.estimate
    own = {c.name: float(std) for c, std in zip(found.coefficients, np.sqrt(np.diag(found.covariance)), strict=True)}
    apart = apart_by_law(result)
    told = [f"{name} ({100.0 * (now.since_reference.value - 1.0):+.1f} % with it, "
            f"{100.0 * (now.since_reference.value - 1.0 - apart[name][1]):+.1f} % without)"
            for name, now in health.items()
            if now.since_reference is not None and abs(apart.get(name, (0.0, 0.0))[1]) > own.get(WEAR[name], np.inf)]
    return [Note(f"since the reference, {listed(told)} can't be told from the law that has no name; the deviation "
                 "holds both", "health_or_law")] if told else []  # fmt: skip


def _pipe_notes(result: PointsDiscovery) -> list[Note]:
    """What a back pressure comes to where the engine has pipes of its own, which its reference doesn't show."""
    if result.beside_pipes is None or "back_pressure" not in result.effects:
        return []
    found = result.effects["back_pressure"][0]
    return [Note(f"the back pressure is {found / 1e3:.3g} kPa/(kg/s)^2 if nothing throttled the exhaust of the well "
                 f"engine, and {result.beside_pipes / 1e3:.3g} beside usual pipes; the deviation holds both, and a "
                 "pressure read behind the turbine would tell", "not_recorded", ("p_es_pa",))]  # fmt: skip


def _reference(result: PointsDiscovery) -> Reference | None:
    """How many of the judged points lie within the reference's range of every input."""
    points = result.calibration.points
    if JUDGED not in points:
        return None
    known = points.take(points[JUDGED] < 0.5)
    judged = points.judged
    inside = [(judged[name] >= known[name].min()) & (judged[name] <= known[name].max()) for name in INPUTS]
    return Reference(recordings=1, minutes=0.0, domain_share=float(np.all(inside, axis=0).mean()))


def details(result: PointsDiscovery, asked: Mapping[str, Any]) -> dict[str, Any]:
    """Content of `details.json`, from which `--explain` answers."""
    first = result.rounds[0].found
    chosen = [name for item in result.rounds if item.taken for name in item.names]
    rows = []
    for row in candidate_rows(first):
        if row["name"] in chosen:
            place = _round_of(result, row["name"])
            row["reason"] = f"chosen in round {place}: held-out points are foretold better"
            if (onset := result.rounds[place - 1].onset) is not None:
                row["reason"] += f" with it since data row {onset.row}"
        rows.append(dict(row))
    return plain({
        "recording_sha256": result.calibration.points.sha256,
        "options": dict(asked),
        "notes": list(result.calibration.notes),
        "candidates": rows,
        "rounds": [
            {"names": list(item.names), "taken": item.taken, "held_out_nll": item.nll, "kind": item.found.kind,
             "since_row": None if item.onset is None else item.onset.row,
             "singles": [{"name": fit.candidate.names[0], "gain": item.found.gain(fit),
                          "magnitude": float(fit.magnitudes[0])} for fit in item.found.singles[:8]]}
            for item in result.rounds
        ],
        "minimum_detectable": minimum_detectable(first.scored, first.settings.alarm_gain),
        "tolerance": {name: h.tolerance for name, h in first.twin.hypotheses.items()},
        "units": {name: h.unit for name, h in first.twin.hypotheses.items()},
        "equivalent_gain": first.settings.equivalent_gain,
        "settings": result.options.search.model_dump(),
    })  # type: ignore[no-any-return]  # fmt: skip


def _round_of(result: PointsDiscovery, name: str) -> int:
    return next(k for k, item in enumerate(result.rounds, 1) if name in item.names and item.taken)


def _rmse(result: PointsDiscovery, before: bool) -> dict[str, float]:
    points = result.points.judged
    here = result.calibration if before else result.repaired
    relations = here.model.relations(points, points.states(), here.start)
    return {_COLUMN[row]: float(np.sqrt(np.nanmean((relations.measured[row] - relations.predicted[row]) ** 2)))
            for row in ROWS if row in _COLUMN}


def _chi2(result: PointsDiscovery) -> tuple[float, float]:
    """Mean square of the judged points' balances before and after, over what they may be off by afterwards [-].

    Over one deviation for all points a few small EGR flows, of which a reading tells little, made it 4 on a healthy
    engine.
    """
    points, rows = result.points.judged, slice(len(ROWS))
    repaired = result.repaired
    deviation = balance_deviation(repaired.model, points, repaired.start, repaired.estimate.discrepancy)[:, rows]

    def of(machine: Calibration) -> float:
        residual = machine.model.relations(points, points.states(), machine.start).residual[0, :, rows]
        return float(np.nanmean(np.minimum((residual / deviation) ** 2, MOST_CHI2)))

    return of(result.calibration), of(repaired)


def _region(result: PointsDiscovery) -> FoundRegion:
    """The box of the points that hold most of the evidence (upper half of the gain)."""
    points = result.points.judged
    states = points.states()
    r_0 = result.calibration.model.relations(points, states, result.calibration.start).residual[0]
    r_1 = result.repaired.model.relations(points, states, result.repaired.start).residual[0]
    gain = np.nansum(r_0[:, : len(ROWS)] ** 2 - r_1[:, : len(ROWS)] ** 2, axis=1)
    strong = gain >= np.median(gain)
    total = float(np.sum(np.maximum(gain, 0.0)))
    share = float(np.sum(np.maximum(gain[strong], 0.0)) / total) if total > 0 else 1.0
    box = {name: (float(points[name][strong].min()), float(points[name][strong].max())) for name in INPUTS}
    return FoundRegion(n_e_rpm=box["n_e_rpm"], u_delta_mg=box["u_delta_mg"], u_egr_pct=box["u_egr_pct"],
                       u_vgt_pct=box["u_vgt_pct"], share_of_evidence=min(share, 1.0))
