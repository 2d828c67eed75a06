"""Beside a learned engine the likelihood is renewed about two effects, and what was recorded of the ambient stays."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from dieseltwin.discovery.likelihood.fit import Candidate, Fit
from dieseltwin.discovery.options import Options
from dieseltwin.discovery.search import renewal
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


def test_what_is_not_fitted_anew_keeps_its_share_of_the_leading_gain_and_overtakes_nothing() -> None:
    """Where health alone is less bad in the new metric, a fit with the gain that it had would lead all others."""

    def metric(objective: float) -> SimpleNamespace:
        return SimpleNamespace(
            null=SimpleNamespace(fit=SimpleNamespace(objective=objective)), gain=lambda fit: objective - fit.objective
        )

    def fit(objective: float) -> Fit:
        return Fit(Candidate(("leak",)), np.zeros(1), np.zeros(1), np.zeros((1, 1)), objective, True)

    before, after = metric(15000.0), metric(12000.0)
    lead, there = fit(200.0), fit(2000.0)  # gains of 14800 and 10000
    moved = renewal._moved(before, after, [lead, fit(240.0), fit(14800.0)], (lead, there), -np.inf)
    assert moved[0] is there
    gains = [after.gain(each) for each in moved]
    assert gains == pytest.approx([10000.0, 10000.0 * 14760.0 / 14800.0, 10000.0 * 200.0 / 14800.0])
