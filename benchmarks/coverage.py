"""Coverage of the 90 % intervals, and who is called "not identifiable here".

    python benchmarks/coverage.py --methods classical --runs 1000
    python benchmarks/coverage.py --methods classical few-shot-newton --models models

Coverage: the five benchmark segments (benchmarks/identification.py), runs / 5 noise draws and starts of each; counted
over the runs whose own bound calls the parameter identifiable. Flags: a minute of idle with the EGR valve shut and at
0.3 %, and segments of random driving with other health values (`datasets.make_validation`), whose bound at the truth is
known.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from identification import NOISE, benchmark_problems

from dieseltwin.engine import HEALTH, MEASURED, Inputs, simulate, we2011
from dieseltwin.identification.bound import IDENTIFIABLE_BELOW, cramer_rao
from dieseltwin.identification.identify import identify_segments
from dieseltwin.identification.problem import PAPER_CHANNELS, NoiseLevels, SegmentProblem, problems_from_recording
from dieseltwin.paper.datasets import make_validation
from dieseltwin.recordings.reader import recording
from dieseltwin.settings.params import Params, load_params

CLEARLY_IDENTIFIABLE = 0.10
"""Relative bound below which a segment must not be flagged (docs/definitions.md)."""


def idle_problem(u_egr_pct: float, parameters: Any = we2011.PARAMETERS) -> SegmentProblem:
    """A minute of idle with a little movement of speed and VGT, and the EGR valve held still."""
    time = np.round(0.2 * np.arange(301), 6)
    inputs = Inputs(
        time,
        612.0 + 6.0 * np.sin(0.35 * time),
        9.0 + 0.5 * np.sin(0.2 * time),
        np.full(time.shape, u_egr_pct),
        45.0 + 10.0 * np.sin(0.4 * time),
    )
    frame = simulate(inputs, we2011.FIELD, oxygen=False)
    clean = frame[list(MEASURED)].to_numpy()
    noise = NoiseLevels.from_signals(clean)
    measured = clean + noise.sigma * np.random.default_rng(3).standard_normal(clean.shape)
    measured[:, len(PAPER_CHANNELS) :] = np.nan
    return SegmentProblem(0.0, 60.0, inputs, measured, noise.sigma, parameters)


def driving_problems(seeds: Sequence[int], params: Params) -> tuple[list[SegmentProblem], np.ndarray]:
    """Noisy segments of random driving with other health values, and their relative bounds at the truth (S, 4)."""
    problems, bounds = [], []
    for seed in seeds:
        clean, true = make_validation(seed, params)
        made = recording(clean, we2011.PARAMETERS)
        initial = np.array([[s.columns[n][0] for n in MEASURED[:3]] for s in made.segments(60.0)])
        found = problems_from_recording(made, we2011.PARAMETERS, channels=PAPER_CHANNELS)
        bounds += [b.relative for b in cramer_rao(found, true.health(), initial)]
        problems += [p.with_noise_draws(1, np.random.default_rng([NOISE, seed, k])) for k, p in enumerate(found)]
    return problems, np.stack(bounds)


def coverage_lines(method: str, runs: int, seed: int, options: dict[str, Any]) -> list[str]:
    """Share of the runs' 90 % intervals that hold the truth, per parameter."""
    problems, _ = benchmark_problems(max(1, runs // 5), seed)
    found = identify_segments(problems, method, max(1, runs // 5), seed, **options)
    truth = we2011.FIELD.health()
    inside = np.concatenate(
        [(s.interval_90[..., 0] <= truth) & (truth <= s.interval_90[..., 1]) for s in found.segments]
    )
    relative = np.concatenate([s.std / s.parameters for s in found.segments])
    counted = np.isfinite(relative) & (relative <= IDENTIFIABLE_BELOW)
    share = (inside & counted).sum(axis=0) / np.maximum(counted.sum(axis=0), 1)
    converged = float(np.mean([s.converged.mean() for s in found.segments]))
    cells = "".join(
        f"{name} {100.0 * v:.1f} % of {n}   " for name, v, n in zip(HEALTH, share, counted.sum(axis=0), strict=True)
    )
    return [f"{method}: coverage of 90 % intervals: {cells}(converged {converged:.1%})"]


def flag_lines(method: str, params: Params, seeds: Sequence[int], options: dict[str, Any]) -> list[str]:
    """Who is flagged: idle with a shut valve must be, segments with a small bound must not."""
    lines = []
    for position in (0.0, 0.3):
        segment = identify_segments([idle_problem(position)], method, 1, 0, **options).segments[0]
        flagged = [n for n, good in zip(HEALTH, segment.identifiable, strict=True) if not good]
        relative = segment.bound / segment.centre
        bounds = "  ".join(f"{n} {100.0 * v:.3g} %" for n, v in zip(HEALTH, relative, strict=True))
        lines.append(
            f"  idle, EGR valve at {position:g} %: not identifiable: {' '.join(flagged) or 'none'}   (bounds: {bounds})"
        )
    problems, bounds = driving_problems(seeds, params)
    found = identify_segments(problems, method, 1, 0, **options)
    identifiable = np.stack([s.identifiable for s in found.segments])
    small, large = bounds <= CLEARLY_IDENTIFIABLE, bounds > IDENTIFIABLE_BELOW
    for i, name in enumerate(HEALTH):
        kept, count = int((identifiable & small)[:, i].sum()), int(small[:, i].sum())
        missed = int((identifiable & large)[:, i].sum())
        lines.append(
            f"  {name:<9} bound < 10 %: {kept} of {count} segments not flagged ({kept / max(count, 1):.1%}); "
            f"bound > 25 %: {int(large[:, i].sum()) - missed} of {int(large[:, i].sum())} flagged"
        )
    return lines


def main() -> None:
    """Print coverage and flags of each method."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--methods", nargs="+", default=["classical"])
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("--validation-seeds", type=int, nargs="+", default=[901, 902, 903, 904, 905])
    parser.add_argument("--models", type=Path, default=None, help="folder of pretrained networks")
    parser.add_argument("--maps", default="exact", help="exact, paper or improved")
    parser.add_argument("--profile", default="quick")
    arguments = parser.parse_args()

    from dieseltwin.settings.methods import find
    from dieseltwin.surrogates.files import networks_for

    params = load_params(None, arguments.profile)
    for method in arguments.methods:
        options = {"config": params.identify, **networks_for(find(method), arguments.models, arguments.maps)}
        lines = coverage_lines(method, arguments.runs, arguments.seed, options)
        lines += flag_lines(method, params, arguments.validation_seeds, options)
        print("\n".join(lines), flush=True)


if __name__ == "__main__":
    main()
