"""Discovery on a petrol engine's recording: is something left out or a sensor wrong, which, how large, since when.

1. Score every effect at every onset against the calibrated, toleranced twin; refit the best exactly.
2. Report one only beyond the threshold of fault-free pieces and beyond its tolerance.
3. Take it back and search again: what is left says whether a second effect is there, or whether none of these fits.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve

from dieseltwin import __version__
from dieseltwin.discovery.verdict.document import (
    NONE_OF_THESE,
    Alternative,
    Discrepancy,
    Fit,
    FoundEffect,
    HealthValue,
    Location,
    Provenance,
    RecordingInfo,
)
from dieseltwin.petrol.effects import HYPOTHESES, LOG_PRIOR, undo
from dieseltwin.petrol.likelihood import FREEDOM, LEAST_SUPPORT, BalanceFit
from dieseltwin.petrol.model import BALANCES, Bound, active_rows, bind
from dieseltwin.petrol.parameters import PetrolParameters
from dieseltwin.petrol.recording import PetrolRecording
from dieseltwin.petrol.search import Candidate, information, refit, search, with_std

Array = NDArray[np.float64]

EQUIVALENT = 4.5  # log-likelihood: 2 delta log-likelihood below 9 can't be told apart
UNEXPLAINED = 0.25  # a second effect at the same onset with so much of the first one's gain: none of these
SAME_ONSET_S = 30.0
TOLD_LEVEL = 0.01  # shift of a level that the sentence tells [-]
ONSET_SHARE = 0.1  # of the recording, before an effect that `minimum_detectable` speaks of
LEAST_P_VALUE = 1e-12  # pieces of one recording can't vouch for less
HELD_OUT = 1.0 / 3.0  # last part of the recording, for the held-out score
CHANNELS = ("p_ic_pa", "p_im_pa", "w_af_kg_s", "t_ic_k", "alpha_th_pct", "omega_e_rad_s", "p_amb_pa", "t_amb_k")
SPLIT_BY = {
    frozenset(("p_ic_gain", "p_ic_offset")): "p_ic is known at rest, near one value; other ambient pressure would tell",
    frozenset(("p_im_gain", "p_im_offset")): "driving over a wide range of p_im tells gain from offset",
    frozenset(("p_im_gain", "volumetric_efficiency_change")): "wide-open throttle: p_im is p_ic there",
    frozenset(("w_af_gain", "intake_leak")): "high load: a leak vanishes as p_im nears p_amb, a gain does not",
}


@dataclass(frozen=True)
class PetrolDiscovery:
    """What was found.

    Attributes:
        document: schema 1.
        candidates: strongest first, of the first search.
        found: the effects reported, or none.
        before, after: fits of the balances.
        bound, bound_after: the twin on the measured and on the corrected signals.
        sentence: in words.
        runtime_s: seconds.
    """

    document: Discrepancy
    candidates: tuple[Candidate, ...]
    found: tuple[Candidate, ...]
    before: dict[str, BalanceFit]
    after: dict[str, BalanceFit]
    bound: Bound
    bound_after: Bound
    sentence: str
    runtime_s: float

    @property
    def threshold(self) -> float:
        """What twice a gain in log-likelihood has to exceed [-]."""
        return self.bound.parameters.detection.for_duration(float(self.bound.signals.time_s[-1]))


def discover_petrol(recording: PetrolRecording, engine: PetrolParameters, params_sha256: str = "") -> PetrolDiscovery:
    """Judge a recording with a calibrated engine."""
    began = time.perf_counter()
    bound = bind(engine, recording.signals)
    duration = float(recording.signals.time_s[-1])
    candidates, _ = search(bound)
    best = _first(candidates)
    found: tuple[Candidate, ...] = ()
    unnamed = False
    bound_after = bound
    if significant(best, engine, duration):
        found = (with_std(bound, best),)
        bound_after = _corrected(bound, best)
        second = _first(search(bound_after, keep=3)[0])
        more = significant(second, engine, duration)
        unnamed = more and _same_onset(best, second) and second.gain > UNEXPLAINED * best.gain
        if more and not unnamed and second.name != best.name:
            found = (*found, with_std(bound_after, second))
            bound_after = _corrected(bound_after, second)
    before, after = bound.null(), bound_after.null()
    document = _document(recording, engine, bound, bound_after, candidates, found, unnamed, params_sha256)
    return PetrolDiscovery(document, tuple(candidates), found, before, after, bound, bound_after,
                           _sentence(document), time.perf_counter() - began)


def significant(c: Candidate, engine: PetrolParameters, duration_s: float) -> bool:
    """Beyond the threshold of fault-free pieces and beyond the effect's tolerance."""
    return 2.0 * c.gain > engine.detection.for_duration(duration_s) and abs(c.magnitude) >= HYPOTHESES[c.name].tolerance


