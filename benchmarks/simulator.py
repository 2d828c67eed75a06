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
import pandas as pd

from dieseltwin.engine import (
    DEFAULT_STEP_S,
    INPUT_COLUMNS,
    Inputs,
    actuate,
    parameter_batch,
    quantities_frame,
    simulate_states,
    we2011,
)
from dieseltwin.engine.simulate import thread_count

REFERENCE = Path(__file__).parents[1] / "tests" / "reference" / "field_random_300s.csv"
FINE_STEP_S = 0.0005
HISTORY_S = 2.0


def segment(table: pd.DataFrame, start_s: float) -> tuple[Inputs, np.ndarray]:
    """One minute of the reference driving with its history, and the initial state (3,)."""
    rows = table["time_s"].between(start_s - HISTORY_S - 1e-9, start_s + 60.0 + 1e-9)
    piece = table[rows]
    history = int((piece["time_s"] < start_s - 1e-9).sum())
    inputs = Inputs(*(piece[name].to_numpy() for name in ("time_s", *INPUT_COLUMNS)), n_history=history)
    return inputs, piece.iloc[history][["p_im_pa", "p_em_pa", "omega_t_rad_s"]].to_numpy(dtype=float)


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
    table = pd.read_csv(REFERENCE)

    for start in range(0, 300, 60):
        inputs, initial = segment(table, float(start))
        column, error = largest_error(inputs, initial, arguments.step)
        print(f"segment {start:3d}-{start + 60} s: largest error {error:.4f} % of the mean ({column})")

    inputs, initial = segment(table, 60.0)
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


if __name__ == "__main__":
    main()
