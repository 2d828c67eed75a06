"""Loss and gradients of a tensor program, eager or compiled into one loop.

An epoch of the loops is some 900 element-wise operations over (lanes, points) forward and backward, and with learned
maps five networks. Eager, each of them goes over memory by itself. The same operations, recorded once with their
gradient and written as one loop (`point_loops`), take a fifth of that. Formulae and derivatives are recorded from the
eager program: nothing is derived anew by hand, and the results differ by rounding only.

Recording and compiling take 3-4 s of CPU time for a batch (the C compiler's second only the first time; its result
lies beside the simulator's kernels), an eager epoch of one lane 0.1 to 0.7 ms more than a compiled one. So only jobs of
`WORTHWHILE` epochs x lanes are compiled, unless told. Without a C compiler the loops go on eagerly, and the log says
so once.
"""

from __future__ import annotations

import ctypes
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from dieseltwin.engine import HEALTH
from dieseltwin.identification.unknowns import physical_columns
from dieseltwin.paper.loops.c_library import NotCompiledError
from dieseltwin.paper.loops.few_shot_program import Program
from dieseltwin.paper.loops.losses import TERMS, Weights, channel_gradient, weights_gradient
from dieseltwin.paper.loops.point_loops import PointLoops, lift, pointers

WORTHWHILE = 50_000
"""Epochs x lanes from which on compiling pays."""
_LOG = logging.getLogger(__name__)
_TOLD: set[str] = set()


@dataclass(frozen=True)
class Place:
    """What an epoch reads and writes: tensors that stay where they are through the whole training.

    Attributes:
        z: linear outputs of the five states, (L, n or 2 n) each.
        masked: (L, 4) unknowns.
        weights: self-adaptive weights.
        by_z, by_masked, by_weights: gradients, shapes as these.
        terms: (L, 10) `losses.TERMS`.
    """

    z: list[Tensor]
    masked: Tensor
    weights: Weights
    by_z: list[Tensor]
    by_masked: Tensor
    by_weights: Weights
    terms: Tensor

    @classmethod
    def within(cls, values: Tensor, gradient: Tensor, unknowns: int, program: Program) -> Place:
        """Places in a lane's columns, values and gradient (L, M) alike: unknowns from there on, weights behind them."""
        n, count = program.n, len(values)
        at, end = unknowns + len(HEALTH), unknowns + len(HEALTH) + 4 * n

        def views(columns: Tensor) -> tuple[Tensor, Weights]:
            weights = Weights(columns[:, at:end].view(count, 4, n), columns[:, end : end + 2])
            return columns[:, unknowns:at], weights

        widths = [int(c.shape[1]) for c in program.columns]
        z, by_z = ([values.new_empty(count, width) for width in widths] for _ in range(2))
        return cls(z, *views(values), by_z, *views(gradient), values.new_empty(count, len(TERMS)))


class EagerLoss:
    """Loss and gradients by autograd."""

    def __init__(self, program: Program, place: Place) -> None:
        self.program, self.place = program, place

    def __call__(self, adaptive: bool) -> Tensor:
        """Total loss (L,); terms and gradients are written, those of the weights only if they adapt."""
        at = self.place
        leaves = [v.detach().requires_grad_() for v in (*at.z, at.masked)]
        loss = self.program(leaves[:-1], leaves[-1], at.weights)
        found = torch.autograd.grad(loss.total.sum(), leaves)
        for target, value in zip((*at.by_z, at.by_masked), found, strict=True):
            target.copy_(value)
        torch.stack(loss.terms, 1, out=at.terms)
        if adaptive:
            for target, value in zip(at.by_weights, weights_gradient(loss, at.weights), strict=True):
                target.copy_(value)
        return loss.total.detach()


class CompiledLoss:
    """The same as one C loop over lanes and points.

    Attributes:
        total: (L,) total loss of the last call.
        loops: the compiled loop.
        z, by_z, inputs, outputs, strides: addresses of its tensors, for C.

    Raises:
        NotCompiledError: see there.
    """

    def __init__(self, program: Program, place: Place) -> None:
        from torch.fx.experimental.proxy_tensor import make_fx

        n = program.n
        example = (*program.points(place.z), *place.masked.unbind(1), *place.weights)
        _ = program.observed.gains  # a constant, not part of the graph

        def flat(*values: Tensor) -> tuple[Tensor, ...]:
            leaves = [v.detach().requires_grad_() for v in values[:-2]]
            weights = Weights(*values[-2:])
            health = [v[:, None].expand(-1, n) for v in physical_columns(leaves[-len(HEALTH) :], torch)]
            loss = program.at_points(leaves[: -len(HEALTH)], health, weights)
            found = torch.autograd.grad(loss.total, leaves, torch.ones_like(loss.total))
            up = [channel_gradient(square, weights.pointwise[:, i]) for i, square in enumerate(loss.channels)]
            single = [loss.singles[i] * torch.sigmoid(weights.single[:, i]) for i in range(2)]
            return tuple(v.detach() for v in (*found, *up, *single, loss.total, *loss.terms))

        recorded: Any = make_fx(flat)(*example)
        lifted = lift(recorded)
        self.total = place.masked.new_empty(len(place.masked))
        up = place.by_weights
        written = (
            *program.points(place.by_z), *place.by_masked.unbind(1), *up.pointwise.unbind(1), *up.single.unbind(1),
            self.total, *place.terms.unbind(1),
        )  # fmt: skip
        arguments = (*example, *lifted)
        self._held: Sequence[Any] = (arguments, written, place)
        self.loops = PointLoops(recorded.graph, arguments, n)
        self.inputs, self.outputs = pointers(arguments), pointers(written)
        self.z, self.by_z = pointers(place.z), pointers(place.by_z)
        self.strides = (ctypes.c_long * len(written))(*(t.stride(0) for t in written))

    def __call__(self, adaptive: bool) -> Tensor:
        """Total loss (L,); terms and all gradients are written."""
        self.loops.run(0, len(self.total), self.inputs, self.outputs, self.strides)
        return self.total


def gradient_function(
    program: Program, place: Place, lane_epochs: int, compiled: bool | None = None
) -> EagerLoss | CompiledLoss:
    """Loss and gradients of a program.

    Args:
        program: the loss. Tensors it holds may change in place between calls (dropout), their shapes may not.
        place: where everything stands.
        lane_epochs: epochs x lanes that it is going to be called for.
        compiled: compile or not; None compiles where it pays.
    """
    wanted = lane_epochs >= WORTHWHILE if compiled is None else compiled
    try:
        return CompiledLoss(program, place) if wanted else EagerLoss(program, place)
    except NotCompiledError as error:
        if str(error) not in _TOLD:
            _LOG.warning("the loop runs uncompiled: %s", error)
        _TOLD.add(str(error))
        return EagerLoss(program, place)
