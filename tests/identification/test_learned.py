"""Classical estimation with learned maps: variants of the simulator, and the maps' own uncertainty."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from segments import PAPER

from dieseltwin.engine import MEASURED, Observations, actuate, parameter_batch, simulate_states, we2011
from dieseltwin.identification.bound import cramer_rao
from dieseltwin.identification.identify import identify_segments
from dieseltwin.identification.learned import ErrorDirections, LearnedSimulator
from dieseltwin.identification.problem import SegmentProblem

# Two maps of three members; spread is the factor that calibrates their scatter.
MAPS = SimpleNamespace(members=3, maps={"eta_c": SimpleNamespace(spread=1.0), "eta_tm": SimpleNamespace(spread=2.0)})
T_EM = MEASURED.index("t_em_k")
BIAS_K = 12.0


@pytest.fixture
def maps(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Maps whose nominal reading of T_em is off by BIAS_K, and whose members of eta_tm scatter by as much.

    They stand in for trained ones, whose simulator takes a minute to compile.
    """
    from dieseltwin.surrogates import map_compiled

    def stand_in(maps: object, member: dict[str, int] | None = None) -> Callable[..., Observations]:
        shift = BIAS_K * (1.0 + (member or {}).get("eta_tm", 2) - 2.0)

        def simulate(*arguments: object) -> Observations:
            exact = simulate_states(*arguments)  # type: ignore[arg-type]
            measured = exact.measured.copy()
            measured[..., T_EM] += shift
            return Observations(exact.states, measured)

        return simulate

    monkeypatch.setattr(map_compiled, "compiled_simulator", stand_in)
    return MAPS


def test_each_lane_gets_its_own_variant(maps: SimpleNamespace, problem: SegmentProblem) -> None:
    learned = LearnedSimulator(maps)  # type: ignore[arg-type]
    assert learned.variants[0] == {}
    assert learned.variants[4:] == [{"eta_tm": 1}, {"eta_tm": 2}, {"eta_tm": 3}]
    actuation = actuate(problem.inputs, we2011.PARAMETERS)
    batch = parameter_batch(we2011.PARAMETERS, A_vgtmax=np.linspace(7e-4, 9e-4, 4))
    initial = np.tile(problem.first_states(), (4, 1))
    found = learned([actuation] * 4, batch, initial, np.array([6, 0, 4, 6]))
    exact = simulate_states(actuation, batch, initial)
    np.testing.assert_array_equal(found.states, exact.states)
    shift = (found.measured - exact.measured)[:, 0, T_EM]
    np.testing.assert_allclose(shift, [2.0 * BIAS_K, BIAS_K, 0.0, 2.0 * BIAS_K])


def test_whitening_is_the_inverse_square_root_of_the_covariance() -> None:
    rng = np.random.default_rng(0)
    directions = rng.standard_normal((30, 4)) * np.array([3.0, 1.0, 0.3, 0.1])
    errors = ErrorDirections.of(directions)
    rows = rng.standard_normal((5, 30))
    inverse = np.linalg.inv(np.eye(30) + directions @ directions.T)
    np.testing.assert_allclose(errors.whiten(rows) @ errors.whiten(rows).T, rows @ inverse @ rows.T, rtol=1e-10)


def test_errors_too_small_to_see_change_nothing() -> None:
    rows = np.ones((2, 30))
    np.testing.assert_array_equal(ErrorDirections.of(np.full((30, 3), 1e-4)).whiten(rows), rows)


def test_uncertainty_of_the_maps_widens_the_interval_and_takes_out_the_bias(
    maps: SimpleNamespace, problem: SegmentProblem
) -> None:
    single = SimpleNamespace(members=0, maps=maps.maps)  # nothing known about the maps' errors
    sure = identify_segments([problem], "classical", 2, 0, maps=single, config=PAPER).segments[0]
    aware = identify_segments([problem], "classical", 2, 0, maps=maps, config=PAPER).segments[0]
    exact = identify_segments([problem], "classical", 2, 0, config=PAPER).segments[0]
    assert sure.converged.all() and aware.converged.all()
    assert (aware.std[0] >= sure.std[0] * (1.0 - 1e-6)).all()
    z_sure = np.abs(np.log(sure.centre / exact.centre)) / (exact.std[0] / exact.centre)
    z_aware = np.abs(np.log(aware.centre / exact.centre)) / (exact.std[0] / exact.centre)
    assert z_sure.max() > 3.0
    assert z_aware.max() < 0.5 * z_sure.max()


def test_the_bound_knows_the_noise_of_the_sensors_only(maps: SimpleNamespace, problem: SegmentProblem) -> None:
    health, start = we2011.FIELD.health(), problem.first_states()
    exact = cramer_rao([problem], health, start)[0]
    learned = cramer_rao([replace(problem)], health, start, simulator=LearnedSimulator(maps))[0]  # type: ignore[arg-type]
    np.testing.assert_allclose(learned.relative, exact.relative, rtol=1e-6)
