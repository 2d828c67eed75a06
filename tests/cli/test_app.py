"""The command line does what it says: simulate, identify, engine show, params show."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

import dieseltwin
from dieseltwin.cli import app as cli
from dieseltwin.cli.app import main
from dieseltwin.engine import load_engine, we2011
from dieseltwin.notes import STRICT_CODE
from dieseltwin.symbols import BY_COLUMN

Run = Callable[..., list[str]]
INPUTS = ["time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct"]
SENSORS = ["p_im_pa", "p_em_pa", "omega_t_rad_s", "w_egr_kg_s", "t_em_k"]
BEYOND_THE_TRACES = {"x_oim", "x_oem", "lambda", "egr_fraction", "torque_nm"}
HEALTH = ("A_egrmax", "A_vgtmax", "eta_sc", "h_tot")


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str]) -> Run:
    """Run a command that must succeed and be silent on stderr; returns its lines."""

    def runner(*arguments: str | Path) -> list[str]:
        capfd.readouterr()
        code = main([str(a) for a in arguments])
        said = capfd.readouterr()
        assert code == 0, said.err
        assert said.err == ""
        return said.out.splitlines()

    return runner


@pytest.fixture(scope="module")
def field_engine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The engine that the trace was made with."""
    path = tmp_path_factory.mktemp("engine") / "field.yaml"
    lab = we2011.PARAMETERS
    changed = {"A_egrmax": lab.A_egrmax / 1.333, "A_vgtmax": lab.A_vgtmax / 1.1663, "eta_sc": lab.eta_sc / 0.9179}
    path.write_text(yaml.safe_dump(changed))
    return path


