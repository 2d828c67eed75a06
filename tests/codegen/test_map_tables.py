"""Maps as tables: the engine's own values, learned corrections applied, the same in CSV and in C."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.interpolate import RegularGridInterpolator

from dieseltwin.cli.app import main
from dieseltwin.codegen.tables import MAPS, Table, tabulated, write_tables
from dieseltwin.engine import Inputs, constants, simulate, we2011
from dieseltwin.engine.binding import MAPS as NAMES
from dieseltwin.engine.binding import bind
from dieseltwin.engine.map_corrections import basis
from dieseltwin.engine.terms import CorrectionTerm
from tests.disk import full_beyond

LEARNED = we2011.PARAMETERS.replace(terms=[
    CorrectionTerm(coefficients=tuple(0.02 * np.random.default_rng(1).standard_normal(len(basis().names))))
])  # fmt: skip


def _looked_up(folder: Path, compiler: str, name: str, points: np.ndarray) -> np.ndarray:
    """Values of the function in `maps.c` at points (n, arguments)."""
    calls = "".join(f'    printf("%.17g\\n", map_{name}({", ".join(map(repr, map(float, row)))}));\n' for row in points)
    text = f'#include <stdio.h>\n#include "maps.c"\nint main(void) {{\n{calls}    return 0;\n}}\n'
    (folder / "call.c").write_text(text)
    command = [compiler, "-std=c99", "-Wall", "-Wextra", "-Werror", "-o", folder / "call", folder / "call.c"]
    subprocess.run(command, check=True)
    return np.array(subprocess.run([folder / "call"], capture_output=True, text=True, check=True).stdout.split(), float)


def _at(table: Table, points: Sequence[Sequence[float]]) -> np.ndarray:
    """Values of a table at points (n,) of each argument."""
    at = RegularGridInterpolator(tuple(table.nodes.values()), table.values, bounds_error=False, fill_value=None)
    return at(np.stack([np.asarray(values) for values in points], axis=1))


def test_all_six_maps_are_there():
    assert set(NAMES) < set(MAPS)


@pytest.mark.parametrize("name", ["eta_vol", "f_egr", "eta_tm"])
def test_c_and_csv_are_the_map(name: str, compiler: str, tmp_path: Path):
    write_tables(we2011.PARAMETERS, "published", tmp_path)
    table = pd.read_csv(tmp_path / f"{name}.csv")
    rng = np.random.default_rng(3)
    rows = table.sample(5, random_state=4).to_numpy()
    ends = table.iloc[:, :-1].min().to_numpy(), table.iloc[:, :-1].max().to_numpy()
    inside = rng.uniform(*ends, (5, len(ends[0])))
    beyond = ends[1][None] * 2.0
    got = _looked_up(tmp_path, compiler, name, np.concatenate([rows[:, :-1], inside, beyond]))
    assert got[:5] == pytest.approx(rows[:, -1], rel=1e-5)
    assert got[-1] == pytest.approx(table.iloc[-1, -1], rel=1e-6)  # held
    model = bind("numpy", {"blade_speed_ratio": lambda omega_t, BSR, Pi_t, c: BSR})
    exact = MAPS[name].formula(model, constants(we2011.PARAMETERS), *inside.T)
    assert got[5:10] == pytest.approx(exact, rel=0.02, abs=2e-3)  # linear between nodes


def test_learned_corrections_are_in_the_tables():
    """The share by which `simulate` departs from the published map is the share between the tables."""
    time = np.arange(0.0, 80.0, 0.2)
    middles = {1250.0: 9.0, 130.0: 7.0, 30.0: 5.0, 55.0: 3.0}  # and periods of the four inputs
    waves = [middle * (1.0 + 0.3 * np.sin(time / period)) for middle, period in middles.items()]
    rows = simulate(Inputs(time, *waves), LEARNED)
    model, c = bind("numpy"), constants(we2011.PARAMETERS)
    own, plain = tabulated(LEARNED), tabulated(we2011.PARAMETERS)
    Pi_t = model.turbine_pressure_ratio(rows["p_em_pa"].to_numpy(), c)
    omega_t = rows["omega_t_rad_s"]
    BSR = model.blade_speed_ratio(omega_t, rows["t_em_k"], Pi_t, c)
    points = {"eta_vol": (rows["p_im_pa"], rows["n_e_rpm"]), "eta_tm_learned": (omega_t, Pi_t),
              "eta_tm_learned_bsr": (omega_t, BSR)}  # fmt: skip
    factors = {name: _at(own[name], at) / _at(plain[name], at) for name, at in points.items()}
    of_turbine = factors["eta_tm_learned"] + factors["eta_tm_learned_bsr"] - 1.0
    shares = {
        "eta_vol": (rows["eta_vol"] / model.eta_vol(rows["p_im_pa"], rows["n_e_rpm"], c), factors["eta_vol"]),
        "eta_tm": (rows["eta_tm"] / model.eta_tm(omega_t, rows["t_em_k"], Pi_t, c), of_turbine),
    }
    for share, got in shares.values():
        assert np.ptp(share) > 3e-3 and np.abs(got - share).max() < 1e-3


def test_the_command_writes_tables(tmp_path: Path):
    assert main(["export", "--table", str(tmp_path / "maps")]) == 0
    assert {path.name for path in (tmp_path / "maps").iterdir()} == {*(f"{name}.csv" for name in MAPS), "maps.c"}


def test_a_disk_that_fills_up_leaves_no_part_of_what_was_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    with full_beyond(70_000):  # room for the simulator, none for the look-ups
        assert main(["export", "--c", str(tmp_path / "mine.c"), "--table", str(tmp_path / "maps")]) == 2
    assert "nothing was written" in capsys.readouterr().err and not list(tmp_path.iterdir())
