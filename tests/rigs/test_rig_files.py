"""A rig's file: what it may say, that it runs no code, and that its simulation is that of its equations."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml

import dieseltwin as dt
from dieseltwin.cli.app import main
from dieseltwin.errors import InputError
from dieseltwin.rigs.expressions import moment, names_in
from dieseltwin.rigs.parameters import LawFactor, Quantity, RigLaw, RigParameters, RigTerm, load_rig, save_rig
from dieseltwin.rigs.recording import read_rig
from dieseltwin.rigs.simulate import run_error, simulate_rig
from dieseltwin.rigs.twin import RigTwin, model_of

RIGS = Path(__file__).resolve().parents[2] / "examples" / "rigs"

BALANCE = {"formula": "q - (k + leak)*h", "unit": "m/s", "site": "tank", "relative": False, "ports": ["h"]}
LEAK = {"site": "tank", "law": "c h lost", "unit": "1/s", "tolerance": 0.01, "limits": [0.0, 1.0]}
TANK_PARAMETERS = {"k": {"value": 0.5, "prior_std": 0.5, "scale": 0.05, "unit": "1/s"}}
TANK: dict[str, Any] = {
    "kind": "rig", "name": "tank", "states": {"h": {"scale": 1.0, "unit": "m", "nearest": "level"}},
    "inputs": {"q": "m/s"},
    "parameters": TANK_PARAMETERS, "quantities": {"balance": BALANCE}, "rates": {"h": "balance"},
    "readings": {"level": "h"}, "sub_steps": 4, "effects": {"leak": LEAK},
}  # fmt: skip


@pytest.fixture
def tank() -> RigParameters:
    return RigParameters.model_validate(TANK)


def emptying(rate: float, n: int = 60) -> pd.DataFrame:
    """A tank without inflow: h = 2 exp(-rate t)."""
    time = 0.1 * np.arange(n)
    return pd.DataFrame({"time_s": time, "q": 0.0, "level": 2.0 * np.exp(-rate * time)})


@pytest.mark.parametrize(
    "formula",
    ["__import__('os')", "h.__class__", "(lambda: 1)()", "[h for h in (1,)]", "'text'", "h if h else 1", "True",
     "h = 1", "open(h)", "abs(x=1)", "h[0]", "1j", "h" * 501, "(" * 300 + "h" + ")" * 300, "f'{h}'", "h := 2"],
)  # fmt: skip
def test_a_formula_is_arithmetic_and_nothing_else(formula: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        names_in(formula)


@pytest.mark.parametrize("formula", ["min(h, 2, k)", "max(h)", "abs()", "abs(h, k)", "root(h, k)", "positive()"])
def test_a_function_takes_its_own_number_of_values(formula: str) -> None:
    """Given one more, NumPy writes into it: `min(h, 2, k)` would change k."""
    with pytest.raises(ValueError, match=r"takes (one|two) value.*; got [0-3]$"):
        names_in(formula)


@pytest.mark.parametrize(
    "formula", ["h*9**9**9**9", "10.0**400", "h/0", "h/(1 - 1)", "h*" + "9" * 400, "(-8)**(1/3)", "abs(1/0)"]
)
def test_a_number_that_no_float_holds_is_refused(formula: str) -> None:
    with pytest.raises(ValueError, match="has no value"):
        names_in(formula)
    assert names_in("h**2*10**300 + min(2**-1*k, -3/4)") == ("h", "k")


@pytest.mark.parametrize("name", ["__class__", "_x", "abs", "for", "h-2", "h; import os", "ℎ", ""])
def test_a_name_is_a_plain_identifier(name: str, tank: RigParameters) -> None:
    changed = {**TANK, "inputs": {"q": "m/s", name: "-"}}
    with pytest.raises(ValueError, match="can't be a name"):
        RigParameters.model_validate(changed)
    with pytest.raises(ValueError, match="can't be a name"):
        moment({name: "u"}, {}, ["1.0"])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"rates": {"h": "balanse"}}, "did you mean balance"),
        ({"rates": {"x": "balance"}}, "one rate a state"),
        ({"terms": [{"effect": "leek", "magnitude": 0.1}]}, "did you mean leak"),
        ({"terms": [{"effect": "leak", "magnitude": 0.1}, {"effect": "leak", "magnitude": 0.2, "onset_s": 9.0}]},
         "terms: leak twice"),
        ({"laws": [{"at": "balanc", "coefficient": 1.0}]}, "did you mean balance"),
        ({"states": {"h": {"scale": 1.0, "nearest": "levle"}}}, "did you mean level"),
        ({"readings": {}}, "at least"),
        ({"parameters": {"h": {"value": 1.0, "prior_std": 1.0, "scale": 0.1}}}, "h stands for two things"),
        ({"effects": {"leak": {**LEAK, "tolerance": 2.0}}}, "effect leak: tolerance 2 beyond its limits, 0 to 1"),
        ({"effects": {"leak": {**LEAK, "site": "sensor:levle"}}}, "unknown name 'levle'; did you mean level"),
        ({"substeps": 2}, "did you mean sub_steps"),
        ({"states": {"h": {"scale": 1.0, "nearest": "q"}}}, "h: nearest: unknown name 'q'; known: level"),
        ({"floors": {"levle": 0.1}}, "floors: unknown name 'levle'; did you mean level?"),
        ({"quantities": {"balance": {**BALANCE, "ports": ["height"]}}}, "ports of balance: unknown name 'height'"),
        ({"quantities": {"balance": {**BALANCE, "ports": ["k"]}}}, "ports of balance: unknown name 'k'; known: h, q"),
        ({"quantities": {"balance": {**BALANCE, "formula": "q - k*h"}}}, "effect leak: in no rate and no reading"),
        ({"parameters": {**TANK_PARAMETERS, "c": {"value": 1.0, "prior_std": 1.0, "scale": 0.1}}},
         "parameter c: in no rate and no reading, so that no recording could tell it"),
        ({"parameters": {**TANK_PARAMETERS, "c": {"value": 1.0, "prior_std": 1.0, "scale": 0.1}},
          "quantities": {"idle": {"formula": "c*h"}, "balance": BALANCE}}, "parameter c: in no rate and no reading"),
        ({"quantities": {"idle": {"formula": "q", "site": "inlet"}, "balance": BALANCE}},
         "quantity idle: in no rate and no reading, so that nothing could be missing there"),
        ({"effects": {"leak": {**LEAK, "limits": [1.0, 0.0]}}}, "effect leak: limits 1 to 0; the lower first"),
        ({"effects": {"leak": {**LEAK, "limits": [0.1, 1.0]}}}, "effect leak: limits 0.1 to 1; "),
        ({"effects": {"leak": {**LEAK, "sizes": [0.1, 2.0]}}}, "effect leak: sizes 0.1, 2 beyond its limits"),
        ({"rates": {"h": f"balance{' + balance' * 30} - h^2"}}, "h: a power is written **, not ^"),
        ({"rates": {"h": f"balance{' + balance' * 30} - (h % 2)"}}, "h: Mod is no arithmetic"),
    ],
)
def test_a_mistake_in_a_file_is_one_line(change: dict[str, Any], says: str, tmp_path: Path) -> None:
    path = tmp_path / "tank.yaml"
    path.write_text(yaml.safe_dump({**TANK, **change}), encoding="utf-8")
    with pytest.raises(InputError) as error:
        dt.engine(path)
    assert says in error.value.line() and "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["cascaded_tanks", "positioning_axis"])
def test_what_is_written_is_read_again(name: str, tmp_path: Path) -> None:
    rig = load_rig(RIGS / f"{name}.yaml")
    effect, point = next(iter(rig.effects)), next(iter(rig.quantities))
    law = RigLaw(at=point, coefficient=-0.1, text="-0.1",
                 factors=(LawFactor(kind="sign", variables=("h",), references=(1.0,)),))  # fmt: skip
    found = rig.model_copy(update={"terms": (RigTerm(effect=effect, magnitude=0.1, std=0.01),), "laws": (law,)})
    assert load_rig(save_rig(found, tmp_path / "found.yaml")) == found


def test_the_simulation_is_that_of_the_equations(tank: RigParameters) -> None:
    recording = read_rig(emptying(0.7), tank)
    table = simulate_rig(tank.model_copy(update={"terms": (RigTerm(effect="leak", magnitude=0.2),)}), recording)
    np.testing.assert_allclose(table["level"], recording.readings["level"], rtol=3e-4)  # Heun's
    level = LawFactor(kind="power", variables=("h",), references=(1.0,))
    law = RigLaw(at="balance", coefficient=-0.2, factors=(level,))
    by_law = simulate_rig(tank.model_copy(update={"laws": (law,)}), recording)
    np.testing.assert_allclose(by_law["level"], table["level"], rtol=1e-9)
    assert list(table) == ["time_s", "h", "q", "balance", "level"]
    (axes,) = dt.simulate(emptying(0.7), tank).plot().axes
    assert axes.get_ylabel() == "level" and len(axes.lines) == 2


@pytest.mark.parametrize("k", [-500.0, 500.0])
def test_a_simulation_that_runs_away_is_refused(k: float, tank: RigParameters) -> None:
    """A tank that fills itself, and steps too long for one that empties in milliseconds: both gave 1e200 and more."""
    parameters = {"k": tank.parameters["k"].model_copy(update={"value": k})}
    with pytest.raises(InputError, match=r"tank: got h = .*e\+[0-9]+ at 0\.[0-9]* s; .*sub_steps"):
        dt.simulate(emptying(0.5), tank.model_copy(update={"parameters": parameters}))
    empty = tank.model_copy(update={"quantities": {**tank.quantities, "share": Quantity(formula="h/q")}})
    assert np.isinf(dt.simulate(emptying(0.5), empty).table()["share"]).all()


def _noted(passed: dict[str, Any], name: str, value: Any) -> Any:
    return passed.setdefault(name, value)


def test_effects_that_are_not_there_are_not_computed() -> None:
    model, rng = model_of(load_rig(RIGS / "positioning_axis.yaml")), np.random.default_rng(0)
    x, u, p = (
        SimpleNamespace(**{name: rng.standard_normal((3, 5)) for name in names})
        for names in (model.states, model.inputs, [parameter.name for parameter in model.parameters])
    )
    names = {effect.name for effect in model.hypotheses}
    for there, noted in ((set(), ["force", "viscous", "net"]), ({"coulomb_friction"}, ["way", "dry"])):
        e = SimpleNamespace(**{name: 0.3 * (name in there) for name in names})
        passed: dict[str, Any] = {}
        rates = model.rates_without(frozenset(names - there))(x, u, p, partial(_noted, passed), e)
        for one, other in zip(rates, model.rates(x, u, p, lambda _, value: value, e), strict=True):
            np.testing.assert_array_equal(one, other)
        assert set(noted) <= set(passed) and "position" not in passed and ("way" in passed) is bool(there)


def test_rows_are_averaged_and_runs_start_anew(tank: RigParameters) -> None:
    rig = tank.model_copy(update={"every": 2, "run_s": 1.5, "first_rows": 4})
    table = emptying(0.5, 121).assign(q=np.arange(121) % 2)
    recording = read_rig(table, rig)
    assert len(recording.time_s) == 60 and (recording.inputs["q"] == 0.5).all()
    assert RigTwin(rig, recording, rig.run_s).starts.size == 8
    quiet = read_rig(emptying(0.5, 120), rig)
    assert run_error(rig, quiet)[0] < 1e-4


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda t: t.drop(columns="q"), "column q"),
        (lambda t: t.assign(q=t["q"].where(t.index != 5)), "sample 6"),
        (lambda t: t.iloc[::-1], r"column time_s, data row 2: got 5.8 after 5.9; allowed: times that increase"),
        (lambda t: pd.concat([t, t]), r"data row 61: got 0 after 5.9.*two recordings one by one"),
        (lambda t: t.assign(time_s=t["time_s"].where(t.index != 5)), r"column time_s, data row 6: got no number"),
        (lambda t: t.assign(level=t["level"].astype(object).where(t.index != 5, "oops")), r"data row 6: got 'oops'"),
        (lambda t: t.assign(level=np.nan), "column level: got none, or no number in it"),
        (lambda t: t.iloc[:10], "10 rows; allowed: 20 or more"),
        (lambda t: t.drop(columns="level"), "column level"),
    ],
)
def test_a_recording_that_does_not_fit_is_refused(change: Any, says: str, tank: RigParameters) -> None:
    with pytest.raises(InputError, match=says):
        dt.discover(change(emptying(0.5)), tank)


@pytest.mark.parametrize("key", ["window_s", "run_s"])
def test_windows_that_start_anew_at_every_sample_are_refused(key: str, tank: RigParameters) -> None:
    """They left nothing, and "no mismatch" was said of any recording."""
    short = tank.model_copy(update={key: 0.05})
    with pytest.raises(InputError, match=rf"tank: {key}: got 0.05 s, where a sample comes every 0.1 s; allowed: 0.6 s"):
        dt.discover(emptying(0.5), short)


@pytest.mark.parametrize("change", [{"value": 0.0}, {"value": 1e6, "prior_std": 1e3}])
def test_a_file_whose_rates_have_no_value_is_one_line(change: dict[str, float]) -> None:
    """An inertia of nought, a resistance in milliohms: these were tracebacks."""
    stiff = {"k": {**TANK["parameters"]["k"], **change}}
    rate = "balance/k" if not change["value"] else "balance"
    rig = RigParameters.model_validate({**TANK, "parameters": stiff, "rates": {"h": rate}})
    with pytest.raises(InputError, match=r"no fit of tank that stays finite.*check values and units"):
        dt.discover(emptying(0.5), rig)


@pytest.mark.parametrize("change", [lambda t: t.drop(columns="level"), lambda t: t.assign(level=np.nan)])
def test_a_machine_without_its_sensor_starts_where_its_file_says(change: Any, tank: RigParameters) -> None:
    state = tank.states["h"].model_copy(update={"first": 3.0})
    rig = tank.model_copy(update={"states": {"h": state}})
    table = dt.simulate(change(emptying(0.5)), rig).table()
    assert table["level"].to_numpy() == pytest.approx(3.0 * np.exp(-0.5 * table["time_s"]), rel=1e-3)


def test_an_error_code_among_the_readings_is_missing_and_said(tank: RigParameters) -> None:
    table = emptying(0.5)
    table.loc[7, "level"] = -9999.0
    read = read_rig(table, tank)
    assert np.flatnonzero(np.isnan(read.readings["level"])).tolist() == [7]
    assert any("error code (-9999)" in note and "level" in note for note in read.notes)
    wide = table.assign(level=np.where(table["level"] > 1.0, -999.0, table["level"] * 1e5))  # it may be a reading here
    assert np.isfinite(read_rig(wide.drop(index=7), tank).readings["level"]).all()


def test_behind_a_gap_a_machine_starts_anew(tank: RigParameters) -> None:
    """Inflow that nobody recorded: one straight line over the gap would be held against the parameters."""
    second = emptying(0.5, 40).assign(time_s=lambda t: t["time_s"] + 60.0)
    recording = read_rig(pd.concat([emptying(0.5, 40), second]), tank)
    assert RigTwin(tank, recording, None).starts.tolist() == [0, 40]
    assert run_error(tank, recording)[0] < 1e-3
    found = dt.identify(pd.concat([emptying(0.4, 40), second.assign(level=emptying(0.4, 40)["level"])]), tank)
    assert found.table().loc["k", "mean"] == pytest.approx(0.4, rel=1e-3)


def test_what_a_recording_says_nothing_of_is_said(tank: RigParameters) -> None:
    """An empty tank: what was believed before looked like a result."""
    empty = emptying(0.5).assign(level=1e-3 * np.random.default_rng(0).standard_normal(60))
    dull = dt.identify(empty, tank).lines()
    assert dull[-1].startswith("note: this recording says next to nothing of k:")
    good = dt.identify(emptying(0.4), tank)
    assert len(good.lines()) == 2 and good.off["level"] < 1e-3


def test_rows_that_one_sample_stands_for_are_counted(tank: RigParameters) -> None:
    with pytest.raises(InputError, match=r"60 rows, 12 samples of 5 rows.*lower `every`"):
        read_rig(emptying(0.5), tank.model_copy(update={"every": 5}))


def test_engines_and_rigs_are_told_apart(tank: RigParameters) -> None:
    recording = dt.read(emptying(0.5), engine=tank)
    for wrong in (lambda: dt.discover(recording), lambda: dt.simulate(recording), lambda: dt.identify(recording),
                  lambda: dt.calibrate(emptying(0.5), tank), lambda: dt.discover(recording, tank, sensors=["level"]),
                  lambda: dt.discover(recording, tank, withhold=["leek"])):  # fmt: skip
        with pytest.raises(InputError):
            wrong()
    fitted = dt.identify(emptying(0.7), tank)
    assert fitted.table().loc["k", "mean"] == pytest.approx(0.7, rel=1e-3)


def test_a_rig_reads_any_format(tank: RigParameters, tmp_path: Path) -> None:
    table = emptying(0.5)
    table.to_csv(tmp_path / "a.csv", index=False, sep=";", decimal=",")
    table.to_excel(tmp_path / "a.xlsx", index=False)
    for source in (tmp_path / "a.csv", tmp_path / "a.xlsx", table):
        np.testing.assert_allclose(read_rig(source, tank).readings["level"], table["level"], rtol=1e-12)


def test_a_fitted_rig_draws_its_readings(tank: RigParameters) -> None:
    """`plot()` raised, although every result has one."""
    fitted = dt.identify(emptying(0.6), tank)
    assert fitted.plot().axes and fitted.plot("readings").axes


@pytest.mark.parametrize("option", [["--pdf"], ["--strict"], ["--method", "multi-stage"], ["--profile", "paper"],
                                    ["--no-fit-test"], ["--params", "x.yaml"], ["--runs", "2"]])  # fmt: skip
def test_options_that_mean_nothing_to_a_rig_are_refused(
    tmp_path: Path, tank: RigParameters, capsys: pytest.CaptureFixture[str], option: list[str]
) -> None:
    """Six of them were passed over without a word, and so was the time that a search may take."""
    save_rig(tank, tmp_path / "tank.yaml")
    emptying(0.6).to_csv(tmp_path / "tank.csv", index=False)
    asked = [str(tmp_path / "tank.csv"), "--engine", str(tmp_path / "tank.yaml"), "--out", str(tmp_path / "out")]
    assert main(["identify", *asked, *option]) == 2
    assert f"{option[0]}: got given; allowed: no such option for tank" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert main(["discover", *asked, "--time", "5"]) == 2
    assert "--time: got given; allowed: no such option for tank" in capsys.readouterr().err


@pytest.mark.parametrize("judge", [dt.discover, dt.identify])
@pytest.mark.parametrize("level", [0.0, 1.3])
def test_a_reading_that_stands_still_is_no_clean_bill(judge: Any, level: float, tank: RigParameters) -> None:
    """An unplugged sensor, nought in every row, was "no mismatch"."""
    with pytest.raises(InputError, match=rf"column level: got {level:g} in every row; allowed: a reading that moves"):
        judge(emptying(0.5).assign(level=level), tank)
    assert len(dt.simulate(emptying(0.5).assign(level=level), tank).table()) == len(emptying(0.5))


def test_identify_refuses_what_no_fit_can_follow() -> None:
    """It wrote the file's values with deviations that were infinite."""
    rig = RigParameters.model_validate({**TANK, "parameters": {"k": {**TANK_PARAMETERS["k"], "value": 0.0}},
                                        "rates": {"h": "balance/k"}})  # fmt: skip
    with pytest.raises(InputError, match=r"no fit of tank that stays finite"):
        dt.identify(emptying(0.5), rig)


