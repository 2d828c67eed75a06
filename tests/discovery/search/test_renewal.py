"""What was learned of the maps, renewed about the explanation that leads."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from dieseltwin.discovery.likelihood.fit import Candidate, Fit
from dieseltwin.discovery.search import renewal


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
