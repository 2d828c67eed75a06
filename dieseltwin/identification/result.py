"""What an estimator returns, and `identification.json` (schema 1)."""

from __future__ import annotations

import math
import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import stdtrit

from dieseltwin.arrays import Array
from dieseltwin.engine.parameters import HEALTH, HEALTH_UNITS
from dieseltwin.identification.in_place import InPlace
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.states import FORMULAE, StateSamples, segment_states
from dieseltwin.least_squares import INTERVAL, Z_90

SCHEMA = 1
EPOCH = "epoch"
MEMBERS_FOR_QUANTILES = 20
"""From this many members on, the spread is read as quantiles; below, a Student interval is used."""
STATE_SAMPLES = 24
"""Draws from the uncertainty of a segment that are simulated for the bands of its states."""


@dataclass(frozen=True)
class ParameterSummary:
    """One unknown of one segment, or pooled.

    Attributes:
        mean, std: value and standard deviation [SI unit of the parameter]; None where nothing was
            identifiable.
        interval_90: 90 % interval, or None.
        bound: Cramer-Rao standard deviation [same unit]; infinite where there is no information at all.
        identifiable: whether the relative bound is small enough.
        ambient_log: change of the logarithm by one standard deviation of the ambient pressure, which all segments
            share; counted in `std` [-].
    """

    mean: float | None
    std: float | None
    interval_90: tuple[float, float] | None
    bound: float
    identifiable: bool
    ambient_log: float = 0.0

    def to_json(self, name: str) -> dict[str, Any]:
        """Strict JSON: an infinite bound becomes null."""
        return {
            "mean": _finite(self.mean),
            "std": _finite(self.std),
            "interval_90": None if self.interval_90 is None else [_finite(v) for v in self.interval_90],
            "unit": HEALTH_UNITS[name],
            "bound": _finite(self.bound),
            "identifiable": bool(self.identifiable),
        }


