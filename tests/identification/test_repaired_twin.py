"""A twin whose engine knows the left-out effect finds the health parameters without bias."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from segments import PAPER

from dieseltwin.engine import HEALTH, Inputs, actuate, we2011
from dieseltwin.engine.terms import Term
from dieseltwin.errors import InputError
from dieseltwin.identification.few_shot.term_model import TermModel
from dieseltwin.identification.identify import identify_segments
from dieseltwin.identification.learned import LearnedSimulator
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.shooting import Shooting
from dieseltwin.paper.loops.few_shot_program import METHOD, draw_lane, make_program

TERMS = (Term(effect="boost_leak", magnitude=3e-5), Term(effect="bearing_friction", magnitude=5e-6))


def _errors(problem: SegmentProblem, method: str, terms: tuple) -> np.ndarray:
    known = replace(problem, parameters=problem.parameters.replace(terms=terms))
    segment = identify_segments([known], method, 1, 0, config=PAPER).segments[0]
    return np.abs(segment.centre / [getattr(we2011.FIELD, name) for name in HEALTH] - 1.0)


@pytest.fixture(scope="module")
def hurt(simulated: Callable[..., SegmentProblem], drive: Callable[..., Inputs]) -> SegmentProblem:
    """A minute of an engine with two effects, without noise."""
    return simulated(drive(300, 301), we2011.FIELD.replace(terms=TERMS), noise_seed=None)


@pytest.mark.parametrize("method", ["classical", "few-shot-newton"])
def test_terms_take_the_bias_away(hurt: SegmentProblem, method: str) -> None:
    before, after = _errors(hurt, method, ()), _errors(hurt, method, TERMS)
    assert before.max() > 0.05
    assert after.max() < 0.01 and after.max() < before.max() / 10.0


@pytest.mark.parametrize("method", ["classical", "few-shot-newton"])
def test_an_engine_with_a_flap_is_identified(
    simulated: Callable[..., SegmentProblem], drive: Callable[..., Inputs], method: str
) -> None:
    inputs = drive(300, 101)
    position = 55.0 + 20.0 * np.sin(0.5 * inputs.time_s)
    terms = (Term(effect="exhaust_flap", magnitude=1e5),)
    truth = we2011.FIELD.replace(terms=terms)
    problem = simulated(replace(inputs, u_flap_pct=position), truth, noise_seed=None)
    assert _errors(problem, method, terms).max() < 0.05


def test_the_networks_program_holds_the_terms(hurt: SegmentProblem) -> None:
    """Rates of few-shot Adam's program (and so the PINN's) at the same states, with and without the terms."""
    rates = []
    for terms in ((), TERMS):
        problem = replace(hurt, parameters=hurt.parameters.replace(terms=terms))
        lanes = [draw_lane(problem, 0, run, 0, PAPER.start) for run in range(2)]
        actuations = {0: actuate(problem.inputs, problem.parameters)}
        program = make_program(lanes, actuations, None, None, None, PAPER.of(METHOD))
        assert isinstance(program.model, TermModel) == bool(terms)
        states = [torch.tensor(s, dtype=program.dtype).expand(2, -1) for s in _states(problem)]
        q = program.model.quantities(*states, *program.inputs, program.c)
        rates.append(torch.stack([q.dp_im, q.domega_t]))
    assert (rates[1][0] < rates[0][0]).all() and (rates[1][1] < rates[0][1]).all()


def _states(problem: SegmentProblem) -> list[np.ndarray]:
    n = problem.time_s.size
    return [np.full(n, v) for v in (1.6e5, 2.0e5, 6000.0, 0.03, 330.0)]


def test_learned_maps_with_terms_are_refused_by_the_compiled_simulator(hurt: SegmentProblem) -> None:
    problem = replace(hurt, parameters=hurt.parameters.replace(terms=TERMS))
    with pytest.raises(InputError, match="learned maps"):
        Shooting((problem,), LearnedSimulator.__new__(LearnedSimulator))
