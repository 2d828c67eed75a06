"""Errors of the pretrained networks beside those that the paper prints."""

from __future__ import annotations

import json
from dataclasses import replace

import stored_results as synthetic

from dieseltwin.paper.comparison.pretraining import pretraining
from dieseltwin.paper.printed import BODY_ERRORS
from dieseltwin.report.results import Results


def test_pretraining_beside_the_paper_in_a_fixed_order(results: Results) -> None:
    shuffled = json.loads(json.dumps(synthetic.PRETRAINING, sort_keys=True))
    figure = pretraining(replace(results, pretraining=shuffled))
    assert figure is not None
    operators, bodies, maps = (axes for axes in figure.figure.axes if axes.get_label() != "<colorbar>")
    assert [t.get_text() for t in operators.get_legend().get_texts()][:2] == ["training", "test"]
    assert "p_{im}" in bodies.get_yticklabels()[0].get_text()
    legend = [t.get_text() for t in bodies.get_legend().get_texts()]
    assert legend.count("POD floor") == 1 and "paper, training" in legend
    bars = sorted(float(bar.get_width()) for bar in bodies.patches)
    assert bars == sorted(mean for mean, _ in BODY_ERRORS.values())
    assert {t.get_text() for t in maps.get_legend().get_texts()} == {"as printed", "improved"}
    marks = next(line for line in bodies.lines if line.get_label() == "conditioned, training")
    assert sorted(marks.get_xdata()) == sorted(
        v["train"] for v in synthetic.PRETRAINING["bodies"]["conditioned"].values()
    )
