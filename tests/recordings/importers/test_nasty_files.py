"""Files as people really have them: each read right, or refused in one line. The list is the documentation."""

from __future__ import annotations

import gzip
import io
import zipfile
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.io

from dieseltwin.errors import InputError
from dieseltwin.recordings.importers.read import read_raw
from dieseltwin.recordings.importers.signals import unreadable

TIME, SPEED = [0.0, 0.1, 0.2, 0.3], [1000.0, 1001.5, 1002.0, 1003.25]


def rows(separator: str = ";", decimal: str = ",", time=TIME) -> str:
    pairs = (f"{t if isinstance(t, str) else f'{t:.1f}'}{separator}{n:.2f}\n" for t, n in zip(time, SPEED, strict=True))
    return "".join(pairs).replace(".", decimal) if decimal != "." and not isinstance(time[0], str) else "".join(pairs)


HEAD = "Zeit;Drehzahl\n"
READ: dict[str, tuple[str, bytes]] = {
    "decimal comma and semicolons": ("a.csv", (HEAD + rows()).encode()),
    "Excel's mark of UTF-8": ("a.csv", ("Zeit,Drehzahl\n" + rows(",", ".")).encode("utf-8-sig")),
    "UTF-16 with tabs, as Excel saves 'Unicode text'": ("a.txt", ("Zeit\tDrehzahl\n" + rows("\t")).encode("utf-16")),
    "UTF-16 without a mark": ("a.csv", ("Zeit\tDrehzahl\n" + rows("\t")).encode("utf-16-le")),
    "Windows-1252 umlauts and a degree sign": ("a.csv", ("Prüfstand 3 °C\n" + HEAD + rows()).encode("cp1252")),
    "gzip": ("a.csv.gz", gzip.compress((HEAD + rows()).encode())),
    "gzip that lost its ending": ("a.csv", gzip.compress((HEAD + rows()).encode())),
    "a row of units in brackets": ("a.csv", (HEAD + "[s];[1/min]\n" + rows()).encode()),
    "a row of units below, INCA's preamble above": (
        "a.ascii", ("Version: 7.2\nRecorder;default\nDatum;01.05.2024\n\n" + HEAD + "s;1/min\n\n" + rows()).encode()),
    "an oscilloscope's units under the names": (
        "a.csv", ('"Zeit","Drehzahl"\n"(s)","(rpm)"\n\n' + rows(",", ".")).encode()),
    "Excel's line sep=;": ("a.csv", ("sep=;\n" + HEAD + rows()).encode()),
    "comments above": ("a.csv", ("# logger 4.2\n# car 17\nZeit,Drehzahl\n" + rows(",", ".")).encode()),
    "the names in a comment": ("a.csv", ("# Zeit,Drehzahl\n" + rows(",", ".")).encode()),
    "a comment above the names in a comment": ("a.csv", ("# logger 4.2\n# Zeit,Drehzahl\n" + rows(",", ".")).encode()),
    "two comments as long as a row": ("a.csv", ("# car, 17\n# Zeit,Drehzahl\n" + rows(",", ".")).encode()),
    "names and units in comments": ("a.csv", ("# Zeit,Drehzahl\n# s,1/min\n" + rows(",", ".")).encode()),
    "names in a comment, and comments below": (
        "a.csv", ("// Zeit,Drehzahl\n" + rows(",", ".").replace("\n0.2", "\n# pause, short\n0.2")).encode()),
    "thousands by points": ("a.csv", (HEAD + "0,0;1.000,00\n0,1;1.001,50\n0,2;1.002,00\n0,3;1.003,25\n").encode()),
    "thousands by commas, in quotes": (
        "a.csv", b'Zeit,Drehzahl\n0.0,"1,000.00"\n0.1,"1,001.50"\n0.2,"1,002.00"\n0.3,"1,003.25"\n'),
    "blanks between columns of fixed width": ("a.txt", ("Zeit  Drehzahl\n" + rows("   ", ".")).encode()),
    "old Mac line ends": ("a.csv", (HEAD + rows()).replace("\n", "\r").encode()),
    "a separator at the end of every line": ("a.csv", (HEAD + rows()).replace("\n", ";\n").encode()),
    "pandas' index in front": (
        "a.csv", b",Zeit,Drehzahl\n" + b"".join(b"%d,%.1f,%.2f\n" % (i, t, n) for i, (t, n) in
                                              enumerate(zip(TIME, SPEED, strict=True)))),
    "words at the end": ("a.csv", (HEAD + rows() + "End of measurement\n").encode()),
    "zeros at the end, the logger lost power": ("a.csv", (HEAD + rows()).encode() + b"\0" * 300),
    "German date stamps": ("a.csv", (HEAD + rows(time=[f"01.05.2024 23:59:59,{i}" for i in (6, 7, 8, 9)])).encode()),
    "ISO stamps in UTC": ("a.csv", ("Zeit,Drehzahl\n" + rows(",", ".", [f"2024-05-01T10:00:00.{i}Z" for i in range(4)])
                                    ).encode()),
    "times of day across midnight": ("a.csv", ("Zeit,Drehzahl\n" + rows(
        ",", ".", ["23:59:59.8", "23:59:59.9", "00:00:00.0", "00:00:00.1"])).encode()),
    "date and time in two columns": ("a.csv", ("Datum;Zeit;Drehzahl\n" + rows(
        ";", ".", [f"01.05.2024;12:00:00.{i}" for i in range(4)])).encode()),
    "a clock put back for winter": ("a.csv", ("Zeit,Drehzahl\n" + rows(",", ".", [
        "2026-10-25 02:59:59.8", "2026-10-25 02:59:59.9", "2026-10-25 02:00:00.0", "2026-10-25 02:00:00.1"])).encode()),
    "a clock put forward for summer": ("a.csv", ("Zeit,Drehzahl\n" + rows(",", ".", [
        "29.03.2026 01:59:59.8", "29.03.2026 01:59:59.9", "29.03.2026 03:00:00.0", "29.03.2026 03:00:00.1"])).encode()),
    "names of time zones": ("a.csv", ("Zeit,Drehzahl\n" + rows(",", ".", [
        "2026-10-25 02:59:59.8 CEST", "2026-10-25 02:59:59.9 CEST", "2026-10-25 02:00:00.0 CET",
        "2026-10-25 02:00:00.1 CET"])).encode()),
    "a phone's stamps": ("a.csv", ("Zeit,Drehzahl\n" + rows(",", ".", [
        f"23-Nov-2026 14:15:47.{i}" for i in range(4)])).encode()),
    "stamps with the year at the end": ("a.csv", ("Zeit,Drehzahl\n" + rows(",", ".", [
        f"Mon Nov 23 11:58:47.{i} GMT+01:00 2026" for i in range(4)])).encode()),
    "German months": ("a.csv", ("Zeit;Drehzahl\n" + rows(";", ".", [
        f"23. Okt 2026 14:15:47,{i}" for i in range(4)])).encode()),
    "minutes and seconds": ("a.csv", ("Zeit,Drehzahl\n" + rows(",", ".", [f"59:59.{i}" for i in range(4)])).encode()),
    "thousands by apostrophes": (
        "a.csv", b"Zeit;Drehzahl\n0.0;1'000.00\n0.1;1'001.50\n0.2;1'002.00\n0.3;1'003.25\n"),
    "thousands by narrow blanks": (
        "a.csv", (HEAD + rows().replace("1000", "1\u202f000").replace("1001", "1\u202f001")).encode()),
    "decimal commas in quotes between commas": (
        "a.csv", b'"Zeit","Drehzahl"\n"0,0","1000,00"\n"0,1","1001,50"\n"0,2","1002,00"\n"0,3","1003,25"\n'),
    "cells that carry the unit": ("a.csv", (HEAD + rows().replace(";", " s;").replace("\n", " rpm\n")).encode()),
    "the names once more in the middle": (
        "a.csv", ("Zeit,Drehzahl\n" + rows(",", ".").replace("0.2,", "Zeit,Drehzahl\n0.2,")).encode()),
    "a CSV called .xlsx": ("a.xlsx", (HEAD + rows()).encode()),
    "a text column beside": ("a.csv", (HEAD.strip() + ";Kommentar\n" + rows().replace("\n", ";IDLE\n")).encode()),
}  # fmt: skip


