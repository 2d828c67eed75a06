"""Operators of a law that act on an actuator's command: simulated before its lags, and reported as fitted."""

from __future__ import annotations

import numpy as np
import pytest

from dieseltwin.discovery.laws.grammar import Factor, Form
from dieseltwin.discovery.laws.search import _as_found, law_text
from dieseltwin.discovery.laws.terms import _operator_term
from dieseltwin.discovery.laws.twin import LawTwin, Placed
from dieseltwin.discovery.likelihood.fit import first_fit
from dieseltwin.discovery.twins.diesel import EngineTwin
from dieseltwin.discovery.twins.interface import single
from dieseltwin.engine import HEALTH, simulate
from dieseltwin.engine.inputs import Inputs
from dieseltwin.engine.we2011 import PARAMETERS
from dieseltwin.recordings.reader import Recording

N, SAMPLE_S = 200, 0.2


@pytest.fixture(scope="module")
def twin() -> EngineTwin:
    """40 s of steps of the EGR valve at constant speed and fuel, clean."""
    time_s = SAMPLE_S * np.arange(N)
    u_egr = 30.0 + 25.0 * np.sign(np.sin(0.5 * time_s)) + 5.0 * np.sin(1.7 * time_s)
    inputs = {
        "n_e_rpm": np.full(N, 1200.0), "u_delta_mg": np.full(N, 100.0), "u_egr_pct": u_egr,
        "u_vgt_pct": np.full(N, 45.0),
    }  # fmt: skip
    out = simulate(Inputs(time_s, *inputs.values()), PARAMETERS)
    measured = {c: out[c].to_numpy() for c in ("p_im_pa", "p_em_pa", "omega_t_rad_s", "w_egr_kg_s", "t_em_k")}
    ambient = {"t_amb_k": PARAMETERS.T_amb, "p_amb_pa": PARAMETERS.p_amb}
    return EngineTwin(Recording(time_s=time_s, columns={**inputs, **measured}, **ambient), PARAMETERS)


def _play(width: float) -> Placed:
    return Placed(Form("u_egr", (Factor("play", ("u_egr",), (1.0,), width, ("%",)),), 1.0), 1.0, free_shape=True)


def test_play_of_a_law_is_play_of_the_command(twin: EngineTwin) -> None:
    law = LawTwin(twin, [_play(6.0)])
    nominal = np.array([p.value for p in twin.parameters])
    widths = (4.0, 8.0)
    lanes = single(np.append(nominal, widths[0]), first_fit(twin).local)
    for width in widths:
        lanes.parameters[0, len(HEALTH)] = width
        own = single(nominal, lanes.local[0], magnitudes={"egr_backlash": np.array([width])})
        np.testing.assert_allclose(law.simulate(lanes), twin.simulate(own), rtol=1e-12)
        moved = twin.variables(own)["u_egr"] - twin.variables(single(nominal, lanes.local[0]))["u_egr"]
        np.testing.assert_allclose(law.signals(lanes)[0], moved, atol=1e-12)
        assert np.max(np.abs(moved)) > 0.4 * width


def test_a_law_is_reported_with_the_width_that_was_fitted(twin: EngineTwin) -> None:
    found = _as_found(_play(6.0), 1.0, 5.31)
    term = _operator_term(found.form)
    assert term is not None and term.magnitude == 5.31
    assert not found.free_shape
    assert law_text(twin, found.form, 1.0, std=0.12) == "u_egr becomes play[u_egr, 5.31 ± 0.12 %]"
