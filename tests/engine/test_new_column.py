"""A new sensor column is one row of `sensors` and the words of its names: read, simulated, compared and told."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from dieseltwin.sensors import MEASURED, SENSORS
from tests.engine.grown import copied, differences, write_sensor

PROOF = """
import json
import numpy as np
import pandas as pd
import dieseltwin as dt
from dieseltwin.engine import MEASURED, extended
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.errors import InputError
from dieseltwin.identification.few_shot._compiled import N_CHANNELS, curvature, residuals
from dieseltwin.paper.datasets import add_noise
from dieseltwin.recordings.channels import read_channel_map
from dieseltwin.recordings.reader import recording
from dieseltwin.report.over_time import beside_readings
from dieseltwin.settings.params import load_params

# One text makes both kernels: the one with implicit laws serves every lane, and the other compiles for as long again.
extended.integrate_free = extended.integrate_restricted

told = {"columns": MEASURED}
true = dt.simulate("drive.csv", effects={"t_c_gain": 0.05}).table()
told["gain"] = float((true["t_c_k"] / dt.simulate("drive.csv").table()["t_c_k"]).mean())
relative = load_params().noise.model_copy(update={name: 0.01 for name in ("p_im_rel", "p_em_rel", "w_egr_rel")})
noisy = add_noise(true.assign(p_amb_pa=101100.0, t_amb_k=298.46), relative)
told["noise"] = float((noisy["t_c_k"] / true["t_c_k"]).std())
try:
    recording(noisy.assign(t_c_k=noisy["t_c_k"] - 273.15))
except InputError as error:
    told["refused"] = str(error)

noisy.assign(t_c_k=noisy["t_c_k"] - 273.15).rename(columns={"t_c_k": "T after compressor [degC]"}).to_csv("noisy.csv")
guessed = read_channel_map(dt.channels("noisy.csv").save("map.yaml"))
told["unit"] = guessed.entries["T after compressor [degC]"].unit
read = dt.read("noisy.csv", channels=guessed)
told["figure"] = [axes.get_ylabel() for axes in beside_readings(true, read.columns).figure.axes]

six = dt.read(noisy.drop(columns="t_c_k"))
tables = [dt.identify(each, method="classical", runs=1).table() for each in (six, read)]
told["std"] = [float(table.loc["A_vgtmax", "std"]) for table in tables]
found = dt.discover(read, withhold=[name for name, effect in EFFECTS.items() if effect.kind != "sensor"])
told["sentence"] = found.sentence

# few-shot: the gradient by the log-parameters against differences of the cost, for values that are linear in them
rng = np.random.default_rng(0)
path, slopes = rng.uniform(1.0, 2.0, (1, 12, 2)), rng.normal(size=(1, N_CHANNELS, 7, 2))
others = [rng.uniform(1.0, 2.0, (1, rows, 2)) for rows in (N_CHANNELS, N_CHANNELS, 3, 3, N_CHANNELS)]
row, physics, misfit = np.zeros(1, dtype=int), np.empty((1, 3, 2)), np.empty((1, N_CHANNELS, 2))

def cost(p):
    total = np.empty(1)
    values = np.einsum("kcpi,p->kci", slopes[:, :, 3:], p)
    residuals.py_func(row, path, values, *others, np.inf, total, physics, misfit)
    return total[0]

differences = [(cost(1e-4 * e) - cost(-1e-4 * e)) / 2e-4 for e in np.eye(4)]
cost(np.zeros(4))
gradient, by_health, corner = np.empty((1, 3, 4)), np.empty((1, 4)), np.empty((1, 4, 4))
curvature.py_func(row, path, slopes, others[1], others[2], np.inf, physics, misfit, gradient, by_health,
                  np.empty((1, 45, 2)), corner)
told["gradient"] = float(np.abs(by_health[0] - differences).max())
print(json.dumps(told))
"""


@pytest.fixture(scope="module")
def told(grown: Path, run_grown: Callable[..., str], trace: pd.DataFrame) -> dict[str, Any]:
    """What the library says of the column that it has got."""
    columns = ["time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct", "p_im_pa", "p_em_pa", "omega_t_rad_s"]
    trace[columns].iloc[:401].to_csv(grown / "drive.csv", index=False)
    result: dict[str, Any] = json.loads(run_grown("-c", PROOF).splitlines()[-1])
    return result


def test_the_patch_is_two_files(tmp_path: Path, project_root: Path) -> None:
    library = copied(project_root, tmp_path)
    write_sensor(library)
    assert list(differences(project_root / "dieseltwin", library)) == ["data/channel_names.yaml", "sensors.py"]


@pytest.mark.thorough
def test_it_is_simulated_with_its_fault_and_has_noise(told: dict[str, Any]) -> None:
    assert told["columns"] == [*MEASURED, "t_c_k"]
    assert told["gain"] == pytest.approx(1.05, rel=1e-9)
    assert told["noise"] == pytest.approx(0.01, rel=0.15)


@pytest.mark.thorough
def test_it_is_guessed_checked_and_drawn(told: dict[str, Any]) -> None:
    assert told["unit"] == "degC"
    assert "column t_c_k" in told["refused"] and "looks like degC" in told["refused"]
    assert "$T_c$ [K]" in told["figure"]


@pytest.mark.thorough
def test_the_likelihoods_compare_it(told: dict[str, Any]) -> None:
    six, seven = told["std"]
    assert 0.9 * six < seven < 0.995 * six
    assert "missing: a gain error of the T_c reading of " in told["sentence"]
    assert told["gradient"] < 1e-6


def test_every_row_is_whole() -> None:
    assert [sensor.symbol.equation for sensor in SENSORS[:3]] == ["A.1", "A.2", "A.24"]
    for sensor in SENSORS:
        assert 0.0 < sensor.noise < 0.2 and 0.0 < sensor.floor < sensor.usual and sensor.without
        assert sensor.symbol.low <= sensor.usual <= sensor.symbol.high
        assert all(0.0 < fault.tolerance < fault.limit for fault in sensor.faults)
