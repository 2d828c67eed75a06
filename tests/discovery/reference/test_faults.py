"""The main faults that a reference may have had: sizes by how fits beside them fall off."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from dieseltwin.discovery.reference import faults
from dieseltwin.discovery.reference.faults import MAIN, fitted_size, main_faults
from dieseltwin.discovery.reference.joint import Joint
from dieseltwin.discovery.reference.part import Part
from dieseltwin.discovery.twins.interface import Hypothesis
from dieseltwin.engine import we2011
from dieseltwin.engine.terms import Term
from dieseltwin.learning.belief import prior_belief
from dieseltwin.recordings.reader import recording
from tests.api.simulated import drive

TOLD = 25.0


@dataclass(frozen=True)
class Quadratic:
    """Fits whose cost is known: of each effect the size at which it is least, and its standard deviation."""

    known: dict[str, Hypothesis]
    least: dict[str, tuple[float, float]]
    at: tuple[str, float] = (MAIN[0], 0.0)

    def beside(self, effect: str, size: float, anew: bool) -> Quadratic:
        return replace(self, at=(effect, size))

    def cost(self) -> float:
        effect, size = self.at
        each = ((size if name == effect else 0.0, *of_effect) for name, of_effect in self.least.items())
        return sum(((value - best) / std) ** 2 for value, best, std in each)

    def hypotheses(self) -> dict[str, Hypothesis]:
        return self.known


@pytest.fixture(scope="module")
def part() -> Part:
    leaking = we2011.PARAMETERS.replace(terms=(Term(effect="exhaust_leak", magnitude=4e-5),))
    return Part(recording(drive(90.0, leaking, seed=3)), we2011.PARAMETERS, prior_belief(we2011.PARAMETERS, 0.02), 0.02)


@pytest.mark.parametrize("size", [0.0, 8e-6, 3e-5, 9e-5])
def test_a_size_and_its_deviation_are_those_of_the_costs(part: Part, size: float):
    known = {name: part.twin.hypotheses[name] for name in ("exhaust_leak", "injector_drift")}
    joint = Quadratic(known, {"exhaust_leak": (size, 3e-6), "injector_drift": (-0.02, 0.01)})
    found = {item.name: item for item in main_faults(joint, TOLD)}
    leak, drift = found["exhaust_leak"], found["injector_drift"]
    assert leak.size == pytest.approx(size, abs=1e-9) and leak.std == pytest.approx(3e-6)
    assert drift.size == pytest.approx(-0.02) and drift.std == pytest.approx(0.01)
    assert leak.told(TOLD) == (size >= 3e-5) and leak.hidden(TOLD) == pytest.approx(1.5e-5)


def test_no_more_is_gained_than_a_fit_showed(part: Part):
    """Costs that explode far away make a parabola dip deep between two sizes."""
    found = fitted_size(part.twin.hypotheses["back_pressure"], {0.0: 0.0, 4e4: 300.0, 8e4: 11000.0})
    assert found is not None and (found.size, found.gain) == (0.0, 0.0)
    assert fitted_size(part.twin.hypotheses["back_pressure"], {0.0: 0.0, 4e4: 300.0, 8e4: 320.0}) is None


def test_errors_of_maps_that_explain_more_keep_a_fault_unsaid(part: Part):
    costs = {0.0: 0.0, 2e-5: -84.0, 4e-5: -60.0}
    effect = part.twin.hypotheses["exhaust_leak"]
    found = fitted_size(effect, costs)
    assert found is not None
    assert [replace(found, rival=rival).told(TOLD) for rival in (50.0, 120.0)] == [True, False]


def test_a_leak_in_the_engine_is_fitted_at_its_size(part: Part, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(faults, "MAIN", ("exhaust_leak",))
    joint = Joint([part], part.prior)
    joint.fit(12, 0.02)
    joint.whiten_anew()
    before = (joint.x.copy(), joint.cost(), part.local.copy())
    first = main_faults(joint, TOLD, rival=1.0)[0]  # so little that it is fitted anew
    assert first.name == "exhaust_leak" and abs(first.size - 4e-5) < 3.0 * first.std
    assert np.array_equal(joint.x, before[0]) and joint.cost() == before[1] and np.array_equal(part.local, before[2])