def test_commands_are_made_once_a_process(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    first = run("effects")
    monkeypatch.setattr("typer.main.get_params_from_function", None)
    assert run("effects") == first


def test_version_and_help(run: Run) -> None:
    assert run("--version") == [f"dieseltwin {dieseltwin.__version__}"]
    commands = "\n".join(run())
    assert all(name in commands for name in ("simulate", "identify", "engine", "params"))
    assert any("--runs" in line for line in run("identify", "--help"))
    assert any("show" in line for line in run("engine"))


def test_module_and_console_script_are_the_same_program() -> None:
    for command in ([sys.executable, "-m", "dieseltwin"], [str(Path(sys.executable).with_name("dieseltwin"))]):
        done = subprocess.run([*command, "--version"], capture_output=True, text=True, check=True)
        assert done.stdout == f"dieseltwin {dieseltwin.__version__}\n"


def test_help_does_not_load_the_heavy_libraries() -> None:
    heavy = {"torch", "numba", "pandas", "matplotlib", "pydantic"}  # the models of the settings are half of a start
    code = f"import sys; from dieseltwin.cli.app import main; main(['--version']); print({heavy} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "set()"


def test_unexpected_errors_keep_their_traceback(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def defect(*_: object, **__: object) -> None:
        raise ZeroDivisionError("a defect")

    monkeypatch.setattr("dieseltwin.settings.params.load_params", defect)
    with pytest.raises(ZeroDivisionError):
        main(["params", "show"])


@pytest.mark.parametrize("engine", ["liu_petrol", "positioning_axis.yaml"])
def test_engine_show_of_other_machines_is_what_engine_takes(
    run: Run, project_root: Path, tmp_path: Path, engine: str
) -> None:
    file, example = tmp_path / "shown.yaml", project_root / "examples" / "rigs" / engine
    shown = run("engine", "show", "--engine", str(example) if example.exists() else engine)
    file.write_text("\n".join(shown))
    assert run("engine", "show", "--engine", str(file)) == shown and "name" in yaml.safe_load(file.read_text())


@pytest.mark.parametrize("command", [["identify", "drive.csv", "--out", "x"], ["calibrate", "p.csv", "--out", "e.yml"]])
def test_a_negative_seed_is_refused(command: list[str], capfd: pytest.CaptureFixture[str]) -> None:
    assert main([*command, "--seed", "-1"]) == 2
    error = capfd.readouterr().err
    assert "--seed" in error and "0" in error and error.count("\n") == 1


@pytest.mark.parametrize("where", ["the command", "around it"])
def test_interrupt_is_one_line(
    where: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    if where == "around it":
        monkeypatch.setattr(cli, "_commands", lambda: interrupted)
    else:
        monkeypatch.setattr("dieseltwin.cli.show.params_lines", interrupted)
    assert main(["params", "show"]) == 130
    said = "dieseltwin: interrupted; no file is half-written, and what was finished before is kept\n"
    assert capfd.readouterr().err == said


# --- show


def test_engine_show_can_be_read_back(run: Run, tmp_path: Path, field_engine: Path) -> None:
    path = tmp_path / "engine.yaml"
    path.write_text("\n".join(run("engine", "show")) + "\n")
    assert load_engine(path) == we2011.PARAMETERS
    path.write_text("\n".join(run("engine", "show", "--engine", field_engine)) + "\n")
    assert load_engine(path) == load_engine(field_engine) != we2011.PARAMETERS


def test_params_show_is_yaml_of_the_profile(run: Run) -> None:
    lines = run("params", "show", "--profile", "paper")
    shown = yaml.safe_load("\n".join(lines))
    assert shown["profile"] == "paper" and shown["identify"]["methods"]["few-shot-adam"]["epochs"] == 30_000
    assert lines[0].startswith("# sha256 ") and len(lines[0].split()[-1]) == 64
    assert lines != run("params", "show", "--profile", "quick")


# --- simulate


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory, trace: pd.DataFrame, field_engine: Path) -> pd.DataFrame:
    folder = tmp_path_factory.mktemp("simulated")
    trace[[*INPUTS, "p_im_pa", "p_em_pa", "omega_t_rad_s"]].to_csv(folder / "inputs.csv", index=False)
    out = folder / "out.parquet"
    assert main(["simulate", str(folder / "inputs.csv"), "--engine", str(field_engine), "--out", str(out)]) == 0
    return pd.read_parquet(out)


def test_simulate_gives_every_column_at_the_inputs_times(simulated: pd.DataFrame, trace: pd.DataFrame) -> None:
    assert set(trace.columns) | BEYOND_THE_TRACES <= set(simulated.columns)
    assert set(simulated.columns) <= set(BY_COLUMN)
    assert np.array_equal(simulated["time_s"], trace["time_s"])
    assert np.isfinite(simulated.to_numpy()).all()


def test_simulate_starts_at_the_first_row_and_meets_the_trace(simulated: pd.DataFrame, trace: pd.DataFrame) -> None:
    for column in ("p_im_pa", "p_em_pa", "omega_t_rad_s"):
        assert simulated[column].iloc[0] == trace[column].iloc[0]
    after = trace["time_s"] > 1.0
    for column in trace.columns.drop("time_s"):
        error = (simulated[column] - trace[column])[after].abs().max()
        assert error <= 1e-3 * trace[column].abs().mean(), column


def test_simulate_without_states_starts_at_rest(run: Run, trace: pd.DataFrame, tmp_path: Path) -> None:
    """A minute of constant inputs from the rest state stays where it began."""
    steady = trace.loc[:0, INPUTS].loc[[0] * 61].assign(time_s=np.arange(61.0), u_delta_mg=100.0, n_e_rpm=1300.0)
    steady.to_csv(tmp_path / "steady.csv", index=False)
    run("simulate", tmp_path / "steady.csv", "--out", tmp_path / "out.csv")
    out = pd.read_csv(tmp_path / "out.csv")
    for column in ("p_im_pa", "p_em_pa", "omega_t_rad_s"):
        assert np.ptp(out[column]) < 1e-4 * out[column].mean(), column


def test_simulate_uses_ambient_columns_and_the_engine_file(run: Run, trace: pd.DataFrame, tmp_path: Path) -> None:
    inputs = trace.loc[trace["time_s"] <= 10.0, INPUTS]
    inputs.to_csv(tmp_path / "a.csv", index=False)
    inputs.assign(p_amb_pa=9.0e4).to_csv(tmp_path / "b.csv", index=False)
    (tmp_path / "engine.yaml").write_text("p_amb: 9.0e+4\n")
    run("simulate", tmp_path / "a.csv", "--out", tmp_path / "a.parquet")
    run("simulate", tmp_path / "b.csv", "--out", tmp_path / "b.parquet")
    run("simulate", tmp_path / "a.csv", "--out", tmp_path / "c.parquet", "--engine", tmp_path / "engine.yaml")
    sea, high, engine = (pd.read_parquet(tmp_path / f"{name}.parquet") for name in "abc")
    assert (high["p_im_pa"] < sea["p_im_pa"]).all()
    pd.testing.assert_frame_equal(high, engine)


def test_simulate_reads_foreign_names_and_units(run: Run, trace: pd.DataFrame, tmp_path: Path) -> None:
    inputs = trace.loc[trace["time_s"] <= 10.0, INPUTS]
    inputs.to_csv(tmp_path / "ours.csv", index=False)
    theirs = pd.DataFrame({"t [ms]": inputs["time_s"] * 1e3, "EGR": inputs["u_egr_pct"] / 100})
    theirs = pd.concat([theirs, inputs[["n_e_rpm", "u_delta_mg", "u_vgt_pct"]]], axis=1)
    theirs.to_csv(tmp_path / "theirs.csv", index=False)
    (tmp_path / "map.yaml").write_text(
        "t [ms]: {column: time_s, unit: ms}\nEGR: {column: u_egr_pct, unit: fraction}\n"
    )
    run("simulate", tmp_path / "ours.csv", "--out", tmp_path / "a.parquet")
    run("simulate", tmp_path / "theirs.csv", "--channels", tmp_path / "map.yaml", "--out", tmp_path / "b.parquet")
    a, b = pd.read_parquet(tmp_path / "a.parquet"), pd.read_parquet(tmp_path / "b.parquet")
    np.testing.assert_allclose(b, a, rtol=1e-6, atol=1e-9)


# --- identify

OPTIONS = ("--method", "classical", "--runs", "2", "--seed", "3")


@pytest.fixture(scope="module")
def noisy(tmp_path_factory: pytest.TempPathFactory, trace: pd.DataFrame) -> Path:
    """Two minutes of the trace with the paper's noise, and a gap of half a second in one sensor."""
    rng = np.random.default_rng(7)
    recording = trace.loc[trace["time_s"] <= 120.0, [*INPUTS, *SENSORS]].reset_index(drop=True)
    for column, share in zip(SENSORS, (0.03, 0.03, 0.01, 0.05, 0.03), strict=True):
        recording[column] += share * recording[column].mean() * rng.standard_normal(len(recording))
    recording.loc[100:102, "t_em_k"] = np.nan
    path = tmp_path_factory.mktemp("recording") / "drive.parquet"
    recording.to_parquet(path, index=False)
    return path


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures take most of a small identification's time; one test draws them."""
    monkeypatch.setattr("dieseltwin.report.html.identification_sections", lambda *_: [])


@pytest.fixture(scope="module")
def identified(tmp_path_factory: pytest.TempPathFactory, noisy: Path) -> Path:
    out = tmp_path_factory.mktemp("identified") / "new" / "out"
    assert main(["identify", str(noisy), *OPTIONS, "--out", str(out)]) == 0
    return out


def test_identify_writes_its_files_and_nothing_else(identified: Path) -> None:
    written = {p.name for p in identified.iterdir()}
    assert written == {"identification.json", "runtime.json", "states.parquet", "report.html", "figures"}
    figures = list((identified / "figures").iterdir())
    assert len(figures) >= 4 and {p.suffix for p in figures} <= {".svg", ".png"}
    assert all(p.stat().st_size > 1000 for p in figures)


def test_identification_follows_the_schema(identified: Path) -> None:
    text = (identified / "identification.json").read_text()
    document = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not strict JSON"))
    assert document["schema"] == 1 and document["method"] == "classical"
    assert [(s["t0_s"], s["t1_s"]) for s in document["segments"]] == [(0.0, 60.0), (60.0, 120.0)]
    assert len(document["runs"]) == 2
    for parameters in (document["parameters"], *(s["parameters"] for s in document["segments"])):
        assert tuple(parameters) == HEALTH
        for entry in parameters.values():
            assert {"mean", "std", "interval_90", "unit", "bound", "identifiable"} <= set(entry)
            assert entry["interval_90"][0] < entry["mean"] < entry["interval_90"][1]


def test_identify_finds_the_planted_values(identified: Path, field_engine: Path) -> None:
    """Within four standard deviations, and the two areas (10-30 % off at the start) within 3 %."""
    found = json.loads((identified / "identification.json").read_text())["parameters"]
    truth = load_engine(field_engine)
    for name in HEALTH:
        assert abs(found[name]["mean"] - getattr(truth, name)) < 4 * found[name]["std"], name
    for name in ("A_egrmax", "A_vgtmax"):
        assert found[name]["mean"] == pytest.approx(getattr(truth, name), rel=0.03)


def test_states_are_a_table_over_all_samples(identified: Path, trace: pd.DataFrame) -> None:
    states = pd.read_parquet(identified / "states.parquet")
    assert {"time_s", "p_im_pa", "p_em_pa", "omega_t_rad_s", "x_r", "t_1_k"} <= set(states.columns)
    assert len(states) == 2 * 301
    truth = np.interp(states["time_s"], trace["time_s"], trace["p_im_pa"])
    assert np.abs(states["p_im_pa"] - truth).mean() < 0.01 * truth.mean()


def test_runtime_holds_what_may_differ(identified: Path) -> None:
    runtime = json.loads((identified / "runtime.json").read_text())
    assert {"seconds_per_run", "versions", "params_sha256", "recording_sha256"} <= set(runtime)
    assert runtime["seed"] == 3


@pytest.mark.usefixtures("no_figures")
def test_same_command_same_bytes(run: Run, identified: Path, noisy: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("kept")
    lines = run("identify", noisy, *OPTIONS, "--out", tmp_path)
    for name in ("identification.json", "states.parquet"):
        assert (tmp_path / name).read_bytes() == (identified / name).read_bytes(), name
    assert (tmp_path / "mine.txt").read_text() == "kept"
    assert not list(tmp_path.glob(".partial-*"))
    assert all(any(line.startswith(name) for line in lines) for name in HEALTH)
    assert lines[-1] == f"results: {tmp_path}"


@pytest.mark.usefixtures("no_figures")
def test_rows_outside_the_engines_range_are_reported(
    noisy: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """As a line, in the document, and in the exit code when asked."""
    recording = pd.read_parquet(noisy)
    recording = recording[recording["time_s"] <= 60.0].copy()
    recording.loc[:9, "u_vgt_pct"] = 15.0
    recording.to_parquet(tmp_path / "drive.parquet", index=False)
    command = ["identify", str(tmp_path / "drive.parquet"), "--runs", "1", "--out", str(tmp_path / "out"), "--strict"]
    assert main(command) == STRICT_CODE
    expected = "10 of 301 rows of u_vgt_pct are outside the engine's range 20 to 100"
    assert f"note: {expected}" in capfd.readouterr().out.splitlines()
    warnings = json.loads((tmp_path / "out" / "identification.json").read_text())["warnings"]
    found = {warning["code"]: warning for warning in warnings}
    assert found["out_of_range"]["affects"] == ["u_vgt_pct"] and expected in found["out_of_range"]["text"]


@pytest.mark.usefixtures("no_figures")
def test_a_segment_without_a_sensor_is_left_out(run: Run, noisy: Path, tmp_path: Path) -> None:
    recording = pd.read_parquet(noisy)
    recording.loc[recording["time_s"] >= 60.0, "p_im_pa"] = np.nan
    recording.to_parquet(tmp_path / "drive.parquet", index=False)
    lines = run("identify", tmp_path / "drive.parquet", "--runs", "1", "--out", tmp_path / "out")
    assert "note: segment 60-120 s left out: no reading of p_im_pa" in lines
    document = json.loads((tmp_path / "out" / "identification.json").read_text())
    assert [s["t0_s"] for s in document["segments"]] == [0.0]


@pytest.mark.usefixtures("no_figures")
def test_identify_with_the_sensors_that_are_named(
    run: Run, noisy: Path, field_engine: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Without exhaust temperature the estimates stay right, and the lines say what it costs."""
    without = tmp_path / "without.csv"
    pd.read_parquet(noisy).drop(columns="t_em_k").to_csv(without, index=False)
    assert main(["identify", str(without), "--out", str(tmp_path / "refused")]) == 2
    assert "--sensors p_im_pa,p_em_pa,omega_t_rad_s,w_egr_kg_s" in capfd.readouterr().err
    assert main(["identify", str(without), "--out", str(tmp_path / "refused"), "--method", "few-shot-adam"]) == 2
    assert "--sensors" not in capfd.readouterr().err
    lines = run("identify", without, "--out", tmp_path / "out", "--runs", "1", "--sensors",
                "p_im_pa,p_em_pa,omega_t_rad_s,w_egr_kg_s")  # fmt: skip
    assert any(line.startswith("note: without t_em_k: injector drift") for line in lines)
    found = json.loads((tmp_path / "out" / "identification.json").read_text())["parameters"]
    truth = load_engine(field_engine)
    for name in HEALTH:
        assert abs(found[name]["mean"] - getattr(truth, name)) < 5.0 * found[name]["std"], name


@pytest.mark.parametrize(
    ("sensors", "method", "word"),
    [("p_im_pa,p_em_pa", "classical", "omega_t_rad_s"), ("p_im_pa,p_em", "classical", "did you mean p_em_pa"),
     ("p_im_pa,p_em_pa,omega_t_rad_s", "few-shot-adam", "w_egr_kg_s")],
)  # fmt: skip
def test_identify_refuses_too_few_sensors(
    noisy: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], sensors: str, method: str, word: str
) -> None:
    command = ["identify", str(noisy), "--out", str(tmp_path / "out"), "--sensors", sensors, "--method", method]
    assert main(command) == 2
    said = capfd.readouterr().err
    assert word in said and len(said.strip().splitlines()) == 1


@pytest.mark.thorough
@pytest.mark.usefixtures("no_figures")
def test_a_fit_that_misses_the_readings_is_reported(run: Run, noisy: Path, tmp_path: Path) -> None:
    """A compressor that is best at another flow is not this engine, whatever its health parameters."""
    (tmp_path / "engine.yaml").write_text("W_copt: 0.4\n")
    recording = pd.read_parquet(noisy)
    recording[recording["time_s"] <= 60.0].to_parquet(tmp_path / "drive.parquet", index=False)
    command = ("identify", tmp_path / "drive.parquet", "--runs", "1", "--segment", "30")
    wrong = run(*command, "--engine", tmp_path / "engine.yaml", "--out", tmp_path / "wrong")
    right = run(*command, "--out", tmp_path / "right")
    assert any("times the noise" in line for line in wrong)
    assert not any("times the noise" in line for line in right)
    assert len(json.loads((tmp_path / "right" / "identification.json").read_text())["segments"]) == 2


def test_the_command_line_is_started_without_numpy() -> None:
    """`main` sets numpy's threads before it is imported, which only works as long as nothing imports it earlier."""
    started = subprocess.run([sys.executable, "-c", "import sys, dieseltwin.cli.app; sys.exit('numpy' in sys.modules)"])
    assert started.returncode == 0
