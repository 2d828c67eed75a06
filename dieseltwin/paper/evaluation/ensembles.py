"""Ensembles of the evaluation: the paper's three cases of data, members in batches, and what is kept of every member.

Source: paper, sections "Results: Multi-stage Transfer Learning" and "Results: Few-shot transfer learning": clean data
at 151 and at 301 points a minute, noisy data at 301, thirty runs of each. The residual points are always the 301 of the
recording; "points" are those with readings. Each member has its own noise draw.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dieseltwin.engine import HEALTH, MEASURED
from dieseltwin.errors import InputError
from dieseltwin.identification.bound import IDENTIFIABLE_BELOW, nominal_bound
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.result import SegmentEstimate


@dataclass(frozen=True)
class Case:
    """One way of reading the field engine.

    Attributes:
        every: readings at every so many samples.
        noisy: whether noise is added.
        words: for headings.
    """

    every: int
    noisy: bool
    words: str


CASES: Mapping[str, Case] = {
    "clean-151": Case(2, False, "clean data, 151 points a minute"),
    "clean-301": Case(1, False, "clean data, 301 points a minute"),
    "noisy-301": Case(1, True, "noisy data, 301 points a minute"),
}
"""The paper's cases, in its order."""
FAR_OFF = 10.0
"""An identifiable parameter beyond this many times its true value, or below its inverse, counts as diverged; one that
the minute says nothing about may be anywhere."""


def case_problems(
    clean: Sequence[SegmentProblem], case: str, members: int, seed: int, channels: Sequence[str] | None = None
) -> list[SegmentProblem]:
    """The segments as one case shows them.

    Args:
        clean: segments with clean readings; `sigma` is the noise of the recording.
        case: a key of `CASES`.
        members: members of the ensemble; with noise, each has a draw of its own.
        seed: of the noise. Draws depend on (seed, segment, member) alone.
        channels: sensors that are read; None = those of `clean`.

    Returns:
        One problem for each segment.

    Raises:
        InputError: unknown case or channel.
    """
    if case not in CASES:
        raise InputError("case", repr(case), ", ".join(CASES), "choose one of them")
    unknown = sorted(set(channels or ()) - set(MEASURED))
    if unknown:
        raise InputError("channels", ", ".join(unknown), ", ".join(MEASURED), "correct the names")
    what = CASES[case]
    made = []
    for number, problem in enumerate(clean):
        measured = problem.measured.copy()
        for i, name in enumerate(MEASURED):
            if channels is not None and name not in channels:
                measured[:, i] = np.nan
        if what.every > 1:
            unread = np.arange(len(measured)) % what.every != 0
            measured[unread] = np.nan
        seen = replace(problem, measured=measured, noise_draws=None)
        if what.noisy:
            draws = [
                np.random.default_rng([seed, number, m]).standard_normal(measured.shape) * problem.sigma
                for m in range(members)
            ]
            noisy = measured + np.stack(draws)
            seen = replace(seen, measured=noisy[0], noise_draws=noisy)
        made.append(seen)
    return made


_FIELDS = (
    "time_s", "parameters", "std", "interval_90", "states", "bound", "identifiable", "converged", "chi2_per_sample",
    "state_samples", "parameter_samples",
)  # fmt: skip
_PLAIN = ("t0_s", "t1_s")


def save_estimates(path: Path, estimates: Sequence[SegmentEstimate]) -> None:
    """Write the estimates of a batch as one .npz file, but for their run times: equal seeds give equal bytes."""
    arrays: dict[str, Any] = {"method": np.array(estimates[0].method), "count": np.array(len(estimates))}
    for i, estimate in enumerate(estimates):
        for name in _FIELDS:
            value = getattr(estimate, name)
            if value is not None:
                arrays[f"{i}/{name}"] = value
        arrays[f"{i}/plain"] = np.array([getattr(estimate, name) for name in _PLAIN])
        arrays |= {f"{i}/curves/{name}": values for name, values in estimate.curves.items()}
    np.savez(path, **arrays)


def load_estimates(path: Path, seconds_per_run: Sequence[float]) -> list[SegmentEstimate]:
    """Read what `save_estimates` wrote, and give each segment its seconds per run [s].

    Raises:
        InputError: a file that isn't whole.
    """
    try:
        return _loaded(path, seconds_per_run)
    except (BadZipFile, zlib.error, OSError, EOFError, KeyError, ValueError) as error:
        raise InputError(str(path), error, "the estimates of a batch, as they were written",
                         "put the file back, or delete it and evaluate again") from None


def _loaded(path: Path, seconds_per_run: Sequence[float]) -> list[SegmentEstimate]:
    with np.load(path) as stored:
        method, count = str(stored["method"]), int(stored["count"])
        made = []
        for i in range(count):
            prefix = f"{i}/curves/"
            curves = {name.removeprefix(prefix): stored[name] for name in stored.files if name.startswith(prefix)}
            fields = {name: stored.get(f"{i}/{name}") for name in _FIELDS}
            plain = dict(zip(_PLAIN, stored[f"{i}/plain"].tolist(), strict=True))
            made.append(
                SegmentEstimate(**fields, **plain, method=method, curves=curves, seconds_per_run=seconds_per_run[i])
            )
    return made


