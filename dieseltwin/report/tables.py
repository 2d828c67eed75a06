"""The report's numbers: summary and segment tables, and the paragraph that says the result in words.

Tables hold raw SI numbers; formatting happens last, so that a test can compare them with the documents they come from.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import pandas as pd

from dieseltwin.notes import counted, listing
from dieseltwin.report import quantities, style
from dieseltwin.report.results import PARAMETERS, Estimate, MethodResult, Results, SegmentResult
from dieseltwin.report.statistics import (
    agree,
    relative_bound,
    relative_error,
    typical_ratio,
    within,
)

SAME_HEALTH = 0.005  # a change below half a percent is called "as nominal" in the headline


def summary_table(results: Results) -> pd.DataFrame:
    """One row per method and parameter: pooled estimate, std, interval, error, ratio to the bound, seconds per run.

    Columns: method, parameter, mean, std, low, high, bound [SI], identifiable, error [-], nominal_change [-],
    ratio_to_bound [-], segments_identifiable, segments, runs, not_converged, seconds_per_run [s].
    """
    rows = []
    for method in results.methods:
        for parameter in PARAMETERS:
            estimate = method.pooled[parameter]
            truth = results.true_value(parameter)
            flags = [s.parameters[parameter].identifiable for s in method.segments]
            rows.append(
                {
                    "method": method.method,
                    "parameter": parameter,
                    **_numbers(estimate),
                    "identifiable": estimate.finite and any(flags),
                    "error": relative_error(estimate.mean, truth),
                    "nominal_change": relative_error(estimate.mean, results.nominal.get(parameter, math.nan)),
                    "ratio_to_bound": typical_ratio(method, parameter, truth),
                    "segments_identifiable": sum(flags),
                    "segments": len(flags),
                    "runs": method.number_of_runs,
                    "not_converged": method.number_not_converged,
                    "seconds_per_run": method.seconds_per_run,
                }
            )
    return pd.DataFrame(rows)


def segment_table(results: Results) -> pd.DataFrame:
    """One row per method, segment and parameter, in SI.

    Columns: method, segment, t0_s, t1_s, parameter, mean, std, low, high, bound [SI], relative_bound [-], identifiable,
    error [-], truth_inside.
    """
    rows = []
    for method in results.methods:
        for segment in method.segments:
            for parameter in PARAMETERS:
                estimate = segment.parameters[parameter]
                truth = results.true_value(parameter)
                rows.append(
                    {
                        "method": method.method,
                        "segment": segment.minutes,
                        "t0_s": segment.t0_s,
                        "t1_s": segment.t1_s,
                        "parameter": parameter,
                        **_numbers(estimate),
                        "relative_bound": relative_bound(results, estimate, parameter),
                        "identifiable": estimate.identifiable,
                        "error": relative_error(estimate.mean, truth),
                        "truth_inside": within(estimate.interval_90, truth) if math.isfinite(truth) else None,
                    }
                )
    return pd.DataFrame(rows)


def _numbers(estimate: Estimate) -> dict[str, float]:
    low, high = estimate.interval_90
    return {"mean": estimate.mean, "std": estimate.std, "low": low, "high": high, "bound": estimate.bound}


def summary_text(results: Results) -> str:
    """The summary as plain text for a terminal, one line per method and parameter."""
    header = ("method", "parameter", "estimate ± std", "error", "ratio to bound", "s per run")
    lines = [header]
    for row in summary_table(results).itertuples():
        lines.append(
            (
                str(row.method),
                str(row.parameter),
                quantities.value_with_std(row.parameter, row.mean, row.std)
                if row.identifiable
                else "not identifiable",
                quantities.percent(row.error, signed=True) if row.identifiable else "–",
                quantities.significant(row.ratio_to_bound, 3),
                quantities.significant(row.seconds_per_run, 3),
            )
        )
    widths = [max(len(line[i]) for line in lines) for i in range(len(header))]
    padded = ([cell.ljust(width) for cell, width in zip(line, widths, strict=True)] for line in lines)
    return "\n".join("  ".join(cells).rstrip() for cells in padded)


def headline_method(results: Results) -> MethodResult:
    """The method that the headline quotes: the one named in report.json, else the first in the house's order.

    The choice never looks at the truth: with a real recording there is none.
    """
    wanted = results.about.get("headline_method")
    return next((m for m in results.methods if m.method == wanted), results.methods[0])


def _minutes(segments: Sequence[SegmentResult]) -> str:
    """``minute 2–3`` or ``minutes 1–2, 3–4 and 7–8``."""
    return f"minute{'s' if len(segments) > 1 else ''} {listing([s.minutes for s in segments])}"


def _duration(segments: Sequence[SegmentResult]) -> str:
    seconds = sum(s.t1_s - s.t0_s for s in segments)
    return f"{quantities.significant(seconds / 60, 2)} min" if seconds >= 60 else f"{seconds:.0f} s"


def _blind_spots(results: Results, method: MethodResult) -> list[str]:
    """Sentences on segments where parameters cannot be identified, with the size of the bound; one per set of them."""
    groups: dict[tuple[float, ...], list[str]] = {}
    for parameter in PARAMETERS:
        blind = tuple(s.t0_s for s in method.segments if not s.parameters[parameter].identifiable)
        if blind:
            groups.setdefault(blind, []).append(parameter)
    found = []
    for starts, parameters in groups.items():
        are = "is" if len(parameters) == 1 else "are"
        their = "its value" if len(parameters) == 1 else "their values"
        if len(starts) == len(method.segments):
            names = listing([quantities.html_symbol(p) for p in parameters])
            found.append(f"{names} {are} not identifiable in any segment of this driving.")
            continue
        segments = [s for s in method.segments if s.t0_s in starts]
        where = (
            _minutes(segments)
            if len(segments) <= 6
            else f"{len(segments)} of {len(method.segments)} segments"
        )
        names = listing([quantities.html_symbol(p) + _best_possible(results, segments, p) for p in parameters])
        found.append(f"In {where}, {names} {are} not identifiable; that part is left out of {their}.")
    return found


def _best_possible(results: Results, segments: Sequence[SegmentResult], parameter: str) -> str:
    bounds = [100 * relative_bound(results, s.parameters[parameter], parameter) for s in segments]
    finite = [b for b in bounds if math.isfinite(b)]
    if not finite:
        return " (no information)"
    lowest, highest = f"{min(finite):.0f}", f"{max(finite):.0f}"
    return f" (best possible std {lowest if lowest == highest else f'{lowest} to {highest}'} %)"


def _agreement(results: Results, chosen: MethodResult) -> list[str]:
    found = []
    for other in results.methods:
        if other is chosen:
            continue
        verdicts = {p: agree(chosen.pooled[p], other.pooled[p]) for p in PARAMETERS}
        apart = [quantities.html_symbol(p) for p, same in verdicts.items() if same is False]
        label = style.method_style(other.method).label
        runs = other.number_of_runs * len(other.segments)
        if runs and other.number_not_converged == runs:
            label += " (none of whose runs had converged)"
        if all(same is None for same in verdicts.values()):
            found.append(f"{label} gave nothing that can be compared.")
        elif apart:
            found.append(f"{label} differs by more than two combined standard deviations on {listing(apart)}.")
        else:
            found.append(f"{label} agrees within two combined standard deviations.")
    return found


def _change_words(change: float, relative_std: float) -> str:
    """How a value stands to the nominal one; a change inside two standard deviations is no finding."""
    if abs(change) < SAME_HEALTH or abs(change) < 2 * relative_std:
        return " (as nominal, within its uncertainty)" if abs(change) >= SAME_HEALTH else " (as nominal)"
    return f" ({quantities.significant(100 * abs(change), 2)} % {'above' if change > 0 else 'below'} nominal)"


def _values(results: Results, estimates: Mapping[str, Estimate]) -> list[str]:
    """Each estimate in words (HTML), beside its nominal value; those without a number are left out."""
    values = []
    for parameter, estimate in estimates.items():
        if not estimate.finite:
            continue
        change = relative_error(estimate.mean, results.nominal.get(parameter, math.nan))
        words = _change_words(change, estimate.std / estimate.mean) if math.isfinite(change) else ""
        text = quantities.value_with_std(parameter, estimate.mean, estimate.std)
        values.append(f"{quantities.html_symbol(parameter)} = <b>{text}</b>{words}")
    return values


def _as_sentence(text: str) -> str:
    """A warning's text as the beginning of a sentence (HTML)."""
    return quantities.with_symbols(text[:1].upper() + text[1:])


