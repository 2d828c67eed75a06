"""Milliseconds an epoch: the paper's loop, one run at a time, beside the batched programs, in one process.

    python benchmarks/paper_loop.py                                       # exact formulae
    python benchmarks/paper_loop.py --models models                       # and learned maps with dropout in both
    python benchmarks/paper_loop.py --models models --methods baseline --lanes 10 30 100

The loop is what the paper describes, in PyTorch instead of TensorFlow 1: 32-bit, one thread, one run, all 301 points of
a segment in one tensor, reverse-mode automatic differentiation of the networks by time in every epoch (few-shot: dh/dt
computed once outside the loop), autograd for the gradient, Adam. It is no straw man:

- equations, loss and weights are the library's own, over all points at once; what stays the same is computed before;
- two fused Adam optimisers over few tensors instead of eight; p_im and p_em share a forward pass;
- the six maps hold one dropout realisation, with closed-form slopes, where the batched program draws new ones in every
  epoch: cheaper for the loop than what the paper has. --fresh-dropout gives the loop new masks too.

The second-order methods have no epochs: theirs are CPU seconds a run of --draws noise draws of the five segments,
against the few-shot loop's milliseconds times the paper's 30,000 epochs, in the same process. Where the loop has the
learned maps with dropout, they have the improved maps, which have none.

Milliseconds are CPU time of this one thread, the best of some repetitions that alternate between loop and batch, so
that other work on the machine disturbs both alike; on an idle machine they equal wall time.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from identification import benchmark_problems
from torch import Tensor

from dieseltwin.engine import actuate, bind
from dieseltwin.identification.few_shot.residuals import HEALTH, physics_residuals
from dieseltwin.identification.identify import identify_segments
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.unknowns import to_physical
from dieseltwin.paper import printed
from dieseltwin.paper.loop_settings import Stage
from dieseltwin.paper.loops import baseline, pinn_training
from dieseltwin.paper.loops import few_shot_adam as fewshot_adam
from dieseltwin.paper.loops import few_shot_program as fewshot_program
from dieseltwin.paper.loops.losses import Weights, total_loss
from dieseltwin.paper.loops.pinn_networks import N_STATES, StateNetworks
from dieseltwin.settings.params import load_params

METHODS = {"few-shot": "few-shot-adam", "multi-stage": "multi-stage", "baseline": "baseline"}
PRINTED = {name: [t for (method, _), t in printed.TIMES.items() if method == ours] for name, ours in METHODS.items()}
EPOCHS = {name: times[0].epochs for name, times in PRINTED.items()}
PAPER_MS = {name: float(np.mean([1e3 * t.clean_151[0] / t.epochs for t in times])) for name, times in PRINTED.items()}
"""Milliseconds an epoch of the paper, from its table of computational times: clean data, mean over the minutes."""
REPEATS = 4
LEAST_EPOCHS = 100
"""Of the batched program, so that they weigh more than what is kept of them for the curves."""
SEED = 1
RATES = (1e-3, 1e-3, 1e-2)
"""Learning rates of networks, unknowns, weights; without influence on the time."""
PAPER = load_params(None, "paper").identify


@dataclass
class Loop:
    """One run of the paper's loop.

    Attributes:
        outputs: linear outputs z, and dz/dt behind the values for the first three, from the leaves.
        leaves: weights of networks or heads.
        program: inputs, readings, bound equations.
        masked: (1, 4) unknowns.
        weights: self-adaptive weights, pointwise and single.
    """

    outputs: Callable[[], list[Tensor]]
    leaves: list[Tensor]
    program: fewshot_program.Program
    masked: Tensor
    weights: list[Tensor]

    def __post_init__(self) -> None:
        for leaf in (*self.leaves, self.masked, *self.weights):
            leaf.requires_grad_()
        self.down = torch.optim.Adam(
            [{"params": self.leaves, "lr": RATES[0]}, {"params": [self.masked], "lr": RATES[1]}], fused=True
        )
        self.up = torch.optim.Adam(self.weights, lr=RATES[2], maximize=True, fused=True)

    def epoch(self, adaptive: bool = True) -> None:
        """One epoch; without `adaptive` the self-adaptive weights rest."""
        p = self.program
        states, rates = p.states(self.outputs())
        health = to_physical(self.masked, torch).unsqueeze(-1).unbind(1)
        c = p.c._replace(**dict(zip(HEALTH, health, strict=True)))
        residuals = physics_residuals(p.model, states, rates, p.inputs, c)
        pointwise, single = self.weights if adaptive else [w.detach() for w in self.weights]
        loss = total_loss(residuals, states, Weights(pointwise, single), p.observed).total
        if adaptive:
            self.up.zero_grad(set_to_none=True)
        self.down.zero_grad(set_to_none=True)
        loss.sum().backward()
        self.down.step()
        if adaptive:
            self.up.step()


def program_of(problem: SegmentProblem, maps: Any, settings: Any, runs: int, fresh: bool | None) -> tuple[Any, Any]:
    """Lanes and tensor program of one segment; `fresh` None leaves the maps as the batched program has them."""
    lanes = [fewshot_program.draw_lane(problem, 0, run, SEED, PAPER.start) for run in range(runs)]
    actuations = {0: actuate(problem.inputs, problem.parameters)}
    program = fewshot_program.make_program(lanes, actuations, None, None, maps, settings)
    if maps is not None and fresh is not None:
        told = {"generator": torch.Generator().manual_seed(SEED)} if fresh else {"member": 1, "slopes": True}
        functions = maps.replacements("torch", dtype=program.dtype, **told)
        if not fresh:  # the valve's position is known before the loop
            opening = functions["f_egr"](program.inputs.u_egr, program.c).detach()
            functions["f_egr"] = lambda u, c: opening
        program = replace(program, model=bind("torch", replace=functions))
    return lanes, program


def few_shot_loop(problem: SegmentProblem, maps: Any, fresh: bool) -> Loop:
    """Few-shot: heads on bodies of the paper's widths."""
    settings = PAPER.of(fewshot_program.METHOD)
    lanes, program = program_of(problem, maps, settings, 1, fresh)
    values, _ = fewshot_program.start_values(lanes, program, settings)
    widths = program.widths()
    *heads, masked, pointwise, single = torch.split(values, [*widths, len(HEALTH), 4 * program.n, 2], 1)
    leaves = [h.clone() for h in heads]

    def outputs() -> list[Tensor]:
        return [h @ columns for h, columns in zip(leaves, program.columns, strict=True)]

    return Loop(outputs, leaves, program, masked.clone(), [pointwise.reshape(1, 4, -1).clone(), single.clone()])


