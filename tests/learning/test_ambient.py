"""What is told of weather and charge beside a learned engine is no surer than what its reference knew of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import dieseltwin as dt
from dieseltwin.engine import we2011
from dieseltwin.learning.ambient import level_std, reference_std
from dieseltwin.learning.belief import Belief, prior_belief
from dieseltwin.learning.files import LearnedEngine, save_learned
from dieseltwin.recordings.reader import recording
from dieseltwin.settings.defaults import default_search
from tests.api.simulated import drive

BELIEFS = default_search().circumstances


@pytest.fixture(scope="module")
def learned() -> LearnedEngine:
    before, driven = prior_belief(we2011.PARAMETERS, 0.02), recording(drive(30.0, seed=29))
    belief = Belief(before.mean, 0.01 * before.covariance)
    return LearnedEngine(we2011.PARAMETERS, belief, 0.02, (driven,), {}, {driven.sha256: 1.0})


def _with(learned: LearnedEngine, **columns: float) -> LearnedEngine:
    (driven,) = learned.recordings
    read = {name: np.full(driven.time_s.size, value) for name, value in columns.items()}
    return replace(learned, recordings=(replace(driven, columns={**driven.columns, **read}),))


def test_a_column_is_as_sure_as_its_sensor(learned: LearnedEngine):
    stds = reference_std(_with(learned, p_amb_pa=1e5, t_amb_k=295.0, t_im_k=301.0), BELIEFS)
    assert stds == {"p_amb_pa": BELIEFS.p_amb_read_pa, "t_amb_k": BELIEFS.t_amb_read_k, "t_im_k": BELIEFS.t_im_read_k}


def test_without_a_column_the_charge_is_as_sure_as_the_level_of_eta_vol(learned: LearnedEngine):
    (driven,) = learned.recordings
    bare = replace(learned, recordings=(replace(driven, columns={
        name: values for name, values in driven.columns.items() if name not in ("p_amb_pa", "t_amb_k", "t_im_k")}),))
    level, stds = level_std(bare, "eta_vol"), reference_std(bare, BELIEFS)
    assert 0.2 * 0.02 < level < 0.02
    assert stds == {"t_im_k": pytest.approx(level * we2011.PARAMETERS.T_im)}


def test_what_is_stated_of_a_case_holds_it(learned: LearnedEngine, tmp_path: Path):
    save_learned(learned, tmp_path / "mine.yaml")
    document = dt.discover(drive(60.0, seed=31), engine=tmp_path / "mine.yaml").document
    charge = next(item for item in document.circumstances if item.name == "t_im_k")
    assert charge.std >= reference_std(learned, BELIEFS)["t_im_k"]
