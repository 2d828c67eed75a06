"""`multi-stage`: the paper's multi-stage transfer: the hybrid PINN, carried from the first segment to the others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from dieseltwin.paper.loop_settings import PinnConfig
from dieseltwin.settings.methods import Method, MethodStyle, Needs

if TYPE_CHECKING:
    from dieseltwin.identification.problem import SegmentProblem
    from dieseltwin.identification.result import SegmentEstimate


def estimate(problems: Sequence[SegmentProblem], runs: int, seed: int, **given: Any) -> list[SegmentEstimate]:
    """See `loops.multi_stage.estimate`."""
    from dieseltwin.paper.loops.multi_stage import estimate as train

    return train(problems, runs, seed, **given)


METHOD = Method(
    name="multi-stage",
    estimate=estimate,
    settings=PinnConfig,
    style=MethodStyle("#CC79A7", "D", ":", "multi-stage"),
    learned="maps and operators learned",
    rank=40,
    needs=Needs(operators="operators.pt", maps="paper"),
    extra="networks",
    with_epochs=True,
    varied=frozenset(),  # it starts from its source models
    sources="baseline",
)