@pytest.mark.parametrize("what", READ)
def test_read_right(tmp_path, what):
    name, content = READ[what]
    (tmp_path / name).write_bytes(content)
    table = read_raw(tmp_path / name).table
    assert table is not None
    np.testing.assert_allclose(table["Zeit"].to_numpy(dtype=float), TIME, atol=1e-9)
    np.testing.assert_allclose(table["Drehzahl"].to_numpy(dtype=float), SPEED)
    if "unit" in what:
        rpm = "scope" in what or "cells" in what
        assert read_raw(tmp_path / name).units == {"Zeit": "s", "Drehzahl": "rpm" if rpm else "1/min"}


def test_rows_between_stamps_without_fractions_are_spread_evenly(tmp_path):
    seconds = np.arange(23) // 5 + 12
    text = "".join(f"2026-11-23 10:00:{second},{900 + row}\n" for row, second in enumerate(seconds))
    (tmp_path / "a.csv").write_text("Time,n_e\n" + text)
    raw = read_raw(tmp_path / "a.csv")
    np.testing.assert_allclose(np.diff(raw.table["Time"]), 0.2)
    assert any("steps by 1 s, 5 rows each" in note for note in raw.notes)


def test_a_reading_a_row_becomes_channels_with_times_of_their_own(tmp_path):
    lines = [f'"{0.1 * row:.1f}";"{name}";"{value + row}";"{unit}";' for row in range(30)
             for name, value, unit in (("rpm", 1000, "rpm"), ("boost", 120, "kPa"), ("EGT", 300, "°C"))
             if row % 3 == 0 or name == "rpm"]  # fmt: skip
    (tmp_path / "a.csv").write_text('"SECONDS";"PID";"VALUE";"UNITS";\n' + "\n".join(lines))
    signals = read_raw(tmp_path / "a.csv").signals
    assert {name: signal.unit for name, signal in signals.items()} == {"rpm": "rpm", "boost": "kPa", "EGT": "°C"}
    np.testing.assert_allclose(signals["boost"].time_s, 0.3 * np.arange(10))
    np.testing.assert_allclose(signals["rpm"].values, 1000.0 + np.arange(30))


