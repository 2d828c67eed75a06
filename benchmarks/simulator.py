"""Speed and error of the compiled simulator on 60 s segments of the benchmark driving.

    python benchmarks/simulator.py

Times are CPU seconds of the thread (single core) or wall seconds (all cores), warm, median of the repeats. Errors are
the largest deviation of any column from the same segment at a step of 0.5 ms, in % of the column's mean.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from dieseltwin.engine import (
    DEFAULT_STEP_S,
    Inputs,
    actuate,
    parameter_batch,
    quantities_frame,
    simulate_states,
    we2011,
)
from dieseltwin.engine.effects import EFFECTS, STATE_EFFECTS
from dieseltwin.engine.extended import Extension, simulate_extended
from dieseltwin.engine.simulate import thread_count
from dieseltwin.paper.datasets import benchmark_segments

REFERENCE = Path(__file__).parents[1] / "tests" / "reference" / "field_random_300s.csv"
FINE_STEP_S = 0.0005


def largest_error(inputs: Inputs, initial: np.ndarray, step_s: float) -> tuple[str, float]:
    """Column with the largest error and that error in % of the column's mean."""
    frames = []
    for step in (FINE_STEP_S, step_s):
        actuation = actuate(inputs, we2011.FIELD, step)
        states = simulate_states(actuation, parameter_batch(we2011.FIELD), initial).states[0]
        frames.append(quantities_frame(states, actuation, we2011.FIELD).drop(columns="time_s"))
    fine, coarse = frames
    error = (coarse - fine).abs().max() / fine.mean().abs() * 100.0
    return str(error.idxmax()), float(error.max())


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--step", type=float, default=DEFAULT_STEP_S, help="integration step [s]")
    arguments = parser.parse_args()
    _, segments = benchmark_segments(REFERENCE, we2011.FIELD)
    cases = [(piece.inputs, piece.measured[0, :3]) for piece in segments]  # p_im, p_em, omega_t come first in measured

    for piece, (inputs, initial) in zip(segments, cases, strict=True):
        column, error = largest_error(inputs, initial, arguments.step)
        print(f"segment {piece.t0_s:3.0f}-{piece.t1_s:.0f} s: largest error {error:.4f} % of the mean ({column})")

    inputs, initial = cases[1]
    actuation = actuate(inputs, we2011.FIELD, arguments.step)
    for lanes, threads in ((1, 1), (8, 1), (64, 1), (64, thread_count())):
        batch = parameter_batch(we2011.FIELD, size=lanes)
        clock = time.thread_time if threads == 1 else time.perf_counter
        simulate_states(actuation, batch, initial, threads=threads)
        seconds = []
        for _ in range(arguments.repeats):
            begin = clock()
            simulate_states(actuation, batch, initial, threads=threads)
            seconds.append(clock() - begin)
        median = float(np.median(seconds))
        ratio = 60.0 * lanes / median
        print(f"{lanes:3d} lanes, {threads} thread(s): {median * 1e3:8.2f} ms, {ratio:10,.0f} x real time")

    batch = parameter_batch(we2011.FIELD, size=8)
    for label, name in (("explicit laws", "boost_leak"), ("implicit laws", "back_pressure")):
        magnitudes = np.zeros((len(STATE_EFFECTS), 8))
        magnitudes[STATE_EFFECTS.index(name)] = EFFECTS[name].tolerance
        simulate_extended(actuation, batch, Extension(magnitudes), initial, threads=1)
        seconds = []
        for _ in range(arguments.repeats):
            begin = time.thread_time()
            simulate_extended(actuation, batch, Extension(magnitudes), initial, threads=1)
            seconds.append(time.thread_time() - begin)
        ratio = 60.0 * 8 / float(np.median(seconds))
        print(f"  8 lanes with effects, {label}: {ratio:10,.0f} x real time")


if __name__ == "__main__":
    main()
