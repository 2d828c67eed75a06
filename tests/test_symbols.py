"""The nomenclature is complete, consistent and agrees with the reference traces."""

from __future__ import annotations

import re
from pathlib import Path

import pandas as pd
import pytest

from dieseltwin.engine.binding import LEAVES, functions_of
from dieseltwin.errors import InputError
from dieseltwin.sensors import SENSORS
from dieseltwin.symbols import BY_COLUMN, HEALTH_NAMES, INPUT_COLUMNS, SYMBOLS, label, symbol

UNIT_ENDINGS = {
    "_pa": "Pa", "_kg_s": "kg/s", "_rad_s": "rad/s", "_rpm": "rpm", "_pct": "%", "_mg": "mg/cycle", "_nm": "N m",
    "_k": "K", "_w": "W", "_s": "s",
}  # fmt: skip


DOCUMENTED = {"F_vgt_Pi_t": "F_vgt,Pi_t", "P_t_eta_m": "P_t eta_m"} | {
    name: f"d{name}/dt" for name in ("p_im", "p_em", "omega_t")
}  # fmt: skip
"""Symbols that a function's docstring writes in another way; of a state it has the rate."""
ACTUATOR_STATES = ("u_egr1", "u_egr2", "u_vgt_act")
"""One function steps them all."""


def test_names_and_columns_are_unique() -> None:
    assert len(SYMBOLS) == len(BY_COLUMN)


@pytest.mark.parametrize("entry", SYMBOLS.values(), ids=SYMBOLS)
def test_entry_is_sound(entry) -> None:
    assert entry.low < entry.high
    assert entry.meaning and entry.latex
    assert entry.equation in {"input", "parameter", "published"} or re.fullmatch(r"A\.\d{1,2}", entry.equation)


NUMBERED = {name: entry for name, entry in SYMBOLS.items() if entry.equation.startswith("A.")}


@pytest.mark.parametrize("name", NUMBERED)
def test_equation_is_the_one_that_the_engine_s_function_names(name: str) -> None:
    functions = [function for module in LEAVES for function in functions_of(module).values()]
    said = [(f.__doc__ or "").split("\n\n")[0] for f in functions]
    number = rf"\({re.escape(NUMBERED[name].equation)}\b"
    if name in ACTUATOR_STATES:
        text = next(text for text in said if text.startswith("State [%] of an actuator"))
        assert re.search(rf"[(, ]{NUMBERED[name].equation}\b", text)
    elif name in HEALTH_NAMES:
        assert any(re.search(number, text) for text in said)
    else:
        written = re.escape(DOCUMENTED.get(name, name))
        (text,) = [text for text in said if re.search(rf"(^| ){written} \[[^]]*\] \(A", text)]
        assert re.search(number, text), text


@pytest.mark.parametrize("entry", [s for s in SYMBOLS.values() if s.name not in HEALTH_NAMES], ids=lambda s: s.column)
def test_the_columns_name_says_its_unit(entry) -> None:
    endings = [unit for ending, unit in UNIT_ENDINGS.items() if entry.column.endswith(ending)]
    assert (endings[0] if endings else "-") == entry.unit


@pytest.mark.parametrize("name", ["lab_whtc_500s_800s", "field_random_300s", "limits_180s"])
def test_reference_traces_use_the_nomenclature_and_lie_in_its_ranges(project_root: Path, name: str) -> None:
    trace = pd.read_csv(project_root / "tests" / "reference" / f"{name}.csv")
    for column in trace:
        entry = symbol(column)
        assert entry.low <= trace[column].median() <= entry.high, column


def test_the_usual_wrong_units_lie_outside() -> None:
    met = {"p_im_pa": [1.5, 150.0, 1500.0], "p_em_pa": [1.8, 180.0], "t_amb_k": [25.0], "t_im_k": [40.0]}
    for column, wrong in met.items():
        for value in wrong:
            assert not symbol(column).low <= value <= symbol(column).high, (column, value)


def test_lookup_by_name_and_by_column() -> None:
    assert symbol("p_im") is symbol("p_im_pa")
    assert symbol("A_egrmax").unit == "m2"
    for name in (*(sensor.name for sensor in SENSORS), *HEALTH_NAMES, "time_s", *INPUT_COLUMNS):
        symbol(name)


def test_unknown_symbol_says_what_was_meant() -> None:
    with pytest.raises(InputError, match="did you mean omega_t"):
        symbol("omega_tt")


def test_labels() -> None:
    assert label("p_im_pa") == "$p_{im}$ [Pa]"
    assert label("eta_c") == r"$\eta_c$"
    assert label("oil_temp") == "oil_temp"
    assert symbol("p_im").allowed == "50000 to 1e+06 Pa"