@pytest.mark.parametrize("word", ["", "NaN", "n/a", "#N/A", "---", "1.#QNAN", "INVALID", "#DIV/0!", "null"])
def test_every_word_for_no_reading_is_missing(tmp_path, word):
    (tmp_path / "a.csv").write_text(f"Zeit;Drehzahl;p\n0,0;1000;1\n0,1;{word};2\n0,2;1002;3\n0,3;1003;4\n")
    table = read_raw(tmp_path / "a.csv").table
    assert table is not None and np.isnan(table["Drehzahl"][1]) and table["Drehzahl"].notna().sum() == 3


def zipped(**files: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in files.items():
            archive.writestr(name.replace("__", "/"), content)
    return buffer.getvalue()


def timetable() -> bytes:
    buffer = io.BytesIO()
    scipy.io.savemat(buffer, {"text": "only words"})
    return buffer.getvalue()


REFUSED: dict[str, tuple[str, bytes, str]] = {
    "empty": ("a.csv", b"", "empty"),
    "names only": ("a.csv", b"Zeit;Drehzahl\n", "no rows"),
    "numbers without names": ("a.csv", b"0,1000\n1,1001\n2,1002\n", "names in the first row"),
    "one column": ("a.csv", b"n\n1\n2\n3\n", "two columns"),
    "a million columns": ("a.csv", b",".join(b"c%d" % i for i in range(1_000_000)) + b"\n", "at most 20000"),
    "a name twice": ("a.csv", b"t,n,n\n0,1,2\n1,2,3\n", "twice"),
    "rows of different lengths": ("a.csv", b"a,b\n1,2\n1,2\n1,2,3,4\n", "line 4"),
    "prose": ("a.csv", b"Dear colleague,\nplease find attached\nthe measurement.\n", "no readable CSV"),
    "a web page": ("a.csv", b"<!DOCTYPE html><html><body>log in</body></html>", "web page"),
    "JSON": ("a.json", b'[{"t": 0}]', "JSON"),
    "a PDF": ("a.pdf", b"%PDF-1.7\n%\xe2\xe3\xcf\xd3\n", "PDF"),
    "a picture": ("a.png", b"\x89PNG\r\n\x1a\n" + bytes(50), "picture"),
    "a Git LFS pointer": ("a.mf4", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "git lfs pull"),
    "old Excel": ("a.xls", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(600), "save it as .xlsx"),
    "a zip with a CSV": ("a.zip", zipped(**{"a.csv": b"t,n\n0,1\n"}), "unpack"),
    "binary Excel": ("a.xlsb", zipped(xl__workbook_bin=b"").replace(b"workbook_bin", b"workbook.bin"), "xlsb"),
    "a broken gzip": ("a.csv.gz", gzip.compress(b"t,n\n" + b"0,1\n" * 5000)[:60], "gzip"),
    "a truncated MDF": ("a.mf4", b"MDF     4.10    " + bytes(200), "MDF"),
    "half a MATLAB file": (
        "a.mat", b"MATLAB 5.0 MAT-file, Platform".ljust(124) + b"\x00\x01IM" + b"\x0f\0\0\0\xff", "MATLAB"),
    "a MATLAB file of words": ("a.mat", timetable(), "vectors"),
    "HDF5 that stops": ("a.mat", b"\x89HDF\r\n\x1a\n" + bytes(40), "7.3"),
    "nothing but zeros": ("a.blf", bytes(5000), "zero"),
    "noise": ("a.bin", bytes(range(256)) * 20, "binary"),
    "a BLF that stops": ("a.blf", b"LOGG" + bytes(20), "BLF"),
    "a DBC in place of the trace": ("a.dbc", b'VERSION ""\n\nBO_ 100 M: 8 X\n', "describes a bus"),
    "a CAN trace without times": ("a.log", b"  can0  18FEF600   [8]  FF 28 55 2E FF 60 5A FF\n" * 5, "times"),
    "Parquet that stops": ("a.parquet", b"PAR1" + bytes(30), "Parquet"),
    "names and numbers with different separators": ("a.csv", b"t;n;p\n0.0,1,2\n0.1,2,3\n", "same separator"),
    "a clock that can't be read": ("a.csv", b"Time,n,p\n12:61:77x,1,2\n12:61:78x,2,2\n12:61:79x,3,2\n",
                                   "date and time such as"),
    "a stamp that is none": (
        "a.csv", b"t,n\n2024-05-01 10:00:00,1\n2024-05-01 10:00:01,2\nyesterday,3\n", "data row 3"),
}  # fmt: skip


@pytest.mark.parametrize("version", ["3.30", "4.10"])
def test_a_measurement_cut_in_the_middle_is_one_line_and_nothing_on_stderr(tmp_path, version, capfd):
    asammdf = pytest.importorskip("asammdf")
    whole, path = tmp_path / "whole.mf4", tmp_path / "half.mf4"
    with asammdf.MDF(version=version) as mdf:
        mdf.append(asammdf.Signal(np.arange(5000.0), np.arange(5000.0), name="n_e"))
        whole = mdf.save(whole, overwrite=True)
    path.write_bytes(whole.read_bytes()[:30_000])
    with pytest.raises(InputError, match="MDF") as error:
        read_raw(path)
    assert "\n" not in str(error.value) and capfd.readouterr().err == ""


def test_a_librarys_object_is_not_printed():
    error = unreadable(Path("a.mf4"), "MDF", ValueError("seek in <mmap.mmap closed=False, length=300>\n out of range"))
    assert "no readable MDF (seek in its content out of range)" in str(error)


@pytest.mark.parametrize("what", REFUSED)
def test_refused_in_one_line(tmp_path, what):
    name, content, word = REFUSED[what]
    path: Path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError) as error:
        read_raw(path)
    message = str(error.value)
    assert name in message and word in message and "\n" not in message and len(message) < 400, message


