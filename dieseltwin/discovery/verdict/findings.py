"""Where the mismatch sits and what it is called: the location and the effects of a finished search."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, cast

import numpy as np
from scipy.special import expit, logsumexp

from dieseltwin.discovery.likelihood.circumstances import left_to_clocks
from dieseltwin.discovery.likelihood.fit import Fit
from dieseltwin.discovery.likelihood.score import minimum_detectable as smallest_seen
from dieseltwin.discovery.likelihood.score import surely_found
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.search.variants import Region, Variant, inside_region
from dieseltwin.discovery.twins.diesel import EngineTwin
from dieseltwin.discovery.twins.interface import Array, Twin, rows_of
from dieseltwin.discovery.twins.several import SeveralTwin
from dieseltwin.discovery.verdict.document import NONE_OF_THESE, Alternative, FoundEffect, FoundRegion, Location
from dieseltwin.discovery.verdict.left_out import LeftOut
from dieseltwin.discovery.verdict.reasons import split_by
from dieseltwin.discovery.verdict.when import CONDITIONS
from dieseltwin.least_squares import Z_90
from dieseltwin.symbols import INPUT_COLUMNS

_LEAST_PROBABILITY = 1e-3  # of a site or name that is still worth a line
_RIVALS = 5  # sites that are said beside the first
_REGION_SHARE = 0.9  # of the positive evidence that a reported region holds along each condition


def finite(value: float | None) -> float | None:
    """A number for JSON: None where there is none."""
    return float(value) if value is not None and np.isfinite(value) else None


def location(found: Search, twin: EngineTwin | SeveralTwin, evidence: Array) -> Location:
    """Site with its rivals, the driving that holds the evidence, the onset and the end."""
    variant = found.variant if found.kind == "variant" else None
    return ranked_location(
        site_probabilities(found),
        regions=_regions(twin, evidence, variant.region if variant else None), only_in=_only_in(found),
        **({} if variant is None else times_since_start(twin, variant)), **_since_of_law(found, twin),
        **ranges_of_dates(found, partial(since_start, twin)),
    )


def ranges_of_dates(found: Search, stamp: Callable[[float], float]) -> dict[str, Any]:
    """Between which dates an onset and an end lie, by the fields of `Location`.

    Args:
        found: the search.
        stamp: a time of the twin as the document has it [s].
    """
    ranges = {"onset_range_s": found.onset_range_s, "until_range_s": found.until_range_s}
    if found.kind not in ("variant", "law"):
        return {}
    return {name: (stamp(dates[0]), stamp(dates[1])) for name, dates in ranges.items() if dates is not None}


def left_out(found: Search, twin: EngineTwin | SeveralTwin) -> LeftOut | None:
    """The windows that weren't used, side by side as one span; None where all were."""
    rows = rows_of(twin, found.left_out) if found.left_out.any() else np.zeros(0, dtype=bool)
    if not rows.any():
        return None
    if isinstance(twin, SeveralTwin):
        return LeftOut(share=float(rows.mean()))
    time_s = twin.recording_time_s - twin.start_s
    begins = np.flatnonzero(np.diff(rows.astype(int), prepend=0) == 1)
    ends = np.minimum(np.flatnonzero(np.diff(rows.astype(int), append=0) == -1) + 1, rows.size - 1)
    spans = tuple((float(time_s[a]), float(time_s[b])) for a, b in zip(begins, ends, strict=True))
    return LeftOut(share=float(rows.mean()), spans_s=spans)


def _only_in(found: Search) -> dict[str, tuple[float | None, float | None]]:
    """The conditions in which alone the chosen explanation acts; an edge beyond the range driven is none."""
    region = _region(found)
    inside: dict[str, tuple[float | None, float | None]] = {}
    for name, (low, high) in region.items():
        values = found.twin.conditions[name]
        inside[name] = (low if low > values.min() else None, high if high < values.max() else None)
    return {name: edges for name, edges in inside.items() if edges != (None, None)}


def _region(found: Search) -> Region:
    variant = found.variant if found.kind == "variant" else None
    return {} if variant is None or variant.region is None else variant.region


def _since_of_law(found: Search, twin: Twin) -> dict[str, Any]:
    """Since when a law acts that isn't there from the first row on, by the field of `Location`."""
    since_s = found.since_s if found.kind == "law" else None
    return {} if since_s is None else {"onset_s": since_start(twin, since_s)}


def since_start(twin: Twin, time_s: float) -> float:
    """A time of the twin, in which gaps are closed, as one since the recording's start [s]."""
    return float(twin.recording_time_s[np.searchsorted(twin.time_s, time_s)] - twin.start_s)


