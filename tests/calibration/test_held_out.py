"""Which of two machines foretells held-out points better is no matter of one or two of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dieseltwin.calibration import calibrate as module
from dieseltwin.calibration.calibrate import Calibration, calibrate
from dieseltwin.calibration.held_out import Foretold, foretold
from dieseltwin.recordings.steady_points import STATES
from tests.calibration.simulated import GEOMETRY, TRUTH, made_points


@pytest.mark.parametrize(("most", "two", "better"), [(0.2, 0.2, True), (0.2, -6.0, True), (-0.2, -0.2, False),
                                                     (-0.2, 6.0, False), (0.0, 6.0, False)])  # fmt: skip
def test_two_points_of_forty_seven_do_not_decide(most: float, two: float, better: bool) -> None:
    density = 17.0 + np.random.default_rng(0).standard_normal(47)
    other = density + np.where(np.arange(47) < 2, two, most)
    assert Foretold(other, {}).better_than(Foretold(density, {})) is better


def test_a_few_points_may_still_be_outvoted_by_the_rest() -> None:
    """Of nine points none can be left out, and all of them count."""
    density = np.zeros(9)
    assert not Foretold(np.array([0.1] * 8 + [-1.0]), {}).better_than(Foretold(density, {}))


@pytest.fixture(scope="module")
def well() -> Calibration:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "STARTS", 0)
        return calibrate(made_points(count=60, noise=0.004, u_flap_pct=100.0), TRUTH, GEOMETRY)


def test_a_machine_that_is_further_off_foretells_worse(well: Calibration) -> None:
    free = list(well.estimate.coefficients)
    here = foretold(well, free)
    assert here.density.size == well.held_out.sum() and here.nll == pytest.approx(-here.density.mean())
    spoiled = well.points.with_columns(p_im_pa=well.points["p_im_pa"] * np.where(well.held_out, 1.05, 1.0))
    assert set(STATES) <= set(spoiled.columns)
    worse = foretold(replace(well, points=spoiled), free)
    assert here.better_than(worse) and not worse.better_than(here)
