"""Finding the health parameters of a diesel engine from a recording: one interface, five methods."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from dieseltwin.errors import InputError
from dieseltwin.identification.bound import IDENTIFIABLE_BELOW
from dieseltwin.identification.problem import (
    NOISE_FLOOR,
    PAPER_CHANNELS,
    PAPER_NOISE,
    NoiseLevels,
    SegmentProblem,
    problem_from_segment,
    problems_from_recording,
)
from dieseltwin.identification.result import Identification, ParameterSummary, SegmentEstimate
from dieseltwin.identification.unknowns import HEALTH

METHODS: dict[str, str] = {
    "classical": "dieseltwin.identification.classical",
    "few-shot-newton": "dieseltwin.identification.fewshot_newton",
    "few-shot-adam": "dieseltwin.identification.fewshot_adam",
    "multi-stage": "dieseltwin.identification.multistage",
    "baseline": "dieseltwin.identification.baseline",
}
"""Method name -> module with `estimate(problems, runs, seed, bodies, operators, maps, config)`, imported when used."""

__all__ = [
    "HEALTH",
    "IDENTIFIABLE_BELOW",
    "METHODS",
    "NOISE_FLOOR",
    "PAPER_CHANNELS",
    "PAPER_NOISE",
    "Identification",
    "NoiseLevels",
    "ParameterSummary",
    "SegmentEstimate",
    "SegmentProblem",
    "estimator",
    "identify_segments",
    "problem_from_segment",
    "problems_from_recording",
]


def estimator(method: str) -> Callable[..., list[SegmentEstimate]]:
    """Look a method up.

    Args:
        method: a key of `METHODS`.

    Returns:
        Its `estimate` function.

    Raises:
        InputError: unknown method.
    """
    if method not in METHODS:
        raise InputError("method", repr(method), ", ".join(METHODS), "choose one of them")
    function: Callable[..., list[SegmentEstimate]] = importlib.import_module(METHODS[method]).estimate
    return function


def identify_segments(
    problems: Sequence[SegmentProblem],
    method: str,
    runs: int,
    seed: int,
    *,
    maps: Any = None,
    bodies: Any = None,
    operators: Any = None,
    config: Any = None,
    threshold: float = IDENTIFIABLE_BELOW,
) -> Identification:
    """Identify the health parameters of every segment with one method.

    Args:
        problems: segments of one recording.
        method: a key of `METHODS`.
        runs: number of runs R (initialisations, dropout masks and source models) on each segment.
        seed: seed of everything random in the method.
        maps: learned empirical maps, or None for the exact formulae.
        bodies: trained multi-head bodies (few-shot methods).
        operators: trained actuator operators, or None for the exact actuators.
        config: the method's section of params.yaml, or None for its defaults.
        threshold: largest relative bound that counts as identifiable [-].

    Returns:
        Estimates of every segment and run, with their pooling.

    Raises:
        InputError: no segment, unknown method, or fewer than one run.
    """
    if not problems:
        raise InputError("segments", "none", "one or more", "give a recording that is at least one segment long")
    if runs < 1:
        raise InputError("runs", runs, "1 or more", "ask for at least one run")
    began = time.perf_counter()
    estimates = estimator(method)(
        list(problems), runs, seed, bodies=bodies, operators=operators, maps=maps, config=config
    )
    seconds = time.perf_counter() - began
    segments = [replace(e, identifiable=e.bound <= threshold * e.centre) for e in estimates]
    return Identification(method, tuple(segments), tuple(problems), seed, seconds, threshold)
