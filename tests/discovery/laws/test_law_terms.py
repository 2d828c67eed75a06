"""Found laws as terms of an engine file."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from dieseltwin.discovery.laws.grammar import Factor, Form
from dieseltwin.discovery.laws.terms import law_terms_of
from dieseltwin.discovery.laws.twin import Placed
from dieseltwin.engine.terms import ActuatorTerm, Term


def _written(kind: str, point: str, size: float, unit: str) -> tuple:
    form = Form(point, (Factor(kind, (point,), (0.0,), size, (unit,)),), 1.0)  # type: ignore[arg-type]
    law = SimpleNamespace(faults=(), placed=(Placed(form, 1.0),), text="", std=None)
    return law_terms_of(law, SimpleNamespace(points=()))  # type: ignore[arg-type]


@pytest.mark.parametrize("tau", [0.3, 10.0, 60.0])
def test_a_lag_of_the_gas_is_carried_however_slow_a_manifold_is(tau: float) -> None:
    assert _written("lag", "T_em", tau, "K") == (Term(effect="exhaust_thermal_inertia", magnitude=tau),)


def test_a_lag_that_no_manifold_has_is_not_written_and_is_no_traceback() -> None:
    assert _written("lag", "T_em", 400.0, "K") == ()


def test_operators_of_commands_are_faults_of_their_actuators() -> None:
    assert _written("play", "u_vgt", 3.0, "%") == (ActuatorTerm(actuator="vgt", fault="backlash", magnitude=3.0),)
    assert _written("dead_time", "u_egr", 0.2, "%") == (ActuatorTerm(actuator="egr", fault="dead_time", magnitude=0.2),)
