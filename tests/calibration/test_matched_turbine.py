"""The slope of the turbine's efficiency over its blade speed ratio is held; what hangs on it is in the deviation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dieseltwin.calibration.matched_turbine import beside_best_ratio
from dieseltwin.calibration.matched_values import BEST_AT, SLOPE_OF_RATIO, WORKS_AT, known_turbine, matched_values
from dieseltwin.engine import constants, we2011
from dieseltwin.engine.binding import bind
from tests.calibration.simulated import GEOMETRY, TRUTH, made_points
from tests.calibration.test_reference_engine import blowing  # noqa: F401  # a fixture

ANOTHER = we2011.PARAMETERS.replace(V_d=0.0117, R_t=0.041)


def slope(works_at: float) -> float:
    """dln eta/dln BSR of the formula at the middle of some points."""
    few = made_points(count=20)
    engine = ANOTHER.replace(**_as_parameters(matched_values(few, ANOTHER, works_at)))
    eq, c = bind("numpy"), constants(engine)
    omega, T_em, Pi_t = few["omega_t_rad_s"], few["t_em_k"], few["p_amb_pa"] / few["p_em_pa"]
    ratio = float(np.median(eq.blade_speed_ratio(omega, T_em, Pi_t, c)))
    curvature = matched_values(few, ANOTHER, works_at)["c_m1"]
    eta = engine.eta_tmmax - curvature * (ratio - engine.BSR_opt) ** 2
    return 2.0 * curvature * (engine.BSR_opt - ratio) * ratio / eta


def _as_parameters(values: dict[str, float]) -> dict[str, object]:
    return {"BSR_opt": values["BSR_opt"], "c_m": (values["c_m1"], *we2011.PARAMETERS.c_m[1:])}


@pytest.mark.parametrize("works_at", [0.6, WORKS_AT, BEST_AT])
def test_torque_falls_with_speed(works_at: float) -> None:
    assert slope(works_at) == pytest.approx(2.0 * (1.0 - works_at) / (2.0 - works_at), abs=0.01)
    assert slope(works_at) < 1.0


def test_an_optimum_is_known_of_the_published_engine_and_of_one_that_names_its_own() -> None:
    published = we2011.PARAMETERS
    assert known_turbine(published, published)
    assert not known_turbine(published, ANOTHER)
    assert known_turbine(TRUTH, GEOMETRY)  # BSR_opt of its own


def test_beside_a_reference_the_slope_is_held(blowing) -> None:  # type: ignore[no-untyped-def]  # noqa: F811
    free = {c.name for c in blowing.estimate.coefficients}
    assert not free & {*SLOPE_OF_RATIO}
    assert blowing.start["BSR_opt"] == pytest.approx(TRUTH.BSR_opt)  # the base's, that names its own


def test_of_another_engine_sizes_are_made_with_another_slope_too(blowing) -> None:  # type: ignore[no-untyped-def]  # noqa: F811
    free, name = blowing.estimate.coefficients, "A_vgtmax:since"
    assert beside_best_ratio(blowing, free, [name]) == {}
    unknown = replace(blowing, base=we2011.PARAMETERS)
    assert np.isfinite(beside_best_ratio(unknown, free, [name])[name])
    assert beside_best_ratio(unknown, free, []) == {}
