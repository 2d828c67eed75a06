"""The report's own small computations: references, ratios to the bound, residuals and their autocorrelation."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dieseltwin.identification.states import HIGH, LOW
from dieseltwin.report.results import PARAMETERS, Estimate, MethodResult, Results
from dieseltwin.sensors import MEASURED


def reference_values(results: Results) -> dict[str, float]:
    """What figures are divided by: the truth where known, else the first finite pooled estimate [SI]."""
    references = {}
    for parameter in PARAMETERS:
        candidates = [results.true_value(parameter)]
        candidates += [method.pooled[parameter].mean for method in results.methods]
        candidates += [s.parameters[parameter].mean for m in results.methods for s in m.segments]
        references[parameter] = next((v for v in candidates if math.isfinite(v) and v != 0), math.nan)
    return references


def relative_bound(results: Results, estimate: Estimate, parameter: str) -> float:
    """Cramer-Rao bound over the estimate (over the reference where there is no estimate) [-]."""
    value = estimate.mean if estimate.finite else reference_values(results)[parameter]
    return estimate.bound / abs(value) if value else math.nan


def std_over_bound(estimate: Estimate) -> float:
    """Stated standard deviation over the bound [-]; NaN where either is missing."""
    return estimate.std / estimate.bound if estimate.bound > 0 else math.nan


def error_of_runs(method: MethodResult, segment: int, parameter: str, truth: float) -> float:
    """Root-mean-square error of one segment's runs against ``truth`` [SI].

    Runs that did not converge don't count while any did, as in the segment's own estimate.
    """
    runs = method.runs
    chosen = runs[
        (runs["segment"] == segment) & (runs["parameter"] == parameter) & np.isfinite(runs["value"])
    ]
    if len(chosen) and chosen["converged"].any():
        chosen = chosen[chosen["converged"]]
    mean = method.segments[segment].parameters[parameter].mean
    values = chosen["value"].to_numpy(dtype=float) if len(chosen) else np.array([mean])
    return float(np.sqrt(np.mean((values - truth) ** 2)))


def error_over_bound(method: MethodResult, segment: int, parameter: str, truth: float) -> float:
    """`error_of_runs` over that segment's Cramer-Rao bound [-]; NaN where either is missing."""
    bound = method.segments[segment].parameters[parameter].bound
    return error_of_runs(method, segment, parameter, truth) / bound if bound > 0 else math.nan


def typical_ratio(method: MethodResult, parameter: str, truth: float) -> float:
    """Root mean square over the identifiable segments of `error_over_bound`, or of std over bound without truth [-]."""
    ratios = []
    for index, segment in enumerate(method.segments):
        estimate = segment.parameters[parameter]
        if not estimate.identifiable:
            continue
        known = math.isfinite(truth)
        ratios.append(
            error_over_bound(method, index, parameter, truth) if known else std_over_bound(estimate)
        )
    finite = [r for r in ratios if math.isfinite(r)]
    return math.sqrt(sum(r * r for r in finite) / len(finite)) if finite else math.nan


def band(states: pd.DataFrame, column: str) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Lower and upper edge (n,) of a column's 90 % band over runs [SI], or None where the table has none."""
    low, high = f"{column}{LOW}", f"{column}{HIGH}"
    if low not in states:
        return None
    return states[low].to_numpy(dtype=float), states[high].to_numpy(dtype=float)


def residuals(
    results: Results, method: MethodResult
) -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Measured minus predicted over the noise's standard deviation, per measured column: (time [s], residual [-]).

    Rows are matched by time; masked readings and rows without a prediction are left out.
    """
    found: dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]] = {}
    if method.states is None or results.measured is None:
        return found
    predicted = method.states.drop_duplicates("time_s")
    measured = results.measured.drop_duplicates("time_s")
    # recordings carry time stamps of a logger: match to a tenth of a millisecond, not bit by bit
    left = measured.assign(_key=(measured["time_s"] * 1e4).round().astype("int64"))
    right = predicted.assign(_key=(predicted["time_s"] * 1e4).round().astype("int64"))
    joined = left.merge(right, on="_key", suffixes=("", "__predicted"))
    for column in MEASURED:
        sigma = results.sigma.get(column, math.nan)
        other = f"{column}__predicted" if f"{column}__predicted" in joined else column
        if column not in measured or column not in predicted or not (math.isfinite(sigma) and sigma > 0):
            continue
        values = (joined[column].to_numpy(dtype=float) - joined[other].to_numpy(dtype=float)) / sigma
        keep = np.isfinite(values)
        if keep.any():
            found[column] = (joined["time_s"].to_numpy(dtype=float)[keep], values[keep])
    return found


def autocorrelation(values: NDArray[np.float64], lags: int) -> NDArray[np.float64]:
    """Sample autocorrelation (lags + 1,) of ``values`` (n,), lag 0 first [-]."""
    centred = values - values.mean()
    scale = float(np.dot(centred, centred))
    lags = min(lags, len(values) - 1)
    if scale <= 0:
        return np.full(lags + 1, math.nan)
    return np.array([np.dot(centred[: len(centred) - k], centred[k:]) / scale for k in range(lags + 1)])


STD_TOLERANCE = 0.1  # a residual's std may leave 1 by this much: the noise level itself is known no better
WHITE_LIMIT = (
    4.0  # standard deviations of white noise's autocorrelation at one sample; rarer than chance over channels
)


def odd_channels(
    found: Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]]],
) -> dict[str, list[str]]:
    """Channels whose residuals (see `residuals`) don't look like the noise, by what is wrong.

    Keys: "large" and "small" (std against 1) and "coloured" (neighbouring residuals go together).
    """
    odd: dict[str, list[str]] = {"large": [], "small": [], "coloured": []}
    for column, (_, values) in found.items():
        spread = float(np.sqrt(np.mean(values**2)))
        if spread > 1 + STD_TOLERANCE:
            odd["large"].append(column)
        elif spread < 1 - STD_TOLERANCE:
            odd["small"].append(column)
        if len(values) > 2 and abs(autocorrelation(values, 1)[1]) > WHITE_LIMIT / math.sqrt(len(values)):
            odd["coloured"].append(column)
    return odd


def agree(one: Estimate, other: Estimate) -> bool | None:
    """Whether two estimates lie within two combined standard deviations; None where either is missing."""
    if not (one.finite and other.finite and math.isfinite(one.std) and math.isfinite(other.std)):
        return None
    return abs(one.mean - other.mean) <= 2.0 * math.hypot(one.std, other.std)


def within(interval: tuple[float, float], value: float) -> bool:
    """Whether ``value`` lies in the interval; False where anything is missing."""
    return interval[0] <= value <= interval[1]


def relative_error(mean: float, truth: float) -> float:
    """``mean / truth - 1`` [-]; NaN where either is missing."""
    return mean / truth - 1.0 if math.isfinite(truth) and truth != 0 else math.nan
