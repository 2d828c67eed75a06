"""Cramer-Rao bound against an independent computation, and the rule for "not identifiable here"."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dieseltwin.engine import HEALTH, MEASURED, Inputs, simulate, we2011
from dieseltwin.identification.bound import IDENTIFIABLE_BELOW, cautious_bound, cramer_rao
from dieseltwin.identification.problem import SegmentProblem

Make = Callable[..., SegmentProblem]
Drive = Callable[..., Inputs]


def start(problem: SegmentProblem) -> np.ndarray:
    """True p_im, p_em, omega_t at the start."""
    assert problem.true_initial is not None
    return problem.true_initial[:3]


def test_bound_is_the_inverse_fisher_information(simulated: Make, drive: Drive) -> None:
    problem = simulated(drive(0, 151), we2011.FIELD)
    bound = cramer_rao([problem], we2011.FIELD.health(), start(problem))[0]

    # The same from the data-frame simulator, by central differences of another size, in plain units.
    def readings(values: np.ndarray) -> np.ndarray:
        engine = we2011.FIELD.replace(**dict(zip(HEALTH, values[:4].tolist(), strict=True)))
        frame = simulate(problem.inputs, engine, initial=values[4:], step_s=0.00625, oxygen=False)
        return (frame[list(MEASURED[:5])].to_numpy() / problem.sigma[:5]).ravel()

    centre = np.concatenate([we2011.FIELD.health(), start(problem)])
    columns = []
    for i in range(7):
        step = np.zeros(7)
        step[i] = 5e-4 * centre[i]
        columns.append((readings(centre + step) - readings(centre - step)) / (2.0 * step[i]))
    sensitivity = np.stack(columns, axis=1) * centre  # relative, for a well-scaled inverse
    inverse = np.linalg.inv(sensitivity.T @ sensitivity)
    np.testing.assert_allclose(bound.relative, np.sqrt(np.diag(inverse))[:4], rtol=2e-3)
    np.testing.assert_allclose(bound.absolute, bound.relative * we2011.FIELD.health())


def test_twice_the_noise_is_twice_the_bound(problem: SegmentProblem) -> None:
    louder = replace(problem, sigma=2.0 * problem.sigma)
    one, two = cramer_rao([problem, louder], we2011.FIELD.health(), start(problem))
    np.testing.assert_allclose(two.relative, 2.0 * one.relative, rtol=1e-3)


def test_masked_readings_carry_no_information(problem: SegmentProblem) -> None:
    measured = problem.measured.copy()
    measured[::2] = np.nan
    thinner = replace(problem, measured=measured)
    one, half = cramer_rao([problem, thinner], we2011.FIELD.health(), start(problem))
    assert (half.relative > 1.2 * one.relative).all()


def test_a_shut_egr_valve_makes_its_area_unidentifiable(idle_problem: SegmentProblem) -> None:
    bound = cramer_rao([idle_problem], we2011.FIELD.health(), start(idle_problem))[0]
    assert not bound.identifiable(IDENTIFIABLE_BELOW)[HEALTH.index("A_egrmax")]
    assert np.isinf(bound.absolute[HEALTH.index("A_egrmax")])
    assert np.isfinite(bound.relative[HEALTH.index("A_vgtmax")])


def test_driving_identifies_everything(problem: SegmentProblem) -> None:
    bound = cramer_rao([problem], we2011.FIELD.health(), start(problem))[0]
    assert bound.identifiable(IDENTIFIABLE_BELOW).all()


def test_an_estimate_far_off_shows_the_bound_that_it_is_judged_by(simulated: Make, drive: Drive) -> None:
    """Two seconds tell three times the h_tot to 22 %, and the laboratory's to 35 %."""
    there = we2011.FIELD.replace(h_tot=3.0 * we2011.FIELD.h_tot)
    problem = simulated(drive(600, 11), there)
    own, nominal = (
        cramer_rao([problem], values, start(problem))[0] for values in (there.health(), problem.parameters.health())
    )
    bound = cautious_bound([problem], there.health(), start(problem), IDENTIFIABLE_BELOW)[0]
    assert own.identifiable(IDENTIFIABLE_BELOW).all()
    assert bound.identifiable(IDENTIFIABLE_BELOW).tolist() == [True, True, True, False]
    np.testing.assert_array_equal(bound.absolute[:3], own.absolute[:3])
    np.testing.assert_allclose(bound.absolute[3], nominal.relative[3] * there.h_tot)