def test_what_is_withheld_is_not_looked_for_and_explained_so(tank: RigParameters, tmp_path: Path, capsys: Any) -> None:
    """The command from end to end: one of two effects withheld, then asked about."""
    effects = {"leak": LEAK, "bias": {**LEAK, "site": "sensor:level", "law": "reading + b", "sensor": True}}
    rig = tank.model_validate({**TANK, "effects": effects, "readings": {"level": "h + bias"},
                               "parameters": {"k": {**TANK_PARAMETERS["k"], "prior_std": 1e-3}}})  # fmt: skip
    save_rig(rig, tmp_path / "rig.yaml")
    table = emptying(0.8, 120)
    table["level"] += 0.002 * np.random.default_rng(3).standard_normal(len(table))
    table.to_csv(tmp_path / "a.csv", index=False)
    asked = ["discover", str(tmp_path / "a.csv"), "--engine", str(tmp_path / "rig.yaml"), "--out"]
    assert main([*asked, str(tmp_path / "whole")]) == 0
    assert main([*asked, str(tmp_path / "without"), "--withhold", "leak"]) == 0
    capsys.readouterr()
    assert main(["discover", "--explain", "leak", "--out", str(tmp_path / "without")]) == 0
    assert "withheld from the catalogue" in capsys.readouterr().out
    assert main(["discover", "--explain", "leak", "--out", str(tmp_path / "whole")]) == 0
    said = capsys.readouterr().out
    assert "\nchosen\n" in said and "could show: –" not in said
    assert main([*asked, str(tmp_path / "none"), "--withhold", "leek"]) == 2
    assert "did you mean leak" in capsys.readouterr().err and not (tmp_path / "none").exists()
    said = json.loads((tmp_path / "without" / "discrepancy.json").read_text())
    assert "leak" not in [effect["name"] for effect in said["effects"]]
