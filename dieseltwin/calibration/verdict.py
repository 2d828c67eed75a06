"""The words and the document (schema 1) of what settled points call for."""

from __future__ import annotations

import numpy as np

from dieseltwin.calibration.repair import Candidate, Repair
from dieseltwin.calibration.steady_model import FLAP_REFERENCE, ROWS, T_REFERENCE
from dieseltwin.discovery.verdict.document import (
    NONE_OF_THESE,
    Alternative,
    Discrepancy,
    Fit,
    FoundEffect,
    FoundRegion,
    HealthValue,
    Location,
    Provenance,
    RecordingInfo,
)
from dieseltwin.engine.parameters import HEALTH
from dieseltwin.recordings.steady_points import STATES
from dieseltwin.version import __version__

_PLAIN = {
    "exhaust_flap": "the exhaust behind the turbine is throttled by the flap",
    "back_pressure": "the exhaust behind the turbine has back-pressure",
    "turbo_speed_low": "the turbo speed reads low at low speed",
    "charge_cooler_loss": "the charge-air cooler leaves part of the compressor's heat",
    "egr_heating": "recirculated gas heats the charge",
    "air_filter_restriction": "the air filter restricts the flow",
    "volumetric_efficiency_residual": "residual gas and hot walls lower the volumetric efficiency",
}


def flap_magnitude(repair: Repair) -> tuple[float, float]:
    """Back-pressure coefficient of the flap at 50 % near ambient pressure, and its deviation [Pa/(kg/s)^2]."""
    values, std = repair.estimate.values(), repair.estimate.std()
    engine = repair.model.engine
    area = np.exp(values["flap_0"])
    k = T_REFERENCE * engine.R_e / (2.0 * engine.p_amb * area**2)
    return float(k), float(2.0 * k * std["flap_0"])


def sentence(repair: Repair) -> str:
    """Where, what, how large, how much the held-out fit improved, and what could not be told apart."""
    if not repair.chosen:
        return (f"The {repair.calibration.points.size} points call for no term beyond the mean-value model "
                f"(held-out negative log-likelihood {repair.nll_before:.2f} per point).")
    parts = []
    for found in repair.chosen:
        also = repair.equivalent.get(found.term.name, ())
        told = f" (not told apart from {', '.join(also)})" if also else ""
        parts.append(f"{_PLAIN[found.term.name]} [{found.term.site}; gain {found.gain:.0f}]{told}")
    power, flow = repair.fits_before["turbo_power"], repair.fits_before["turbine_flow"]
    after = repair.fits_after
    text = (
        f"{'; '.join(parts)}. Held-out third: turbine flow {flow.held_out:.1f} -> {after['turbine_flow'].held_out:.1f} "
        f"%, turbo power {power.held_out:.1f} -> {after['turbo_power'].held_out:.1f} %, negative log-likelihood "
        f"{repair.nll_before:.1f} -> {repair.nll_after:.1f} per point."
    )
    return text[0].upper() + text[1:]


def _effect(repair: Repair, found: Candidate) -> FoundEffect:
    probability = float(1.0 / (1.0 + np.exp(-min(found.gain, 50.0))))
    law, split = found.term.law, found.term.split_by
    if found.term.name == "exhaust_flap":
        k, std = flap_magnitude(repair)
        values = repair.estimate.values()
        law += "; " + ", ".join(f"{name} = {values[name]:.4g}" for name in ("flap_0", "flap_1", "flap_2"))
        return FoundEffect(name="back_pressure", probability=probability, law=law, magnitude=k, std=std,
                           unit="Pa/(kg/s)^2", split_by=split,
                           valid_for=f"magnitude at u_flap_pct = {FLAP_REFERENCE:g} %; the law over the flap's range")
    if not found.term.catalogue:
        values = repair.estimate.values()
        law += "; " + ", ".join(f"{c.name} = {values[c.name]:.4g}" for c in found.term.parameters)
        return FoundEffect(name=NONE_OF_THESE, probability=probability, law=law, magnitude=None, std=None, unit=None,
                           split_by=split)
    names = tuple(n for n in repair.equivalent.get(found.term.name, ()) if n not in ("exhaust_flap", "turbo_speed_low"))
    head = found.term.parameters[0]
    return FoundEffect(name=found.term.name, probability=probability, equivalent_names=names, law=law,
                       magnitude=repair.estimate.values()[head.name], std=repair.estimate.std()[head.name],
                       unit=head.unit, split_by=split)


