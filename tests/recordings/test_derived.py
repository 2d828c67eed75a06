"""Computed quantities against figures by hand, and the one line for each formula that lacks something."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from dieseltwin.errors import InputError
from dieseltwin.recordings import channels, derived
from dieseltwin.recordings.channels import channel_map
from dieseltwin.recordings.derived import DERIVATIONS

OTHERS = {"n_e_rpm": np.array([1200.0]), "p_amb_pa": np.array([84e3]), "p_im_pa": np.array([130e3]),
          "w_c_kg_s": np.array([0.1])}  # fmt: skip


@pytest.mark.parametrize(
    ("entry", "value", "expected"),
    [
        # 12 L/h at 0.835 kg/L are 2.7833e-3 kg/s; 1200 rpm and 6 cylinders are 60 injections a second
        ("{column: u_delta_mg, unit: L/h, via: fuel_volume_rate, cylinders: 6}", 12.0, 46.3889),
        ("{column: u_delta_mg, unit: kg/h, via: fuel_rate, cylinders: 6}", 10.8, 50.0),
        ("{column: u_delta_mg, unit: mm3/cycle, via: fuel_volume, density_kg_l: 0.82}", 50.0, 41.0),
        ("{column: p_im_pa, unit: kPa, via: gauge}", 46.0, 130e3),
        ("{column: p_im_pa, unit: kPa, via: gauge, ambient_pa: 100000}", 46.0, 146e3),
        ("{column: p_im_pa, via: pressure_ratio}", 1.5, 126e3),
        ("{column: p_em_pa, unit: kPa, via: above_intake}", 20.0, 150e3),
        ("{column: w_egr_kg_s, unit: '%', via: egr_rate}", 20.0, 0.025),
        ("{column: w_c_kg_s, unit: mg/cycle, via: air_per_stroke, cylinders: 6}", 1000.0, 0.06),
        # 0.1 kg/s of air at lambda 2 are 3.4317e-3 kg/s of fuel
        ("{column: u_delta_mg, via: lambda, cylinders: 6}", 2.0, 57.195),
    ],
)
def test_formulas_by_hand(tmp_path, entry, value, expected):
    mapping = channel_map({"x": yaml.safe_load(entry)})
    column = mapping.entries["x"].column
    columns = {"x": np.array([value]), **{name: values for name, values in OTHERS.items() if name != column}}
    assert mapping.apply(columns, "file")[0][column][0] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("name", DERIVATIONS)
def test_a_computed_column_is_worked_out_again_from_what_it_follows(name):
    """As if the map had been applied to the columns that were put right."""
    derivation = DERIVATIONS[name]
    column = derivation.gives[-1]
    cylinders = {"cylinders": 6} if derivation.cylinders else {}
    mapping = channel_map({"x": {"column": column, "via": name, "unit": next(iter(derivation.units)), **cylinders}})
    before = {key: values for key, values in OTHERS.items() if key != column}
    after = {key: 1.1 * values for key, values in before.items()}
    x = {"x": np.array([0.4])}
    made = mapping.made.among({column, *before})
    found = mapping.apply({**x, **before}, "file")[0]
    raw = made.undone(found, found["p_amb_pa"])
    again = made.redone({**after, **raw}, after["p_amb_pa"])
    assert {**found, **again}[column] == pytest.approx(mapping.apply({**x, **after}, "file")[0][column])
    assert (column in again) == bool(derivation.follows)


def test_formulas_wait_for_each_other():
    """EGR flow needs the air flow, which comes from air per stroke, whatever the order of the lines."""
    mapping = channel_map({
        "rate": {"column": "w_egr_kg_s", "unit": "%", "via": "egr_rate"},
        "air": {"column": "w_c_kg_s", "unit": "mg/cycle", "via": "air_per_stroke", "cylinders": 6},
        "rpm": "n_e_rpm",
    })  # fmt: skip
    made = mapping.apply({"rate": np.array([50.0]), "air": np.array([1000.0]), "rpm": np.array([1200.0])}, "file")[0]
    assert made["w_egr_kg_s"][0] == pytest.approx(0.06)


@pytest.mark.parametrize(
    ("content", "word"),
    [
        ({"x": {"column": "p_im_pa", "via": "guage"}}, "did you mean gauge"),
        ({"x": {"column": "t_em_k", "via": "gauge"}}, "p_im_pa, p_em_pa"),
        ({"x": {"column": "u_delta_mg", "unit": "L/h", "via": "fuel_volume_rate"}}, "cylinders: 4, 6"),
        ({"x": {"column": "u_delta_mg", "unit": "bar", "via": "fuel_rate", "cylinders": 6}}, "kg/h"),
        ({"x": {"column": "u_delta_mg", "unit": "kg/h", "via": "fuel_rate", "cylinders": 0}}, "greater than or equal"),
    ],
)
def test_bad_formulas_are_one_line(content, word):
    with pytest.raises(InputError) as error:
        channel_map(content)
    assert word in str(error.value) and "\n" not in str(error.value)


def test_what_a_formula_needs_must_be_there():
    mapping = channel_map({"x": {"column": "p_im_pa", "unit": "kPa", "via": "gauge"}})
    with pytest.raises(InputError, match=r"needs p_amb_pa.*ambient_pa"):
        mapping.apply({"x": np.array([40.0])}, "file")


def test_the_examples_in_the_words_are_channel_maps():
    for module in (derived, channels):
        text = (module.__doc__ or "").split("::\n")[1]
        lines = [line for line in text.splitlines() if line.startswith("    ")]
        assert lines and len(channel_map(yaml.safe_load("\n".join(lines))).entries) == len(lines)
