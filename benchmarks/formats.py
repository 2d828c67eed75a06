"""One drive in every format, written by the format's own library: what is read, what `discover` and `identify` say.

    python benchmarks/formats.py OUT.jsonl [--page] [--only NAME ...]

The drive is ten minutes of the benchmark plant with a boost leak, six sensors, 5 Hz (`examples/discovery_cases.py`,
case boost_leak). Formats that hold doubles must give every number back; those that count in steps (a DBC of 16 bits,
J1939) are read through the channel map that `dieseltwin channels` proposes, and their estimates must lie within the
intervals. One line a format is appended to OUT.jsonl, formats that are there aren't run again; `--page` writes the
table into docs/formats.md.
"""

from __future__ import annotations

import argparse
import gzip
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import asammdf
import can
import cantools
import h5py
import numpy as np
import pandas as pd
import scipy.io
from drawn_machine import DrawnMachine
from kept import keep, kept_lines
from pages import table, write_table

import dieseltwin as dt
from dieseltwin.challenge.plant_effects import Fault
from dieseltwin.engine import HEALTH, we2011

SEED, LEAK_M2, SECONDS = (20261121, 0), 2.5e-5, 600.0
CYLINDERS, DENSITY_KG_L, AMBIENT_KPA = 6, 0.835, we2011.PARAMETERS.p_amb / 1e3
GERMAN = {
    "time_s": ("Zeit", "s", 1.0, 0.0), "n_e_rpm": ("Motordrehzahl", "1/min", 1.0, 0.0),
    "u_delta_mg": ("Einspritzmenge", "mg/Hub", 1.0, 0.0), "u_egr_pct": ("AGR_Position", "%", 1.0, 0.0),
    "u_vgt_pct": ("VTG_Position", "%", 1.0, 0.0), "p_im_pa": ("Ladedruck", "kPa", 1e-3, 0.0),
    "p_em_pa": ("Abgasgegendruck", "kPa", 1e-3, 0.0), "omega_t_rad_s": ("Laderdrehzahl", "1/min", 30.0 / np.pi, 0.0),
    "w_egr_kg_s": ("AGR_Massenstrom", "kg/h", 3600.0, 0.0), "t_em_k": ("Abgastemperatur_v_Turbine", "°C", 1.0, -273.15),
    "w_c_kg_s": ("Luftmassenstrom", "kg/h", 3600.0, 0.0),
}  # fmt: skip
"""Our column -> name and unit of a German control unit, scale and offset into that unit."""


@dataclass(frozen=True)
class Format:
    """One way to write the drive.

    Attributes:
        write: table, path of the file to make.
        ending: of the file.
        guessed: foreign names and units; read through the channel map of `dieseltwin channels`.
        steps: the format counts in steps, so that numbers come back rounded.
    """

    write: Callable[[pd.DataFrame, Path], None]
    ending: str
    guessed: bool = False
    steps: bool = False


def drive() -> pd.DataFrame:
    """The recording (n,) of all columns, with the ambient pressure that a bus sends too [SI, columns' units]."""
    rng = np.random.default_rng(SEED)
    return DrawnMachine.draw(SECONDS, rng).recorded([Fault("boost_leak", LEAK_M2)], rng)


def german(frame: pd.DataFrame) -> pd.DataFrame:
    """The drive in foreign names and units."""
    return pd.DataFrame({name: scale * frame[column] + offset for column, (name, _, scale, offset) in GERMAN.items()})


# --- writers


def _units_csv(frame: pd.DataFrame, path: Path) -> None:
    rows = german(frame).to_csv(index=False, sep=";", decimal=",").split("\n")
    rows.insert(1, ";".join(unit for _, unit, _, _ in GERMAN.values()))
    path.write_text("Prüfstand 3;\nDatum;01.05.2026\n\n" + "\n".join(rows), encoding="cp1252")


def _packed_csv(frame: pd.DataFrame, path: Path) -> None:
    path.write_bytes(gzip.compress(frame.to_csv(index=False, sep="\t").encode("utf-8-sig")))


def _excel(frame: pd.DataFrame, path: Path) -> None:
    with pd.ExcelWriter(path) as book:
        pd.DataFrame({"about": ["bench 3"]}).to_excel(book, sheet_name="Info", index=False)
        frame.to_excel(book, sheet_name="Messung", index=False, startrow=3)


