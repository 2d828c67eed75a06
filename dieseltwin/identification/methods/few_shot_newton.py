"""`few-shot-newton`: learned bodies, Gauss-Newton on their heads and the health parameters, exact formulae."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from dieseltwin.identification.settings import NewtonConfig
from dieseltwin.settings.methods import Method, MethodStyle, Needs

if TYPE_CHECKING:
    from dieseltwin.identification.problem import SegmentProblem
    from dieseltwin.identification.result import SegmentEstimate


def estimate(problems: Sequence[SegmentProblem], runs: int, seed: int, **given: Any) -> list[SegmentEstimate]:
    """See `few_shot.newton.estimate`."""
    from dieseltwin.identification.few_shot.newton import estimate as fit

    return fit(problems, runs, seed, **given)


METHOD = Method(
    name="few-shot-newton",
    estimate=estimate,
    settings=NewtonConfig,
    style=MethodStyle("#D55E00", "s", "--", "few-shot-newton"),
    learned="bodies learned, exact formulae",
    rank=20,
    needs=Needs(bodies="bodies_conditioned.pt"),
    extra="networks",
)