def _first(candidates: list[Candidate]) -> Candidate:
    """The strongest; among those that can't be told from it, the one that is likelier beforehand."""
    top = candidates[0]
    level = top.gain - LOG_PRIOR.get(top.name, 0.0)
    same = [c for c in candidates if level - (c.gain - LOG_PRIOR.get(c.name, 0.0)) < EQUIVALENT]
    return max(same, key=lambda c: (LOG_PRIOR.get(c.name, 0.0), c.gain))


def _same_onset(a: Candidate, b: Candidate) -> bool:
    return abs((a.onset_s or 0.0) - (b.onset_s or 0.0)) < SAME_ONSET_S


def _corrected(bound: Bound, c: Candidate) -> Bound:
    active = active_rows(bound.signals.time_s, c.onset_s)
    corrected = bind(bound.parameters, undo(c.name, c.magnitude, active, bound.signals))
    return replace(corrected, scales=bound.scales)  # the same blocks count, and as much


def _document(
    recording: PetrolRecording, engine: PetrolParameters, bound: Bound, after: Bound, candidates: list[Candidate],
    found: tuple[Candidate, ...], unnamed: bool, params_sha256: str,
) -> Discrepancy:
    duration = float(recording.signals.time_s[-1])
    gain = 2.0 * (found[0].gain if found else candidates[0].gain)
    return Discrepancy(
        schema=1,
        recording=RecordingInfo(path=recording.path, sha256=recording.sha256, duration_s=duration, channels=CHANNELS),
        mismatch=bool(found),
        p_value=_p_value(gain, engine, duration),
        location=_location(recording, candidates, found) if found else None,
        effects=_effects(candidates, found, unnamed),
        health=_health(bound, after),
        fit=_fit(bound, after, found),
        minimum_detectable=minimum_detectable(after),
        provenance=Provenance(code_version=__version__, params_sha256=params_sha256 or engine.calibrated_on),
    )


def _p_value(score: float, engine: PetrolParameters, duration_s: float) -> float:
    """From the scores of fault-free pieces: exponential beyond their mean; with six pieces no more can be said."""
    scores = engine.detection.piece_scores or (engine.detection.threshold / 3.0,)
    scale = max(float(np.mean(np.maximum(scores, 0.0))), 2.0) * engine.detection.stretch(duration_s)
    return max(float(np.exp(-max(score, 0.0) / scale)), LEAST_P_VALUE)


def _location(recording: PetrolRecording, candidates: list[Candidate], found: tuple[Candidate, ...]) -> Location:
    log = np.array([c.gain for c in candidates])
    weight = np.exp(log - log.max())
    weight = weight / weight.sum()
    sites: dict[str, float] = {}
    for c, w in zip(candidates, weight, strict=True):
        site = HYPOTHESES[c.name].site
        sites[site] = min(sites.get(site, 0.0) + float(w), 1.0)
    site = HYPOTHESES[found[0].name].site
    others = tuple(Alternative(site=s, probability=min(p, 1.0 - sites[site]))
                   for s, p in sorted(sites.items(), key=lambda item: -item[1]) if s != site and p > 1e-12)
    onset = found[0].onset_s
    return Location(site=site, probability=sites[site], alternatives=others[:5],
                    onset_s=None if onset is None else recording.time0_s + onset)