def network_loop(problem: SegmentProblem, maps: Any, fresh: bool, last_only: bool = False) -> Loop:
    """Networks differentiated by time in every epoch; `last_only` trains the last layers (Stages II and III)."""
    settings = PAPER.of(baseline.METHOD)
    lanes, program = program_of(problem, maps, settings, 1, fresh)
    networks = StateNetworks(problem.time_s)
    values = pinn_training.start_values(lanes, program, networks, settings)
    layers = [
        [(layer.weight(values)[0].T.clone(), layer.bias(values)[0, :, 0].clone()) for layer in rows]
        for rows in networks.layers
    ]
    size = networks.size
    masked, pointwise, single = torch.split(values[:, size:], [len(HEALTH), 4 * program.n, 2], 1)
    time_s = (networks.input / networks.input_rate)[:, None].requires_grad_()

    def outputs() -> list[Tensor]:
        result: list[Tensor] = [time_s] * N_STATES
        for spec, rows in zip(networks.specs, layers, strict=True):
            h = time_s * networks.input_rate
            for weight, bias in rows[:-1]:
                h = torch.tanh(torch.addmm(bias, h, weight))
            z = torch.addmm(rows[-1][1], h, rows[-1][0])
            for column, state in zip(z.unbind(1), spec.states, strict=True):
                rate = [torch.autograd.grad(column.sum(), time_s, create_graph=True)[0][:, 0]] if spec.rates else []
                result[state] = torch.cat([column, *rate])[None]
        return result

    trained = [pair for rows in layers for pair in (rows[-1:] if last_only else rows)]
    leaves = [t for pair in trained for t in pair]
    return Loop(outputs, leaves, program, masked.clone(), [pointwise.reshape(1, 4, -1).clone(), single.clone()])


