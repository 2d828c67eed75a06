"""`few-shot-adam`: the paper's few-shot transfer, everything as printed: learned bodies, maps and operators."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from dieseltwin.paper.loop_settings import AdamConfig
from dieseltwin.settings.methods import Method, MethodStyle, Needs

if TYPE_CHECKING:
    from dieseltwin.identification.problem import SegmentProblem
    from dieseltwin.identification.result import SegmentEstimate


def estimate(problems: Sequence[SegmentProblem], runs: int, seed: int, **given: Any) -> list[SegmentEstimate]:
    """See `loops.few_shot_adam.estimate`."""
    from dieseltwin.paper.loops.few_shot_adam import estimate as train

    return train(problems, runs, seed, **given)


METHOD = Method(
    name="few-shot-adam",
    estimate=estimate,
    settings=AdamConfig,
    style=MethodStyle("#009E73", "^", "-.", "few-shot-adam"),
    learned="maps, operators and bodies learned",
    rank=30,
    needs=Needs(bodies="bodies_paper.pt", operators="operators.pt", maps="paper"),
    extra="networks",
    with_epochs=True,
    varied=frozenset({"held_out_share", "weight_share", "scale_x_r", "start"}),
)