LONG = "Zeit,Drehzahl,Druck\n" + "".join(f"{0.1 * k:.1f},{1000 + k:.2f},{100 + k:.3f}\n" for k in range(60))


@pytest.mark.parametrize(
    ("ending", "kept", "said"),
    [
        ("6.0,10", 60, "ends in cell 2 of 3"),  # of 1060.00
        ("6.0,1060.00,", 60, "ends in cell 3 of 3"),
        ("6.0,1060.00,16", 60, "ends in cell 3 of 3"),  # of 160.000
        ('6.0,"10', 60, "ends in cell 2 of 3"),
        ("6.0,1060.00\n", 61, "only 2 of 3 cells"),
        ("6.0,1060.00,160.000", 61, None),
        ("6.0,1060.00,160.000\n", 61, None),
        ("6.0,1060.00,\n", 61, None),
        ("End of measurement\n", 60, "lines of text at the end"),
    ],
)
def test_a_last_row_that_is_cut_off_is_left_out_and_said(
    ending: str, kept: int, said: str | None, tmp_path: Path
) -> None:
    file = tmp_path / "a.csv"
    file.write_text(LONG + ending)
    found = read_raw(file)
    assert found.table is not None and len(found.table) == kept
    assert len(found.notes) == (said is not None) and (said is None or said in found.notes[0]), found.notes


