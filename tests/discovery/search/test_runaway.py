"""A machine that runs away beyond some size: fits stay where it can be simulated, and say so where it can't."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dieseltwin.discovery.likelihood import learned
from dieseltwin.discovery.likelihood.fit import Candidate, Fit, Linearisation, fit_fully
from dieseltwin.discovery.likelihood.metric import Metric, WhitenedNuisances, Whitening
from dieseltwin.discovery.likelihood.nuisance import map_nuisances, nuisance_responses
from dieseltwin.discovery.twins.interface import Lanes
from dieseltwin.engine import MEASURED, we2011
from dieseltwin.learning.belief import prior_belief
from dieseltwin.recordings.noise import Noise, estimate_noise
from tests.discovery.toy import Toy


class Explosive(Toy):
    """The vessel has no end of a run where the heater's gain exceeds 1.153."""

    def simulate(self, lanes: Lanes) -> np.ndarray:
        out = super().simulate(lanes)
        out[lanes.parameters[:, 0] > 1.153, out.shape[1] // 2 :] = np.nan
        return out


def _fit(toy: Toy, gain: float) -> tuple[Whitening, Fit]:
    whitening = Whitening.of(toy.measured, estimate_noise(toy.measured), toy.starts)
    return whitening, Fit(Candidate(), np.array([gain]), np.zeros(0), toy.first_local(), np.inf, False)


def _responses(toy: Toy, whitening: Whitening, start: Fit) -> np.ndarray:
    base = start.lanes()
    return nuisance_responses(
        toy, base, Linearisation(toy, whitening, start).simulated, map_nuisances(toy, toy.variables(base))
    )


def test_a_run_without_an_end_explains_nothing() -> None:
    toy = Explosive(900, 6).record(gain=1.1)
    whitening, start = _fit(toy, 1.2)
    assert Linearisation(toy, whitening, start).fit.objective == np.inf


def test_a_fit_takes_shorter_steps_where_the_machine_runs_away() -> None:
    """Tolerances are linearised at every trial: those that can't be are no end of the search."""
    toy = Explosive(900, 6).record(gain=1.15)  # the second reading is cubic in the gain: a full step goes beyond it
    whitening, start = _fit(toy, 1.0)
    response = _responses(toy, whitening, start)
    assert np.isfinite(response).all()
    reached = fit_fully(toy, whitening, start, response)
    assert reached.fit.parameters[0] == pytest.approx(1.15, abs=0.003)
    assert reached.fit.objective < Linearisation(toy, whitening, start, None, response).fit.objective


def test_a_step_that_leads_uphill_costs_one_simulation() -> None:
    """Sensitivities are worked out where a trial is lower, not at each trial."""
    begun: list[float] = []

    class Counted(Explosive):
        def simulate(self, lanes: Lanes) -> np.ndarray:
            if lanes.size == 1 + len(self.parameters) + len(self.states):  # of a linearisation
                begun.append(float(lanes.parameters[0, 0]))
            return super().simulate(lanes)

    toy = Counted(900, 6).record(gain=1.15)
    whitening, start = _fit(toy, 1.0)
    begun.clear()
    reached = fit_fully(toy, whitening, start)
    assert reached.fit.parameters[0] == pytest.approx(1.15, abs=0.003)
    assert 2 <= len(begun) <= 6 and max(begun) < 1.153


def test_one_run_without_an_end_is_no_error_of_the_others() -> None:
    """Beside tolerances it was a traceback: vanes that were recorded the wrong way round."""
    toy = Toy(900, 6).record(gain=1.1)
    whitening, start = _fit(toy, 1.0)
    at = Linearisation(toy, whitening, start, None, _responses(toy, whitening, start))
    values = np.stack([at.residual, np.where(np.arange(900)[:, None] < 450, at.residual, np.nan), at.residual])
    projected = at.metric.project(values)
    np.testing.assert_allclose(projected[[0, 2]], at.metric.project(values[[0, 2]]), atol=1e-9)
    assert not np.isfinite(projected[1]).all()


def test_responses_that_are_not_finite_are_an_error_that_callers_know() -> None:
    toy = Toy(100, 2).record()
    whitening, _ = _fit(toy, 1.0)
    local = np.zeros((0, 100, 2))
    with pytest.raises(np.linalg.LinAlgError, match="runs away"):
        unknown = WhitenedNuisances.of(whitening, np.full((1, 100, 2), np.nan))
        Metric(whitening, toy.starts, local, np.zeros(0), unknown)


def test_what_is_still_open_of_a_learned_engine_is_told_by_windows_that_do_not_run_away(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of two windows one surges: directions and responses are those of the other one."""
    rng, prior, channels = np.random.default_rng(7), prior_belief(we2011.PARAMETERS, 0.03), len(MEASURED)
    simulated = rng.uniform(0.5, 1.5, size=(60, channels))
    calm = rng.normal(size=(np.count_nonzero(prior.free), *simulated.shape))
    calm[:, 30:] = 0.0
    surging = calm.copy()
    surging[:, 30:] = 1e30 * rng.normal(size=surging[:, 30:].shape)
    twin: Any = SimpleNamespace(channels=MEASURED, starts=np.array([0, 30]), time_s=np.arange(60.0))
    whitening = Whitening.of(simulated, Noise(np.full(channels, 0.01), np.zeros(channels)), twin.starts)
    lanes: Any = None
    found = []
    for columns in (calm, surging):
        monkeypatch.setattr(learned, "map_columns", lambda *_, columns=columns: columns.copy())
        nuisances = learned.learned_nuisances(twin, prior, lanes, simulated, whitening)
        found.append(np.stack([nuisance.response for nuisance in nuisances]))  # type: ignore[misc]
    assert len(found[0]) > 10 and np.array_equal(*found)
