"""One simulated drive, written by every format's own library, gives the same recording."""

from __future__ import annotations

import gzip
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.io

import dieseltwin as dt
from dieseltwin.errors import InputError
from dieseltwin.recordings.importers.read import read_raw
from dieseltwin.recordings.reader import read_recording

REFERENCE = Path(__file__).parents[2] / "reference"
COLUMNS = ["time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct", "p_im_pa", "p_em_pa", "omega_t_rad_s",
           "w_egr_kg_s", "t_em_k", "w_c_kg_s"]  # fmt: skip
UNITS = {"time_s": "s", "n_e_rpm": "rpm", "p_im_pa": "Pa", "t_em_k": "K"}
WRITERS: dict[str, Callable[[pd.DataFrame, Path], None]] = {}


@pytest.fixture(scope="module")
def drive(trace: pd.DataFrame) -> pd.DataFrame:
    """A minute of simulated driving at 5 Hz."""
    return trace[COLUMNS][:301]


def writer(name: str):
    def registered(function):
        WRITERS[name] = function
        return function

    return registered


@writer("comma.csv")
def _(drive, path):
    drive.to_csv(path, index=False)


@writer("german.csv")
def _(drive, path):
    drive.to_csv(path, index=False, sep=";", decimal=",", encoding="utf-16")


@writer("packed.csv.gz")
def _(drive, path):
    path.write_bytes(gzip.compress(drive.to_csv(index=False, sep="\t").encode("utf-8-sig")))


@writer("units.txt")
def _(drive, path):
    rows = drive.to_csv(index=False, sep=";").split("\n")
    rows.insert(1, ";".join(f"[{UNITS.get(name, '-')}]" for name in drive))
    path.write_text("Test bench 3\nDate;01.05.2024\n\n" + "\n".join(rows))


@writer("drive.parquet")
def _(drive, path):
    drive.to_parquet(path)


@writer("drive.xlsx")
def _(drive, path):
    pytest.importorskip("openpyxl")
    with pd.ExcelWriter(path) as book:
        pd.DataFrame({"about": ["bench 3"]}).to_excel(book, sheet_name="Info", index=False)
        drive.to_excel(book, sheet_name="Messung", index=False, startrow=3)


@writer("version5.mat")
def _(drive, path):
    scipy.io.savemat(path, {name: drive[name].to_numpy() for name in drive})


@writer("structure.mat")
def _(drive, path):
    scipy.io.savemat(path, {"data": {name: drive[name].to_numpy()[:, None] for name in drive}}, do_compression=True)


@writer("version4.mat")
def _(drive, path):
    scipy.io.savemat(path, {name: drive[name].to_numpy() for name in drive}, format="4")


@writer("simulink.mat")
def _(drive, path):
    signals = np.array([{"values": drive[name].to_numpy(), "label": name} for name in COLUMNS[1:]], dtype=object)
    scipy.io.savemat(path, {"out": {"time": drive["time_s"].to_numpy(), "signals": signals}})