def document(repair: Repair) -> Discrepancy:
    """`discrepancy.json` of settled points: duration 0, no onset; names not of the catalogue are laws."""
    points = repair.calibration.points
    effects: list[FoundEffect] = []
    for found in repair.chosen:
        effect = _effect(repair, found)
        if effect.name not in [e.name for e in effects]:  # the schema takes each name once
            effects.append(effect)
    location = None
    if repair.chosen:
        rivals = [c for c in repair.candidates if c.round == 1]
        weight = {c.term.site: 0.0 for c in rivals}
        best = max(c.gain for c in rivals)
        for c in rivals:
            weight[c.term.site] = max(weight[c.term.site], float(np.exp(max(c.gain - best, -60.0))))
        total = sum(weight.values())
        site = repair.chosen[0].term.site
        ordered = sorted(weight.items(), key=lambda pair: -pair[1])
        others = tuple(Alternative(site=s, probability=w / total) for s, w in ordered if s != site)
        regions = (_region(repair),)
        location = Location(site=site, probability=weight[site] / total, alternatives=others, regions=regions,
                            onset_s=None)
    engine, before = repair.engine(), repair.calibration.engine
    std = repair.full_estimate.std()
    health = {name: HealthValue(value=float(getattr(engine, name)), std=std.get(name),
                                before=float(getattr(before, name))) for name in HEALTH}
    smallest: dict[str, float] = {}
    for c in repair.candidates:  # the last round in which it was tried
        if c.term.catalogue:
            smallest[c.term.name] = float(3.0 * c.std)
    return Discrepancy(
        schema=1,
        recording=RecordingInfo(path=str(points.path), sha256=points.sha256, duration_s=0.0,
                                channels=tuple(name for name in STATES if name in points)),
        mismatch=bool(repair.chosen),
        p_value=repair.p_value,
        location=location,
        effects=tuple(effects),
        health=health,
        fit=Fit(held_out_nll_before=repair.nll_before, held_out_nll_after=repair.nll_after,
                chi2_per_sample_before=repair.chi2_before, chi2_per_sample_after=repair.chi2_after,
                rmse_before=_rmse(repair, before=True), rmse_after=_rmse(repair, before=False)),
        minimum_detectable=smallest,
        provenance=Provenance(code_version=__version__, params_sha256="-"),
    )  # fmt: skip


def _rmse(repair: Repair, before: bool) -> dict[str, float]:
    points = repair.calibration.points
    model = repair.calibration.model if before else repair.model
    values = dict(repair.calibration.start) if before else {**repair.calibration.start, **repair.estimate.values()}
    relations = model.relations(points, points.states(), values)
    column = {"compressor_flow": "w_c_kg_s", "egr_flow": "w_egr_kg_s", "exhaust_temperature": "t_em_k"}
    return {column[row]: float(np.sqrt(np.nanmean((relations.measured[row] - relations.predicted[row]) ** 2)))
            for row in ROWS if row in column}


def _region(repair: Repair) -> FoundRegion:
    """The box of the points that hold most of the evidence (upper half of the gain)."""
    points = repair.calibration.points
    values = {**repair.calibration.start, **repair.estimate.values()}
    r_0 = repair.calibration.model.relations(points, points.states(), repair.calibration.start).residual[0]
    r_1 = repair.model.relations(points, points.states(), values).residual[0]
    gain = np.nansum(r_0[:, : len(ROWS)] ** 2 - r_1[:, : len(ROWS)] ** 2, axis=1)
    strong = gain >= np.median(gain)
    total = float(np.sum(np.maximum(gain, 0.0)))
    share = float(np.sum(np.maximum(gain[strong], 0.0)) / total) if total > 0 else 1.0
    box = {name: (float(points[name][strong].min()), float(points[name][strong].max()))
           for name in ("n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct")}
    return FoundRegion(n_e_rpm=box["n_e_rpm"], u_delta_mg=box["u_delta_mg"], u_egr_pct=box["u_egr_pct"],
                       u_vgt_pct=box["u_vgt_pct"], share_of_evidence=min(share, 1.0))

