"""Loss and gradients of a tensor program, eager or compiled into one loop.

An epoch of the few-shot loop is some 900 element-wise operations over (lanes, points) forward and backward. Eager, each
of them goes over memory by itself: nine tenths of an epoch with exact formulae. The same operations, recorded once with
their gradient and written as one loop (`point_loops`), take a quarter of that. Formulae and derivatives are recorded
from the eager program: nothing is derived anew by hand, and the results differ by rounding only. Learned maps mix a
point's inputs in matrix products, for which no such loop is written: with them the program stays eager.

Recording and compiling take 3-4 s of CPU time for a batch (the C compiler's second only the first time; its result
lies beside the simulator's kernels), an eager epoch of one lane 0.1 ms more than a compiled one. So only jobs of
`WORTHWHILE` epochs x lanes are compiled, unless told. Without a C compiler the loop goes on eagerly, and the log says
so once.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from dieseltwin.engine import HEALTH
from dieseltwin.identification.unknowns import to_physical
from dieseltwin.paper.loops.few_shot_program import Program
from dieseltwin.paper.loops.losses import Weights, channel_gradient, weights_gradient
from dieseltwin.paper.loops.point_loops import NotPointwiseError, PointLoops, lift

WORTHWHILE = 200_000
"""Epochs x lanes from which on compiling pays: at 0.1 ms each 20 s, five times what it takes."""
_LOG = logging.getLogger(__name__)
_TOLD: set[str] = set()


class Gradients(NamedTuple):
    """Loss of the lanes and its derivatives.

    Attributes:
        total: (L,) total loss.
        outputs: derivative of the sum over lanes by each linear output, shapes as these.
        masked: (L, 4) by the masked unknowns.
        weights: by the self-adaptive weights; None where not asked.
    """

    total: Tensor
    outputs: tuple[Tensor, ...]
    masked: Tensor
    weights: Weights | None


GradientFunction = Callable[[Sequence[Tensor], Tensor, Weights, bool], Gradients]


def gradient_function(program: Program, lane_epochs: int, compiled: bool | None = None) -> GradientFunction:
    """A function that gives loss and gradients of a program.

    Args:
        program: the loss. Tensors it holds may change in place between calls (dropout), their shapes may not.
        lane_epochs: epochs x lanes that it is going to be called for.
        compiled: compile or not; None compiles where it pays.

    Returns:
        Function of linear outputs, masked unknowns, weights, and whether the weights' gradient is asked.
    """

    def eager(z: Sequence[Tensor], masked: Tensor, weights: Weights, adaptive: bool) -> Gradients:
        leaves = [v.detach().requires_grad_() for v in (*z, masked)]
        loss = program(leaves[:-1], leaves[-1], weights)
        *outputs, d_masked = torch.autograd.grad(loss.total.sum(), leaves)
        up = weights_gradient(loss, weights) if adaptive else None
        return Gradients(loss.total.detach(), tuple(outputs), d_masked, up)

    wanted = lane_epochs >= WORTHWHILE if compiled is None else compiled
    if not wanted or program.dropout is not None:
        return eager
    chosen: list[Callable[..., Gradients]] = []

    def first_compiled(z: Sequence[Tensor], masked: Tensor, weights: Weights, adaptive: bool) -> Gradients:
        if not chosen:
            try:
                chosen.append(_compiled(program, z, masked, weights))
            except NotPointwiseError as error:
                if str(error) not in _TOLD:
                    _LOG.warning("the few-shot loop runs uncompiled: %s", error)
                _TOLD.add(str(error))
                chosen.append(eager)
        return chosen[0](z, masked, weights, adaptive)

    return first_compiled


def _compiled(program: Program, z: Sequence[Tensor], masked: Tensor, weights: Weights) -> Callable[..., Gradients]:
    """The program with its gradient, compiled for tensors of these shapes and strides."""
    from torch.fx.experimental.proxy_tensor import make_fx

    n, lanes = program.n, masked.shape[0]
    example = (*program.points(z), to_physical(masked, torch), *weights)
    _ = program.observed.gains  # a constant, not part of the graph

    def flat(*values: Tensor) -> tuple[Tensor, ...]:
        health = [v[:, None].expand(-1, n) for v in (values[-3][:, i] for i in range(len(HEALTH)))]
        leaves = [v.detach().requires_grad_() for v in (*values[:-3], *health)]
        weights = Weights(*values[-2:])
        loss = program.at_points(leaves[:-4], leaves[-4:], weights)
        found = torch.autograd.grad(loss.total, leaves, torch.ones_like(loss.total))
        up = [channel_gradient(square, weights.pointwise[:, i]) for i, square in enumerate(loss.channels)]
        single = [loss.singles[i] * torch.sigmoid(weights.single[:, i]) for i in range(2)]
        of_health = [g.sum(-1) for g in found[-4:]]
        return tuple(v.detach() for v in (*found[:-4], *up, loss.total, *of_health, *single))

    recorded: Any = make_fx(flat)(*example)
    lifted = lift(recorded)
    loops = PointLoops(recorded.graph, (*example, *lifted), n)

    def evaluate(z: Sequence[Tensor], masked: Tensor, weights: Weights, adaptive: bool) -> Gradients:
        leaf = masked.detach().requires_grad_()
        with torch.enable_grad():
            health = to_physical(leaf, torch)
        outputs = tuple(torch.empty_like(v) for v in z)
        up = Weights(*(torch.empty(v.shape, dtype=v.dtype) for v in weights))
        total, d_health = masked.new_empty(lanes), torch.empty_like(masked)
        columns = (*up.pointwise.unbind(1), total, *d_health.unbind(1), *up.single.unbind(1))
        loops(lanes, (*program.points(z), health.detach(), *weights, *lifted), (*program.points(outputs), *columns))
        (d_masked,) = torch.autograd.grad(health, leaf, d_health)
        return Gradients(total, outputs, d_masked, up if adaptive else None)

    return evaluate
