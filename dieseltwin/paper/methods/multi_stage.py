"""`multi-stage`: the paper's multi-stage transfer: the hybrid PINN, carried from the first segment to the others."""

from __future__ import annotations

from dieseltwin.paper.loop_settings import PinnConfig
from dieseltwin.settings.methods import Method, MethodStyle, Needs

METHOD = Method(
    name="multi-stage",
    estimate="dieseltwin.paper.loops.multi_stage",
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
