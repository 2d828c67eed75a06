"""Tables without a clock: settled points are read; a recording that lost its time is not taken for them."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from dieseltwin.errors import InputError
from dieseltwin.recordings.moving import roughness
from dieseltwin.recordings.named_columns import import_columns
from dieseltwin.recordings.steady_points import JUDGED, SteadyPoints, read_points

COLUMNS = ["n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct", "p_im_pa", "p_em_pa", "omega_t_rad_s", "w_c_kg_s"]


@pytest.fixture(scope="module")
def drive(trace: pd.DataFrame) -> pd.DataFrame:
    """Five minutes at 5 Hz."""
    return trace[COLUMNS]


def grid(speeds: int = 12, loads: int = 12) -> pd.DataFrame:
    """Settled points over a map, line after line, as a bench's schedule goes."""
    n_e, load = (values.ravel() for values in np.meshgrid(np.linspace(800, 2200, speeds), np.linspace(0.2, 1, loads),
                                                          indexing="ij"))  # fmt: skip
    boost = 1e5 * (1.0 + 2.0 * load * n_e / 2200.0)
    return pd.DataFrame({"n_e_rpm": n_e, "u_delta_mg": 200.0 * load, "u_egr_pct": 40.0 - 30.0 * load, "u_vgt_pct": 50.0,
                         "p_im_pa": boost, "p_em_pa": 1.1 * boost, "omega_t_rad_s": 2e3 + 8e3 * load * n_e / 2200.0,
                         "w_c_kg_s": 1e-9 * boost * n_e})  # fmt: skip


def finer(drive: pd.DataFrame, rows: int) -> pd.DataFrame:
    """The first half minute of the drive at 10 Hz and more."""
    at = np.linspace(0.0, 150.0, rows)
    return pd.DataFrame({name: np.interp(at, np.arange(len(drive)), drive[name]) for name in COLUMNS})


@pytest.mark.parametrize("counter", ["Sample", "Ticks", None])
def test_a_recording_without_its_time_is_no_table_of_points(drive, counter):
    table = finer(drive, 600)
    if counter is not None:
        table.insert(0, counter, np.arange(600))
    with pytest.raises(InputError, match=f"map column {counter} to time_s" if counter else "add time_s"):
        read_points(table, needed=COLUMNS)


def test_slower_rows_that_somebody_counted_are_noted(drive):
    found = read_points(drive.assign(Sample=np.arange(len(drive))), needed=COLUMNS)
    assert any("though speed, fuel and boost go on from row to row" in note for note in found.notes)


@pytest.mark.parametrize("order", [None, *COLUMNS, "random", "to and fro"])
def test_settled_points_are_read_in_any_order(order):
    points = grid().assign(point=np.arange(1, 145))
    if order in COLUMNS:
        points = points.sort_values(order)
    elif order == "random":
        points = points.sample(frac=1.0, random_state=1)
    elif order == "to and fro":
        points = pd.concat([line[:: -1 if k % 2 else 1] for k, (_, line) in enumerate(points.groupby("n_e_rpm"))])
    assert not any("row to row" in note for note in read_points(points, needed=COLUMNS).notes)


def test_a_full_load_curve_up_and_down_is_read():
    curve = grid(25, 2)[1::2]
    both = pd.concat([curve, curve[::-1]], ignore_index=True)
    both["u_delta_mg"] = 150.0 + 40.0 * np.sin(both["n_e_rpm"] / 500.0)
    assert read_points(both, needed=COLUMNS).size == 50


def test_roughness_is_one_by_chance_and_nothing_on_a_line():
    assert roughness(np.random.default_rng(1).standard_normal(4000)) == pytest.approx(1.0, abs=0.05)
    assert roughness(np.arange(200.0)) < 1e-3
    assert roughness(np.ones(50)) == 1.0


@pytest.mark.parametrize(("lacking", "rows", "kept"), [(5, 139, True), (100, 144, False)])
def test_points_without_the_position_of_the_flap_are_left_out(lacking, rows, kept):
    position = np.where(np.arange(144) < lacking, np.nan, 50.0)
    found = read_points(grid().assign(u_flap_pct=position), needed=COLUMNS)
    assert (found.size, "u_flap_pct" in found) == (rows, kept)
    assert any("left out" in note for note in found.notes)


@pytest.mark.parametrize("column", ["p_em_pa", "t_im_k", "p_amb_pa", "p_es_pa"])
def test_text_in_a_reading_is_refused_whatever_is_needed(column):
    """`imply` needs the inputs alone, and counted text in a reading as missing without a word."""
    table = grid().assign(t_im_k=310.0, p_amb_pa=1e5, p_es_pa=1.05e5).astype({column: object})
    table.loc[4, column] = "1.2e5 (estimated)"
    with pytest.raises(InputError, match=f"{column}, data row 5"):
        read_points(table, needed=COLUMNS[:4])
    assert read_points(grid().assign(remark="fine"), needed=COLUMNS[:4]).size == 144


@pytest.mark.parametrize(("name", "values", "timed"), [
    ("Time of day", [f"{8 + k // 12:02d}:{5 * (k % 12):02d}:00" for k in range(144)], False),
    ("Time to steady [s]", [30.0] * 144, False),
    ("Time to steady [s]", list(np.random.default_rng(1).uniform(20.0, 60.0, 144)), False),
    ("time", [f"08:{k // 60:02d}:{k % 60:02d}" for k in range(144)], True),
    ("Zeit", list(np.arange(144) * 200.0), True),  # in ms
    ("Time [min]", list(np.arange(144) * 5.0), False),
])  # fmt: skip
def test_settled_points_may_have_times(tmp_path, name, values, timed):
    """Any column called like a time made a recording of them, and refused it for want of `time_s`."""
    table = grid().assign(**{name: values})
    table.to_csv(tmp_path / "points.csv", index=False)
    for source in (table, tmp_path / "points.csv"):
        assert import_columns(source).timed == timed


def test_the_usual_charge_of_a_colder_day_has_egr_from_a_coolant_as_warm_as_ever() -> None:
    """Cooled air, mixed with EGR from a cooler of 95 % on a coolant of 365 K; told by points of 297 K alone."""
    generator = np.random.default_rng(3)
    count = 200
    pressures, flows, hot, egr = generator.uniform([1.1, 0.1, 600.0, 0.05], [3.4, 0.5, 1000.0, 0.3], (count, 4)).T
    judged = (np.arange(count) >= 120).astype(float)
    T_0 = np.where(judged > 0.5, 280.0, 297.0)
    behind = T_0 + T_0 * (pressures**0.286 - 1.0) / 0.75
    charge = (1.0 - egr) * (T_0 + 0.1 * (behind - T_0)) + egr * (365.0 + 0.05 * (hot - 365.0))
    data = SteadyPoints({
        JUDGED: judged, "t_amb_k": T_0, "p_amb_pa": np.full(count, 1e5), "p_im_pa": 1e5 * pressures, "t_em_k": hot,
        "w_c_kg_s": (1.0 - egr) * flows, "w_egr_kg_s": egr * flows, "t_im_k": charge,
    }, np.arange(count))  # fmt: skip
    foretold = data.usual_charge
    assert foretold is not None
    assert np.abs(foretold - charge)[judged > 0.5].max() < 0.5