def _matlab(version: str, nested: bool) -> Callable[[pd.DataFrame, Path], None]:
    def write(frame: pd.DataFrame, path: Path) -> None:
        vectors = {name: frame[name].to_numpy()[:, None] for name in frame}
        scipy.io.savemat(path, {"data": vectors} if nested else vectors, format=version, do_compression=nested)

    return write


def _matlab_73(frame: pd.DataFrame, path: Path) -> None:
    """As MATLAB's own `save -v7.3` writes it: HDF5 behind a block of 512 bytes, every vector as a row."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name in frame:
            vector = file.create_dataset(name, data=frame[name].to_numpy()[None, :])
            vector.attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def _measurement(version: str, one_group: bool, foreign: bool = False) -> Callable[[pd.DataFrame, Path], None]:
    def write(frame: pd.DataFrame, path: Path) -> None:
        units = {name: unit for name, unit, _, _ in GERMAN.values()}
        shown, clock = (german(frame), "Zeit") if foreign else (frame, "time_s")
        times = shown[clock].to_numpy()
        signals = [asammdf.Signal(shown[name].to_numpy(), times, name=name, unit=units.get(name, ""))
                   for name in shown if name != clock]  # fmt: skip
        with asammdf.MDF(version=version) as mdf:
            for group in [signals] if one_group else [[signal] for signal in signals]:
                mdf.append(group)
            mdf.save(path, overwrite=True, compression=0 if version < "4" or one_group else 2)

    return write


DBC_MESSAGES: Mapping[int, tuple[tuple[str, float, float], ...]] = {
    0x100: (("n_e_rpm", 0.125, 0.0), ("u_delta_mg", 0.01, 0.0), ("u_egr_pct", 0.01, 0.0), ("u_vgt_pct", 0.01, 0.0)),
    0x110: (("p_im_pa", 10.0, 0.0), ("p_em_pa", 10.0, 0.0), ("omega_t_rad_s", 0.25, 0.0)),
    0x120: (("w_egr_kg_s", 1e-5, -0.05), ("t_em_k", 0.03125, 0.0), ("w_c_kg_s", 2e-5, -0.1)),
}
"""Message -> (column, step, lowest number), sixteen bits each [columns' units]."""


def _database(path: Path) -> cantools.db.Database:
    messages = []
    for number, signals in DBC_MESSAGES.items():
        lines = [f' SG_ {name} : {16 * k}|16@1+ ({step},{low}) [0|0] "" ECU'
                 for k, (name, step, low) in enumerate(signals)]  # fmt: skip
        messages.append("\n".join([f"BO_ {number} M{number:X}: 8 ECU", *lines]))
    path.write_text('VERSION ""\nBU_: ECU\n' + "\n\n".join(messages) + "\n", encoding="ascii")
    return cantools.database.load_file(path)


def _bus(frame: pd.DataFrame, path: Path) -> None:
    """Frames by a DBC of 16 bits, which lies beside the trace."""
    database = _database(path.with_suffix(".dbc"))
    rows = frame.to_dict("records")
    with can.Logger(path) as log:
        for row in rows:
            for number, signals in DBC_MESSAGES.items():
                data = database.encode_message(number, {name: row[name] for name, _, _ in signals})
                log.on_message_received(can.Message(timestamp=row["time_s"], arbitration_id=number,
                                                    is_extended_id=False, data=data))  # fmt: skip


Groups = Mapping[int, tuple[tuple[str, int, int, float, float], ...]]
GAUGE, ABSOLUTE = (65270, ("boost_kpa", 8, 8, 2.0, 0.0)), (64976, ("p_im_kpa", 32, 8, 2.0, 0.0))
J1939: Groups = {
    61444: (("n_e", 24, 16, 0.125, 0.0),), 65266: (("fuel_l_h", 0, 16, 0.05, 0.0),),
    64916: (("u_egr", 0, 16, 0.0025, 0.0),), 64931: (("u_vgt", 16, 8, 0.4, 0.0),),
    65269: (("p_amb_kpa", 0, 8, 0.5, 0.0),), 65270: (("t_em_c", 40, 16, 0.03125, -273.0),),
    65170: (("p_em_kpa", 8, 16, 0.0078125, -250.0),), 65245: (("turbo_rpm", 8, 16, 4.0, 0.0),),
    61450: (("egr_kg_h", 0, 16, 0.05, 0.0), ("air_kg_h", 16, 16, 0.05, 0.0)),
}  # fmt: skip
"""Group -> (quantity, first bit, bits, step, lowest number) as J1939-71 has them; boost comes besides."""


def _j1939(boost: tuple[int, tuple[str, int, int, float, float]]) -> Callable[[pd.DataFrame, Path], None]:
    """The drive as J1939 with boost in steps of 2 kPa: as gauge pressure (SPN 102) or absolute (SPN 3563)."""
    groups = {**J1939, boost[0]: (*J1939.get(boost[0], ()), boost[1])}

    def write(frame: pd.DataFrame, path: Path) -> None:
        _send(frame, path, groups)

    return write


def _send(frame: pd.DataFrame, path: Path, groups: Groups) -> None:
    strokes = frame["n_e_rpm"] * CYLINDERS / 120.0
    sent = pd.DataFrame({
        "n_e": frame["n_e_rpm"], "fuel_l_h": frame["u_delta_mg"] * 1e-6 * strokes * 3600.0 / DENSITY_KG_L,
        "u_egr": frame["u_egr_pct"], "u_vgt": frame["u_vgt_pct"], "p_amb_kpa": AMBIENT_KPA,
        "boost_kpa": frame["p_im_pa"] / 1e3 - AMBIENT_KPA, "p_im_kpa": frame["p_im_pa"] / 1e3,
        "t_em_c": frame["t_em_k"] - 273.0,
        "p_em_kpa": frame["p_em_pa"] / 1e3 - AMBIENT_KPA, "turbo_rpm": frame["omega_t_rad_s"] * 30.0 / np.pi,
        "egr_kg_h": frame["w_egr_kg_s"] * 3600.0, "air_kg_h": frame["w_c_kg_s"] * 3600.0,
    })  # fmt: skip
    with can.Logger(path) as log:
        for moment, (_, row) in zip(frame["time_s"], sent.iterrows(), strict=True):
            for group, signals in groups.items():
                raw = (1 << 64) - 1  # every bit set: not available
                for name, first, bits, step, low in signals:
                    count = int(np.clip(np.rint((row[name] - low) / step), 0, (0xFA << (bits - 8)) | 0xFF >> 16 - bits))
                    raw = raw & ~(((1 << bits) - 1) << first) | count << first
                log.on_message_received(can.Message(timestamp=moment, arbitration_id=0x0C000000 | group << 8,
                                                    data=raw.to_bytes(8, "little")))  # fmt: skip


FORMATS: Mapping[str, Format] = {
    "CSV, commas": Format(lambda f, p: f.to_csv(p, index=False), ".csv"),
    "CSV, semicolons, decimal commas, UTF-16": Format(
        lambda f, p: f.to_csv(p, index=False, sep=";", decimal=",", encoding="utf-16"), ".csv"),
    "CSV, tabs, UTF-8 with a mark, gzip": Format(_packed_csv, ".csv.gz"),
    "CSV, German names and units, Windows-1252": Format(_units_csv, ".txt", guessed=True),
    "Parquet": Format(lambda f, p: f.to_parquet(p), ".parquet"),
    "Excel": Format(_excel, ".xlsx"),
    "MATLAB 4": Format(_matlab("4", nested=False), ".mat"),
    "MATLAB 5, vectors": Format(_matlab("5", nested=False), ".mat"),
    "MATLAB 5, a structure, packed": Format(_matlab("5", nested=True), ".mat"),
    "MATLAB 7.3": Format(_matlab_73, ".mat"),
    "MDF 3.30, one group": Format(_measurement("3.30", one_group=True), ".mdf"),
    "MDF 4.10, a group a channel, packed": Format(_measurement("4.10", one_group=False), ".mf4"),
    "MDF 4.10, German names and units": Format(
        _measurement("4.10", one_group=True, foreign=True), ".mf4", guessed=True),
    "candump, DBC of 16 bits": Format(_bus, ".log", steps=True),
    "Vector ASC, DBC of 16 bits": Format(_bus, ".asc", steps=True),
    "Vector BLF, DBC of 16 bits": Format(_bus, ".blf", steps=True),
    "J1939 in candump, absolute boost": Format(_j1939(ABSOLUTE), ".log", guessed=True, steps=True),
    "J1939 in BLF, absolute boost": Format(_j1939(ABSOLUTE), ".blf", guessed=True, steps=True),
    "J1939 in candump, gauge boost": Format(_j1939(GAUGE), ".log", guessed=True, steps=True),
}  # fmt: skip


# --- one format


def judge(name: str, frame: pd.DataFrame, folder: Path) -> dict[str, Any]:
    """Write the drive in a format, read it, ask `discover` and `identify`."""
    chosen = FORMATS[name]
    path = folder / f"drive{chosen.ending}"
    chosen.write(frame, path)
    mapping: Path | None = None
    if chosen.guessed:
        mapping = dt.channels(path, cylinders=CYLINDERS).save(folder / "map.yaml")
    elif path.with_suffix(".dbc").is_file():
        mapping = folder / "map.yaml"
        mapping.write_text(f"dbc: {path.with_suffix('.dbc').name}\n", encoding="ascii")
    made = dt.read(path, mapping)
    sensors = [column for column in frame if column != "time_s"]
    off = {column: float(np.nanmax(np.abs(made.columns[column] - frame[column]))) for column in sensors}
    worst = max(sensors, key=lambda column: off[column] / frame[column].abs().mean())
    times = float(np.abs(made.time_s - made.time_s[0] - (frame["time_s"] - frame["time_s"].iloc[0])).max())
    began = time.perf_counter()
    document = dt.discover(made).document
    seconds = time.perf_counter() - began
    found = dt.identify(made, runs=1).table()
    location = document.location
    return {
        "format": name, "rows": len(made.time_s), "time_off_s": times, "worst": worst,
        "worst_rel": off[worst] / float(frame[worst].abs().mean()), "off": off, "seconds": seconds,
        "bytes": path.stat().st_size, "effects": [effect.model_dump(mode="json") for effect in document.effects],
        "site": None if location is None else location.site,
        "health": {key: [value.value, value.std] for key, value in document.health.items()},
        "identify": {key: [float(found.loc[key, "mean"]), float(found.loc[key, "std"])] for key in HEALTH},
    }  # fmt: skip


# --- the table


def lines_of(rows: list[dict[str, Any]]) -> list[str]:
    """The table of docs/formats.md, each format beside the first one."""
    known = {row["format"]: row for row in rows}
    ordered = [known[name] for name in FORMATS if name in known]
    first = ordered[0]
    shown = []
    for row in ordered:
        effect = row["effects"][0] if row["effects"] else None
        verdict = "nothing" if effect is None else effect["name"].replace("_", " ")
        size = ""
        if effect is not None and effect["magnitude"] is not None:
            size = f"{1e6 * effect['magnitude']:.2f} ± {1e6 * effect['std']:.2f}"
        moved = max(abs(row["health"][key][0] - first["health"][key][0]) / row["health"][key][1] for key in HEALTH)
        fitted = max(abs(row["identify"][k][0] - first["identify"][k][0]) / row["identify"][k][1] for k in HEALTH)
        read_off = "0" if row["worst_rel"] == 0.0 else f"{100.0 * row['worst_rel']:.2g} % of {row['worst']}"
        shown.append([row["format"], f"{row['bytes'] / 1e3:.0f} kB", read_off, verdict,
                      (row["site"] or "").replace("_", " "), size, f"{moved:.2g}", f"{fitted:.2g}"])  # fmt: skip
    return table(["format", "size", "read", "verdict", "site", "mm²", "health", "identify"], shown)


def main() -> None:
    """Run the formats that are missing, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--page", action="store_true", help="write the table into docs/formats.md")
    parser.add_argument("--only", nargs="+", choices=list(FORMATS), default=list(FORMATS))
    given = parser.parse_args()
    rows = kept_lines(given.out)
    frame = drive()
    for name in (name for name in given.only if name not in {row["format"] for row in rows}):
        with tempfile.TemporaryDirectory() as scratch:
            row = judge(name, frame, Path(scratch))
        rows.append(row)
        keep(given.out, row)
        print(name, f"{row['worst_rel']:.3g}", [effect["name"] for effect in row["effects"]], f"{row['seconds']:.0f} s",
              flush=True)  # fmt: skip
    lines = lines_of(rows)
    print("\n".join(lines))
    if given.page:
        write_table("formats.md", "table of formats", lines)


if __name__ == "__main__":
    main()