def merged(parts: Sequence[SegmentEstimate], problem: SegmentProblem) -> SegmentEstimate:
    """One estimate of a segment from those of its batches, in the order of their members.

    The same as of one batch with all members, but for rounding. The methods that run in batches state the bound where
    their pooled states begin, which each batch has of its own: it is stated anew for the states of all members.

    Args:
        parts: estimates of the batches.
        problem: the segment.

    Returns:
        The estimate of all members; a single batch as it is.
    """
    if len(parts) == 1:
        return parts[0]

    def joined(name: str, of: Sequence[SegmentEstimate] = parts) -> Any:
        values = [getattr(part, name) for part in of]
        return None if any(v is None for v in values) else np.concatenate(values)

    runs = np.array([part.runs for part in parts])
    together = replace(parts[0], parameters=joined("parameters"), converged=joined("converged"))
    used = np.array([of.sum() for of in np.split(together.used, np.cumsum(runs)[:-1])])
    kept = [part for part, count in zip(parts, used, strict=True) if count]
    states = np.average([part.states for part in kept], axis=0, weights=used[used > 0])
    bound = nominal_bound(problem, states)
    curves = {}
    for name, first in parts[0].curves.items():
        values = [np.asarray(part.curves[name]) for part in parts]
        if np.ndim(first) == 2:
            curves[name] = np.concatenate(values, axis=1)
        else:  # one curve for all runs of a batch: epochs, or a mean over runs
            curves[name] = first if name == "epoch" else np.average(values, axis=0, weights=runs)
    return replace(
        together,
        **{name: joined(name) for name in ("std", "interval_90", "chi2_per_sample")},
        **{name: joined(name, kept) for name in ("state_samples", "parameter_samples")},
        states=states,
        bound=bound.absolute,
        identifiable=bound.identifiable(IDENTIFIABLE_BELOW),
        seconds_per_run=float(np.average([part.seconds_per_run for part in parts], weights=runs)),
        curves=curves,
    )


def at_last_epoch(estimate: SegmentEstimate) -> SegmentEstimate:
    """The parameters as the last epoch of the training left them, not a mean over epochs; without samples for bands."""
    last = np.stack([estimate.curves[name][-1] for name in HEALTH], -1)
    return replace(estimate, parameters=last, parameter_samples=None, state_samples=None)


def diverged(
    parameters: NDArray[np.float64], truth: NDArray[np.float64], bound: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """(R,) members without a usable value: not finite, or one that can be known is far off (`FAR_OFF`).

    Args:
        parameters: (R, 4) estimates [SI]; truth: (4,) [SI].
        bound: (4,) relative Cramér-Rao bound at the truth [-].
    """
    known = bound <= IDENTIFIABLE_BELOW
    with np.errstate(invalid="ignore", divide="ignore"):
        size = np.abs(np.log(parameters[:, known] / truth[known]))
    return ~np.isfinite(parameters).all(axis=1) | ~(size <= np.log(FAR_OFF)).all(axis=1)


def without_diverged(
    estimate: SegmentEstimate, truth: NDArray[np.float64], bound: NDArray[np.float64]
) -> SegmentEstimate | None:
    """The estimate with NaN for members that diverged, for bands and pooled values; None where no member has a value.

    The number of members stays: member r of one segment is member r of the others.
    """
    keep = ~diverged(estimate.parameters, truth, bound)
    if not keep.any():
        return None
    if keep.all():
        return estimate

    def blank(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(keep.reshape(-1, *[1] * (values.ndim - 1)), values, np.nan)

    chi2 = estimate.chi2_per_sample
    curves = {
        name: np.where(keep, values, np.nan) if values.ndim == 2 and values.shape[1] == len(keep) else values
        for name, values in estimate.curves.items()
    }
    samples, states = estimate.parameter_samples, estimate.state_samples
    if samples is not None and states is not None:
        whole = ~diverged(samples, truth, bound) & np.isfinite(states).all(axis=(1, 2))
        samples, states = (samples[whole], states[whole]) if whole.any() else (None, None)
    return replace(
        estimate,
        parameters=blank(estimate.parameters),
        std=blank(estimate.std),
        interval_90=blank(estimate.interval_90),
        converged=estimate.converged & keep,
        chi2_per_sample=None if chi2 is None else blank(chi2),
        curves=curves,
        parameter_samples=samples,
        state_samples=states,
        states=estimate.states if states is None or np.isfinite(estimate.states).all() else states.mean(axis=0),
    )


def member_table(
    estimates: Sequence[SegmentEstimate], truth: Mapping[str, float], bounds: Sequence[NDArray[np.float64]], seed: int
) -> pd.DataFrame:
    """One row for each segment, member and parameter; nothing is left out.

    Args:
        estimates: of the segments.
        truth: true health values [SI].
        bounds: (4,) relative Cramér-Rao bound of each segment at the truth [-].
        seed: of the ensemble.

    Returns:
        Columns segment, t0_s, t1_s, member, seed, parameter, ratio (estimate over truth), std (claimed, over truth; NaN
        where a method claims none), low, high (90 % interval over truth), bound (relative), identifiable (as the method
        says), converged, diverged, chi2.
    """
    true = np.array([truth[name] for name in HEALTH])
    rows = []
    for number, (estimate, bound) in enumerate(zip(estimates, bounds, strict=True)):
        off = diverged(estimate.parameters, true, bound)
        chi2 = estimate.chi2_per_sample
        for member in range(estimate.runs):
            for i, name in enumerate(HEALTH):
                rows.append(
                    {
                        "segment": number,
                        "t0_s": estimate.t0_s,
                        "t1_s": estimate.t1_s,
                        "member": member,
                        "seed": seed,
                        "parameter": name,
                        "ratio": estimate.parameters[member, i] / true[i],
                        "std": estimate.std[member, i] / true[i],
                        "low": estimate.interval_90[member, i, 0] / true[i],
                        "high": estimate.interval_90[member, i, 1] / true[i],
                        "bound": bound[i],
                        "identifiable": bool(estimate.identifiable[i]),
                        "converged": bool(estimate.converged[member]),
                        "diverged": bool(off[member]),
                        "chi2": np.nan if chi2 is None else chi2[member],
                    }
                )
    return pd.DataFrame(rows)
