"""`classical`: maximum likelihood by single shooting with sensitivities; nothing is learned."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from dieseltwin.identification.settings import ClassicalConfig
from dieseltwin.settings.methods import Method, MethodStyle

if TYPE_CHECKING:
    from dieseltwin.identification.problem import SegmentProblem
    from dieseltwin.identification.result import SegmentEstimate


def estimate(problems: Sequence[SegmentProblem], runs: int, seed: int, **given: Any) -> list[SegmentEstimate]:
    """See `maximum_likelihood.estimate`."""
    from dieseltwin.identification.maximum_likelihood import estimate as fit

    return fit(problems, runs, seed, **given)


METHOD = Method(
    name="classical",
    estimate=estimate,
    settings=ClassicalConfig,
    style=MethodStyle("#0072B2", "o", "-", "classical"),
    learned="exact formulae",
    rank=10,
)