def cpu_ms(work: Callable[[], None], count: int) -> float:
    """CPU milliseconds of `work`, divided by `count`."""
    began = time.process_time()
    work()
    return 1e3 * (time.process_time() - began) / count


def loop_ms(loop: Loop, adaptive: bool, epochs: int) -> float:
    """Milliseconds an epoch of the loop."""
    return cpu_ms(lambda: [loop.epoch(adaptive) for _ in range(epochs)] and None, epochs)


def pieces(method: str) -> list[tuple[float, bool, bool]]:
    """Share of the epochs, whether only last layers are trained, whether the weights are: as the paper has them."""
    if method == "few-shot":
        settings = PAPER.of(fewshot_program.METHOD)
        share = settings.weights_until_epoch / settings.epochs
        return [(share, False, True), (1.0 - share, False, False)]
    stages = PAPER.of(method).stages
    ends = [0, *(s.until_epoch for s in stages)]
    return [
        ((b - a) / ends[-1], s.layers == "last", s.rate_weights > 0.0)
        for a, b, s in zip(ends, ends[1:], stages, strict=False)
    ]


def merged(parts: Sequence[tuple[float, bool, bool]]) -> list[tuple[float, bool, bool]]:
    """Pieces that cost the same, together."""
    shares: dict[tuple[bool, bool], float] = {}
    for share, last, adaptive in parts:
        shares[last, adaptive] = shares.get((last, adaptive), 0.0) + share
    return [(share, last, adaptive) for (last, adaptive), share in shares.items()]


class Batch:
    """The batched program of one method; several calls of `ms` time one of its pieces."""

    def __init__(self, method: str, problem: SegmentProblem, maps: Any, lanes: int) -> None:
        self.method, self.count = method, lanes
        settings: Any = PAPER.of(fewshot_program.METHOD if method == "few-shot" else baseline.METHOD)
        self.lanes, self.program = program_of(problem, maps, settings, lanes, None)
        self.problem, self.settings = problem, settings
        self.sigma = np.stack([problem.sigma[:5]] * lanes)

    def ms(self, last: bool, adaptive: bool, epochs: int) -> float:
        """Milliseconds of `epochs` of all runs, when set-up, recording and compiling are over."""
        marks: list[float] = []

        def mark(_: int) -> None:
            marks.append(time.process_time())

        if self.method == "few-shot":
            until = epochs if adaptive else 0
            settings = self.settings.model_copy(update={"epochs": epochs, "weights_until_epoch": until})
            fewshot_adam.train(self.lanes, self.program, settings, mark, compiled=True)
        else:
            networks = StateNetworks(self.problem.time_s)
            values = pinn_training.start_values(self.lanes, self.program, networks, self.settings)
            stage = Stage(
                until_epoch=2 * epochs, layers="last" if last else "all", rate_networks=RATES[0],
                rate_unknowns=RATES[1], rate_weights=RATES[2] if adaptive else 0.0,
            )  # fmt: skip
            pinn_training.train(self.program, networks, values, (stage,), self.sigma, mark, compiled=True)
        return 1e3 * (marks[-1] - marks[0])


