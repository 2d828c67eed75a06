"""Beside a learned engine the likelihood is renewed about two effects, and what was recorded of the ambient stays."""

from __future__ import annotations

from dieseltwin.discovery.options import Options
from dieseltwin.discovery.search.run import run
from dieseltwin.discovery.twins.diesel_circumstances import LoggedTwin
from dieseltwin.engine import we2011
from dieseltwin.engine.terms import Term
from dieseltwin.learning.belief import Belief, prior_belief
from dieseltwin.recordings.reader import recording
from tests.api.simulated import drive

TRUE = {"volumetric_efficiency_residual": 0.5, "air_filter_restriction": 40_000.0}


def test_two_strong_effects_are_named_with_their_sizes() -> None:
    engine = we2011.PARAMETERS
    terms = tuple(Term(effect=name, magnitude=size) for name, size in TRUE.items())
    frame = drive(120.0, engine.replace(terms=terms)).assign(p_amb_pa=engine.p_amb, t_amb_k=engine.T_amb)
    before = prior_belief(engine, 0.02)
    belief = Belief(before.mean, 0.04 * before.covariance)  # as after a reference: a fifth of every doubt is left
    found = run(LoggedTwin(recording(frame), engine, belief=belief), Options().settings(), laws=False)
    assert found.kind == "pair" and found.best is not None and not found.unsettled
    fit, at = found.best.fit, len(found.twin.parameters)
    for name, size, std in zip(fit.candidate.names, fit.magnitudes, fit.std[at:], strict=True):
        assert abs(size - TRUE[name]) < 3.0 * std
    assert isinstance(found.twin, LoggedTwin)
    assert not {"p_amb_pa", "t_amb_k"} & found.twin.values.keys()
    assert found.twin.deviation.any()  # the maps are linearised about what explains the recording