@writer("version73.mat")
def _(drive, path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name in drive:
            vector = file.create_dataset(name, data=drive[name].to_numpy()[None, :])
            vector.attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def _measurement(drive, path, version: str, one_group: bool) -> None:
    asammdf = pytest.importorskip("asammdf")
    signals = [
        asammdf.Signal(drive[name].to_numpy(), drive["time_s"].to_numpy(), name=name, unit=UNITS.get(name, ""))
        for name in COLUMNS[1:]
    ]
    with asammdf.MDF(version=version) as mdf:
        for group in [signals] if one_group else [[signal] for signal in signals]:
            mdf.append(group)
        mdf.save(path, overwrite=True, compression=0 if one_group else 2)


@writer("version3.mdf")
def _(drive, path):
    _measurement(drive, path, "3.30", one_group=True)


@writer("version4.mf4")
def _(drive, path):
    _measurement(drive, path, "4.10", one_group=False)


BUS = """VERSION ""
BU_: ECU
{messages}
"""


def _bus(drive: pd.DataFrame, folder: Path) -> tuple[Path, list]:
    """A DBC with one double per column, and the drive as frames."""
    can = pytest.importorskip("can")
    pytest.importorskip("cantools")
    messages = [
        f'BO_ {256 + i} M{i}: 8 ECU\n SG_ {name} : 0|64@1- (1,0) [0|0] "{UNITS.get(name, "")}" ECU'
        for i, name in enumerate(COLUMNS[1:])
    ]
    kinds = "\n".join(f"SIG_VALTYPE_ {256 + i} {name} : 2;" for i, name in enumerate(COLUMNS[1:]))
    database = folder / "bus.dbc"
    database.write_text(BUS.format(messages="\n\n".join(messages)) + "\n" + kinds + "\n")
    frames = [
        can.Message(timestamp=time, arbitration_id=256 + i, is_extended_id=False, data=struct.pack("<d", value))
        for time, row in zip(drive["time_s"], drive[COLUMNS[1:]].to_numpy(), strict=True) for i, value in enumerate(row)
    ]  # fmt: skip
    return database, frames


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_gives_the_same_recording(tmp_path, drive, name):
    path = tmp_path / name
    WRITERS[name](drive, path)
    made = read_recording(path)
    for column in COLUMNS:
        np.testing.assert_array_equal(made.columns[column], drive[column], err_msg=column)
    assert len(made.segments(60.0)) == 1


@pytest.mark.parametrize("ending", ["blf", "asc", "log"])
def test_a_trace_with_its_dbc_gives_the_same_recording(tmp_path, drive, ending):
    can = pytest.importorskip("can")
    _, frames = _bus(drive, tmp_path)
    path = tmp_path / f"drive.{ending}"
    with can.Logger(path) as log:
        for frame in frames:
            log.on_message_received(frame)
    (tmp_path / "map.yaml").write_text("dbc: bus.dbc\n")
    made = dt.read(path, tmp_path / "map.yaml")
    for column in COLUMNS[1:]:
        np.testing.assert_allclose(made.columns[column], drive[column], rtol=0, atol=0, err_msg=column)
    np.testing.assert_allclose(made.time_s - made.time_s[0], drive["time_s"], atol=2e-6)  # what the formats resolve
    assert read_raw(path, tmp_path / "bus.dbc").signals["p_im_pa"].unit == "Pa"


def test_vectors_of_several_lengths_have_the_unit_of_their_clock(tmp_path, drive):
    """Times in ms were taken as s where a MATLAB file had more than one raster."""
    clock = {"values": 1e3 * drive["time_s"].to_numpy(), "unit": "ms"}
    slow = {"p_em": drive["p_em_pa"].to_numpy()[::5], "time": {**clock, "values": clock["values"][::5]}}
    scipy.io.savemat(tmp_path / "a.mat", {"fast": {"n_e": drive["n_e_rpm"].to_numpy(), "time": clock}, "slow": slow})
    signals = read_raw(tmp_path / "a.mat").signals
    np.testing.assert_allclose(signals["fast.n_e"].time_s, drive["time_s"], atol=1e-9)
    np.testing.assert_allclose(signals["slow.p_em"].time_s, drive["time_s"][::5], atol=1e-9)


@pytest.mark.parametrize("ending", ["csv", "parquet", "xlsx"])
def test_an_index_of_dates_is_the_time_in_every_format(tmp_path, drive, ending):
    """A CSV, whose index pandas leaves without a name, had no time."""
    stamped = drive.set_index(pd.Timestamp("2026-03-05 12:00") + pd.to_timedelta(drive["time_s"].to_numpy(), unit="s"))
    path = tmp_path / f"drive.{ending}"
    table = stamped.drop(columns="time_s").rename_axis(None)
    {"csv": table.to_csv, "parquet": table.to_parquet, "xlsx": table.to_excel}[ending](path)
    read = read_recording(path)
    np.testing.assert_allclose(read.time_s, drive["time_s"], atol=1e-6)
    assert read.began is not None and f"{read.began:%Y-%m-%d %H:%M}" == "2026-03-05 12:00"


def test_a_broken_or_unknown_frame_costs_no_trace(tmp_path):
    """A page that the DBC lacks, and a last line that ends in the middle of a byte, ended in a traceback."""
    pytest.importorskip("cantools")
    signals = (' SG_ Page M : 0|8@1+ (1,0) [0|255] "" ECU\n SG_ Boost m0 : 8|16@1+ (0.1,0) [0|6000] "kPa" ECU\n'
               ' SG_ Temp m1 : 8|16@1+ (0.1,0) [0|6000] "K" ECU\n')  # fmt: skip
    (tmp_path / "bus.dbc").write_text(BUS.format(messages=f"BO_ 256 Mux: 8 ECU\n{signals}"))
    lines = [f"({0.1 * k:.6f}) can0 100#{k % 3:02X}E8030000000000\n" for k in range(30)]
    (tmp_path / "a.log").write_text("".join(lines) + "(3.000000) can0 100#00E80")
    raw = read_raw(tmp_path / "a.log", tmp_path / "bus.dbc")
    for name in ("Boost", "Temp"):
        np.testing.assert_allclose(raw.signals[name].values, np.full(10, 100.0))
    assert any("1 lines that are no frame" in note for note in raw.notes)
    assert any("10 frames of Mux can't be decoded by bus.dbc" in note for note in raw.notes)


def test_the_content_decides_not_the_ending(tmp_path, drive):
    drive.to_parquet(tmp_path / "drive.csv")
    drive.to_csv(tmp_path / "drive.parquet", index=False)
    for name in ("drive.csv", "drive.parquet"):
        np.testing.assert_array_equal(read_recording(tmp_path / name).columns["t_em_k"], drive["t_em_k"])


def test_units_come_along(tmp_path, drive):
    for name in ("units.txt", "version4.mf4"):
        WRITERS[name](drive, tmp_path / name)
    assert read_raw(tmp_path / "units.txt").units["t_em_k"] == "K"
    assert read_raw(tmp_path / "version4.mf4").signals["p_im_pa"].unit == "Pa"


def test_a_missing_library_is_one_line_that_says_what_to_install(tmp_path, drive, monkeypatch):
    WRITERS["drive.xlsx"](drive, tmp_path / "drive.xlsx")
    WRITERS["version4.mf4"](drive, tmp_path / "version4.mf4")
    for module in ("openpyxl", "asammdf"):
        monkeypatch.setitem(__import__("sys").modules, module, None)
    for name in ("drive.xlsx", "version4.mf4"):
        with pytest.raises(InputError, match=r"pip install 'dieseltwin\[formats\]'") as error:
            read_recording(tmp_path / name)
        assert "\n" not in str(error.value)


def test_slow_sensors_stay_slow(tmp_path):
    """Turbo speed at 1 Hz and boost at 2 Hz beside inputs at 50 Hz: rows at 5 Hz, nothing held between the readings."""
    asammdf = pytest.importorskip("asammdf")
    reference = pd.read_csv(REFERENCE / "field_random_300s.csv")

    def sampled(name: str, step: float, phase: float = 0.0) -> object:
        time = np.arange(phase, 120.0, step)
        values = np.interp(time, reference["time_s"], reference[name])
        return asammdf.Signal(values, time, name=name)

    steps = {"n_e_rpm": 0.02, "u_delta_mg": 0.02, "u_egr_pct": 0.1, "u_vgt_pct": 0.1, "p_em_pa": 0.1, "p_im_pa": 0.5,
             "omega_t_rad_s": 1.0, "w_egr_kg_s": 0.05, "t_em_k": 0.5}  # fmt: skip
    with asammdf.MDF(version="4.10") as mdf:
        for name, step in steps.items():
            mdf.append(sampled(name, step))
        mdf.save(tmp_path / "rasters.mf4")
    made = read_recording(tmp_path / "rasters.mf4")
    np.testing.assert_allclose(np.diff(made.time_s), 0.2)
    present = {name: int(np.isfinite(made.columns[name]).sum()) for name in steps}
    assert present["omega_t_rad_s"] == pytest.approx(120, abs=1) and present["p_im_pa"] == pytest.approx(240, abs=1)
    assert present["p_em_pa"] == len(made.time_s)
    turbo = np.flatnonzero(np.isfinite(made.columns["omega_t_rad_s"]))
    truth = np.interp(made.time_s[turbo], reference["time_s"], reference["omega_t_rad_s"])
    np.testing.assert_allclose(made.columns["omega_t_rad_s"][turbo], truth, rtol=1e-6)
    assert any("omega_t_rad_s every 1 s" in note for note in made.notes)


def test_a_held_channel_of_a_table_counts_at_its_own_readings_only(drive):
    from dieseltwin.recordings.reader import recording

    held = drive.assign(omega_t_rad_s=drive["omega_t_rad_s"].to_numpy()[(np.arange(len(drive)) // 5) * 5])
    made = recording(held)
    present = np.isfinite(made.columns["omega_t_rad_s"])
    np.testing.assert_array_equal(np.flatnonzero(present), np.arange(0, len(drive), 5))
    assert any("omega_t_rad_s is held" in note for note in made.notes)
    assert recording(drive).notes == ()


def test_one_hertz_is_accepted_and_says_what_it_costs(drive):
    from dieseltwin.recordings.reader import recording

    slow = drive.iloc[::5].reset_index(drop=True)
    made = recording(slow)
    assert len(made.pieces()) == 1
    assert any("1 rows per second" in note and "out of reach" in note for note in made.notes)
    with pytest.raises(InputError, match="rows per second"):
        recording(drive.iloc[::10].reset_index(drop=True))


def test_a_bus_log_in_an_mdf_file_is_read_with_its_dbc(tmp_path, drive):
    asammdf = pytest.importorskip("asammdf")
    database, frames = _bus(drive, tmp_path)
    rows = np.zeros(len(frames), dtype=[("CAN_DataFrame.BusChannel", "u1"), ("CAN_DataFrame.ID", "<u4"),
                                        ("CAN_DataFrame.IDE", "u1"), ("CAN_DataFrame.DLC", "u1"),
                                        ("CAN_DataFrame.DataLength", "u1"), ("CAN_DataFrame.DataBytes", "u1", (8,))])
    for row, frame in zip(rows, frames, strict=True):
        row["CAN_DataFrame.ID"], row["CAN_DataFrame.DataLength"] = frame.arbitration_id, 8
        row["CAN_DataFrame.DataBytes"] = list(frame.data)
    with asammdf.MDF(version="4.10") as mdf:
        mdf.append(asammdf.Signal(rows, np.array([frame.timestamp for frame in frames]), name="CAN_DataFrame"))
        mdf.save(tmp_path / "bus.mf4")
    raw = read_raw(tmp_path / "bus.mf4", database)
    np.testing.assert_array_equal(raw.signals["p_em_pa"].values, drive["p_em_pa"])


def test_a_map_for_an_mdf_file_lets_our_own_names_pass_and_names_the_nearest(tmp_path, drive):
    asammdf = pytest.importorskip("asammdf")
    time = drive["time_s"].to_numpy()
    names = {"p_im_pa": "PBoost", "t_em_k": "TExh"}
    with asammdf.MDF(version="4.10") as mdf:
        for name in COLUMNS[1:]:
            mdf.append(asammdf.Signal(drive[name].to_numpy(), time, name=names.get(name, name)))
        mdf.save(tmp_path / "drive.mf4")
    (tmp_path / "map.yaml").write_text("PBoost: p_im_pa\nTExh: t_em_k\n")
    made = read_recording(tmp_path / "drive.mf4", tmp_path / "map.yaml")
    np.testing.assert_array_equal(made.columns["w_egr_kg_s"], drive["w_egr_kg_s"])
    (tmp_path / "map.yaml").write_text("PBoos: p_im_pa\nTExh: t_em_k\n")
    with pytest.raises(InputError, match="did you mean PBoost"):
        read_recording(tmp_path / "drive.mf4", tmp_path / "map.yaml")


@pytest.mark.parametrize("ending", ["log", "asc", "blf", "mf4", "csv"])
def test_a_clock_that_starts_again_is_refused_and_never_mingles_two_drives(tmp_path, drive, ending):
    twice = pd.concat([drive[:150], drive[:140].assign(time_s=drive["time_s"][:140] + 0.1)], ignore_index=True)
    path, database = tmp_path / f"drive.{ending}", None
    if ending == "mf4":
        asammdf = pytest.importorskip("asammdf")
        speed = asammdf.Signal(twice["n_e_rpm"].to_numpy(), twice["time_s"].to_numpy(), name="n_e")
        with asammdf.MDF(version="4.10") as mdf:
            mdf.append(speed)
            mdf.save(path)
    elif ending == "csv":
        names = ["n_e_rpm", "p_im_pa", "p_em_pa"]
        rows = [f"{time};{name};{value}" for time, *values in twice[["time_s", *names]].to_numpy()
                for name, value in zip(names, values, strict=True)]  # fmt: skip
        path.write_text("time;name;value\n" + "\n".join(rows) + "\n")
    else:
        database, frames = _bus(twice, tmp_path)
        with pytest.importorskip("can").Logger(path) as log:
            for frame in frames:
                log.on_message_received(frame)
    with pytest.raises(InputError, match=r"reading 151: got .* the clock starts again"):
        read_raw(path, database)


def test_buses_written_in_turn_are_put_in_order(tmp_path, drive):
    database, frames = _bus(drive, tmp_path)
    frames[300:310], frames[310:320] = frames[310:320], frames[300:310]
    with pytest.importorskip("can").Logger(tmp_path / "drive.log") as log:
        for frame in frames:
            log.on_message_received(frame)
    raw = read_raw(tmp_path / "drive.log", database)
    np.testing.assert_array_equal(raw.signals["p_em_pa"].values, drive["p_em_pa"])
    assert raw.notes == ("10 channels had times that repeat or fall: sorted, each time once",)


def test_vector_asc_with_times_since_the_last_event_counts_from_the_beginning(tmp_path, drive):
    database, frames = _bus(drive, tmp_path)
    head = "date Mon Nov 23 10:11:12.000 am 2026\nbase hex  timestamps relative\ninternal events logged\n"
    lines, before = [], 0.0
    for row, frame in enumerate(frames):
        if row % 50 == 7:  # an event that is no frame takes part of the time
            lines.append(f"   {frame.timestamp - before:.6f} Start of measurement")
            before = frame.timestamp
        data = " ".join(f"{byte:02X}" for byte in frame.data)
        lines.append(f"   {frame.timestamp - before:.6f} 1  {frame.arbitration_id:X}             Rx   d 8 {data}")
        before = frame.timestamp
    path = tmp_path / "drive.asc"
    path.write_text(head + "\n".join(lines) + "\n")
    signal = read_raw(path, database).signals["p_im_pa"]
    np.testing.assert_allclose(signal.time_s - signal.time_s[0], drive["time_s"], atol=1e-6)
    np.testing.assert_array_equal(signal.values, drive["p_im_pa"])
