"""Errors of the health parameters before and after the twin is repaired: an effect concealed, then known.

    python benchmarks/repaired_twin.py [--minutes 2] [--methods classical,few-shot-newton,few-shot-adam,multi-stage]

A field engine with one left-out effect is simulated over the reference driving, with the paper's noise. Each method
finds the four health parameters with the published equations (the effect unknown) and with the effect's term in the
engine. Printed are errors in % of the truth, pooled over the segments that identify a parameter (the mean where none
does), and the largest of them. `--share` shortens the networks' training: the paper's epochs need half an hour a
segment on one core.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import pandas as pd

from dieseltwin.engine import HEALTH, INPUT_COLUMNS, MEASURED, EngineParameters, Inputs, simulate, we2011
from dieseltwin.engine.terms import Term
from dieseltwin.identification.identify import identify_segments
from dieseltwin.identification.problem import NoiseLevels, SegmentProblem
from dieseltwin.paper.loops import baseline
from dieseltwin.paper.loops import multi_stage as multistage
from dieseltwin.paper.loops.few_shot_program import METHOD as FEW_SHOT
from dieseltwin.settings.params import IdentifyConfig, load_params

REFERENCE = Path(__file__).parents[1] / "tests" / "reference" / "field_random_300s.csv"
EFFECTS = {"boost_leak": 3e-5, "back_pressure": 1e5, "bearing_friction": 5e-6}
SEGMENT_ROWS, HISTORY_ROWS = 300, 10


def problems_of(plant: EngineParameters, known: EngineParameters, minutes: int, seed: int) -> list[SegmentProblem]:
    """Segments of one minute of the plant's noisy recording, to be explained by the known engine."""
    trace = pd.read_csv(REFERENCE).iloc[: SEGMENT_ROWS * minutes + 1]
    inputs = Inputs(*(trace[column].to_numpy() for column in ("time_s", *INPUT_COLUMNS))).clipped(plant)
    clean = simulate(inputs, plant, oxygen=False)[list(MEASURED)].to_numpy()
    noise = NoiseLevels.from_signals(clean)
    measured = clean + np.random.default_rng(seed).standard_normal(clean.shape) * noise.sigma
    measured[:, MEASURED.index("w_c_kg_s")] = np.nan
    found = []
    for first in range(0, SEGMENT_ROWS * minutes, SEGMENT_ROWS):
        before = min(first, HISTORY_ROWS)
        rows = slice(first - before, first + SEGMENT_ROWS + 1)
        piece = Inputs(
            inputs.time_s[rows], *(getattr(inputs, name)[rows] for name in INPUT_COLUMNS), n_history=before,
            start_s=float(inputs.time_s[0]),
        )  # fmt: skip
        t = piece.segment_time_s
        found.append(SegmentProblem(t[0], t[-1], piece, measured[rows][before:], noise.sigma, known))
    return found


def shortened(share: float) -> IdentifyConfig:
    """The paper's settings with a share of the epochs of every training."""
    config = load_params(None, "paper").identify
    for method in (FEW_SHOT, baseline.METHOD, multistage.METHOD):
        settings = config.of(method)
        config = config.changed(method, **settings.schedule_of(max(1, round(share * settings.trained_epochs))))
    return config


def errors(problems: list[SegmentProblem], method: str, runs: int, share: float) -> np.ndarray:
    """Errors of the health parameters, (4,) in % of the truth."""
    found = identify_segments(problems, method, runs, 0, config=shortened(share))
    if method == multistage.METHOD:  # the mean over all segments, whatever they identify
        centre = np.mean([s.centre for s in found.segments], axis=0)
        return 100.0 * (centre / we2011.FIELD.health() - 1.0)
    pooled = found.pooled()
    centre = np.mean([segment.centre for segment in found.segments], axis=0)  # where no segment may be trusted
    values = [centre[i] if pooled[name].mean is None else pooled[name].mean for i, name in enumerate(HEALTH)]
    return 100.0 * (np.array(values) / we2011.FIELD.health() - 1.0)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=int, default=2)
    parser.add_argument("--runs", type=int, default=2)
    parser.add_argument("--share", type=float, default=1.0, help="of the epochs of the networks' training")
    parser.add_argument("--methods", default="classical,few-shot-newton,few-shot-adam,multi-stage")
    parser.add_argument("--effects", default=",".join(EFFECTS))
    parser.add_argument("--seed", type=int, default=7)
    arguments = parser.parse_args()
    print(f"{'effect':18s}{'method':17s}{'twin':10s}" + "".join(f"{name:>10s}" for name in HEALTH) + "   largest   s")
    for effect in arguments.effects.split(","):
        term = Term(effect=effect, magnitude=EFFECTS[effect])
        plant = we2011.FIELD.replace(terms=(term,))
        for method in arguments.methods.split(","):
            for label, known in (("published", ()), ("repaired", (term,))):
                began = time.perf_counter()
                problems = problems_of(
                    plant, we2011.PARAMETERS.replace(terms=known), arguments.minutes, arguments.seed
                )
                error = errors(problems, method, arguments.runs, arguments.share)
                cells = "".join(f"{value:9.2f}%" for value in error)
                end = f"{np.abs(error).max():9.2f}%{time.perf_counter() - began:5.0f}"
                print(f"{effect:18s}{method:17s}{label:10s}{cells}{end}", flush=True)


if __name__ == "__main__":
    main()
