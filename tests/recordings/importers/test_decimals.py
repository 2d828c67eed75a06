"""Decimals or thousands: a whole file decides, and what nothing decides isn't read silently."""

from __future__ import annotations

import numpy as np
import pytest

from dieseltwin.errors import InputError
from dieseltwin.recordings.importers.decimals import clear_mark
from dieseltwin.recordings.importers.read import read_raw

FLOW = [390, 640, 990, 1013, 1250, 26621]


def written(tmp_path, times, flows, separator=";"):
    lines = [f"{time}{separator}{flow}" for time, flow in zip(times, flows, strict=True)]
    (tmp_path / "a.csv").write_text(f"Zeit{separator}Luft\n" + "\n".join(lines) + "\n")
    return tmp_path / "a.csv"


def grouped(mark):
    return [f"{flow:,}".replace(",", mark) for flow in FLOW]


@pytest.mark.parametrize(("decimal", "group"), [(",", "."), (".", ",")])
@pytest.mark.parametrize("separator", [";", "\t"])
@pytest.mark.parametrize("late", [False, True])
def test_thousands_are_grouped_by_the_mark_that_is_not_the_decimal_one(tmp_path, decimal, group, separator, late):
    flows = [*["390"] * 300 * late, *grouped(group)]
    times = [f"{0.1 * row:.1f}".replace(".", decimal) for row in range(len(flows))]
    table = read_raw(written(tmp_path, times, flows, separator)).table
    np.testing.assert_array_equal(table["Luft"][-6:], FLOW)
    np.testing.assert_allclose(table["Zeit"], 0.1 * np.arange(len(flows)))


@pytest.mark.parametrize("mark", [",", "."])
def test_three_decimals_stay_decimals(tmp_path, mark):
    values = [1.013, 1.1, 390.25, 999.5, 1000.125, 2.0]
    texts = [f"{value:.3f}".replace(".", mark) for value in values]
    np.testing.assert_array_equal(read_raw(written(tmp_path, range(6), texts)).table["Luft"], values)


def test_quoted_three_decimals_between_commas_stay_decimals(tmp_path):
    texts = [f'"{time},{row}00"' for row, time in enumerate([0, 0, 0, 1])]
    table = read_raw(written(tmp_path, texts, ['"1,500"', '"2,500"', '"0,125"', '"999,000"'], ",")).table
    np.testing.assert_array_equal(table["Luft"], [1.5, 2.5, 0.125, 999.0])


def test_dates_with_points_are_no_thousands(tmp_path):
    lines = "".join(f"01.05.2024;12:00:00,{row};1.01{row},5\n" for row in range(4))
    (tmp_path / "a.csv").write_text("Datum;Zeit;Luft\n" + lines)
    np.testing.assert_array_equal(read_raw(tmp_path / "a.csv").table["Luft"], [1010.5, 1011.5, 1012.5, 1013.5])


@pytest.mark.parametrize("mark", [",", "."])
def test_kept_zeros_tell_thousands_where_no_other_number_does(tmp_path, mark):
    raw = read_raw(written(tmp_path, range(0, 600, 100), grouped(mark)))
    np.testing.assert_array_equal(raw.table["Luft"], FLOW)  # 1.250 keeps its zero


@pytest.mark.parametrize("mark", [",", "."])
def test_what_could_be_either_is_refused_beside_whole_numbers_and_noted_alone(tmp_path, mark):
    path = written(tmp_path, range(0, 600, 100), ["390", "999", f"1{mark}013", "998", "997", "990"])
    with pytest.raises(InputError, match=f"column Luft: got 999 and 1[{mark}]013: decimals or thousands"):
        read_raw(path)
    raw = read_raw(written(tmp_path, range(0, 600, 100), [f"1{mark}01{row}" for row in range(6)]))
    np.testing.assert_allclose(raw.table["Luft"], 1.01 + 0.001 * np.arange(6))
    assert any("of Luft are read as decimal ones" in note for note in raw.notes)


@pytest.mark.parametrize(("cell", "mark"), [("0,5", ","), ("0.123", "."), ("1.234,5", ","), ("1,234.567", "."),
                                            ("1013,250", ","), ("1.013", None), ("26,621", None), ("1e-3", None)])
def test_marks_without_doubt(cell, mark):
    assert clear_mark([cell]) == mark


@pytest.mark.parametrize(
    ("cells", "got"),
    [(["10.250", "10.500", '"12,512"'], "12,512 beside 10.250"), (["12", "13", '"12,500"'], "12,500 beside 12"),
     (["180", "190", '"181,549"'], "181,549 beside 180"), (["990", "1010", '"1,200"'], "1,200 beside 990")],
)  # fmt: skip
def test_three_digits_behind_a_comma_in_one_cell_are_not_taken_for_thousands(tmp_path, cells, got):
    """One cell "12,512" of a typist among 10.25 and 10.5 was read as 12512 without a word."""
    path = tmp_path / "typed.csv"
    path.write_text("time_s,y\n" + "".join(f"{0.1 * i:.1f},{cells[min(i, 2)]}\n" for i in range(3)))
    with pytest.raises(InputError, match=f"column y, data row 3: got {got}: decimals or thousands"):
        read_raw(path)


@pytest.mark.parametrize(
    ("cells", "last"),
    [(["10.25", "10.50", '"12,5"'], 12.5), (["990", "995", '"1,013"'], 1013.0),
     (["990.5", "995.5", '"1,013.5"'], 1013.5)],
)  # fmt: skip
def test_a_comma_that_leaves_no_doubt_is_read(tmp_path, cells, last):
    path = tmp_path / "typed.csv"
    path.write_text("time_s,y\n" + "".join(f"{0.1 * i:.1f},{cells[min(i, 2)]}\n" for i in range(3)))
    assert read_raw(path).table["y"].iloc[-1] == last
