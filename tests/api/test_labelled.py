"""xarray datasets in and out."""

from __future__ import annotations

import numpy as np
import pytest
from segments import REFERENCE

import dieseltwin as dt
from dieseltwin.errors import InputError

xarray = pytest.importorskip("xarray", reason="the extra `tables` brings xarray")


def test_a_dataset_goes_in_and_comes_out():
    recorded = dt.dataset(dt.read(REFERENCE)).isel(time_s=slice(0, 100))
    assert recorded["p_im_pa"].attrs == {
        "long_name": "p_im", "units": "Pa", "description": "intake manifold pressure"
    }  # fmt: skip
    simulated = dt.simulate(recorded)
    assert simulated.table().equals(dt.simulate(recorded.to_dataframe().reset_index()).table())
    found = dt.dataset(simulated)
    assert found.sizes == {"time_s": 100} and np.array_equal(found["time_s"], recorded["time_s"])
    assert found["t_em_k"].sel(time_s=4.0, method="nearest") == simulated.table()["t_em_k"].iloc[20]
    assert dt.read(recorded).channels[0] == "time_s"


def test_more_than_one_dimension_is_refused():
    cube = xarray.Dataset({"n_e_rpm": (("time_s", "cylinder"), np.ones((3, 6)))})
    with pytest.raises(InputError, match="dimensions time_s, cylinder"):
        dt.simulate(cube)
