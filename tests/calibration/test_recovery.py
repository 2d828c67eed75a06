"""A simulated engine of another size comes back within its stated intervals; a hidden back-pressure is found."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dieseltwin.calibration.calibrate import Calibration, calibrate, read_geometry
from dieseltwin.calibration.coefficients import scalar
from dieseltwin.calibration.saved import calibration_sidecar, other_points, write_calibration
from dieseltwin.calibration.steady_twin import SteadyTwin
from dieseltwin.discovery.likelihood.known import KnownErrors
from dieseltwin.discovery.twins.interface import Twin
from dieseltwin.engine import we2011
from dieseltwin.engine.engine_files import load_engine
from dieseltwin.recordings.noise import SETTLED_NOISE
from dieseltwin.recordings.steady_points import read_points
from dieseltwin.settings.defaults import default_search
from tests.calibration.simulated import GEOMETRY, TRUTH, made_points

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("DIESELTWIN_DATA", ROOT.parent / "shared" / "data"))
UW = DATA / "uw_hd_diesel" / "steady_state_points.csv"


@pytest.fixture(scope="module")
def found() -> Calibration:
    """150 points with 1 % noise of an engine with 10.8 l, other wheels and other maps."""
    return calibrate(made_points(), we2011.PARAMETERS, GEOMETRY, noise=dict.fromkeys(SETTLED_NOISE, 0.01))


def test_coefficients_lie_within_their_intervals(found: Calibration) -> None:
    z = {c.name: (c.value - scalar(TRUTH, c.name)) / c.std for c in found.coefficients}
    inside = np.mean([abs(v) < 1.645 for v in z.values()])
    assert inside >= 0.8, z
    assert max(abs(v) for v in z.values()) < 4.0, z
    assert {"c_vol3", "A_egrmax", "K_t", "eta_sc"} <= {c.name for c in found.coefficients if c.verdict == "identified"}


def test_efficiencies_alone_are_the_beliefs(found: Calibration) -> None:
    verdicts = {c.name: c.verdict for c in found.coefficients}
    assert verdicts["eta_cmax"] != "identified"
    assert any("product" in note for note in found.notes)


def test_held_out_fit_is_noise(found: Calibration) -> None:
    assert found.fits["cylinder_flow"].held_out < 2.5
    assert found.fits["turbine_flow"].held_out < 3.0
    assert found.fits["exhaust_temperature"].held_out < 2.0
    # the share that is explained is of the same error: solved for the flow, flat speed lines made it negative
    assert found.fits["compressor_flow"].coefficient_of_determination > 0.98


def test_saved_engine_is_read_back(found: Calibration, tmp_path: Path) -> None:
    file = tmp_path / "engine.yaml"
    write_calibration(found, file)
    assert load_engine(file) == found.engine
    assert calibration_sidecar(file).is_file()
    assert other_points(file, found.points) == []  # of a table there is no telling; of files there is
    read = replace(found, points=replace(found.points, path=tmp_path / "well.csv", sha256="1" * 64))
    write_calibration(read, file)
    assert other_points(file, read.points) == []
    (said,) = other_points(file, replace(read.points, sha256="2" * 64))
    assert "calibrated from other points (well.csv)" in said and "--reference" in said


def test_balances_of_the_twin_answer_effects(found: Calibration) -> None:
    twin = SteadyTwin(found, default_search().points)
    assert isinstance(twin, Twin) and isinstance(twin, KnownErrors)
    plain = twin.plain_lane()
    off = twin.simulate(plain)[0]
    row = twin.channels.index("turbine_flow")
    more = twin.simulate(replace(plain, magnitudes={"back_pressure": np.array([3e5])}))[0]
    assert np.nanmean(np.abs(more[:, row] - off[:, row])) > 3.0  # whitened: three standard deviations
    before = twin.channels.index("cylinder_flow")  # whitening mixes a balance with those before it alone
    np.testing.assert_allclose(more[:, before], off[:, before], atol=1e-9)


@pytest.mark.skipif(not UW.is_file(), reason=f"needs {UW.name} of the shared data (DIESELTWIN_DATA)")
def test_real_engine(tmp_path: Path) -> None:
    file = tmp_path / "geometry.yaml"
    file.write_text("bore_mm: 130\nstroke_mm: 162\nn_cyl: 6\nr_c: 19\n")
    shape = read_geometry(file, we2011.PARAMETERS)
    real = calibrate(read_points(UW, engine=shape), we2011.PARAMETERS, shape)
    assert real.fits["cylinder_flow"].held_out < 2.0
    assert real.fits["exhaust_temperature"].held_out < 3.5
    assert real.fits["turbine_flow"].held_out > 3.0  # the model lacks what throttles the exhaust
    assert [a.opens for a in real.actuators] == [1, 1]
    assert pd.Series(real.tolerances()).between(0.002, 0.4).all()
