"""`few-shot-adam`: the paper's few-shot transfer, the printed method: learned bodies, maps and operators."""

from __future__ import annotations

from dieseltwin.paper.loop_settings import AdamConfig
from dieseltwin.settings.methods import Method, MethodStyle, Needs

METHOD = Method(
    name="few-shot-adam",
    estimate="dieseltwin.paper.loops.few_shot_adam",
    settings=AdamConfig,
    style=MethodStyle("#009E73", "^", "-.", "few-shot-adam"),
    learned="maps, operators and bodies learned",
    rank=30,
    needs=Needs(bodies="bodies_paper.pt", operators="operators.pt", maps="paper"),
    extra="networks",
    with_epochs=True,
    varied=frozenset({"held_out_share", "weight_share", "scale_x_r", "start"}),
)
