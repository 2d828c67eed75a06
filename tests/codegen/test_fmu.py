"""FMUs: valid by the standard, run in FMPy and compared with `simulate`."""

from __future__ import annotations

import ctypes
import subprocess
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dieseltwin.cli.app import main
from dieseltwin.codegen.fmu import Version, write_fmu
from dieseltwin.engine import Inputs, simulate, we2011
from dieseltwin.engine.inputs import INPUT_COLUMNS
from dieseltwin.engine.terms import Term

fmpy = pytest.importorskip("fmpy", reason="the extra `export` brings FMPy")
validation = pytest.importorskip("fmpy.validation")

OUTPUTS = ["p_im_pa", "p_em_pa", "omega_t_rad_s", "w_egr_kg_s", "t_em_k", "w_c_kg_s", "torque_nm", "lambda", "x_oem"]
ALLOWED = 1e-3  # of a column's mean
ENGINE = we2011.PARAMETERS.replace(
    terms=[Term(effect="boost_leak", magnitude=3e-5), Term(effect="egr_heating", magnitude=0.3)]
)


@pytest.fixture(scope="module", params=[2, 3])
def unit(request: pytest.FixtureRequest, compiler: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A unit of each version of the standard."""
    version: Version = request.param
    out = tmp_path_factory.mktemp("fmu") / f"fmi{version}.fmu"
    write_fmu(ENGINE, "two effects", out, version)
    return out


@pytest.fixture(scope="module")
def steps(drive: Inputs) -> Inputs:
    """The drive's inputs held from sample to sample."""
    time = np.sort(np.concatenate([drive.time_s, drive.time_s[1:] - 1e-7]))
    rows = np.searchsorted(drive.time_s, time + 1e-9, side="right") - 1
    return Inputs(time, *(drive.columns[name][rows] for name in INPUT_COLUMNS))


def _off(expected: pd.DataFrame, got: pd.DataFrame) -> float:
    return float(((got[OUTPUTS] - expected[OUTPUTS]).abs().max() / expected[OUTPUTS].abs().mean()).max())


def test_valid_and_with_sources(unit: Path):
    assert validation.validate_fmu(str(unit)) == []
    names = zipfile.ZipFile(unit).namelist()
    assert "sources/two_effects.c" in names and any(name.startswith("binaries/") for name in names)


def test_inputs_held_by_the_master(unit: Path, drive: Inputs, steps: Inputs):
    """`simulate_fmu` holds the inputs over a communication step; `simulate` is given the same steps."""
    signals = np.rec.fromarrays([drive.time_s, *(drive.columns[n] for n in INPUT_COLUMNS)],
                                names=["time", *INPUT_COLUMNS])  # fmt: skip
    found = fmpy.simulate_fmu(
        str(unit), start_time=drive.time_s[0], stop_time=drive.time_s[-1], output_interval=0.2, input=signals,
        output=OUTPUTS,
    )  # fmt: skip
    expected = simulate(steps, ENGINE)
    before = np.searchsorted(steps.time_s, drive.time_s[1:] - 2e-7)  # a step's end, before the inputs jump
    got = pd.DataFrame({name: found[name][1:] for name in OUTPUTS})
    assert _off(expected.iloc[before].reset_index(drop=True), got) < ALLOWED


@contextmanager
def _slave(unit: Path, **start: float) -> Iterator[tuple[Any, dict[str, int]]]:
    """An instance of an FMI 2 unit after its initialization, and the variables' numbers."""
    about = fmpy.read_model_description(str(unit))
    numbers = {variable.name: variable.valueReference for variable in about.modelVariables}
    slave = fmpy.fmi2.FMU2Slave(guid=about.guid, unzipDirectory=fmpy.extract(str(unit)), instanceName="one",
                                modelIdentifier=about.coSimulation.modelIdentifier)  # fmt: skip
    slave.instantiate()
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.setReal([numbers[name] for name in start], list(start.values()))
    slave.exitInitializationMode()
    try:
        yield slave, numbers
    finally:
        slave.terminate()
        slave.freeInstance()


@pytest.fixture(scope="module")
def second(compiler: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("fmu") / "second.fmu"
    write_fmu(ENGINE, "2nd", out)
    return out


def test_inputs_that_run_between_steps(second: Path, drive: Inputs):
    """With the inputs' slopes (FMI 2) the unit follows inputs that are linear between samples, as `simulate` does."""
    values = np.stack([drive.columns[name] for name in INPUT_COLUMNS], axis=1)
    with _slave(second, **dict(zip(INPUT_COLUMNS, values[0], strict=True))) as (slave, numbers):
        given, asked = [numbers[name] for name in INPUT_COLUMNS], [numbers[name] for name in OUTPUTS]
        rows = [slave.getReal(asked)]
        for k, width in enumerate(np.diff(drive.time_s)):
            slave.setReal(given, list(values[k]))
            slopes = (ctypes.c_double * 4)(*((values[k + 1] - values[k]) / width))
            # not by FMPy's helper: its room for the slopes is that of nine inputs
            slave.fmi2SetRealInputDerivatives(slave.component, (ctypes.c_uint32 * 4)(*given), 4,
                                              (ctypes.c_int * 4)(1, 1, 1, 1), slopes)  # fmt: skip
            slave.doStep(drive.time_s[k], width)
            rows.append(slave.getReal(asked))
    assert _off(simulate(drive, ENGINE), pd.DataFrame(rows, columns=OUTPUTS)) < 1e-4


def test_parameters_states_and_refusals(second: Path):
    start = {"n_e_rpm": 1300.0, "u_delta_mg": 120.0, "u_egr_pct": 30.0, "u_vgt_pct": 50.0}
    time = np.array([0.0, 2.0])
    held = Inputs(time, *(np.full(2, value) for value in start.values()))
    with _slave(second, **start, A_vgtmax=7e-4, p_im_start=1.5e5, p_em_start=1.7e5, omega_t_start=6e3) as (slave, of):
        expected = simulate(held, ENGINE.replace(A_vgtmax=7e-4), initial=np.array([1.5e5, 1.7e5, 6e3]))
        state = slave.getFMUState()
        for _ in range(2):  # back to the kept state, and forth again
            slave.doStep(0.0, 2.0)
            got = slave.getReal([of["p_im_pa"], of["omega_t_rad_s"]])
            assert got == pytest.approx(expected[["p_im_pa", "omega_t_rad_s"]].iloc[-1].tolist(), rel=1e-6)
            slave.setFMUState(state)
        slave.freeFMUState(state)
        for numbers, values in (([of["V_d"]], [0.01]), ([9999], [1.0]), ([of["n_e_rpm"]], [np.nan])):
            with pytest.raises(Exception, match="fmi2SetReal"):
                slave.setReal(numbers, values)
        slave.setReal([of["u_vgt_pct"], of["n_e_rpm"]], [40.0, 1500.0])  # read before a step: what jumps, jumps
        assert slave.getReal([of["w_ei_kg_s"]])[0] > 1.1 * expected["w_ei_kg_s"].iloc[0]


def test_the_same_engine_gives_the_same_bytes(tmp_path: Path):
    for name in ("a.fmu", "b.fmu"):
        write_fmu(ENGINE, "same", tmp_path / name, 3, binary=False)
    assert (tmp_path / "a.fmu").read_bytes() == (tmp_path / "b.fmu").read_bytes()
    assert not any(name.startswith("binaries") for name in zipfile.ZipFile(tmp_path / "a.fmu").namelist())


def test_sources_compile_where_they_run(tmp_path: Path, compiler: str):
    write_fmu(ENGINE, "same", tmp_path / "a.fmu", 3, binary=False)
    zipfile.ZipFile(tmp_path / "a.fmu").extractall(tmp_path)
    command = [compiler, "-std=c99", "-Wall", "-Werror", "-Wno-unused-function", "-c", "-o", tmp_path / "a.o"]
    subprocess.run([*command, tmp_path / "sources" / "same.c"], check=True)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["we2011"], "nothing to write"), (["we2012", "--c", "a.c"], "unknown name"),
        (["none.yaml", "--c", "a.c"], "no such file"), (["we2011", "--c", "a.txt"], "ending .txt"),
        (["we2011", "--fmu", "a.fmu", "--fmi", "1"], "2 or 3"), (["liu_petrol", "--c", "a.c"], "petrol"),
        (["we2011", "--c", "there.c"], "--overwrite"), (["we2011", "--fmu", "a.fmu"], "no C compiler"),
        (["bad.yaml", "--c", "a.c"], "V_dd"), (["--table", "full"], "a folder with files"),
        (["--onnx", "a", "--models", "none"], "no such folder"), (["--onnx", "a", "--models", "full"], "no networks"),
        (["we2011", "--c", "nowhere/a.c"], "no such file or directory"),
    ],
)  # fmt: skip
def test_bad_input(
    arguments: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CC", "no-such-compiler")
    Path("there.c").touch()
    Path("bad.yaml").write_text("V_dd: 1\n")
    Path("full").mkdir()
    Path("full", "something").touch()
    assert main(["export", *arguments]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.yaml", "full", "there.c"]


def test_the_command_writes_both(tmp_path: Path, compiler: str):
    out = tmp_path / "mine.c"
    (tmp_path / "mine.yaml").write_text("V_d: 0.0128\nterms:\n- {effect: boost_leak, magnitude: 2.0e-5}\n")
    assert main(["export", str(tmp_path / "mine.yaml"), "--c", str(out), "--fmu", str(tmp_path / "mine.fmu")]) == 0
    assert ".V_d = 0.0128" in out.read_text() and "boost_leak" in out.read_text()
    assert main(["export", "we2011", "--c", str(out), "--overwrite"]) == 0
    assert ".V_d = 0.01274" in out.read_text()
