"""Accuracy and speed of the estimators on the benchmark driving, as ratios to the Cramer-Rao bound.

    python benchmarks/identification.py --methods classical --draws 100
    python benchmarks/identification.py --methods classical few-shot-newton --draws 100 --models models
    python benchmarks/identification.py --methods classical few-shot-newton --models models --maps improved

Inputs of tests/reference/field_random_300s.csv, field parameters, five segments of 301 points, noise
3/3/1/5/3 % of the means
of the recording, five sensors; every run has its own noise draw and its own start around the laboratory
values (docs/definitions.md).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dieseltwin.engine import HEALTH, we2011
from dieseltwin.identification.bound import Bound, cramer_rao
from dieseltwin.identification.identify import identify_segments
from dieseltwin.identification.problem import PAPER_CHANNELS, NoiseLevels, SegmentProblem, problem_from_segment
from dieseltwin.identification.result import Identification
from dieseltwin.paper.datasets import benchmark_segments
from dieseltwin.settings.params import load_params

TRACE = Path(__file__).parents[1] / "tests" / "reference" / "field_random_300s.csv"
NOISE = 2**31
"""First word of the seeds of noise: methods draw starts from (seed, segment, run), which is another stream then."""
START_STATES = ("p_im_pa", "p_em_pa", "omega_t_rad_s", "x_r", "t_1_k")


def benchmark_problems(draws: int, seed: int, trace: Path = TRACE) -> tuple[list[SegmentProblem], list[Bound]]:
    """The five benchmark segments with noise draws, and their bounds at the truth.

    Args:
        draws: noise draws D of each segment.
        seed: seed of the noise.
        trace: reference trace that gives the inputs.

    Returns:
        Problems that start at the laboratory values, and bounds.
    """
    _, segments = benchmark_segments(str(trace), we2011.FIELD)
    noise = NoiseLevels.from_signals(np.concatenate([s.measured for s in segments]))
    truth = {name: getattr(we2011.FIELD, name) for name in HEALTH}
    clean = [
        problem_from_segment(
            s,
            we2011.PARAMETERS,
            noise,
            channels=PAPER_CHANNELS,
            truth=truth,
            true_initial=[float(s.columns[name][0]) for name in START_STATES],
        )
        for s in segments
    ]
    initial = np.stack([p.true_initial[:3] for p in clean if p.true_initial is not None])
    bounds = cramer_rao(clean, we2011.FIELD.health(), initial)
    return [p.with_noise_draws(draws, np.random.default_rng([NOISE, seed, k])) for k, p in enumerate(clean)], bounds


def ratios(found: Identification, bounds: Sequence[Bound]) -> np.ndarray:
    """Root mean square error of each segment and parameter over its bound, (S, 4)."""
    truth = we2011.FIELD.health()
    error = np.stack([s.parameters / truth - 1.0 for s in found.segments])
    return np.sqrt(np.mean(error**2, axis=1)) / np.stack([b.relative for b in bounds])


def table(found: Identification, bounds: Sequence[Bound], cpu_s: float) -> list[str]:
    """Lines of one method's table."""
    ratio = ratios(found, bounds)
    lines = [
        f"{found.method}: {found.runs} runs x {len(found.segments)} segments",
        _row("RMSE / bound", HEALTH),
    ]
    for k, segment in enumerate(found.segments):
        note = f"converged {segment.converged.mean():.1%}"
        if segment.chi2_per_sample is not None:
            note += f", chi2 {np.mean(segment.chi2_per_sample):.3f}"
        flagged = [n for n, good in zip(HEALTH, segment.identifiable, strict=True) if not good]
        if flagged:
            note += ", not identifiable: " + " ".join(flagged)
        lines.append(_row(f"{segment.t0_s:g}-{segment.t1_s:g} s", ratio[k]) + f"  {note}")
    lines.append(_row("median", np.median(ratio, axis=0)))
    lines.append(_row("worst", ratio.max(axis=0)))
    truth = we2011.FIELD.health()
    bias = np.stack([s.parameters.mean(axis=0) / truth - 1.0 for s in found.segments])
    lines.append(_row("bias %, median", 100.0 * np.median(bias, axis=0)))
    lines.append(_row("bound %, median", 100.0 * np.median([b.relative for b in bounds], axis=0)))
    count = found.runs * len(found.segments)
    lines.append(f"  {found.seconds / count:.4f} s per run (wall), {cpu_s / count:.4f} CPU s per run")
    return lines


def _row(name: str, values: Sequence[Any] | np.ndarray) -> str:
    cells = [f"{v:>10}" if isinstance(v, str) else f"{v:10.3f}" for v in values]
    return f"  {name:<16}" + "".join(cells)


def main() -> None:
    """Print one table for each method."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--methods", nargs="+", default=["classical"])
    parser.add_argument("--draws", type=int, default=100, help="noise draws of each segment")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--models", type=Path, default=None, help="folder of pretrained networks")
    parser.add_argument("--maps", default="exact", help="exact (formulae), paper or improved (learned)")
    parser.add_argument("--profile", default="quick")
    arguments = parser.parse_args()

    from dieseltwin.settings.methods import find
    from dieseltwin.surrogates.files import networks_for

    params = load_params(None, arguments.profile)
    problems, bounds = benchmark_problems(arguments.draws, arguments.seed)
    for method in arguments.methods:
        networks = networks_for(find(method), arguments.models, arguments.maps)
        warm = [p.with_noise_draws(1, np.random.default_rng(0)) for p in problems[:1]]
        identify_segments(warm, method, 1, 0, config=params.identify, **networks)
        cpu = time.process_time()
        found = identify_segments(problems, method, arguments.draws, arguments.seed, config=params.identify, **networks)
        print("\n".join(table(found, bounds, time.process_time() - cpu)), flush=True)


if __name__ == "__main__":
    main()