@dataclass(frozen=True)
class SegmentEstimate:
    """Estimates of R runs on one segment.

    Attributes:
        t0_s, t1_s: segment [s].
        time_s: (n,) sample times [s].
        parameters: (R, 4) estimates in the order of `HEALTH` [m2, m2, -, W/(m2 K)]; NaN for a run without a usable one.
        std: (R, 4) standard deviation that each run claims; NaN where a method has none (Adam: spread of
            members).
        interval_90: (R, 4, 2) interval that each run claims; NaN where a method has none.
        states: (n, 5) p_im, p_em, omega_t, x_r, T_1 of the pooled estimate [Pa, Pa, rad/s, -, K].
        bound: (4,) Cramer-Rao standard deviation, absolute [same units as the parameters].
        identifiable: (4,) relative bound at most the threshold.
        converged: (R,) whether a run reached a stationary point.
        seconds_per_run: wall seconds divided by runs, of this segment [s].
        method: name of the method.
        chi2_per_sample: (R,) sum of squared residuals over sigma, divided by the degrees of freedom; NaN if
            not known.
        state_samples: (K, n, 5) states of runs or of draws from their uncertainty, for bands; None if not
            kept.
        parameter_samples: (K, 4) parameters that belong to `state_samples`.
        curves: named convergence curves for the report, e.g. {"loss": (iterations,)}.
        ambient_log: (4,) change of the estimates' logarithms by one standard deviation of an ambient pressure that was
            recorded in coarse steps [-].
    """

    t0_s: float
    t1_s: float
    time_s: Array
    parameters: Array
    std: Array
    interval_90: Array
    states: Array
    bound: Array
    identifiable: NDArray[np.bool_]
    converged: NDArray[np.bool_]
    seconds_per_run: float
    method: str
    chi2_per_sample: Array | None = None
    state_samples: Array | None = field(default=None, repr=False)
    parameter_samples: Array | None = field(default=None, repr=False)
    curves: dict[str, Array] = field(default_factory=dict, repr=False)
    ambient_log: Array = field(default_factory=lambda: np.zeros(len(HEALTH)), repr=False)

    @property
    def runs(self) -> int:
        """Number of runs R."""
        return int(self.parameters.shape[0])

    @property
    def used(self) -> NDArray[np.bool_]:
        """(R,) runs behind the summary: the converged ones; if none converged all with a value, all if none has one."""
        converged = np.asarray(self.converged, dtype=bool)
        if converged.any():
            return converged
        finite = np.asarray(np.isfinite(self.parameters).all(axis=1))
        return finite if finite.any() else np.ones_like(converged)

    @property
    def trusted(self) -> bool:
        """Whether a run converged; methods that stop after their epochs (no deviation of their own) always count."""
        return bool(np.any(self.converged) or np.isnan(self.std).all())

    @property
    def centre(self) -> Array:
        """(4,) geometric mean of the used runs [m2, m2, -, W/(m2 K)]."""
        return np.exp(np.mean(np.log(self.parameters[self.used]), axis=0))

    def summary(self) -> dict[str, ParameterSummary]:
        """Combine the runs of this segment.

        The mean is that of the used runs. Runs with a standard deviation of their own (same recording, other starts)
        are a mixture: the variance is the mean of the claimed variances plus the variance between runs. Runs without
        one give the spread of the members.

        Returns:
            Parameter name -> summary.
        """
        result = {}
        for i, name in enumerate(HEALTH):
            values, common = self.parameters[self.used, i], float(self.ambient_log[i])
            own = np.hypot(self.std[self.used, i], common * values)
            mean, std, interval = _combine_runs(values, own)
            known = bool(self.identifiable[i]) and self.trusted
            result[name] = ParameterSummary(mean, std, interval, float(self.bound[i]), known, common)
        return result

    def states_over_time(self, problem: SegmentProblem, learned: InPlace = FORMULAE) -> pd.DataFrame:
        """States and derived quantities with the bands that the method's samples give; see `states.segment_states`."""
        summary = self.summary()
        health = {name: mean for name in HEALTH if (mean := summary[name].mean) is not None}
        samples = None
        if self.state_samples is not None and self.parameter_samples is not None:
            samples = StateSamples(self.state_samples, self.parameter_samples)
        return segment_states(problem, self.states, health, samples, learned)