@pytest.mark.parametrize(("start", "form", "began", "said"), [
    ("2026-03-05 23:59:00", "%d/%m/%Y", "2026-03-05", False),  # the 6th follows, and no month later
    ("2026-03-05 23:59:00", "%m/%d/%Y", "2026-03-05", False),
    ("2026-03-12 23:59:00", "%d/%m/%Y", "2026-03-12", False),
    ("2026-03-25 12:00:00", "%d/%m/%Y", "2026-03-25", False),
    ("2026-03-05 12:00:00", "%d/%m/%Y", "2026-05-03", True),
    ("2026-05-05 12:00:00", "%d/%m/%Y", "2026-05-05", False),
])  # fmt: skip
def test_day_and_month_are_told_by_all_rows(tmp_path, start, form, began, said):
    """One that goes past midnight was read as a month apart, and the first row's date as another one than the rows'."""
    since = np.round(0.5 * np.arange(240), 1)
    stamps = pd.Series(pd.Timestamp(start) + pd.to_timedelta(since, unit="s")).dt.strftime(f"{form} %H:%M:%S.%f")
    pd.DataFrame({"Zeit": stamps, "Drehzahl": 1000.0 + since}).to_csv(tmp_path / "a.csv", index=False)
    raw = read_raw(tmp_path / "a.csv")
    assert raw.table is not None and raw.began is not None and f"{raw.began:%Y-%m-%d}" == began
    np.testing.assert_allclose(raw.table["Zeit"], since, atol=1e-6)
    assert any("month first" in note for note in raw.notes) == said


def workbook(path: Path, names: list[str], cells: list[list[object]]) -> Path:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in (names, *cells):
        book.active.append(row)
    book.save(path)
    return path


def paired(first: list, second: list) -> list[list[object]]:
    return [list(row) for row in zip(first, second, strict=True)]


@pytest.mark.parametrize("kind", ["dates", "spans", "times of day"])
def test_an_excel_sheet_may_hold_dates_as_such(tmp_path, kind):
    """Dates and spans of time in cells were read as us since 1970, and ended in 460 days."""
    start = datetime(2026, 3, 5, 12, 0)
    stamps = [start + timedelta(seconds=t) for t in TIME]
    clock = {"dates": stamps, "spans": [s - start for s in stamps], "times of day": [s.time() for s in stamps]}[kind]
    raw = read_raw(workbook(tmp_path / "a.xlsx", ["Zeit", "Drehzahl"], paired(clock, SPEED)))
    assert raw.table is not None and raw.units["Zeit"] == "s"
    np.testing.assert_allclose(raw.table["Zeit"], TIME, atol=1e-6)
    assert (raw.began is None) == (kind != "dates")


@pytest.mark.parametrize("form", ["english", "german", "half"])
def test_an_excel_sheet_may_hold_numbers_as_text(tmp_path, form):
    """1,001.50 stayed text, and 101,325 became 101.325."""
    german = [f"{n:,.2f}".translate(str.maketrans(",.", ".,")) for n in SPEED]
    english = [f"{n:,.2f}" for n in SPEED]
    text = {"german": german, "half": [SPEED[0], *english[1:]]}.get(form, english)
    raw = read_raw(workbook(tmp_path / "a.xlsx", ["Zeit", "Drehzahl"], paired(TIME, text)))
    assert raw.table is not None and raw.table["Drehzahl"].tolist() == SPEED
