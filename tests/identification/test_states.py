"""The table of identified states."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from segments import PAPER

from dieseltwin.engine import HEALTH, Inputs, actuate, bind, constants, we2011
from dieseltwin.identification.identify import identify_segments
from dieseltwin.identification.in_place import InPlace
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.states import StateSamples, segment_states
from dieseltwin.surrogates.operators import ActuatorStates


def test_states_table_holds_states_flows_and_bands(problem: SegmentProblem) -> None:
    table = identify_segments([problem], "classical", 2, 0, config=PAPER).states
    assert len(table) == len(problem.time_s)
    np.testing.assert_array_equal(table["time_s"], problem.time_s)
    for name in ("p_im_pa", "omega_t_rad_s", "x_r", "w_egr_kg_s", "t_em_k", "eta_c"):
        assert (table[f"{name}_lo"] <= table[f"{name}_hi"]).all()
    # The model fits its own data: readings scatter about the table by their noise.
    z = (table["omega_t_rad_s"] - problem.measured[:, 2]) / problem.sigma[2]
    assert np.std(z) == pytest.approx(1.0, abs=0.15)
    assert (table["p_im_pa_hi"] - table["p_im_pa_lo"]).mean() < problem.sigma[0]


class ScaledMaps:
    """Maps that are the formulae but for eta_c: nominally 10 % larger, member k by k % more."""

    def replacements(self, backend: str, member: Sequence[int] | None = None) -> dict[str, Any]:
        formula = bind(backend).eta_c
        more = 0.0 if member is None else 0.01 * np.array(member)[:, None]
        return {"eta_c": lambda *a: (1.1 + more) * formula(*a)}


class ShiftedOperators:
    """Operators that are 3 % of position off."""

    def predict(self, inputs: Inputs) -> ActuatorStates:
        exact = actuate(inputs, we2011.PARAMETERS)
        return ActuatorStates(exact.u_egr1 + 3.0, exact.u_egr2 + 3.0, exact.u_vgt)


def test_what_follows_from_the_states_is_that_of_the_learned_parts(problem: SegmentProblem) -> None:
    states, health = problem.first_states(), dict(zip(HEALTH, we2011.FIELD.health(), strict=True))
    whole = np.tile([*states, 0.03, 311.0], (len(problem.time_s), 1))
    samples = StateSamples(np.tile(whole, (3, 1, 1)), np.tile(we2011.FIELD.health(), (3, 1)))
    exact = segment_states(problem, whole, health, samples)
    learned = InPlace(ScaledMaps(), ShiftedOperators())  # type: ignore[arg-type]
    table = segment_states(problem, whole, health, samples, learned)
    np.testing.assert_allclose(table["eta_c"], 1.1 * exact["eta_c"])
    np.testing.assert_allclose(table["p_c_w"], exact["p_c_w"] / 1.1)
    np.testing.assert_allclose(table["eta_c_hi"], (1.13 - 0.05 * 0.02) * exact["eta_c"], rtol=1e-9)
    np.testing.assert_allclose(table["u_egr1_pct"], exact["u_egr1_pct"] + 3.0)
    opening = bind("numpy").f_egr
    position = actuate(problem.inputs, we2011.PARAMETERS).u_egr + 3.0
    np.testing.assert_allclose(table["f_egr"], opening(position, constants(we2011.PARAMETERS)))
    np.testing.assert_array_equal(table["phi_c"], exact["phi_c"])
    np.testing.assert_array_equal(exact["eta_c_lo"], exact["eta_c_hi"])


def test_networks_stay_where_they_are(problem: SegmentProblem) -> None:
    """Another process gets the table of the states, no networks."""
    found = identify_segments([problem], "classical", 1, 0, config=PAPER)
    shown = replace(found, learned=InPlace(ScaledMaps()))  # type: ignore[arg-type]
    sent = pickle.loads(pickle.dumps(shown))
    assert sent.learned.maps is None
    pd.testing.assert_frame_equal(sent.states, shown.states)
    np.testing.assert_allclose(sent.states["eta_c"], 1.1 * found.states["eta_c"])