def _effects(candidates: list[Candidate], found: tuple[Candidate, ...], unnamed: bool) -> tuple[FoundEffect, ...]:
    if unnamed:
        return (FoundEffect(name=NONE_OF_THESE, probability=1.0, law=None, magnitude=None, std=None, unit=None),)
    result = []
    for index, c in enumerate(found):
        h = HYPOTHESES[c.name]
        same: tuple[str, ...] = ()
        probability = 1.0
        if index == 0:
            raw = {o.name: o.gain - LOG_PRIOR.get(o.name, 0.0) for o in candidates}
            same = tuple(o.name for o in candidates if o.name != c.name and raw[c.name] - raw[o.name] < EQUIVALENT)
            weights = np.exp(np.array([o.gain for o in candidates]) - max(o.gain for o in candidates))
            probability = float(weights[[o.name for o in candidates].index(c.name)] / weights.sum())
        split = next((text for pair, text in SPLIT_BY.items() if c.name in pair and pair & set(same)), None)
        std = c.std if np.isfinite(c.std) else None
        result.append(FoundEffect(name=c.name, probability=min(probability, 1.0), equivalent_names=same, law=h.law,
                                  magnitude=c.magnitude, std=std, unit=h.unit, split_by=split))
    return tuple(result)


def _health(bound: Bound, after: Bound) -> dict[str, HealthValue]:
    """Levels of this recording against the calibration: what the fit moved, before and after the repair."""
    result = {}
    for name, balance in (("eta_vol_level", "cylinder"), ("throttle_area_level", "throttle")):
        values = []
        for b in (bound, after):
            fit = b.null()[balance]
            counted = fit.weight > 0.0
            used = _used(b, balance)
            mean = np.average(fit.design[counted], axis=0, weights=fit.weight[counted])
            values.append((float(mean @ fit.delta[used]), float(np.sqrt(mean @ cho_solve(fit.factor, mean)))))
        result[name] = HealthValue(value=values[1][0], std=values[1][1], before=values[0][0])
    zero = len(bound.parameters.throttle.coefficients) if bound.parameters.throttle else 0
    result["throttle_zero_pct"] = HealthValue(value=float(after.null()["throttle"].delta[zero]), std=None,
                                              before=float(bound.null()["throttle"].delta[zero]))
    return result


def _used(b: Bound, balance: str) -> NDArray[np.bool_]:
    design = b.rows(b.measured)[balance].design
    return np.asarray(np.abs(design).max(axis=0) > LEAST_SUPPORT)


def _fit(bound: Bound, after: Bound, found: tuple[Candidate, ...]) -> Fit:
    nll_before, nll_after = _held_out(bound, None), None
    if found:
        nll_after = _held_out(bound, found[0])
    return Fit(
        held_out_nll_before=nll_before, held_out_nll_after=nll_after if found else nll_before,
        chi2_per_sample_before=_chi2(bound), chi2_per_sample_after=_chi2(after),
        rmse_before=_rmse(bound), rmse_after=_rmse(after),
    )


def _chi2(b: Bound) -> float:
    """Squared residual over squared scale, weighted against outliers as in the fit, mean over blocks [-]."""
    total, count = 0.0, 0
    for name, fit in b.null().items():
        kept = np.isfinite(b.scales[name])
        z2 = (fit.residual[kept] / b.scales[name][kept]) ** 2
        total += float(((FREEDOM + 1.0) * z2 / (FREEDOM + z2)).sum())
        count += int(kept.sum())
    return total / max(count, 1)


def _rmse(b: Bound) -> dict[str, float]:
    """Air flow against the cylinders' and the throttle's flow [kg/s]; p_ic against the surroundings at rest [Pa]."""
    null = b.null()
    values = {"w_af_kg_s": b.measured.W_af * np.expm1(null["cylinder"].residual),
              "p_ic_pa": b.measured.p_ic * null["boost"].residual}
    result = {}
    for (channel, error), name in zip(values.items(), ("cylinder", "boost"), strict=True):
        kept = np.isfinite(b.scales[name])
        if kept.any():
            result[channel] = float(np.sqrt(np.mean(np.clip(error[kept], -1e6, 1e6) ** 2)))
    return result


