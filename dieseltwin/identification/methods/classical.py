"""`classical`: maximum likelihood by single shooting with sensitivities; nothing is learned."""

from __future__ import annotations

from dieseltwin.identification.settings import ClassicalConfig
from dieseltwin.settings.methods import Method, MethodStyle

METHOD = Method(
    name="classical",
    estimate="dieseltwin.identification.maximum_likelihood",
    settings=ClassicalConfig,
    style=MethodStyle("#0072B2", "o", "-", "classical"),
    learned="exact formulae",
    rank=10,
)
