"""The paper's few-shot loop: accuracy beside its noisy table, and what batching gains.

    python benchmarks/fewshot.py accuracy --epochs 30000 --runs 2 [--start truth] [--models models --maps paper]
    python benchmarks/fewshot.py gain --runs 150 --epochs 40 [--models models]

`accuracy` runs `few-shot-adam` on the benchmark driving (five segments of tests/reference/field_random_300s.csv, field
parameters, noise of docs/definitions.md) from the laboratory values, or once from the truth, and prints mean +- std of
the estimate over the truth beside the paper's cells (its minutes are another driving; its minute 2-3 is idle). `gain`
measures CPU seconds per run and epoch of one run alone and of many in one batch, with exact and with learned formulae,
in one process. `benchmarks/paper_loop.py` measures the same against a loop written as the paper describes it.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from identification import benchmark_problems

from dieseltwin.engine import HEALTH, actuate, we2011
from dieseltwin.identification.identify import identify_segments
from dieseltwin.paper import printed
from dieseltwin.paper.cells import cell_rmse
from dieseltwin.paper.loops.few_shot_adam import train
from dieseltwin.paper.loops.few_shot_program import METHOD, draw_lane, make_program
from dieseltwin.settings.params import StartConfig, load_params

PAPER_NOISY = printed.PARAMETER_TABLES[printed.FEW_SHOT]["noisy-301"]


def networks(models: Path | None, maps: str) -> dict[str, Any]:
    """Trained bodies and operators (with `models`), and learned maps."""
    from dieseltwin.settings.methods import find
    from dieseltwin.surrogates.files import networks_for

    return networks_for(find(METHOD), models, maps) if models is not None else {}


def accuracy(arguments: argparse.Namespace) -> None:
    """Print estimate over truth and its ratio to the bound, segment by segment."""
    config = load_params(None, "paper").identify
    start = StartConfig(at=arguments.start, sd_masked=config.start.sd_masked)
    config = config.changed(METHOD, **config.of(METHOD).schedule_of(arguments.epochs))
    config = config.model_copy(update={"start": start})
    problems, bounds = benchmark_problems(arguments.runs, arguments.seed)
    given = networks(arguments.models, arguments.maps)
    began = time.process_time()
    found = identify_segments(problems, METHOD, arguments.runs, arguments.seed, config=config, **given)
    cpu = time.process_time() - began
    truth = we2011.FIELD.health()
    print(f"{arguments.epochs} epochs, start at {arguments.start}, {arguments.maps} maps; estimate / truth")
    print(f"{'':12}" + "".join(f"{name:>20}" for name in HEALTH))
    all_ours, all_paper = [], []
    for segment, paper in zip(found.segments, PAPER_NOISY, strict=True):
        ratio = segment.parameters / truth
        ours = np.array([cell_rmse(column) for column in ratio.T])
        theirs = np.array([np.hypot(mean - 1.0, std) for mean, std in paper])
        all_ours.append(ours)
        all_paper.append(theirs)
        cells = (f"{m:10.4f} +- {s:6.4f}" for m, s in zip(ratio.mean(axis=0), ratio.std(axis=0), strict=True))
        print(f"{segment.t0_s:5g}-{segment.t1_s:g} s".ljust(12) + "".join(f"{c:>20}" for c in cells))
        print(f"{'  paper':12}" + "".join(f"{f'{m:10.4f} +- {s:6.4f}':>20}" for m, s in paper))
    relative = np.stack([b.relative for b in bounds])
    rows = {
        "RMSE %": 100.0 * np.median(all_ours, axis=0),
        "paper %": 100.0 * np.median(all_paper, axis=0),
        "RMSE/bound": np.median(np.stack(all_ours) / relative, axis=0),
    }
    for name, row in rows.items():
        print(f"{name:12}" + "".join(f"{v:20.2f}" for v in row) + "   (median over segments)")
    count = arguments.runs * len(found.segments)
    print(f"{found.seconds / count:.2f} s per run (wall), {cpu / count:.2f} CPU s per run")


def gain(arguments: argparse.Namespace) -> None:
    """Print seconds per epoch of one run alone and of a batch, exact and learned formulae."""
    problems, _ = benchmark_problems(1, arguments.seed)
    actuations = {i: actuate(p.inputs, p.parameters) for i, p in enumerate(problems)}
    config = load_params(None, "paper").identify
    settings = config.of(METHOD)
    kinds = ["exact"] + ([arguments.maps] if arguments.models is not None else [])
    for kind in kinds:
        given = networks(arguments.models, kind)
        per_run = {}
        for count in (1, arguments.runs):
            lanes = [draw_lane(problems[r % 5], r % 5, r, 1, config.start) for r in range(count)]
            extra = [given.get(name) for name in ("bodies", "operators", "maps")]
            repeats = max(1, arguments.epochs * (10 if count == 1 else 1))
            cold = settings.model_copy(update={"epochs": 1})
            longer = settings.model_copy(update={"epochs": repeats, "weights_until_epoch": repeats})
            train(lanes, make_program(lanes, actuations, *extra, cold), cold)
            began = time.perf_counter(), time.process_time()
            train(lanes, make_program(lanes, actuations, *extra, cold), cold)
            between = time.perf_counter(), time.process_time()
            train(lanes, make_program(lanes, actuations, *extra, longer), longer)
            ended = time.perf_counter(), time.process_time()
            seconds = [(c - b) - (b - a) for a, b, c in zip(began, between, ended, strict=True)]
            per_run[count] = seconds[1] / (repeats - 1) / count
            print(
                f"{kind:9} {count:4d} runs: {1e3 * seconds[0] / (repeats - 1):8.2f} ms per epoch (wall), CPU"
                f" {1e3 * per_run[count]:8.3f} ms per run and epoch, {30000 * per_run[count]:7.1f} s per run of 30,000"
            )
        print(f"{kind:9} gain of the batch: {per_run[1] / per_run[arguments.runs]:.1f}")


def main() -> None:
    """Read the arguments and run one of the two."""
    torch.set_num_threads(1)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("accuracy", "gain"))
    parser.add_argument("--epochs", type=int, default=None, help="30,000 for accuracy, 40 for gain")
    parser.add_argument("--runs", type=int, default=None, help="2 a segment for accuracy, 150 for gain")
    parser.add_argument("--start", choices=("lab", "truth"), default="lab")
    parser.add_argument("--models", type=Path, default=None, help="folder of pretrained networks")
    parser.add_argument("--maps", default="exact", help="exact, paper or improved")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    defaults = {"accuracy": (30000, 2), "gain": (40, 150)}[arguments.what]
    arguments.epochs = arguments.epochs or defaults[0]
    arguments.runs = arguments.runs or defaults[1]
    (accuracy if arguments.what == "accuracy" else gain)(arguments)


if __name__ == "__main__":
    main()