def _held_out(bound: Bound, c: Candidate | None) -> float | None:
    """Negative log-likelihood per block of the last third, everything fitted to the rest; None if it can't be told."""
    mid = bound.measured.mid_s
    late = mid >= mid[-1] * (1.0 - HELD_OUT)
    if c is not None and c.onset_s is not None and c.onset_s > mid[-1] * (1.0 - HELD_OUT) - SAME_ONSET_S:
        return None
    early = Bound(bound.parameters, bound.signals, bound.grid, bound.measured,
                  {n: np.where(late, np.inf, s) for n, s in bound.scales.items()}, bound.priors, bound.thetas)
    if c is None:
        fits = early.null()
    else:
        magnitude, _ = refit(early, c.name, c.magnitude, c.onset_s)
        fits = early.effect(c.name, magnitude, c.onset_s)[1]
    total, count = 0.0, 0
    for name in BALANCES:
        kept = late & np.isfinite(bound.scales[name])
        scale = bound.scales[name][kept]
        z = fits[name].residual[kept] / scale
        total += float(np.sum(np.log(scale) + 0.5 * (FREEDOM + 1.0) * np.log1p(z * z / FREEDOM)))
        count += int(kept.sum())
    return total / count if count else None


def minimum_detectable(bound: Bound) -> dict[str, float]:
    """Smallest magnitude that this recording could show, had it begun after a tenth of it [unit of the effect]."""
    result = {}
    duration = float(bound.signals.time_s[-1])
    threshold = bound.parameters.detection.for_duration(duration)
    for name, h in HYPOTHESES.items():
        known = information(bound, name, ONSET_SHARE * duration)
        size = np.sqrt(threshold / known) if known > 0.0 else float("inf")
        if np.isfinite(size):
            result[name] = max(float(size), h.tolerance)
    return result


IN_THE_SENTENCE = ("p_im_gain", "p_ic_gain", "w_af_gain", "intake_leak")


def _sentence(d: Discrepancy) -> str:
    if not d.mismatch or d.location is None:
        shown = {n: v for n, v in d.minimum_detectable.items() if n in IN_THE_SENTENCE}
        limit = ", ".join(f"{n} {v:.2g} {HYPOTHESES[n].unit}".replace(" -", "") for n, v in shown.items())
        return f"No mismatch beyond what fault-free driving shows. Visible, if begun after a tenth of it: {limit}."
    e = d.effects[0]
    since = "from its start on" if d.location.onset_s is None else f"since {d.location.onset_s:.0f} s"
    if e.magnitude is None:
        return f"At {d.location.site}, {since}: none of the known effects explains it."
    size = f"{100 * e.magnitude:+.1f} %" if e.unit == "-" else f"{e.magnitude:.3g} {e.unit}"
    spread = "" if e.std is None else (f" ± {100 * e.std:.1f} %" if e.unit == "-" else f" ± {e.std:.1g} {e.unit}")
    same = f"; not told from {', '.join(e.equivalent_names)}" if e.equivalent_names else ""
    return f"At {d.location.site}: {e.name} {size}{spread}, {since}{same}.{_consequence(d)}"


def _consequence(d: Discrepancy) -> str:
    """What the effect did to the levels, if it moved one, and to the held-out score."""
    text = ""
    names = ("eta_vol_level", "throttle_area_level")
    worst = max(names, key=lambda name: abs(d.health[name].before - d.health[name].value))
    level = d.health[worst]
    if abs(level.before - level.value) > TOLD_LEVEL:
        text = f" Unrepaired, {worst} would read {100 * level.before:+.1f} % instead of {100 * level.value:+.1f} %."
    before, after = d.fit.held_out_nll_before, d.fit.held_out_nll_after
    if before is not None and after is not None:
        text += f" Held-out negative log-likelihood {before:.2f} before, {after:.2f} after."
    return text


def details(found: PetrolDiscovery) -> dict[str, Any]:
    """What is worth keeping besides the document."""
    return {"sentence": found.sentence, "threshold": found.threshold,
            "candidates": [{"name": c.name, "site": HYPOTHESES[c.name].site, "score": 2.0 * c.gain,
                            "magnitude": c.magnitude, "unit": HYPOTHESES[c.name].unit, "onset_s": c.onset_s}
                           for c in found.candidates]}