def times_since_start(twin: Twin, variant: Variant) -> dict[str, Any]:
    """Since when, until when and in which spans not, by the fields of `Location`."""
    onset, until = variant.onset_s, variant.until_s
    return {
        "onset_s": None if onset is None or onset <= twin.time_s[0] else since_start(twin, onset),
        "until_s": None if until is None else since_start(twin, until),
        "grows": variant.grows, "gone_s": tuple((since_start(twin, a), since_start(twin, b)) for a, b in variant.gone),
    }  # fmt: skip


def ranked_location(weights: Mapping[str, float], site: str | None = None, **more: Any) -> Location:
    """The likeliest site with its strongest rivals.

    Args:
        weights: site -> probability.
        site: that comes first; None: the likeliest.
        more: further fields of the location.
    """
    ranked = sorted(weights.items(), key=lambda item: -item[1])
    site = ranked[0][0] if site is None else site
    rivals = [item for item in ranked if item[0] != site][:_RIVALS]
    return Location(
        site=site, probability=float(min(weights[site], 1.0)),
        alternatives=tuple(Alternative(site=s, probability=float(p)) for s, p in rivals if p > _LEAST_PROBABILITY),
        **more,
    )  # fmt: skip


def none_of_these(law: str | None, valid: str | None = None, probability: float = 1.0) -> FoundEffect:
    """Something that has no name: the law by which it goes, where there is one, and where that holds."""
    return FoundEffect(
        name=NONE_OF_THESE, probability=probability, law=law, magnitude=None, std=None, unit=None, valid_for=valid
    )


def site_probabilities(found: Search) -> dict[str, float]:
    """Probability of every place where the mismatch may sit."""
    hypotheses = found.twin.hypotheses
    weights: dict[str, float] = {}
    if found.kind == "law":
        if found.law is not None:
            best = found.law
            scores = {best.site: 0.0}
            for rival in best.rivals:
                scores[rival.site] = max(scores.get(rival.site, -np.inf), -0.5 * abs(rival.behind))
        else:
            scores = {}
            unnamed = found.everything_unnamed()
            for item in unnamed:
                score = 0.5 * (item.gain - unnamed[0].gain)
                scores[item.feature.site] = max(scores.get(item.feature.site, -np.inf), score)
        total = logsumexp(list(scores.values()))
        return {site: float(np.exp(score - total)) for site, score in scores.items()}
    for key, probability in found.probabilities.items():
        site = hypotheses[_strongest(found, key.split(" + "))].site
        weights[site] = weights.get(site, 0.0) + probability
    total = sum(weights.values())
    return {site: value / total for site, value in weights.items()}


def _strongest(found: Search, names: list[str]) -> str:
    """Of several effects the one that stands for the place: the one with more evidence by itself."""
    if len(names) == 1:
        return names[0]
    alone = {fit.candidate.names[0]: found.gain(fit) for fit in found.singles}
    return max(names, key=lambda name: alone.get(name, 0.0))


def _regions(
    twin: EngineTwin | SeveralTwin, evidence: Array, known: Mapping[str, tuple[float, float]] | None
) -> tuple[FoundRegion, ...]:
    """The box of conditions that holds most of the evidence; none where nowhere is any."""
    positive = np.maximum(_smooth(evidence), 0.0)
    if not positive.any():  # what was found gains by its prior alone
        return ()
    box: dict[str, tuple[float, float]] = {}
    inside = np.ones(evidence.size, dtype=bool)
    for name in INPUT_COLUMNS:
        values = twin.conditions[name]
        if known and name in known:
            low, high = np.clip(known[name], values.min(), values.max())
        else:
            order = np.argsort(values)
            share = np.cumsum(positive[order]) / max(positive.sum(), 1e-300)
            edge = 0.5 * (1.0 - _REGION_SHARE)
            low = values[order][min(int(np.searchsorted(share, edge)), values.size - 1)]
            high = values[order][min(int(np.searchsorted(share, 1.0 - edge)), values.size - 1)]
        box[name] = (float(low), float(high))
        inside &= (values >= low) & (values <= high)
    share = float(positive[inside].sum() / max(positive.sum(), 1e-300))
    return (FoundRegion(share_of_evidence=float(np.clip(share, 0.0, 1.0)), **box),)


def _smooth(values: Array, width: int = 5) -> Array:
    return np.convolve(values, np.ones(width) / width, mode="same")


