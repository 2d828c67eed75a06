"""`baseline`: the paper's hybrid PINN, every network from scratch."""

from __future__ import annotations

from dieseltwin.paper.loop_settings import PinnConfig
from dieseltwin.settings.methods import Method, MethodStyle, Needs

METHOD = Method(
    name="baseline",
    estimate="dieseltwin.paper.loops.baseline",
    settings=PinnConfig,
    style=MethodStyle("#E69F00", "v", ":", "baseline PINN"),
    learned="maps and operators learned",
    rank=50,
    needs=Needs(operators="operators.pt", maps="paper"),
    extra="networks",
    with_epochs=True,
    varied=frozenset({"scale_x_r", "start"}),
)
