"""The simulator in C: compiled, run on a drive and compared with `simulate`, column by column."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dieseltwin.codegen.c_engine import c_source, input_columns
from dieseltwin.engine import EngineParameters, Inputs, simulate, we2011
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.engine.map_corrections import basis
from dieseltwin.engine.terms import (
    ActuatorTerm,
    CorrectionTerm,
    LawGroup,
    LawTerm,
    OneTerm,
    SensorTerm,
    Term,
)
from tests.engine.test_simulate import FLAT

LEARNED = CorrectionTerm(coefficients=tuple(0.02 * np.random.default_rng(1).standard_normal(len(basis().names))))
LAWS = (
    LawTerm(point="eta_c", coefficient=-0.1, unit="-", factors=(("W_c", 0.2, 1.5), ("Pi_c", 1.5, -0.5)),
            groups=(LawGroup(kind="bump", variables=("n_e",), centre=1300.0, reference=200.0),)),
    LawTerm(point="intake_balance", coefficient=-0.004, unit="kg/s",
            groups=(LawGroup(kind="orifice", variables=("p_im", "p_amb")),)),
    LawTerm(point="intake_balance", coefficient=-2e-5, unit="kg/s", factors=(("t", 1.0, 1.0),)),
)  # fmt: skip
IN_REGION = {"n_e_rpm": (1000.0, 1500.0)}


def _engine(*terms: OneTerm) -> EngineParameters:
    return we2011.PARAMETERS.replace(terms=list(terms))


def _everything() -> EngineParameters:
    """Every effect of the catalogue at its tolerance; a valve that stands still would hide its play and dead time."""
    return _engine(*(Term(effect=name, magnitude=effect.tolerance) for name, effect in EFFECTS.items()
                     if effect.enters.operator != "stuck"))  # fmt: skip


def build(engine: EngineParameters, compiler: str, folder: Path) -> Path:
    """The program of an engine; every warning of the compiler but those of unused names is an error."""
    source, program = folder / "engine.c", folder / "engine"
    source.write_text(c_source(engine, "tested"))
    flags = ["-O1", "-std=c99", "-Wall", "-Wextra", "-Werror", "-Wno-unused-function", "-Wno-unused-parameter"]
    subprocess.run([compiler, *flags, "-o", str(program), str(source), "-lm"], check=True)
    return program


def run(program: Path, inputs: Inputs, *arguments: str) -> pd.DataFrame:
    """What the program makes of the inputs."""
    given, out = program.with_name("inputs.csv"), program.with_name("out.csv")
    pd.DataFrame({"other": "text", "time_s": inputs.time_s, **inputs.columns}).to_csv(given, index=False)
    subprocess.run([program, given, out, *arguments], check=True)
    return pd.read_csv(out)


def differences(expected: pd.DataFrame, got: pd.DataFrame) -> pd.Series:
    """Largest difference of each column over its mean size."""
    assert list(got) == list(expected)
    return (got - expected).abs().max() / expected.abs().mean().clip(lower=1e-12)


@pytest.mark.parametrize(
    ("engine", "allowed"),
    [
        pytest.param(_engine(), 1e-6, id="published"),
        # oxygen is followed at finer steps in the library, with drifts and the flap as they are there
        pytest.param(_everything(), 1e-6, id="every effect"),
        pytest.param(_engine(LEARNED, Term(effect="boost_leak", magnitude=3e-5, onset_s=20.0),
                             Term(effect="egr_clogging", magnitude=1e-3),
                             SensorTerm(sensor="w_c_kg_s", fault="offset", magnitude=0.01)), 1e-6, id="learned"),
        pytest.param(_engine(Term(effect="thermocouple_lag", magnitude=0.8, onset_s=6.03, until_s=24.1)), 1e-6,
                     id="a lag that comes and goes"),
        pytest.param(_engine(Term(effect="thermocouple_lag", magnitude=0.8, region=IN_REGION),
                             Term(effect="egr_dead_time", magnitude=0.1, until_s=30.0),
                             Term(effect="egr_dead_time", magnitude=0.2, onset_s=15.0),
                             Term(effect="vgt_dead_time", magnitude=0.3, grown_s=120.0),
                             Term(effect="egr_backlash", magnitude=8.0, until_s=30.1),
                             Term(effect="vgt_backlash", magnitude=8.0, region=IN_REGION),
                             Term(effect="boost_leak", magnitude=1e-4, onset_s=20.0,
                                  region={"n_e_rpm": (500.0, 2000.0)})), 5e-6, id="in regions and for a time"),
        pytest.param(_engine(LEARNED, Term(effect="back_pressure", magnitude=1.6e5),
                             Term(effect="air_filter_restriction", magnitude=5e4)), 1e-6, id="learned, restricted"),
        pytest.param(_engine(LEARNED).replace(p_amb=85e3, T_amb=275.0, k_cflow=1.0, k_cspeed=0.7), 1e-6,
                     id="learned, in other weather"),
    ],
)  # fmt: skip
def test_c_is_what_simulate_is(engine: EngineParameters, allowed: float, drive: Inputs, compiler: str, tmp_path: Path):
    got = run(build(engine, compiler, tmp_path), drive)
    off = differences(simulate(drive, engine), got)
    assert off.drop(["x_oim", "x_oem"]).max() < allowed
    assert off[["x_oim", "x_oem"]].max() < 1e-3


def test_of_two_rests_it_begins_at_that_of_simulate(compiler: str, tmp_path: Path):
    """An engine with flat speed lines has another without boost."""
    one = np.ones(11)
    inputs = Inputs(np.linspace(0.0, 2.0, 11), 1400.0 * one, 130.0 * one, 30.0 * one, 45.0 * one)
    expected, got = simulate(inputs, FLAT), run(build(FLAT, compiler, tmp_path), inputs)
    assert expected["p_im_pa"].min() > 2.3e5
    assert differences(expected, got).drop(["x_oim", "x_oem"]).max() < 1e-6


def test_no_table_over_the_speed_ratio_leaves_no_ends_of_one(compiler: str, tmp_path: Path):
    """Most learned engines have none; more values than an array has places are an error to some compilers."""
    usual = CorrectionTerm(coefficients=tuple(np.where(basis().of_ratio, 0.0, LEARNED.coefficients)))
    build(_engine(usual), compiler, tmp_path)


def test_laws_onsets_and_regions_are_what_simulate_makes_of_them(drive: Inputs, compiler: str, tmp_path: Path):
    """On the rows as they are, 0.2 s apart; edges of regions and onsets lie at rows in both."""
    engine = _engine(*LAWS, Term(effect="blow_by", magnitude=EFFECTS["blow_by"].limits[1] / 4, region=IN_REGION),
                     Term(effect="boost_leak", magnitude=3e-5, onset_s=5.07, until_s=31.0, gone_s=((9.0, 12.33),)),
                     Term(effect="back_pressure", magnitude=8e4, onset_s=10.0, grown_s=30.0),
                     ActuatorTerm(actuator="egr", fault="backlash", magnitude=6.0),
                     Term(effect="egr_stuck", magnitude=40.0, onset_s=12.0, until_s=22.07),
                     Term(effect="vgt_stuck", magnitude=55.0, until_s=8.0))  # fmt: skip
    off = differences(simulate(drive, engine), run(build(engine, compiler, tmp_path), drive))
    assert off.max() < 2e-4


def test_parameters_and_the_start_can_be_given(drive: Inputs, compiler: str, tmp_path: Path):
    program = build(_engine(), compiler, tmp_path)
    short = replace(drive, **{name: values[:20] for name, values in {"time_s": drive.time_s, **drive.columns}.items()})
    worn = we2011.PARAMETERS.replace(A_vgtmax=7e-4, V_d=0.0128)
    got = run(program, short, "A_vgtmax=7e-4", "V_d=0.0128")
    assert differences(simulate(short, worn), got).max() < 1e-6
    table = pd.DataFrame({"time_s": short.time_s, **short.columns, "p_im_pa": 2e5, "p_em_pa": 2.2e5,
                          "omega_t_rad_s": 8000.0})  # fmt: skip
    table.to_csv(tmp_path / "started.csv", index=False)
    subprocess.run([program, tmp_path / "started.csv", tmp_path / "out.csv"], check=True)
    expected = simulate(short, we2011.PARAMETERS, initial=np.array([2e5, 2.2e5, 8000.0]))
    assert differences(expected, pd.read_csv(tmp_path / "out.csv")).drop(["x_oim", "x_oem"]).max() < 1e-6


def test_a_dead_time_that_is_given_is_remembered_for_as_long(compiler: str, tmp_path: Path):
    time = np.arange(6000) * 1e-3
    wave = 30.0 + 20.0 * np.sin(3.0 * time)
    one = np.ones(time.size)
    inputs = Inputs(time, 1200.0 * one, 100.0 * one, wave, 50.0 * one)
    got = run(build(_engine(), compiler, tmp_path), inputs, "tau_degr=2.5")
    expected = simulate(inputs, we2011.PARAMETERS.replace(tau_degr=2.5), oxygen=False)
    assert differences(expected, got[list(expected)]).max() < 1e-6


def test_what_the_program_can_not_use_is_refused(compiler: str, tmp_path: Path):
    program = build(_engine(), compiler, tmp_path)
    good = "time_s,n_e_rpm,u_delta_mg,u_egr_pct,u_vgt_pct\n0,1200,100,0,50\n0.2,1200,100,0,50\n"
    cases = {
        "no_column": (good.replace("u_vgt_pct", "vgt"), "u_vgt_pct"),
        "no_number": (good + "0.4,,1,1,1\n", "data row 3"),
        "time": (good + "0.1,1200,100,0,50\n", "increase"), "empty": ("", "empty"),
        "no_rows": (good.partition("\n")[0], "two rows"),
    }  # fmt: skip
    for name, (text, said) in cases.items():
        (tmp_path / name).write_text(text)
        command = [program, tmp_path / name, tmp_path / "o.csv"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 2 and said in done.stderr and done.stderr.count("\n") == 1
        assert not (tmp_path / "o.csv").exists()
    (tmp_path / "good").write_text(good)
    for arguments in (["A=1"], ["V_d=x"], ["V_d"]):
        command = [program, tmp_path / "good", tmp_path / "o.csv", *arguments]
        assert subprocess.run(command, capture_output=True, check=False).returncode == 2


def test_earlier_results_stay_until_new_ones_are_whole(compiler: str, tmp_path: Path):
    program = build(_engine(), compiler, tmp_path)
    good = "time_s,n_e_rpm,u_delta_mg,u_egr_pct,u_vgt_pct\n0,1200,100,0,50\n0.2,1200,100,0,50\n"
    given, out = tmp_path / "i.csv", tmp_path / "o.csv"
    given.write_text(good)
    for same in (given, f"{tmp_path}/./i.csv"):
        done = subprocess.run([program, given, same], capture_output=True, text=True, check=False, timeout=20)
        assert done.returncode == 2 and "another file" in done.stderr and given.read_text() == good
    subprocess.run([program, given, out], check=True)
    earlier = out.read_text()
    piped = subprocess.run([program, given, "/dev/stdout"], check=True, capture_output=True, text=True).stdout
    assert piped == earlier and earlier.count("\n") == 3
    given.write_text(good + "0.4,1200,,0,50\n")
    assert subprocess.run([program, given, out], capture_output=True, check=False).returncode == 2
    assert out.read_text() == earlier
    assert {path.name for path in tmp_path.iterdir()} == {"engine", "engine.c", "i.csv", "o.csv"}


def test_inputs_follow_the_effects():
    assert input_columns(_engine()) == ("n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct")
    assert "u_flap_pct" in input_columns(_engine(Term(effect="exhaust_flap", magnitude=1e5)))
