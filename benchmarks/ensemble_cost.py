"""CPU seconds per run against members and segments: what a batch saves, and whether cost grows faster than size.

    python benchmarks/ensemble_cost.py --methods classical few-shot-newton --models models

Noisy minutes 0-5 of Case-V with 301 points, exact formulae, laboratory starts; 50 segments are these five ten times
over, with noise of their own, so that sizes differ in number alone. One thread; the first call (compiled kernels) isn't
counted. Needs data/field/case_v_clean.parquet (`python -m flows.simulate`); without --models the spline basis takes the
bodies' place.
"""

from __future__ import annotations

import argparse
import resource
import time
from pathlib import Path
from typing import Any

import torch

from dieseltwin.identification.identify import identify_segments
from dieseltwin.paper.evaluation.ensembles import case_problems
from dieseltwin.settings.params import load_params
from dieseltwin.surrogates.bodies import Bodies
from evaluation import clean_problems

SEED = 1
MEMBERS = ((1, 5), (30, 5), (300, 5))
SEGMENTS = ((1, 5), (1, 50), (30, 5), (30, 50))


def problems_for(clean: list[Any], members: int, segments: int) -> list[Any]:
    """``segments`` noisy problems with ``members`` noise draws; every copy has draws of its own."""
    copies = range(segments // len(clean))
    return [problem for copy in copies for problem in case_problems(clean, "noisy-301", members, SEED + copy)]


def main() -> None:
    """Measure every method on every size and print a table."""
    torch.set_num_threads(1)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--methods", nargs="+", default=["classical", "few-shot-newton"])
    parser.add_argument("--models", type=Path, default=None, help="folder of pretrained networks")
    parser.add_argument("--sizes", nargs="+", default=None, help="MEMBERSxSEGMENTS, e.g. 30x50")
    parser.add_argument("--recording", type=Path, default=Path("data/field/case_v_clean.parquet"))
    arguments = parser.parse_args()
    sizes = sorted({*MEMBERS, *SEGMENTS})
    if arguments.sizes:
        sizes = [(int(members), int(segments)) for members, segments in (s.split("x") for s in arguments.sizes)]

    params = load_params(None, "paper")
    clean = clean_problems(arguments.recording, params)
    for method in arguments.methods:
        given: dict[str, Any] = {}
        if method == "few-shot-newton" and arguments.models is not None:
            given["bodies"] = Bodies.load(arguments.models / "bodies_conditioned.pt")
        identify_segments(problems_for(clean, 1, 5), method, 1, 0, config=params.identify, **given)
        for members, segments in sizes:
            problems = problems_for(clean, members, segments)
            wall, cpu = time.perf_counter(), time.process_time()
            found = identify_segments(problems, method, members, SEED, config=params.identify, **given)
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
            runs = members * segments
            converged = sum(int(segment.converged.sum()) for segment in found.segments)
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            print(
                f"{method:16} {members:4d} members x {segments:2d} segments: {cpu / runs:.4f} CPU s per run,"
                f" {cpu:.1f} s in all ({wall:.1f} s wall), {converged} of {runs} converged, peak {peak:.0f} MiB",
                flush=True,
            )


if __name__ == "__main__":
    main()