@dataclass(frozen=True)
class Identification:
    """Everything that one method found in one recording.

    Attributes:
        method: name of the method.
        segments: one estimate for each segment.
        problems: the problems that were solved, same order.
        seconds: wall seconds of the whole identification [s].
        threshold: largest relative bound that counts as identifiable [-].
        learned: what it was made with in place of formulae.
    """

    method: str
    segments: tuple[SegmentEstimate, ...]
    problems: tuple[SegmentProblem, ...]
    seconds: float
    threshold: float
    learned: InPlace = FORMULAE

    def __getstate__(self) -> dict[str, Any]:
        """For another process: the states of every segment, but no networks, which nothing else needs."""
        return {**self.__dict__, "states": self.states, "learned": FORMULAE}

    @property
    def runs(self) -> int:
        """Number of runs R."""
        return self.segments[0].runs

    def pooled(self) -> dict[str, ParameterSummary]:
        """Pool the identifiable segments of each parameter by inverse variance.

        Done in logarithms: a standard deviation is proportional to its value, and weights that follow the value would
        pull the mean down. A weight is never larger than the bound allows, so a lucky small spread of few members
        doesn't take over. An ambient pressure that is off is off in all segments: its part doesn't average out. Where
        no segment is identifiable there is no value, only the bound.

        Returns:
            Parameter name -> pooled summary.
        """
        summaries = [segment.summary() for segment in self.segments]
        return {name: _pool([s[name] for s in summaries], self.threshold) for name in HEALTH}

    def run_values(self) -> Array:
        """Pooled value of each run and parameter over the segments where it has one, NaN where none is identifiable.

        Returns:
            (R, 4) values [m2, m2, -, W/(m2 K)].
        """
        values = np.stack([s.parameters for s in self.segments])
        weight = np.stack([np.where(s.identifiable, (s.bound / s.centre) ** -2.0, 0.0) for s in self.segments])
        known = np.isfinite(values)
        weights = np.where(known, weight[:, None, :], 0.0)
        total = weights.sum(axis=0)
        logs = np.log(np.where(known, values, 1.0))
        return np.exp((weights * logs).sum(axis=0) / np.where(total > 0.0, total, np.nan))

    def to_json(self) -> dict[str, Any]:
        """Content of `identification.json`: strict JSON, SI units, no times of day and no run times."""
        pooled = self.pooled()
        run_values = self.run_values()
        runs = []
        for r in range(self.runs):
            runs.append(
                {
                    "run": r,
                    "converged": bool(all(s.converged[r] for s in self.segments)),
                    "parameters": {name: _finite(run_values[r, i]) for i, name in enumerate(HEALTH)},
                    "segments": [_run_of_segment(segment, r) for segment in self.segments],
                }
            )
        return {
            "schema": SCHEMA,
            "method": self.method,
            "parameters": {name: pooled[name].to_json(name) for name in HEALTH},
            "segments": [
                {
                    "t0_s": s.t0_s,
                    "t1_s": s.t1_s,
                    "parameters": {name: value.to_json(name) for name, value in s.summary().items()},
                }
                for s in self.segments
            ],
            "runs": runs,
        }

    def runtime(self) -> dict[str, Any]:
        """Content of `runtime.json`: what may differ between two runs that agree in every result."""
        versions: dict[str, str | None] = {}
        for package in ("dieseltwin", "numpy", "numba", "torch", "scipy"):
            try:
                versions[package] = version(package)
            except PackageNotFoundError:
                versions[package] = None
        return {
            "schema": SCHEMA,
            "method": self.method,
            "finished": datetime.now(UTC).isoformat(timespec="seconds"),
            "seconds": self.seconds,
            "runs": self.runs,
            "segments": len(self.segments),
            "seconds_per_run": float(np.mean([s.seconds_per_run for s in self.segments])),
            "segment_seconds_per_run": [s.seconds_per_run for s in self.segments],
            "host": platform.node(),
            "platform": platform.platform(),
            "cpus": os.cpu_count(),
            "versions": versions,
        }

    @cached_property
    def states(self) -> pd.DataFrame:
        """States and derived quantities of every segment (column `segment`: 0, 1, ..); see `states.segment_states`."""
        parts = []
        for number, (segment, problem) in enumerate(zip(self.segments, self.problems, strict=True)):
            table = segment.states_over_time(problem, self.learned)
            table.insert(0, "segment", number)
            parts.append(table)
        return pd.concat(parts, ignore_index=True)


def curves_table(identification: Identification) -> pd.DataFrame | None:
    """Convergence curves of all segments in long form: epoch, segment, run, quantity, value; None without curves.

    `SegmentEstimate.curves` holds arrays (n,) or (n, R) and, under "epoch", the epochs (n,) that belong to them.
    """
    parts = []
    for number, segment in enumerate(identification.segments):
        epochs = segment.curves.get(EPOCH)
        for name, curve in segment.curves.items():
            values = np.asarray(curve, dtype=np.float64)
            if name == EPOCH or values.ndim not in (1, 2) or not len(values):
                continue
            told = epochs is not None and len(epochs) == len(values)
            axis = np.asarray(epochs) if told else np.arange(len(values))
            for run, column in enumerate(values.reshape(len(values), -1).T):
                frame = {"epoch": axis, "segment": number, "run": run, "quantity": name, "value": column}
                parts.append(pd.DataFrame(frame))
    return pd.concat(parts, ignore_index=True) if parts else None