def measure(
    method: str, problem: SegmentProblem, maps: Any, lane_counts: Sequence[int], fresh: bool
) -> tuple[float, dict[int, float]]:
    """Milliseconds an epoch of the loop and of the batched programs by number of lanes, over the method's schedule."""
    loop_total, totals = 0.0, dict.fromkeys(lane_counts, 0.0)
    batches = {count: Batch(method, problem, maps, count) for count in lane_counts}
    epochs = {count: max(LEAST_EPOCHS, 6000 // count) for count in lane_counts}
    for share, last, adaptive in merged(pieces(method)):
        loop = few_shot_loop(problem, maps, fresh) if method == "few-shot" else network_loop(problem, maps, fresh, last)
        loop_ms(loop, adaptive, 10)
        of_loop: list[float] = []
        of_batch: dict[int, list[float]] = {count: [] for count in lane_counts}
        for _ in range(REPEATS):
            of_loop.append(loop_ms(loop, adaptive, 40))
            for count, batch in batches.items():
                of_batch[count].append(batch.ms(last, adaptive, epochs[count]))
        loop_total += share * min(of_loop)
        for count in lane_counts:
            totals[count] += share * min(of_batch[count]) / (epochs[count] * count)
    return loop_total, totals


def second_order_s(method: str, models: Path | None, kind: str, draws: int) -> float:
    """CPU seconds a run of a second-order method on the benchmark driving, compiled beforehand; the best of three."""
    from dieseltwin.settings.methods import find
    from dieseltwin.surrogates.files import networks_for

    given = networks_for(find(method), models, "improved" if kind == "learned" else "exact")
    problems, _ = benchmark_problems(draws, SEED)
    config = load_params(None, "quick").identify
    identify_segments(benchmark_problems(1, SEED)[0], method, 1, 0, config=config, **given)
    seconds = []
    for _ in range(3):
        start = time.process_time()
        identify_segments(problems, method, draws, SEED, config=config, **given)
        seconds.append(time.process_time() - start)
    return min(seconds) / (draws * len(problems))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--methods", nargs="+", default=list(PAPER_MS), choices=list(PAPER_MS))
    parser.add_argument("--second-order", nargs="*", default=["few-shot-newton", "classical"], help="beside the loop")
    parser.add_argument(
        "--draws", type=int, default=30, help="noise draws of each segment, for the second-order methods"
    )
    parser.add_argument("--lanes", nargs="+", type=int, default=[30, 120])
    parser.add_argument("--models", type=Path, default=None, help="folder with maps_paper.pt")
    parser.add_argument("--fresh-dropout", action="store_true", help="the loop draws new masks in every epoch")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    # 200 points of curves are nothing in 30,000 epochs, and everything in the few that are timed; the time is that
    # between the first and the last one that is kept within the loop
    fewshot_adam.CURVE_POINTS, pinn_training.CURVE_POINTS = 2, 3
    kinds: dict[str, Any] = {"exact": None}
    if arguments.models is not None:
        from dieseltwin.surrogates.empirical import EmpiricalMaps

        kinds["learned"] = EmpiricalMaps.load(arguments.models / "maps_paper.pt")
    problem = benchmark_problems(max(arguments.lanes), SEED)[0][0]
    print("ms an epoch  maps      paper    loop  /paper  lanes  batched  ratio      run")
    loop_s: dict[str, float] = {}
    for method in arguments.methods:
        for kind, maps in kinds.items():
            loop, batched = measure(method, problem, maps, arguments.lanes, arguments.fresh_dropout)
            if method == "few-shot":
                loop_s[kind] = loop * EPOCHS[method] / 1e3
            for count, value in batched.items():
                seconds = value * EPOCHS[method] / 1e3
                print(
                    f"{method:<12} {kind:<8} {PAPER_MS[method]:>6.1f} {loop:>7.2f} {loop / PAPER_MS[method]:>7.2f} "
                    f"{count:>6d} {value:>8.3f} {loop / value:>6.1f} {seconds:>6.1f} s",
                    flush=True,
                )
    if loop_s:
        print("s a run                 loop   method   ratio")
    for method in arguments.second_order if loop_s else []:
        for kind, reference in loop_s.items():
            seconds = second_order_s(method, arguments.models, kind, arguments.draws)
            print(f"{method:<15} {kind:<8} {reference:>7.0f} {seconds:>8.4f} {reference / seconds:>7.0f}", flush=True)


if __name__ == "__main__":
    main()