def headline(results: Results) -> str:
    """One paragraph (HTML): whether the twin fits, what was found, how surely, what can't be said, how, how long."""
    method = headline_method(results)
    values, beside = _values(results, method.pooled), _values(results, method.with_tolerances)
    label = style.method_style(method.method).label
    count = len(method.segments)
    source = f"{_duration(method.segments)} of driving ({count} segment{'s' if count != 1 else ''})"
    sentences = [f"{_as_sentence(method.misfit)}."] if method.misfit else []
    if beside:
        sentences.append(
            f"From {source}, beside what maps and sensors may be off by: {listing(beside)}. "
            f"With exact ones <b>{label}</b> finds {listing(values)}."
        )
    elif values:
        sentences.append(f"From {source}, <b>{label}</b> finds {listing(values)}.")
    else:
        sentences.append(f"From {source}, <b>{label}</b> could not identify any health parameter.")
    sentences += _blind_spots(results, method)
    if results.truth is not None and values:
        errors = [abs(relative_error(method.pooled[p].mean, results.true_value(p))) for p in PARAMETERS]
        worst = max((e for e in errors if math.isfinite(e)), default=math.nan)
        inside = sum(within(method.pooled[p].interval_90, results.true_value(p)) for p in PARAMETERS)
        if math.isfinite(worst):
            total = sum(method.pooled[p].finite for p in PARAMETERS)
            sentences.append(
                f"The recording is simulated, so the truth is known: the largest error is {quantities.percent(worst)}, "
                f"and {inside} of {total} true values lie in their 90 % interval."
            )
    if math.isfinite(method.seconds_per_run):
        runs = method.number_of_runs * count
        duration = number_of_seconds(method, runs)
        count_words = f" ({counted(runs, 'run')}, {duration} in all)" if runs else ""
        sentences.append(
            f"It took {quantities.significant(method.seconds_per_run, 2)} s per run{count_words}."
        )
    if method.number_not_converged:
        every = method.number_of_runs * count
        sentences.append(
            f"{method.number_not_converged} of {every} runs did not converge; they count only where no other did."
        )
    return " ".join(sentences + _agreement(results, method))


def number_of_seconds(method: MethodResult, runs: int) -> str:
    """Wall time of the whole identification in words; from run time per run where the total was not kept."""
    seconds = method.runtime.get("seconds") or method.seconds_per_run * runs
    return f"{seconds / 60:.1f} min" if seconds >= 120 else f"{quantities.significant(float(seconds), 2)} s"
