"""Noise of settled points is what all points of an engine show, and few readings leave more by chance than many."""

from __future__ import annotations

from typing import cast

import numpy as np
import pandas as pd
import pytest

import dieseltwin as dt
from dieseltwin.api.learning import LearnedResult
from dieseltwin.arrays import rms_of_most
from dieseltwin.discovery.reference.evidence import Evidence, Learned
from dieseltwin.discovery.reference.joint import Joint
from dieseltwin.discovery.reference.standing_part import StandingPart, parts_of
from dieseltwin.engine import we2011
from dieseltwin.errors import InputError
from dieseltwin.learning.belief import NOTHING_FURTHER, prior_belief
from dieseltwin.recordings.noise import SETTLED_NOISE
from dieseltwin.recordings.standing import standing
from dieseltwin.recordings.steady_points import points
from dieseltwin.settings.defaults import default_learn, default_search
from tests.api.test_learn_points import OWN, settled

MAP_RMS = 0.02
NOTHING = np.zeros((1, 1))


def of_two_days(seed: int) -> pd.DataFrame:
    """Twelve points, and one more of a warmer day."""
    warm = OWN.replace(T_amb=OWN.T_amb + 12.0)
    return pd.concat([settled(OWN, 12, seed), settled(warm, 1, seed + 100)], ignore_index=True)


def test_size_of_most_values_is_unbiased_behind_a_fit_and_few_far_ones_set_nothing() -> None:
    rng = np.random.default_rng(1)
    own = rng.uniform(0.2, 1.0, 4000)
    values = 1.7 * np.sqrt(own) * rng.standard_normal(4000)
    assert rms_of_most(values, own, 3.0) == pytest.approx(1.7, rel=0.03)
    values[:40] = 100.0
    assert rms_of_most(values, own, 3.0) == pytest.approx(1.7, rel=0.06)
    assert rms_of_most(np.array([0.05]), np.ones(1), 3.0) == pytest.approx(0.87, abs=0.02)  # one tells next to nothing


def test_few_readings_may_leave_more_than_many() -> None:
    """Of six readings one healthy set in seven leaves 1.6 times what is expected."""
    settings = default_learn()

    def marks(*of_each: tuple[float, float]) -> tuple[float, ...]:
        evidence = tuple(Evidence(NOTHING, NOTHING, 1.0, *item) for item in of_each)
        return Learned(prior_belief(we2011.PARAMETERS, MAP_RMS), evidence, True, NOTHING_FURTHER).misfit_marks(settings)

    draws = np.random.default_rng(2).chisquare(6.0, 200_000) / 6.0
    (six,) = marks((6.0, np.inf))
    assert np.mean(draws > settings.misfit_max) == pytest.approx(0.14, abs=0.01)
    assert np.mean(draws > six) == pytest.approx(settings.misfit_level, rel=0.3)
    assert marks((9000.0, np.inf)) == (settings.misfit_max,)
    unsure, many, first = (*marks((6.0, 20.0)), *marks((6.0, 1e6)), marks((6.0, np.inf), (90.0, np.inf))[0])
    assert unsure > first > six == pytest.approx(many, rel=1e-3)  # of several recordings none by chance


def test_a_point_of_another_day_has_the_noise_of_all_and_their_sizes() -> None:
    """It had that of its own residual; and where its EGR valve was shut, 2 % of next to nothing."""
    table = of_two_days(3)
    table.loc[12, "w_egr_kg_s"] = 0.02 * table["w_egr_kg_s"].median()
    days = standing(points(table, needed=()))
    assert [len(day.pieces()) for day in days] == [12, 1]
    prior = prior_belief(OWN, MAP_RMS)
    parts = parts_of(days, OWN, prior, MAP_RMS, default_search().circumstances, [None, None])
    assert all(isinstance(part, StandingPart) for part in parts)
    j = parts[1].twin.channels.index("w_egr_kg_s")
    scale = parts[1].whitening.scale[:, j].max()
    expected = SETTLED_NOISE["w_egr_kg_s"] * 0.5 * np.median(table["w_egr_kg_s"])
    assert 1.0 / scale == pytest.approx(expected, rel=0.1)


def test_a_slip_in_the_one_point_of_a_day_is_seen_and_noise_is_none() -> None:
    """A residual that is its own noise explains itself."""
    table = of_two_days(5)
    found = dt.learn(table)
    assert isinstance(found, LearnedResult) and not found.known.suspected
    assert all(0.1 < misfit < 2.5 for misfit in found.known.misfits.values())
    table.loc[12, "p_im_pa"] *= 1.08
    with pytest.raises(InputError, match="times the noise is left with all maps corrected"):
        dt.learn(table)


def test_noise_is_that_of_all_days_together() -> None:
    """A day of one point has the noise of the other's twelve, and its misfit is as sure as they make it."""
    table, rng = of_two_days(7), np.random.default_rng(8)
    table["p_im_pa"] *= 1.0 + 2.5 * SETTLED_NOISE["p_im_pa"] * rng.standard_normal(len(table))
    days = standing(points(table, needed=()))
    prior = prior_belief(OWN, MAP_RMS)
    joint = Joint(parts_of(days, OWN, prior, MAP_RMS, default_search().circumstances, [None, None]), prior)
    joint.fit(3, 0.02)
    joint.whiten_anew()
    many, one = (cast(StandingPart, part) for part in joint.parts)
    assert many.relative == one.relative and many.relative["p_im_pa"] > 1.4 * many.relative["p_em_pa"]
    assert np.isfinite(one.noise_freedom) and one.noise_freedom < many.noise_freedom


def test_a_valve_that_is_shut_in_most_points_leaves_a_noise() -> None:
    """The middle of its flow was nothing, and no noise was left: a traceback."""
    table = settled(OWN, 12, 9)
    table.loc[:7, "w_egr_kg_s"] = 0.0
    (day,) = standing(points(table, needed=()))
    (part,) = parts_of([day], OWN, prior_belief(OWN, MAP_RMS), MAP_RMS, default_search().circumstances, [None])
    assert np.isfinite(part.whitening.scale).all()
