"""`few-shot-newton`: learned bodies, Gauss-Newton on their heads and the health parameters, exact formulae."""

from __future__ import annotations

from dieseltwin.identification.settings import NewtonConfig
from dieseltwin.settings.methods import Method, MethodStyle, Needs

METHOD = Method(
    name="few-shot-newton",
    estimate="dieseltwin.identification.few_shot.newton",
    settings=NewtonConfig,
    style=MethodStyle("#D55E00", "s", "--", "few-shot-newton"),
    learned="bodies learned, exact formulae",
    rank=20,
    needs=Needs(bodies="bodies_conditioned.pt"),
    extra="networks",
)
