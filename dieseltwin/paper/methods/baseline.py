"""`baseline`: the paper's hybrid PINN, every network from scratch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from dieseltwin.paper.loop_settings import PinnConfig
from dieseltwin.settings.methods import Method, MethodStyle, Needs

if TYPE_CHECKING:
    from dieseltwin.identification.problem import SegmentProblem
    from dieseltwin.identification.result import SegmentEstimate


def estimate(problems: Sequence[SegmentProblem], runs: int, seed: int, **given: Any) -> list[SegmentEstimate]:
    """See `loops.baseline.estimate`."""
    from dieseltwin.paper.loops.baseline import estimate as train

    return train(problems, runs, seed, **given)


METHOD = Method(
    name="baseline",
    estimate=estimate,
    settings=PinnConfig,
    style=MethodStyle("#E69F00", "v", ":", "baseline PINN"),
    learned="maps and operators learned",
    rank=50,
    needs=Needs(operators="operators.pt", maps="paper"),
    extra="networks",
    with_epochs=True,
    varied=frozenset({"scale_x_r", "start"}),
)
