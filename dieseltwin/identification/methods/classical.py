"""`classical`: maximum likelihood by single shooting with sensitivities; nothing is learned."""

from __future__ import annotations

from pydantic import PositiveFloat, PositiveInt

from dieseltwin.settings.method_settings import MethodSettings
from dieseltwin.settings.methods import Method, MethodStyle


class ClassicalConfig(MethodSettings):
    """Maximum likelihood by shooting with sensitivities."""

    iterations_max: PositiveInt
    tolerance: PositiveFloat
    damping_start: PositiveFloat


METHOD = Method(
    name="classical",
    estimate="dieseltwin.identification.maximum_likelihood",
    settings=ClassicalConfig,
    style=MethodStyle("#0072B2", "o", "-", "classical"),
    learned="exact formulae",
    rank=10,
)