def intervals_from_log_std(values: Array, log_std: Array) -> tuple[Array, Array]:
    """Standard deviation and 90 % interval of a positive value whose logarithm is Gaussian.

    Args:
        values: (..) estimates [any].
        log_std: (..) standard deviation of the logarithm [-].

    Returns:
        std (..) [same unit] and interval (.., 2) [same unit]; infinite, and (0, infinite), where nothing is
        known.
    """
    known = log_std < _LARGE_LOG
    half = np.exp(Z_90 * np.where(known, log_std, np.inf))
    return values * np.where(known, log_std, np.inf), np.stack([values / half, values * half], axis=-1)


def _combine_runs(values: Array, own: Array) -> tuple[float, float, tuple[float, float] | None]:
    mean = float(np.exp(np.mean(np.log(values))))
    between = float(np.var(values, ddof=1)) if len(values) > 1 else 0.0
    if not np.isnan(own).any():  # an infinite deviation is one: nothing is known
        std = math.sqrt(float(np.mean(own**2)) + between)
        half = math.exp(Z_90 * std / mean) if math.isfinite(std) and std / mean < _LARGE_LOG else math.inf
        return mean, std, (mean / half, mean * half)
    std = math.sqrt(between)
    if len(values) >= MEMBERS_FOR_QUANTILES:
        low, high = np.quantile(values, [0.5 - INTERVAL / 2.0, 0.5 + INTERVAL / 2.0])
        return mean, std, (float(low), float(high))
    if len(values) < 2:
        return mean, math.nan, None
    half = float(stdtrit(len(values) - 1, 0.5 + INTERVAL / 2.0)) * std
    return mean, std, (mean - half, mean + half)


_LARGE_LOG = 100.0
"""Beyond this logarithmic standard deviation the interval is unbounded for every purpose."""


def _pool(parts: Sequence[ParameterSummary], threshold: float) -> ParameterSummary:
    relative = np.array([p.bound / p.mean if p.mean else math.inf for p in parts])
    usable = [i for i, p in enumerate(parts) if p.identifiable and p.mean is not None]
    informative = np.array([v for v in relative if math.isfinite(v)])
    scale = float(np.mean([p.mean for p in parts if p.mean is not None]))
    if not usable:
        bound = scale / math.sqrt(float(np.sum(informative**-2.0))) if len(informative) else math.inf
        return ParameterSummary(None, None, None, bound, False)
    means = np.array([parts[i].mean for i in usable], dtype=np.float64)
    claimed = np.array([parts[i].std for i in usable], dtype=np.float64) / means
    # A single member has no spread; the bound is the least that it can be off.
    common = np.array([parts[i].ambient_log for i in usable])
    log_std = np.fmax(np.sqrt(np.maximum(claimed**2 - common**2, 0.0)), relative[usable])
    weight = log_std**-2.0
    mean = float(np.exp(np.sum(weight * np.log(means)) / weight.sum()))
    shared = float(np.sum(weight * common) / weight.sum())
    std, interval = intervals_from_log_std(np.array(mean), np.hypot(1.0 / math.sqrt(float(weight.sum())), shared))
    bound = mean / math.sqrt(float(np.sum(relative[usable] ** -2.0)))
    return ParameterSummary(
        mean, float(std), (float(interval[0]), float(interval[1])), bound, bound <= threshold * mean
    )


def _run_of_segment(segment: SegmentEstimate, run: int) -> dict[str, Any]:
    chi2 = None if segment.chi2_per_sample is None else _finite(segment.chi2_per_sample[run])
    return {
        "t0_s": segment.t0_s,
        "converged": bool(segment.converged[run]),
        "chi2_per_sample": chi2,
        "parameters": {
            name: {"value": _finite(segment.parameters[run, i]), "std": _finite(segment.std[run, i])}
            for i, name in enumerate(HEALTH)
        },
    }


def _finite(value: Any) -> float | None:
    """JSON has no NaN or infinity: both become null."""
    if value is None or not math.isfinite(float(value)):
        return None
    return float(value)
