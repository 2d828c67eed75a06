"""Recordings: round trips, channel maps, splitting and cutting, and one line for every kind of bad file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dieseltwin.engine import MEASURED, we2011
from dieseltwin.errors import InputError
from dieseltwin.recordings.channels import CONVERSIONS, channel_map, read_channel_map, unit_of
from dieseltwin.recordings.reader import (
    Recording,
    read_recording,
    recording,
    rows_out_of_range,
    write_recording,
)

REFERENCE = Path(__file__).parents[1] / "reference"
NEEDED = [
    "time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct",
    "p_im_pa", "p_em_pa", "omega_t_rad_s", "w_egr_kg_s", "t_em_k",
]  # fmt: skip


@pytest.fixture(scope="module")
def drive(trace: pd.DataFrame) -> pd.DataFrame:
    """Five minutes of real-looking driving at 5 Hz: the required columns and w_c."""
    return trace[[*NEEDED, "w_c_kg_s"]]


def plausible(n: int, seed: int, rate_hz: float, jitter: float) -> pd.DataFrame:
    rng = np.random.default_rng(seed)
    steps = (1.0 + jitter * rng.uniform(-1.0, 1.0, n)) / rate_hz
    ranges = {
        "n_e_rpm": (600, 1900), "u_delta_mg": (5, 200), "u_egr_pct": (0, 80), "u_vgt_pct": (25, 90),
        "p_im_pa": (1e5, 3e5), "p_em_pa": (1.05e5, 3.5e5), "omega_t_rad_s": (1500, 11000), "w_egr_kg_s": (0, 0.1),
        "t_em_k": (900, 1000),
    }  # fmt: skip
    return pd.DataFrame(
        {"time_s": np.cumsum(steps), **{name: rng.uniform(*limits, n) for name, limits in ranges.items()}}
    )


@settings(max_examples=20)
@given(
    n=st.integers(12, 80), seed=st.integers(0, 10**6), rate_hz=st.floats(5.0, 100.0), jitter=st.floats(0.0, 0.4),
    suffix=st.sampled_from([".csv", ".parquet"]),
)  # fmt: skip
def test_round_trip_keeps_every_bit(tmp_path_factory, n, seed, rate_hz, jitter, suffix):
    frame = plausible(n, seed, rate_hz, jitter)
    frame.loc[3, "p_im_pa"] = np.nan
    path = tmp_path_factory.mktemp("round") / f"drive{suffix}"
    write_recording(frame, path)
    read = read_recording(path)
    for name in frame:
        np.testing.assert_array_equal(read.columns[name], frame[name].to_numpy())
    # a second trip through the Recording itself
    write_recording(read, path)
    pd.testing.assert_frame_equal(read_recording(path).frame(), frame)


@given(
    seed=st.integers(0, 1000),
    column=st.sampled_from(["p_im_pa", "t_em_k", "w_egr_kg_s", "omega_t_rad_s", "u_egr_pct"]),
)
def test_named_units_convert_back_and_forth(seed, column):
    values = plausible(20, seed, 5.0, 0.0)[column].to_numpy()
    for unit, (scale, offset) in CONVERSIONS[unit_of(column)].items():
        foreign = (values - offset) / scale
        ours = channel_map({"foreign": {"column": column, "unit": unit}}).apply({"foreign": foreign}, "x")[0][column]
        np.testing.assert_allclose(ours, values, rtol=1e-12)


@pytest.mark.parametrize(
    ("column", "unit", "foreign", "ours"),
    [
        ("p_im_pa", "bar", 1.5, 1.5e5),
        ("p_im_pa", "kPa", 150.0, 1.5e5),
        ("p_im_pa", "psi", 14.5037738, 1e5),
        ("t_em_k", "degC", 26.85, 300.0),
        ("t_em_k", "degF", 32.0, 273.15),
        ("omega_t_rad_s", "krpm", 60.0, 6283.18530718),
        ("w_egr_kg_s", "kg/h", 36.0, 0.01),
        ("u_egr_pct", "fraction", 0.4, 40.0),
        ("time_s", "ms", 200.0, 0.2),
    ],
)
def test_units_against_hand_figures(column, unit, foreign, ours):
    mapped = channel_map({"x": {"column": column, "unit": unit}}).apply({"x": np.array([foreign])}, "file")[0]
    assert mapped[column][0] == pytest.approx(ours, rel=1e-8)


def test_channel_map_file_gives_the_same_recording(tmp_path, drive):
    foreign = drive.rename(columns={"time_s": "Time", "p_im_pa": "P2", "t_em_k": "T3", "u_egr_pct": "EGR"})
    foreign["P2"] = (foreign["P2"] - 101325.0) / 1e3  # gauge, kPa
    foreign["T3"] -= 273.15
    foreign["EGR"] /= 100.0
    foreign["note"] = "a text column that nobody asked for"
    foreign.to_csv(tmp_path / "bench.csv", index=False, sep=";")
    (tmp_path / "map.yaml").write_text(
        "Time: time_s\nP2: {column: p_im_pa, unit: kPa, offset: 101325}\n"
        "T3: {column: t_em_k, unit: degC}\nEGR: {column: u_egr_pct, scale: 100}\n"
    )
    read = read_recording(tmp_path / "bench.csv", tmp_path / "map.yaml")
    for name in drive:
        np.testing.assert_allclose(read.columns[name], drive[name], rtol=1e-12, atol=1e-12)
    assert "note" not in read.columns


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("P2: {column: p_in_pa}\n", ["P2", "p_im_pa"]),  # a plausible-looking name is taken, see below
        ("P2: {column: pim}\n", ["'pim'", "did you mean"]),
        ("P2: {column: p_im_pa, unit: degC}\n", ["degC", "kPa"]),
        ("P2: {column: p_im_pa, units: kPa}\n", ["units", "did you mean unit"]),
        ("P2: p_im_pa\nP3: p_im_pa\n", ["P3", "already"]),
        ("P2: 5\n", ["P2", "column name"]),
        ("- a\n", ["mapping"]),
        ("Nope: p_im_pa\n", ["Nope", "no such column"]),
    ],
)
def test_bad_channel_maps_are_one_line(tmp_path, drive, text, words):
    if "p_in_pa" in text:
        # further channels by the same naming are welcome, so the missing one is what is reported
        words = ["p_im_pa"]
    (tmp_path / "map.yaml").write_text(text)
    drive.rename(columns={"p_im_pa": "P2"}).assign(P3=1e5).to_csv(tmp_path / "d.csv", index=False)
    with pytest.raises(InputError) as error:
        read_recording(tmp_path / "d.csv", tmp_path / "map.yaml")
    assert "\n" not in str(error.value)
    for word in words:
        assert word in str(error.value)


def changed(frame: pd.DataFrame, **columns) -> pd.DataFrame:
    return frame.assign(**columns)


BAD = {
    "missing column": (lambda d: d.drop(columns="t_em_k"), ["t_em_k", "--channels"]),
    "p_im in kPa": (lambda d: changed(d, p_im_pa=d.p_im_pa / 1e3), ["p_im_pa", "kPa"]),
    "p_em in bar": (lambda d: changed(d, p_em_pa=d.p_em_pa / 1e5), ["p_em_pa", "bar"]),
    "p_im in mbar": (lambda d: changed(d, p_im_pa=d.p_im_pa / 1e2), ["p_im_pa", "mbar"]),
    "t_em in degC": (lambda d: changed(d, t_em_k=d.t_em_k - 273.15), ["t_em_k", "degC"]),
    "t_em in degC, loaded engine only": (
        lambda d: changed(d[d.u_delta_mg > 40].reset_index(drop=True), t_em_k=lambda x: x.t_em_k - 273.15),
        ["t_em_k", "degC"],
    ),
    "t_amb in degC": (lambda d: changed(d, t_amb_k=25.0), ["t_amb_k", "degC"]),
    "positions as fractions": (
        lambda d: changed(d, u_egr_pct=d.u_egr_pct / 100, u_vgt_pct=d.u_vgt_pct / 100), ["u_vgt_pct", "fraction"]
    ),
    "one position as fraction": (lambda d: changed(d, u_egr_pct=d.u_egr_pct / 100), ["u_egr_pct", "fraction"]),
    "flap as fraction": (lambda d: changed(d, u_flap_pct=np.linspace(0.1, 0.9, len(d))), ["u_flap_pct", "fraction"]),
    "turbo in rpm": (lambda d: changed(d, omega_t_rad_s=d.omega_t_rad_s * 30 / np.pi), ["omega_t_rad_s", "rpm"]),
    "flow in kg/h": (lambda d: changed(d, w_egr_kg_s=d.w_egr_kg_s * 3600), ["w_egr_kg_s", "kg/h"]),
    "all-NaN channel": (lambda d: changed(d, p_em_pa=np.nan), ["p_em_pa", "no value"]),
    "time repeats": (lambda d: changed(d, time_s=d.time_s.where(d.index != 7, d.time_s[6])), ["time_s", "row 8"]),
    "time falls": (lambda d: changed(d, time_s=d.time_s.where(d.index < 900, d.time_s - 50)), ["time_s", "row 901"]),
    "time with a hole": (lambda d: changed(d, time_s=d.time_s.where(d.index != 4)), ["time_s", "row 5"]),
    "time in ms": (lambda d: changed(d, time_s=d.time_s * 1e3), ["time_s", "rows per second"]),
    "engine never runs": (lambda d: changed(d, n_e_rpm=d.n_e_rpm / 10), ["n_e_rpm", "300"]),
    "text in a number column": (
        lambda d: changed(d, p_im_pa=d.p_im_pa.astype(str).where(d.index != 2, "n/a!")), ["p_im_pa", "row 3"]
    ),
}  # fmt: skip


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("what", BAD)
def test_bad_recordings_are_one_line_each(tmp_path, drive, what, suffix):
    change, words = BAD[what]
    path = tmp_path / f"drive{suffix}"
    write_recording(change(drive), path)
    with pytest.raises(InputError) as error:
        read_recording(path)
    message = str(error.value)
    assert "\n" not in message and "allowed" in message
    assert error.value.what and error.value.got and error.value.allowed and error.value.do
    for word in words:
        assert word in message, message


def test_bad_files_are_one_line_each(tmp_path, drive):
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "header.csv").write_text(",".join(NEEDED) + "\n")
    (tmp_path / "one_row.csv").write_text(",".join(NEEDED) + "\n" + ",".join(["1"] * len(NEEDED)) + "\n")
    (tmp_path / "binary.csv").write_bytes(bytes(range(256)) * 20)
    (tmp_path / "ragged.csv").write_text("a,b\n1,2\n1,2,3,4\n")
    write_recording(drive, tmp_path / "whole.parquet")
    whole = (tmp_path / "whole.parquet").read_bytes()
    (tmp_path / "truncated.parquet").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "empty.parquet").write_bytes(b"")
    (tmp_path / "drive.xlsx").write_bytes(b"x")
    (tmp_path / "folder.csv").mkdir()
    names = ["empty.csv", "header.csv", "one_row.csv", "binary.csv", "ragged.csv", "truncated.parquet", "empty.parquet",
             "drive.xlsx", "folder.csv", "not_there.csv"]  # fmt: skip
    for name in names:
        with pytest.raises(InputError) as error:
            read_recording(tmp_path / name)
        assert name in str(error.value) and "\n" not in str(error.value)


def test_good_recordings_pass_whatever_their_driving(drive):
    # all of it idle with the valve shut; all of it loaded; the coldest exhaust; a second engine's sizes
    limits = pd.read_csv(REFERENCE / "limits_180s.csv")[NEEDED]
    for frame in (drive, limits, limits[limits.time_s < 40], drive[drive.u_delta_mg > 100].reset_index(drop=True)):
        recording(frame)
    shut = limits.assign(u_egr_pct=0.0, w_egr_kg_s=0.0)
    assert recording(shut).columns["u_egr_pct"].max() == 0.0


def test_gaps_are_masked_not_refused(drive):
    holes = drive.copy()
    holes.loc[100:104, "t_em_k"] = np.nan
    holes.loc[200, "w_c_kg_s"] = np.inf
    holes.loc[700:702, "u_delta_mg"] = np.nan  # 0.8 s between known values
    cut = recording(holes).segments()
    assert len(cut) == 5
    first = cut[0]
    assert np.isnan(first.measured[100:105, MEASURED.index("t_em_k")]).all()
    assert np.isnan(first.measured[200, MEASURED.index("w_c_kg_s")])
    assert np.isfinite(first.measured[:, MEASURED.index("p_im_pa")]).all()
    bridged = cut[2].inputs.u_delta_mg[cut[2].inputs.n_history :][100:103]
    known = drive["u_delta_mg"][[699, 703]].to_numpy()
    np.testing.assert_allclose(bridged, known[0] + np.array([1, 2, 3]) / 4 * (known[1] - known[0]))


def test_short_holes_of_inputs_are_filled_and_said(drive):
    holes = drive.copy()
    holes.loc[700:702, "u_delta_mg"] = np.nan
    holes.loc[900:910, "n_e_rpm"] = np.nan  # 2.4 s between known values
    made = recording(holes)
    assert any("3 missing values of u_delta_mg" in note for note in made.notes)
    assert np.isfinite(made.columns["u_delta_mg"]).all()
    assert np.isnan(made.columns["n_e_rpm"][900:911]).all() and len(made.pieces()) == 2


def test_absent_channel_is_nan(drive):
    segment = recording(drive.drop(columns="w_c_kg_s")).segments()[0]
    assert np.isnan(segment.measured[:, MEASURED.index("w_c_kg_s")]).all()


@pytest.mark.parametrize(
    ("change", "pieces"),
    [
        (lambda d: d, [(0, 1500)]),
        (lambda d: d.assign(n_e_rpm=d.n_e_rpm.where(~d.index.isin(range(600, 603)), 250)), [(0, 599), (603, 1500)]),
        (lambda d: d.drop(index=range(500, 505)).reset_index(drop=True), [(0, 499), (500, 1495)]),  # 1.2 s
        (lambda d: d.drop(index=range(500, 504)).reset_index(drop=True), [(0, 1496)]),  # 1.0 s is no gap over 1 s
        (lambda d: d.assign(u_vgt_pct=d.u_vgt_pct.where((d.index < 500) | (d.index > 505))), [(0, 499), (506, 1500)]),
    ],
)
def test_stopped_engine_and_gaps_split(drive, change, pieces):
    found = recording(change(drive)).pieces()
    assert [(piece.start, piece.stop - 1) for piece in found] == pieces


def test_segments_share_end_rows_and_carry_history(drive):
    made = recording(drive)
    cut = made.segments(60.0)
    assert [(s.t0_s, s.t1_s) for s in cut] == [(0, 60), (60, 120), (120, 180), (180, 240), (240, 300)]
    assert [s.measured.shape for s in cut] == [(301, 6)] * 5
    assert [s.inputs.n_history for s in cut] == [0, 10, 10, 10, 10]
    second = cut[1]
    np.testing.assert_array_equal(second.inputs.time_s[:11], made.time_s[290:301])
    np.testing.assert_array_equal(second.inputs.u_egr_pct, drive["u_egr_pct"][290:601])
    np.testing.assert_array_equal(second.measured, drive[list(MEASURED)][300:601])
    np.testing.assert_array_equal(second.columns["time_s"], drive["time_s"][300:601])


def test_no_history_across_a_stop(drive):
    stopped = drive.assign(n_e_rpm=drive.n_e_rpm.where((drive.index < 300) | (drive.index > 310), 0.0))
    cut = recording(stopped).segments(50.0)
    after = [s for s in cut if s.t0_s > 60.0]
    assert after[0].inputs.n_history == 0 and after[0].t0_s == pytest.approx(62.2)


def test_jittered_time_stamps_are_used_as_they_are(drive):
    rng = np.random.default_rng(3)
    time = drive["time_s"].to_numpy() + rng.uniform(-0.004, 0.004, len(drive))
    cut = recording(drive.assign(time_s=time)).segments()
    assert len(cut) >= 4
    for segment in cut:
        assert segment.t1_s - segment.t0_s == pytest.approx(60.0, abs=0.11)
        rows = slice(segment.inputs.n_history, None)
        np.testing.assert_array_equal(segment.inputs.time_s[rows], segment.columns["time_s"])
        assert np.isin(segment.columns["time_s"], time).all()


def test_short_rest_is_kept_only_on_request(drive):
    made = recording(drive[:1400])
    assert len(made.segments(60.0)) == 4
    assert [round(s.t1_s - s.t0_s, 1) for s in made.segments(60.0, minimum_s=30.0)] == [60, 60, 60, 60, 39.8]
    with pytest.raises(InputError, match="at least 60 s"):
        recording(drive[:200]).segments(60.0)


def test_ambient_comes_from_the_file_or_from_the_engine(drive):
    without = recording(drive)
    assert (without.p_amb_pa, without.t_amb_k) == (we2011.PARAMETERS.p_amb, we2011.PARAMETERS.T_amb)
    other = recording(drive, we2011.PARAMETERS.replace(p_amb=9.5e4))
    assert other.p_amb_pa == 9.5e4
    climb = np.where(drive["time_s"] < 150, 1.0e5, 0.9e5)
    with_columns = recording(drive.assign(p_amb_pa=climb, t_amb_k=280.0))
    assert (with_columns.p_amb_pa, with_columns.t_amb_k) == (0.9e5, 280.0)


def test_rows_out_of_range_are_counted_and_kept(drive):
    high = drive.assign(u_delta_mg=drive.u_delta_mg.where(drive.index >= 3, 400.0))
    made = recording(high)
    p = we2011.PARAMETERS
    ranges = {"u_delta_mg": p.u_delta_range, "n_e_rpm": p.n_e_range, "u_vgt_pct": p.u_vgt_range}
    assert rows_out_of_range(made.columns, ranges) == {"u_delta_mg": 3}
    assert made.segments()[0].inputs.u_delta_mg[0] == 400.0


def test_the_same_file_has_the_same_hash_and_columns_are_read_only(tmp_path, drive):
    write_recording(drive, tmp_path / "a.parquet")
    write_recording(drive, tmp_path / "b.parquet")
    a, b = read_recording(tmp_path / "a.parquet"), read_recording(tmp_path / "b.parquet")
    assert isinstance(a, Recording) and a.sha256 == b.sha256 and len(a.sha256) == 64
    with pytest.raises(ValueError, match="read-only"):
        a.columns["p_im_pa"][0] = 0.0


def test_writing_fails_in_one_line_and_leaves_nothing(tmp_path, drive):
    with pytest.raises(InputError, match="ending"):
        write_recording(drive, tmp_path / "drive.xlsx")
    with pytest.raises(InputError):
        write_recording(drive, tmp_path / "not_there" / "drive.csv")
    assert list(tmp_path.iterdir()) == []


def test_reading_a_missing_map_is_one_line(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_channel_map(tmp_path / "map.yaml")


def test_three_hundred_rows_at_five_hertz_are_a_minute(drive):
    """Their stamps span 59.8 s; one row less is no minute any more."""
    assert len(recording(drive.iloc[:600]).segments()) == 2
    assert len(recording(drive.iloc[:300]).segments()) == 1
    with pytest.raises(InputError, match="at least 60 s"):
        recording(drive.iloc[:298]).segments()


def test_error_codes_of_loggers_count_as_missing(drive: pd.DataFrame) -> None:
    """-9999 in an exhaust temperature was said to look like degC."""
    frame = drive.copy()
    frame.loc[10:29, "t_em_k"] = -9999.0
    read = recording(frame)
    assert np.isnan(read.columns["t_em_k"][10:30]).all() and np.isfinite(read.columns["t_em_k"][30:]).all()
    assert "20 values of t_em_k are an error code (-9999) and count as missing" in read.notes
    with pytest.raises(InputError, match=r"a median of 0; allowed: 0\.5 mg/cycle or more in half of the rows"):
        recording(frame.assign(u_delta_mg=0.0))
    with pytest.raises(InputError, match="if this is in g"):  # 0.1 in half of the rows
        recording(frame.assign(u_delta_mg=frame.u_delta_mg / 1000.0))
    flap = np.where(frame.index < 20, -32768.0, 40.0)
    assert np.isnan(recording(drive.assign(u_flap_pct=flap)).columns["u_flap_pct"][:20]).all()
    recording(drive.assign(u_flap_pct=np.nan))


@pytest.mark.parametrize(("column", "unit", "scale", "code"), [
    ("p_im_pa", "kPa", 1e-3, -999.0), ("omega_t_rad_s", "rpm", 30.0 / np.pi, -32768.0),
    ("w_egr_kg_s", "kg/h", 3600.0, -999.0),
])  # fmt: skip
def test_error_codes_in_any_unit_count_as_missing(drive, tmp_path, column, unit, scale, code):
    """-999 kPa was a reading of -999000 Pa."""
    foreign = drive.rename(columns={column: "X"})
    foreign["X"] *= scale
    foreign.loc[10:29, "X"] = code
    foreign.to_csv(tmp_path / "drive.csv", index=False)
    for source in (foreign, tmp_path / "drive.csv"):
        read = read_recording(source, channel_map({"X": {"column": column, "unit": unit}}))
        assert np.isnan(read.columns[column][10:30]).all() and np.isfinite(read.columns[column][30:]).all()
        assert f"20 values of {column} are an error code ({code:g}) and count as missing" in read.notes


def test_a_reading_that_equals_an_error_code_stays():
    """999 Pa below the ambient are as good a reading as 998."""
    mapping = channel_map({"p2": {"column": "p_im_pa", "unit": "Pa", "via": "gauge", "ambient_pa": 1e5}})
    columns, notes = mapping.apply({"p2": np.array([-998.0, -999.0, 5e4, 6e4, -9999.0, -99999.0])}, "file")
    np.testing.assert_array_equal(columns["p_im_pa"], [99002.0, 99001.0, 1.5e5, 1.6e5, 90001.0, np.nan])
    assert notes == ["1 values of p_im_pa are an error code (-99999) and count as missing"]


@pytest.mark.parametrize("missing", ["sensor error", None, pd.NA])
def test_a_mapped_channel_of_a_table_in_memory_is_read_as_in_a_file(drive, missing):
    """Text and pandas' own missing values ended in a traceback."""
    cells = (drive["p_im_pa"] / 1e3).astype(object)
    cells[3] = missing
    table = drive.assign(p_im_pa=cells).rename(columns={"p_im_pa": "P"})
    mapping = {"P": {"column": "p_im_pa", "unit": "kPa"}}
    if isinstance(missing, str):
        with pytest.raises(InputError, match="column P, data row 4: got 'sensor error'"):
            read_recording(table, channel_map(mapping))
    else:
        assert np.flatnonzero(np.isnan(read_recording(table, channel_map(mapping)).columns["p_im_pa"])).tolist() == [3]