def effects(found: Search, fit: Fit | None = None) -> tuple[FoundEffect, ...]:
    """What was left out, strongest first; `fit` of the chosen explanation gives the sizes, None: as it was chosen."""
    if found.kind == "law":
        return (_unnamed(found),)
    if fit is None:
        if found.best is None:
            return ()
        fit = found.best.fit
    entries = []
    names = fit.candidate.names
    pool = found.equivalent
    for name in names:
        partners = tuple(n for n in names if n != name)
        equivalents = []
        for other in pool:
            rest = [n for n in other if n not in partners]
            if len(rest) == 1 and rest[0] not in names and rest[0] not in equivalents:
                equivalents.append(rest[0])
        for other in found.unsettled:
            if name not in other:
                equivalents += [n for n in other if n not in names and n not in equivalents]
        probability = sum(
            value for key, value in found.probabilities.items() if name in key.split(" + ")
        )
        entries.append(_named(found, fit, name, probability, equivalents))
    alone = {fit.candidate.names[0]: found.gain(fit) for fit in found.singles}
    return tuple(sorted(entries, key=lambda entry: -alone.get(entry.name, 0.0)))


def minimum_detectable(found: Search) -> dict[str, float]:
    """Name -> size at which half of such recordings show an effect [unit]; infinite where none does.

    What is no other than a clock that is open (a valve's dead time) shows where no such clock is to be believed.
    """
    gain = found.settings.alarm_gain
    of_clocks = {name: std * gain**0.5 for name, std in left_to_clocks(found.null).items()}
    return {**smallest_seen(found.scored, gain), **of_clocks}


def surely_detectable(found: Search) -> dict[str, float]:
    """Name -> size that would have raised an alarm in 19 of 20 such recordings [unit]; none where one was raised."""
    if found.kind != "healthy":
        return {}
    least = {name: found.settings.alarm_size * h.tolerance for name, h in found.twin.hypotheses.items()}
    sizes = surely_found(found.scored, found.gain_of_alarm, least)
    of_clocks = {name: std * (found.gain_of_alarm**0.5 + Z_90) for name, std in left_to_clocks(found.null).items()}
    return {name: float(size) for name, size in {**sizes, **of_clocks}.items() if np.isfinite(size)}


def too_small(found: Search) -> FoundEffect | None:
    """The name that explains, beyond chance, what differs where nothing is as large as is of interest."""
    if found.kind != "healthy" or not found.singles:
        return None
    lead = found.singles[0]
    if not found.beyond_chance(lead) or found.of_interest(lead):
        return None
    gains = {fit.candidate.names[0]: found.gain(fit) for fit in found.singles}
    name, *others = gains
    alike = [other for other in others if gains[other] > gains[name] - found.settings.equivalent_gain]
    weights = np.exp(0.5 * (np.array(list(gains.values())) - gains[name]))
    return _named(found, lead, name, float(1.0 / weights.sum()), alike)


def _named(found: Search, fit: Fit, name: str, probability: float, equivalents: Sequence[str]) -> FoundEffect:
    """A name of a fit with its size there."""
    effect, j = found.twin.hypotheses[name], fit.candidate.names.index(name)
    return FoundEffect(
        name=name, probability=min(probability, 1.0), equivalent_names=tuple(equivalents), law=effect.law,
        magnitude=float(fit.magnitudes[j]), std=finite(float(fit.std[len(found.twin.parameters) + j])),
        unit=effect.unit, valid_for=valid_for(found),
        split_by=split_by(found, name, equivalents) if equivalents else None,
    )  # fmt: skip


def valid_for(found: Search) -> str:
    """The driving behind a finding, in words: of what acts in a part of it, that part."""
    acts = _acting(found)
    conditions = {name: values[acts] for name, values in found.twin.conditions.items()}
    parts = []
    for name, values in conditions.items():
        symbol, unit = CONDITIONS.get(name, (name, ""))
        parts.append(f"{symbol} {np.min(values):.4g}-{np.max(values):.4g} {unit}".strip())
    return ", ".join(parts)


def _acting(found: Search) -> np.ndarray:
    """(n,) whether the explanation acts at each sample."""
    if region := _region(found):
        return inside_region(found.twin.conditions, region)
    if found.kind == "variant" and found.variant is not None:
        return found.variant.schedule > 0.0
    return found.twin.time_s >= (-np.inf if found.since_s is None else found.since_s)


def _unnamed(found: Search) -> FoundEffect:
    catalogue = found.gain(found.singles[0]) if found.singles else 0.0
    ahead = max((item.gain for item in found.everything_unnamed()), default=0.0) - catalogue
    law: str | None = None
    if found.law is not None:
        law = found.law.text
        ahead = max(ahead, found.law.gain - catalogue)
    elif found.structure and found.structure[0].feature.channel is not None:
        item = found.structure[0]
        law = {"gain": f"reading (1 + {item.coefficient:.4g})", "lag": f"reading {item.coefficient:.2g} s behind",
               "offset": f"reading + {item.coefficient:.4g} of its mean"}[cast(str, item.feature.fault)]
    return none_of_these(law, valid_for(found), float(expit(0.5 * ahead)))


