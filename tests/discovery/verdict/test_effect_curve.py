"""Every effect's curve can be drawn from what the diesel twin tells, and stands for what its law does."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from dieseltwin.discovery.twins.diesel import EngineTwin
from dieseltwin.discovery.twins.interface import single
from dieseltwin.discovery.verdict.effect_curve import change_by
from dieseltwin.engine import we2011
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.recordings.reader import read_recording

DRAWN = [name for name, effect in EFFECTS.items() if effect.curve is not None]


@pytest.fixture(scope="module")
def told(tmp_path_factory, trace: pd.DataFrame):  # type: ignore[no-untyped-def]
    """Twin of half a minute of driving, and its variables."""
    path = tmp_path_factory.mktemp("curve") / "recording.csv"
    trace.iloc[100:251].to_csv(path, index=False)
    twin = EngineTwin(read_recording(path), we2011.FIELD)
    health = np.array([p.value for p in twin.parameters])
    return twin, twin.variables(single(health, twin.first_local()))


@pytest.mark.parametrize("name", DRAWN)
def test_every_curve_can_be_drawn(told, name: str) -> None:  # type: ignore[no-untyped-def]
    twin, variables = told
    effect = EFFECTS[name]
    assert effect.curve is not None
    x = effect.curve.argument(variables)
    assert x.shape == twin.time_s.shape and np.isfinite(x).all()
    if effect.curve.unit is not None:
        y = effect.curve.sign * change_by(effect, effect.tolerance, variables, twin.engine)
        assert np.isfinite(y).all() and np.median(y) > 0.0


def test_a_leak_is_drawn_as_its_flow(told) -> None:  # type: ignore[no-untyped-def]
    twin, variables = told
    flow = -change_by(EFFECTS["boost_leak"], 2e-5, variables, twin.engine)
    choked = variables["p_im"] > 1.95 * variables["p_amb"]
    R, gamma = twin.engine.R_a, twin.engine.gamma_a
    factor = np.sqrt(gamma * (2.0 / (gamma + 1.0)) ** ((gamma + 1.0) / (gamma - 1.0)))
    expected = 2e-5 * variables["p_im"] / np.sqrt(R * variables["T_im"]) * factor
    assert choked.any()
    np.testing.assert_allclose(flow[choked], expected[choked], rtol=1e-9)
    assert (flow <= expected * (1.0 + 1e-9)).all()
