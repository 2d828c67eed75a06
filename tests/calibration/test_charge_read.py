"""A charge temperature that was read: the engine file has it, `imply` uses it, pages have words for it."""

from __future__ import annotations

import numpy as np
import pytest

from dieseltwin.calibration import calibrate as module
from dieseltwin.calibration.calibrate import calibrate
from dieseltwin.calibration.coefficients import engine_coefficients
from dieseltwin.calibration.discover import Options, PointsDiscovery, discover_points
from dieseltwin.calibration.likelihood import estimate
from dieseltwin.calibration.saved import answers_of
from dieseltwin.calibration.steady_model import EXTRA_ROWS, ROWS, WORK_ROW, SteadyModel
from dieseltwin.engine import we2011
from dieseltwin.recordings.steady_points import SteadyPoints
from dieseltwin.report.calibration import TITLES
from dieseltwin.settings.defaults import default_search
from tests.calibration.simulated import GEOMETRY, TRUTH, made_points

WARM_K = 309.0


@pytest.fixture(scope="module")
def data() -> SteadyPoints:
    """Points of an engine whose charge is 8 K warmer than the published one's, and is read."""
    made = made_points(TRUTH.replace(T_im=WARM_K), count=50, noise=0.005)
    return made.with_columns(t_im_k=WARM_K + 0.5 * np.random.default_rng(2).standard_normal(made.size))


@pytest.fixture(scope="module")
def found(data: SteadyPoints) -> PointsDiscovery:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "STARTS", 0)
        one = default_search().points.model_copy(update={"most_effects": 1})
        return discover_points(calibrate(data, we2011.PARAMETERS, GEOMETRY), Options(law_search=False, search=one))


def test_the_engine_has_the_charge_that_its_maps_were_fitted_at(found: PointsDiscovery) -> None:
    engine = found.calibration.engine
    assert engine.T_im == pytest.approx(WARM_K, abs=0.3) and GEOMETRY.T_im < WARM_K - 5.0
    # so the filling is the true engine's where the file is simulated
    assert engine.c_vol[2] == pytest.approx(TRUTH.c_vol[2], rel=0.02)


def test_imply_takes_it_as_read(found: PointsDiscovery, data: SteadyPoints) -> None:
    answers = answers_of(found)
    without = answers(SteadyPoints({n: v for n, v in data.columns.items() if n != "t_im_k"}, data.row))
    colder = answers(data.with_columns(t_im_k=np.full(data.size, 295.0)))
    assert np.abs(colder["t_im_k"] - 295.0).max() < 3.5 and colder["t_im_k_std"].max() < 2.5
    assert without["t_im_k_std"].min() > 2.6
    once = data["t_im_k"].copy()
    once[3:] = np.nan
    partly = answers(data.with_columns(t_im_k=once))
    assert partly["t_im_k_std"][:3].max() < 2.5 and partly["t_im_k_std"][3:].min() > 2.6


def test_every_relation_has_a_title() -> None:
    assert {*ROWS, WORK_ROW, *EXTRA_ROWS.values()} <= set(TITLES)


def test_a_wide_error_of_a_relation_makes_no_coefficients_cheap(data: SteadyPoints) -> None:
    """Starts of a submodel are compared by this cost: without what normalises the errors, a misfit of 19 % was cheaper
    than one of 0.9 %, as the relation was believed to be off by so much."""
    own = [c for c in engine_coefficients(we2011.PARAMETERS, GEOMETRY) if c.submodel == "compressor_flow"]
    model = SteadyModel(GEOMETRY)
    begin = {c.name: c.mean for c in own}
    astray = {c.name: float(np.clip(c.mean + 4.0 * c.std * (-1.0) ** k, c.low, c.high)) for k, c in enumerate(own)}
    row = ("compressor_flow",)
    good = estimate(model, data, own, begin, rows=row, iterations=3)
    bad = estimate(model, data, own, astray, rows=row, discrepancy={"compressor_flow": 0.3}, iterations=1)
    at = model.rows.index("compressor_flow")
    assert good.discrepancy[at] < 0.5 * bad.discrepancy[at]
    assert good.cost < bad.cost - 20.0
