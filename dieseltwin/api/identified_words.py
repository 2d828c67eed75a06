"""What an identification says in lines: its table, and warnings of fits that miss the readings."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from dieseltwin.discovery.fit_test import Tolerant
from dieseltwin.discovery.verdict.health_value import SinceReference
from dieseltwin.engine import HEALTH_UNITS
from dieseltwin.identification.result import intervals_from_log_std
from dieseltwin.notes import Note, counted
from dieseltwin.report.quantities import value_with_std

MISFIT = 2.0  # chi-square a sample from which the noise or the model is clearly not what was assumed
MOSTLY_STUCK = 0.5  # share of fits without convergence that is worth a warning: single starts are lost now and then
_DIFFER = 1.5  # times what is stated, by which estimates of segments differ before it is worth a word


def misfits(document: Mapping[str, Any]) -> list[Note]:
    """A warning when the fit leaves more than the noise explains: the intervals do not hold then."""
    everything = [s for run in document["runs"] for s in run["segments"]]
    by_segment = list(zip(*([s["converged"] for s in run["segments"]] for run in document["runs"]), strict=True))
    stuck, lost = sum(not any(ends) for ends in by_segment), sum(not s["converged"] for s in everything)
    notes: list[Note] = []
    if stuck or lost > MOSTLY_STUCK * len(everything):
        notes = [Note(f"{lost} of {len(everything)} fits did not converge (`converged` in identification.json), in "
                      f"{stuck} of {len(by_segment)} segments none; such a segment is left out of the pooled values",
                      "not_converged")]  # fmt: skip
    values = [s["chi2_per_sample"] for s in everything]
    known = [value for value in values if value is not None]
    if not known or float(np.median(known)) <= MISFIT:
        return notes
    size = float(np.sqrt(np.median(known)))
    return [*notes, Note(f"the fit leaves {size:.2g} times the noise assumed in params.yaml: a sensor, the engine "
            "file or the model is off, or the method has not converged; the intervals are too narrow", "misfit")]


def with_tolerances(document: Mapping[str, Any], tolerant: Mapping[str, Tolerant]) -> dict[str, Any]:
    """An identification's document with `with_tolerances`: mean, std, 90 % interval and unit of the health parameters
    that the recording can tell, by the method and by this fit. The intervals are symmetric in the logarithm, as those
    of the methods are. Of an engine that was learned `since_reference` stands beside them, as in discrepancy.json."""
    entries = {}
    for name, told in tolerant.items():
        # a value within its deviation of zero says nothing, and has no interval in the logarithm
        if document["parameters"][name]["mean"] is not None and 0.0 < told.std < told.value:
            _, interval = intervals_from_log_std(np.array(told.value), np.array(told.std / told.value))
            entries[name] = {"mean": told.value, "std": told.std, "unit": HEALTH_UNITS[name],
                             "interval_90": interval.tolist()}  # fmt: skip
            if told.since_reference is not None:
                entries[name]["since_reference"] = told.since_reference.model_dump()
    return {**document, "with_tolerances": entries}


def found_words(document: Mapping[str, Any]) -> list[str]:
    """The parameters in words: beside tolerances, where they were fitted so, as the method has them, and what can't be
    told."""
    pooled, beside = document["parameters"], document["with_tolerances"]
    unknown = [name for name, entry in pooled.items() if entry["mean"] is None]
    if len(unknown) == len(pooled):
        return ["no parameter can be told"]
    found = _listed({name: entry for name, entry in pooled.items() if name not in unknown})
    words = [found]
    if beside:
        since = [f"{name} {then.text}" for name, entry in beside.items() if (then := _since(entry)) is not None]
        words = [f"beside tolerances of maps and sensors {_listed(beside)}", f"with exact ones {found}"]
        words[1:1] = [f"since the reference {', '.join(since)}"] if since else []
    return words + ([f"not identifiable here: {', '.join(unknown)}"] if unknown else [])


def _since(entry: Mapping[str, Any]) -> SinceReference | None:
    return SinceReference(**entry["since_reference"]) if "since_reference" in entry else None


def _listed(entries: Mapping[str, Mapping[str, Any]]) -> str:
    return ", ".join(f"{name} {value_with_std(name, entry['mean'], entry['std'])}" for name, entry in entries.items())


def text_table(document: Mapping[str, Any]) -> list[str]:
    """The pooled estimates as lines of text: value, standard deviation and 90 % interval beside tolerances, where
    `document` has them; then the method's own with bound and segments used."""
    segments, beside = document["segments"], document.get("with_tolerances", {})
    own = [f"by {document['method']}, with exact maps and sensors: {_noise_alone(document)}"] if beside else []
    head = f"{'parameter':<10} {'estimate':>12} {'std':>10} {'90 % interval':>27} {'bound':>10}  unit       segments"
    size = f"{counted(len(document['runs']), 'run')}, {counted(len(segments), 'segment')}"
    lines = [f"{document['method']}, {size}", head, *_beside_lines(beside), *own]
    for name, entry in document["parameters"].items():
        used = sum(bool(segment["parameters"][name]["identifiable"]) for segment in segments)
        if entry["mean"] is None:
            lines.append(f"{name:<10} not identifiable here (drive with more EGR, load or time)")
            continue
        low, high = entry["interval_90"] or (float("nan"), float("nan"))
        interval = f"{low:.5g} to {high:.5g}"
        bound = "-" if entry["bound"] is None else f"{entry['bound']:.3g}"
        lines.append(f"{name:<10} {entry['mean']:>12.6g} {entry['std']:>10.3g} {interval:>27} {bound:>10}  "
                     f"{entry['unit']:<9}  {used} of {len(segments)}")
    return lines


def _beside_lines(beside: Mapping[str, Mapping[str, Any]]) -> list[str]:
    lines = ["beside tolerances of maps and sensors:"] if beside else []
    for name, entry in beside.items():
        interval = "{:.5g} to {:.5g}".format(*entry["interval_90"])
        line = f"{name:<10} {entry['mean']:>12.6g} {entry['std']:>10.3g} {interval:>27} {'':>12}{entry['unit']}"
        since = _since(entry)
        lines.append(line if since is None else f"{line:<83}  {since.text} since the reference")
    return lines


def _noise_alone(document: Mapping[str, Any]) -> str:
    """That intervals of a method are noise alone, and by how much its segments differ beside them."""
    most = max(map(partial(_scatter, document), document["parameters"]), default=0.0)
    further = f", and segments of this recording differ by up to {most:.2g} times as much" if most > _DIFFER else ""
    return f"the intervals are noise alone{further}"


def _scatter(document: Mapping[str, Any], name: str) -> float:
    """Root mean square of a parameter's estimates of the segments about their mean, in standard deviations that are
    stated of them, degrees of freedom counted [-]; 0 where fewer than two tell it."""
    entries = [segment["parameters"][name] for segment in document["segments"]]
    told = [(e["mean"], e["std"]) for e in entries if e["identifiable"] and e["mean"] is not None and e["std"]]
    if len(told) < 2:
        return 0.0
    values, stds = np.array(told).T
    mean = np.average(values, weights=stds**-2)
    return float(np.sqrt(np.sum(((values - mean) / stds) ** 2) / (values.size - 1)))
