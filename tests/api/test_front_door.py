"""`import dieseltwin as dt`: light, whole, typed; engines and recordings by name, file and table."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cloudpickle
import numpy as np
import pandas as pd
import pytest

import dieseltwin as dt
from dieseltwin.api.reading import Made
from dieseltwin.engine import HEALTH, we2011
from dieseltwin.engine.terms import Term
from dieseltwin.errors import InputError
from dieseltwin.petrol.parameters import PetrolParameters, save_petrol
from dieseltwin.recordings.channels import channel_map
from dieseltwin.recordings.reader import Recording
from dieseltwin.recordings.steady_points import SteadyPoints

HEAVY = {"numpy", "pandas", "numba", "torch", "matplotlib", "scipy", "pydantic"}
INPUTS = ["time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct"]


def python(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


@pytest.fixture(scope="module")
def trace(trace: pd.DataFrame) -> pd.DataFrame:
    return trace.iloc[:101]


# --- the package


def test_importing_it_loads_nothing_heavy() -> None:
    assert python(f"import sys, dieseltwin; print({HEAVY} & set(sys.modules))") == "set()"


def test_names_load_no_more_than_they_need() -> None:
    """Simulating needs no matplotlib, looking at a history judges nothing, discovering needs nothing of petrol engines
    before there is one, no name torch or scipy.stats (half a second)."""
    steps = (
        ("dt.simulate", "matplotlib"), ("dt.history", "dieseltwin.api.driving"),
        ("dt.discover", "dieseltwin.api.petrol"),
        ("dt.read, dt.engine, dt.identify, dt.calibrate, dt.imply", "torch"),
        ("dt.discover", "scipy.stats"),
    )  # fmt: skip
    code = "\n".join(f"{names}; print({module!r} in sys.modules)" for names, module in steps)
    assert python(f"import sys, dieseltwin as dt\n{code}").split() == ["False"] * len(steps)


def test_every_name_is_there_and_listed() -> None:
    for name in dt.__all__:
        assert getattr(dt, name) is not None and name in dir(dt)
    with pytest.raises(AttributeError, match="discovr"):
        dt.discovr  # noqa: B018


@pytest.mark.parametrize(
    "first", ["import dieseltwin.engine as e", "from dieseltwin.engine import we2011", "from dieseltwin import engine"]
)
def test_engine_is_a_package_and_a_function_whatever_is_imported_first(first: str) -> None:
    code = f"{first}; import dieseltwin as dt; print(dt.engine('we2011') is dt.engine.we2011.PARAMETERS)"
    assert python(code) == "True"


def test_versions(capsys: pytest.CaptureFixture[str]) -> None:
    dt.show_versions()
    said = capsys.readouterr().out
    assert f"dieseltwin  {dt.__version__}" in said and f"numpy       {np.__version__}" in said


# --- engines


def test_engines_by_name_file_and_parameters(tmp_path: Path) -> None:
    assert dt.engine() is dt.engine("we2011") is we2011.PARAMETERS
    assert dt.engine(V_d=0.0128) == we2011.PARAMETERS.replace(V_d=0.0128)
    (tmp_path / "engine.yaml").write_text("V_d: 0.0128\n")
    from_file = dt.engine(tmp_path / "engine.yaml", J_t=2.2e-4)
    assert from_file == we2011.PARAMETERS.replace(V_d=0.0128, J_t=2.2e-4) == dt.engine(from_file)
    assert isinstance(dt.engine("liu_petrol"), PetrolParameters)
    with pytest.raises(InputError, match="we2011"):
        dt.engine("we2012")
    with pytest.raises(InputError, match="did you mean liu_petrol"):  # the command line gives a path
        dt.engine(Path("liu_petrl"))
    with pytest.raises(InputError, match="V_d"):
        dt.engine(V_dd=1.0)
    with pytest.raises(InputError, match="no such file"):
        dt.engine("nowhere.yaml")
    with pytest.raises(InputError, match=r"no maps.*learn HEALTHY --engine .*petrol\.yaml"):  # not another's volumes
        dt.engine(save_petrol(PetrolParameters(), tmp_path / "petrol.yaml"))


# --- recordings


def test_files_tables_and_channel_maps_read_alike(trace: pd.DataFrame, tmp_path: Path) -> None:
    trace.to_csv(tmp_path / "drive.csv", index=False)
    from_file, from_table = dt.read(tmp_path / "drive.csv"), dt.read(trace)
    assert isinstance(from_file, Recording) and isinstance(from_table, Recording)
    pd.testing.assert_frame_equal(from_file.frame(), from_table.frame())
    foreign = trace.rename(columns={"p_im_pa": "boost"}).assign(boost=trace["p_im_pa"] / 1e3)
    mapped = dt.read(foreign, channel_map({"boost": {"column": "p_im_pa", "unit": "kPa"}}))
    assert isinstance(mapped, Recording)
    np.testing.assert_allclose(mapped.columns["p_im_pa"], trace["p_im_pa"])
    assert isinstance(dt.read(trace.drop(columns="time_s")), SteadyPoints)
    with pytest.raises(InputError, match="n_e_rpm"):
        dt.read(trace.drop(columns="n_e_rpm"))


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda made: pickle.loads(pickle.dumps(made))])
def test_what_was_read_goes_to_another_process_and_stays_unchangeable(
    trace: pd.DataFrame, copied: Callable[[Made], Made]
) -> None:
    for made in (dt.read(trace), dt.read(trace.drop(columns="time_s"))):
        again = copied(made)
        assert isinstance(again, Recording | SteadyPoints) and type(again) is type(made)
        pd.testing.assert_frame_equal(pd.DataFrame(dict(again.columns)), pd.DataFrame(dict(made.columns)))
        with pytest.raises(TypeError, match="does not support item assignment"):
            again.columns["n_e_rpm"] = trace["n_e_rpm"].to_numpy()  # type: ignore[index]


# --- simulate


def test_a_function_of_a_script_goes_to_another_process() -> None:
    """joblib, Dask and Ray send functions of `__main__` by value, with the modules that they use."""
    space: dict[str, object] = {"dt": dt, "__name__": "__main__"}
    exec("def published():\n    return dt.engine('we2011').V_d, dt.engine.HEALTH\n", space)
    sent = cloudpickle.dumps(space["published"])
    code = "import pickle, sys; print(pickle.loads(sys.stdin.buffer.read())())"
    done = subprocess.run([sys.executable, "-c", code], input=sent, capture_output=True, check=True)
    assert done.stdout.decode().strip() == str((we2011.PARAMETERS.V_d, HEALTH))
    assert pickle.loads(pickle.dumps(dt)) is dt and pickle.loads(pickle.dumps(dt.engine)) is dt.engine
    assert copy.deepcopy({"module": dt})["module"] is dt


def test_simulating_a_file_a_table_and_a_recording_is_the_same(trace: pd.DataFrame, tmp_path: Path) -> None:
    inputs = trace[[*INPUTS, "p_im_pa", "p_em_pa", "omega_t_rad_s"]]
    inputs.to_csv(tmp_path / "inputs.csv", index=False)
    found = dt.simulate(inputs, dt.engine(A_egrmax=3e-4))
    pd.testing.assert_frame_equal(found.table(), dt.simulate(dt.read(inputs), dt.engine(A_egrmax=3e-4)).table())
    pd.testing.assert_frame_equal(found.table(), dt.simulate(tmp_path / "inputs.csv", found.engine).table())
    out = found.save(tmp_path / "out.parquet")
    pd.testing.assert_frame_equal(pd.read_parquet(out), found.table())
    assert found.sentence in repr(found) and "<table" in found._repr_html_() and len(found.plot().axes) == 7


def test_effects_are_added_and_replaced(trace: pd.DataFrame) -> None:
    leaking = dt.simulate(trace, effects={"boost_leak": 3e-5})
    assert leaking.engine.terms == (Term(effect="boost_leak", magnitude=3e-5),)
    assert leaking.table()["w_leak_im_kg_s"].max() > 1e-3
    assert dt.simulate(trace, leaking.engine, effects={"boost_leak": 0.0}).table()["w_leak_im_kg_s"].max() == 0.0
    with pytest.raises(InputError, match=r"0 to 0\.0002 m2"):
        dt.simulate(trace, effects={"boost_leak": 1.0})


def test_what_can_not_be_simulated_is_one_line(trace: pd.DataFrame) -> None:
    with pytest.raises(InputError, match="no p_ic_pa"):
        dt.simulate(trace, "liu_petrol")
    with pytest.raises(InputError, match="u_egr_pct, data row 4"):
        dt.simulate(trace.assign(u_egr_pct=trace["u_egr_pct"].where((trace.index < 3) | (trace.index > 10))))
    (note,) = dt.simulate(trace.assign(u_egr_pct=trace["u_egr_pct"].where(trace.index != 3))).notes
    assert "1 missing values of u_egr_pct are bridged" in note
    with pytest.raises(InputError, match="plot"):
        dt.simulate(trace).plot("nothing")


def test_more_rows_than_memory_bears_are_refused_before_the_simulation(
    trace: pd.DataFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dieseltwin.api.simulation.MOST_ROWS", len(trace) - 1)
    with pytest.raises(InputError, match="average it down to 10 Hz"):
        dt.simulate(trace)
