"""J1939: synthetic frames with values worked out by hand, and real traces beside a reference decode where they are."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dieseltwin.errors import InputError
from dieseltwin.recordings.importers.j1939 import not_available, parameter_group, parameters
from dieseltwin.recordings.importers.read import read_raw

SHARED = Path(os.environ.get("DIESELTWIN_DATA", "../shared/data")) / "j1939_truck"
TRACES = {
    "t270_drive": "Truck_Sentry/normal.log",
    "t270_idle_fuzz_id": "Truck_Sentry/fuzz_1ms_ID_Only.log",
    "t270_idle_dos": "Truck_Sentry/dos_full.log",
    "t270_idle_blip": "Truck_Sentry/fuzz_1ms_Data_Only.log",
    "css_idle_mf4": "api-examples/00000001.MF4",
}


def trace(path: Path, frames: list[tuple[float, str, str]]) -> Path:
    """A trace in the text of `candump -t a`."""
    lines = [f" ({time:010.6f})  can0  {name}   [{len(data.split())}]  {data}\n" for time, name, data in frames]
    path.write_text("".join(lines))
    return path


def test_values_by_hand(tmp_path):
    frames = []
    for i in range(5):
        t = 0.1 * i
        # speed 1200 rpm = 9600 = 0x2580, torques 40 %, 38 % (165, 163), demand 41 %; torque mode 1
        frames.append((t, "0CF00400", "F1 A5 A3 80 25 00 0F A6"))
        # boost 80 kPa = 40, 45 degC = 85, air intake 92 kPa = 46, 450 degC = 23136 = 0x5A60, others not available
        frames.append((t + 0.001, "18FEF600", "FF 28 55 2E FF 60 5A FF"))
        # fuel 12.5 L/h = 250 = 0x00FA, throttle 0xFE is an error
        frames.append((t + 0.002, "18FEF200", "FA 00 FF FF FF FF FE FF"))
        # turbo 60,000 rpm = 15000 = 0x3A98
        frames.append((t + 0.003, "18FEDD00", "FF 98 3A FF FF FF FF FF"))
        # EGR 50 kg/h = 1000, air 400 kg/h = 8000
        frames.append((t + 0.004, "0CF00A00", "E8 03 40 1F FF FF FF FF"))
    raw = read_raw(trace(tmp_path / "t.log", frames))
    assert raw.kind == "J1939 candump trace"
    expected = {190: 1200.0, 512: 40.0, 513: 38.0, 2432: 41.0, 899: 1.0, 102: 80.0, 105: 45.0, 106: 92.0, 173: 450.0,
                183: 12.5, 103: 60000.0, 2659: 50.0, 132: 400.0}  # fmt: skip
    found = {signal.spn: signal for signal in raw.signals.values()}
    assert set(found) == set(expected)  # nothing that is not available
    for spn, value in expected.items():
        np.testing.assert_array_equal(found[spn].values, np.full(5, value))
        assert found[spn].time_s.size == 5
    np.testing.assert_allclose(found[102].time_s, 0.001 + 0.1 * np.arange(5))
    assert (found[190].name, found[190].unit) == ("SPN 190 engine_speed", "rpm")


@pytest.mark.parametrize(
    ("bits", "largest"), [(8, 0xFA), (16, 0xFAFF), (32, 0xFAFFFFFF), (2, 1), (4, 13)]
)  # J1939-71, table 1
def test_codes_are_missing_not_numbers(bits, largest):
    assert not not_available(largest, bits)
    assert all(not_available(raw, bits) for raw in (largest + 1, (1 << bits) - 2, (1 << bits) - 1))


def test_codes_within_a_signal_are_missing(tmp_path):
    speeds = ["80 25", "FF FF", "00 FE", "80 25", "FF FA", "00 FB"]
    frames = [(0.02 * i, "0CF00400", f"F1 A5 A3 {raw} 00 0F A6") for i, raw in enumerate(speeds)]
    frames += [(0.02 * i + 0.001, "18FEF200", "FA 00 FF FF FF FF FF FF") for i in range(6)]
    speed = read_raw(trace(tmp_path / "t.log", frames)).signals["SPN 190 engine_speed"].values
    np.testing.assert_array_equal(speed, [1200.0, np.nan, np.nan, 1200.0, 8031.875, np.nan])


def test_other_addresses_keep_apart_and_silent_ones_are_no_signal(tmp_path):
    frames = []
    for i in range(4):
        frames.append((i + 0.0, "18FEF700", "FF FF FF FF 18 01 FF FF"))  # 14.0 V from the engine
        frames.append((i + 0.1, "18FEF731", "FF FF FF FF 1A 01 FF FF"))  # 14.1 V from the cab
        frames.append((i + 0.2, "0CF00431", "FF FF FF FF FF FF FF FF"))  # an echo without any value
        frames.append((i + 0.3, "0CF00400", "F1 A5 A3 80 25 00 0F A6"))
    raw = read_raw(trace(tmp_path / "t.log", frames))
    assert raw.signals["SPN 168 battery_potential"].values[0] == pytest.approx(14.0)
    assert raw.signals["SPN 168 battery_potential (address 49)"].values[0] == pytest.approx(14.1)
    assert [signal.origin for signal in raw.signals.values() if signal.spn == 190] == ["PGN 61444 EEC1 from address 0"]
    assert any("never available" in note for note in raw.notes)


def test_long_groups_are_put_together(tmp_path):
    """Reference torque 1109 Nm (0x0455) in bytes 20 and 21 of the 39 of PGN 65251, broadcast in six pieces."""
    content = bytearray(b"\xff" * 39)
    content[19:21] = (1109).to_bytes(2, "little")
    frames = []
    for i in range(2):
        frames.append((i + 0.0, "0CF00400", "F1 A5 A3 80 25 00 0F A6"))
        frames.append((i + 0.1, "18FEF200", "FA 00 FF FF FF FF FF FF"))
        frames.append((i + 0.2, "1CECFF00", "20 27 00 06 FF E3 FE 00"))
        for piece in range(6):
            chunk = bytes(content[7 * piece : 7 * piece + 7]).ljust(7, b"\xff")
            frames.append((i + 0.3 + 0.05 * piece, "1CEBFF00", f"{piece + 1:02X} " + chunk.hex(" ").upper()))
    torque = read_raw(trace(tmp_path / "t.log", frames)).signals["SPN 544 engine_reference_torque"]
    np.testing.assert_array_equal(torque.values, [1109.0, 1109.0])


def test_parameter_groups():
    identifiers = np.array([0x0CF00400, 0x18FEF600, 0x18EA0021, 0x1CECFF00], dtype=np.uint32)
    assert parameter_group(identifiers).tolist() == [61444, 65270, 59904, 60416]  # 0xEA00: the destination is no group


def test_the_table_is_sound():
    for parameter in parameters():
        assert parameter.start >= 0 and parameter.bits in (2, 4, 8, 16, 32), parameter
        assert parameter.scale > 0 and parameter.checked in ("reference", "standard")
        assert parameter.start + parameter.bits <= (64 if parameter.pgn != 65251 else 312), parameter
    places = [(p.pgn, bit) for p in parameters() for bit in range(p.start, p.start + p.bits)]
    assert len(places) == len(set(places))  # no two parameters share a bit
    numbers = [p.spn for p in parameters()]
    assert len(numbers) == len(set(numbers))


def test_a_bus_that_is_not_j1939_asks_for_its_dbc(tmp_path):
    path = trace(tmp_path / "t.log", [(0.1 * i, "1A0", "01 02 03 04") for i in range(20)])
    with pytest.raises(InputError, match="dbc: "):
        read_raw(path)


@pytest.mark.parametrize("name", TRACES)
def test_real_traces_agree_with_the_reference_decode(name):
    """Signal by signal: as many readings, at the same times, with the same values."""
    path, reference = SHARED / "raw" / TRACES[name], SHARED / f"signals_{name}.parquet"
    if not path.is_file() or not reference.is_file():
        pytest.skip("no j1939_truck in ../shared/data")
    if path.suffix == ".MF4":
        pytest.importorskip("asammdf")
    expected = pd.read_parquet(reference)
    ours = {}
    for signal in read_raw(path).signals.values():
        ours[(signal.spn, int(signal.origin.rsplit(" ", 1)[1]))] = signal
    groups = dict(list(expected.groupby(["spn", "sa"])))
    assert set(groups) <= set(ours)
    assert {spn for spn, _ in set(ours) - set(groups)} <= {94, 182, 244, 544}  # which the reference doesn't list
    for key, rows in groups.items():
        there = np.isfinite(ours[key].values)
        np.testing.assert_allclose(ours[key].time_s[there], rows["time_s"], rtol=0, atol=1e-9, err_msg=str(key))
        np.testing.assert_allclose(ours[key].values[there], rows["value"], rtol=1e-12, atol=1e-9, err_msg=str(key))


def test_times_of_day_go_on_after_midnight(tmp_path):
    stamps = ["23:59:59.80", "23:59:59.90", "00:00:00.00", "00:00:00.10"]
    groups = ("0CF00400", "18FEF600", "18FEF200")

    def lines(times: list[str]) -> str:
        return "".join(f" ({time}0000)  can0  {group}   [8]  F1 28 55 2E 25 00 0F A6\n" for time in times
                       for group in groups)  # fmt: skip

    (tmp_path / "t.log").write_text(lines(stamps))
    days = [f"2026-11-{day} {stamp}" for day, stamp in zip((23, 23, 24, 24), stamps, strict=True)]
    (tmp_path / "d.log").write_text(lines(days))
    for name in ("t.log", "d.log"):
        speed = next(signal for signal in read_raw(tmp_path / name).signals.values() if signal.spn == 190)
        assert speed.time_s is not None
        np.testing.assert_allclose(np.diff(speed.time_s), 0.1, atol=1e-6)
    assert speed.time_s[0] == pytest.approx(pd.Timestamp(days[0]).timestamp())


def test_differences_of_times_are_refused(tmp_path):
    frames = [(0.001 * (i % 2), "0CF00400", "F1 A5 A3 80 25 00 0F A6") for i in range(9)]
    with pytest.raises(InputError, match="candump -t a"):
        read_raw(trace(tmp_path / "t.log", frames))
