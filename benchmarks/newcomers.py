"""Three files of newcomers from the logger to the verdict, by the commands that the docs name, timed.

    python benchmarks/newcomers.py OUT.jsonl [--only NAME...] [--page]

A test bench's MF4 with 14 channels on five rasters (1 to 100 Hz) of an engine with a boost leak of 40 mm2; a candump
log with times of day and a DBC of its own names, whose boost sensor reads 8 kPa too high; and the German CSV that the
script of docs/tour-recording.md makes. The first two come from the benchmark's plant (maps off by 0.3 %, tolerances of
sensors, the paper's noise on every reading). `channels`, `identify` and `discover` are run as processes with the map
that `channels` proposed, unedited. Lines that are in OUT.jsonl aren't run again; `--page` writes docs/formats.md.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import asammdf
import can
import cantools
import numpy as np
from drawn_machine import DrawnMachine
from kept import keep, kept_lines
from pages import table, write_table

from dieseltwin.challenge.plant_effects import Fault
from dieseltwin.challenge.sensors import NOISE_REL, SENSORS
from dieseltwin.discovery.verdict.document import load_discrepancy
from dieseltwin.report.discovery_words import sentence

ROOT = Path(__file__).resolve().parents[1]
SEED, SECONDS, FINE_HZ, CYLINDERS = 20261123, 600.0, 100, 6
Conversion = tuple[str, str, float, float]  # their name, their unit, scale and offset into it
BENCH: Mapping[int, Mapping[str, Conversion]] = {
    100: {"n_e_rpm": ("N_Dyno", "1/min", 1.0, 0.0)},
    50: {"u_egr_pct": ("EGRV_AI_Pos", "%", 1.0, 0.0), "u_vgt_pct": ("VGT_AI_Pos", "%", 1.0, 0.0)},
    20: {"p_im_pa": ("PT_ILM", "bar", 1e-5, 0.0), "p_em_pa": ("PT_EXM", "bar", 1e-5, 0.0),
         "omega_t_rad_s": ("N_TC", "1/min", 30.0 / np.pi, 0.0)},
    10: {"w_egr_kg_s": ("MF_EGR", "kg/h", 3600.0, 0.0), "w_c_kg_s": ("MF_Sensyflow", "kg/h", 3600.0, 0.0),
         "fuel": ("FB_Fuel", "kg/h", 3600.0, 0.0)},
    1: {"t_em_k": ("TT_EXM", "degC", 1.0, -273.15), "p_amb_pa": ("P_Amb", "mbar", 1e-2, 0.0),
        "t_amb_k": ("T_Amb", "degC", 1.0, -273.15), "oil": ("T_Oil", "degC", 1.0, -273.15),
        "coolant": ("T_CoolOut", "degC", 1.0, -273.15)},
}  # fmt: skip
"""Raster [Hz] -> quantity -> how the bench calls and counts it."""

BUS: Mapping[int, tuple[float, tuple[tuple[str, str, str, float, float, float], ...]]] = {
    0x101: (0.05, (("n_e_rpm", "EngN", "rpm", 0.125, 0.0, 1.0), ("u_delta_mg", "FuQty", "mg/stroke", 0.01, 0.0, 1.0),
                   ("u_egr_pct", "EgrVlvPos", "%", 0.01, 0.0, 1.0), ("u_vgt_pct", "VgtPos", "%", 0.01, 0.0, 1.0))),
    0x111: (0.1, (("p_im_pa", "SupPrs", "kPa", 0.01, 0.0, 1e-3), ("p_em_pa", "ExhMnfPrs", "kPa", 0.02, 0.0, 1e-3),
                  ("omega_t_rad_s", "TrboN", "rpm", 4.0, 0.0, 30.0 / np.pi))),
    0x121: (0.2, (("w_egr_kg_s", "EgrMs", "kg/h", 0.05, -200.0, 3600.0),
                  ("t_em_k", "ExhTmp", "degC", 0.03125, -273.0, 1.0),
                  ("w_c_kg_s", "AirMs", "kg/h", 0.05, -200.0, 3600.0), ("p_amb_pa", "AmbPrs", "kPa", 0.01, 0.0, 1e-3))),
}  # fmt: skip
"""Message -> period [s] and signals of 16 bits: (quantity, name, unit, step, lowest number, scale)."""


@dataclass(frozen=True)
class Newcomer:
    """One file: what is wrong with its engine, and how it is written."""

    fault: str
    true_size: float  # in `unit`
    unit: str
    write: Callable[[Path], tuple[Path, list[str]]]  # into a folder; the file and options of `channels`


def _drive(number: int, fault: Fault) -> dict[str, np.ndarray]:
    """Ten minutes of the plant at 100 Hz, readings without noise (n,) [SI, columns' units]."""
    machine = DrawnMachine.draw(SECONDS, np.random.default_rng([SEED, number]))
    drive = machine.noiseless([fault], machine.driving.columns(), FINE_HZ)
    known = machine.parameters
    ambient = {"p_amb_pa": known["p_amb"], "t_amb_k": known["T_amb"], "oil": 368.0, "coolant": 358.0}
    fuel = 1e-6 * drive["u_delta_mg"] * drive["n_e_rpm"] * CYLINDERS / 120.0
    return {**drive, "fuel": fuel,
            **{name: np.full(fuel.size, value) for name, value in ambient.items()}}  # fmt: skip


def _read(drive: Mapping[str, np.ndarray], quantity: str, hz: float, rng: np.random.Generator) -> np.ndarray:
    """Readings of one quantity at a rate, with the paper's noise where it is a sensor's [SI]."""
    clean = drive[quantity]
    values = clean[:: round(FINE_HZ / hz)]
    if quantity in SENSORS:
        deviation = NOISE_REL[SENSORS.index(quantity)] * clean.mean()
        values = values + deviation * rng.standard_normal(values.size)
    return values


def bench_mf4(folder: Path) -> tuple[Path, list[str]]:
    """A group a raster, names and units of a test bench."""
    drive, rng = _drive(0, Fault("boost_leak", 4e-5)), np.random.default_rng([SEED, 10])
    with asammdf.MDF(version="4.10") as mdf:
        for hz, channels in BENCH.items():
            times = drive["time_s"][:: FINE_HZ // hz]
            mdf.append([asammdf.Signal(scale * _read(drive, quantity, hz, rng) + offset, times, name=name, unit=unit)
                        for quantity, (name, unit, scale, offset) in channels.items()])  # fmt: skip
        mdf.save(folder / "bench.mf4", overwrite=True)
    return folder / "bench.mf4", []


def bus_candump(folder: Path) -> tuple[Path, list[str]]:
    """Frames as `candump -t a` shows them, with the clock's time, and the bus's DBC."""
    drive, rng = _drive(1, Fault("p_im_offset", 8e3)), np.random.default_rng([SEED, 11])
    messages = []
    for number, (_, signals) in BUS.items():
        lines = [f' SG_ {name} : {16 * k}|16@1+ ({step},{low}) [0|0] "{unit}" ECU'
                 for k, (_, name, unit, step, low, _) in enumerate(signals)]  # fmt: skip
        messages.append("\n".join([f"BO_ {number} M{number:X}: 8 ECU", *lines]))
    text = 'VERSION ""\nBU_: ECU\n' + "\n\n".join(messages) + "\n"
    (folder / "bus.dbc").write_text(text, encoding="ascii")
    database = cantools.database.load_file(folder / "bus.dbc")
    frames: list[can.Message] = []
    for number, (period, signals) in BUS.items():
        times = drive["time_s"][:: round(period * FINE_HZ)]
        read = {}
        for quantity, name, unit, step, low, scale in signals:
            values = scale * _read(drive, quantity, 1.0 / period, rng) - (273.15 if unit == "degC" else 0.0)
            read[name] = np.clip(values, low, low + 65535 * step)
        frames += [can.Message(timestamp=1.7949e9 + time_s, arbitration_id=number, is_extended_id=False,
                               data=database.encode_message(number, {n: values[k] for n, values in read.items()}))
                   for k, time_s in enumerate(times)]  # fmt: skip
    with can.Logger(folder / "trace.log") as log:
        for frame in sorted(frames, key=lambda frame: frame.timestamp):
            log.on_message_received(frame)
    return folder / "trace.log", ["--dbc", str(folder / "bus.dbc")]


def tour_csv(folder: Path) -> tuple[Path, list[str]]:
    """The script that stands in the tour, run as it stands there."""
    page = (ROOT / "docs/tour-recording.md").read_text(encoding="utf-8")
    found = re.search(r"    ```python\n(.*?)\n    ```", page, re.DOTALL)
    if found is None:
        raise SystemExit("docs/tour-recording.md holds no script")
    script = folder / "make_drive.py"
    script.write_text(re.sub(r"^    ", "", found.group(1), flags=re.MULTILINE), encoding="utf-8")
    subprocess.run([sys.executable, str(script)], cwd=folder, check=True)
    return folder / "drive.csv", []


NEWCOMERS: Mapping[str, Newcomer] = {
    "a test bench's MF4": Newcomer("boost_leak", 40.0, "mm²", bench_mf4),
    "candump with a DBC": Newcomer("p_im_offset", 8.0, "kPa", bus_candump),
    "the tour's CSV": Newcomer("boost_leak", 40.0, "mm²", tour_csv),
}
STEPS = ("channels", "identify", "discover")
IN_UNIT = {"mm²": 1e6, "kPa": 1e-3}


def timed(*command: str) -> tuple[float, float, str]:
    """Wall and processor seconds of one command of ours, and what it printed."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run([sys.executable, "-m", "dieseltwin", *command], capture_output=True, text=True, check=False,
                          env={**os.environ, "COLUMNS": "200"})  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(command)}: {done.stdout}{done.stderr}")
    processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.perf_counter() - began, processor, done.stdout + done.stderr


def judged(name: str, folder: Path) -> dict[str, Any]:
    """From the file to the verdict."""
    newcomer = NEWCOMERS[name]
    recording, options = newcomer.write(folder)
    mapping = str(folder / "map.yaml")
    cylinders = ["--cylinders", str(CYLINDERS)]
    channels = timed("channels", str(recording), *options, *cylinders, "--out", mapping)
    guessed = Path(mapping).read_text(encoding="utf-8")
    identify = timed("identify", str(recording), "--method", "classical", "--runs", "2", "--channels", mapping,
                     "--out", str(folder / "health"))  # fmt: skip
    discover = timed("discover", str(recording), "--channels", mapping, "--out", str(folder / "discovery"))
    document = load_discrepancy(folder / "discovery/discrepancy.json")
    notes = [line for line in identify[2].splitlines() if "note" in line]
    return {
        "file": name, "size": recording.stat().st_size, "map": guessed, "sentence": sentence(document),
        "notes": notes[:3],
        "effects": [effect.model_dump(mode="json") for effect in document.effects],
        "seconds": dict(zip(STEPS, (channels[:2], identify[:2], discover[:2]), strict=True)),
    }  # fmt: skip


def lines_of(rows: list[dict[str, Any]]) -> list[str]:
    """The table of docs/formats.md."""
    shown = []
    for row in rows:
        newcomer = NEWCOMERS[row["file"]]
        effect = row["effects"][0] if row["effects"] else None
        said = "nothing"
        if effect is not None:
            factor = IN_UNIT[newcomer.unit]
            names = "/".join([effect["name"], *effect["equivalent_names"]]).replace("_", " ")
            said = f"{names}, {factor * effect['magnitude']:.1f} ± {factor * effect['std']:.1f} {newcomer.unit}"
        times = [f"{row['seconds'][key][0]:.0f} ({row['seconds'][key][1]:.0f})" for key in STEPS]
        shown.append([row["file"], f"{row['size'] / 1e6:.1f} MB", f"{newcomer.fault.replace('_', ' ')}, "
                      f"{newcomer.true_size:.0f} {newcomer.unit}", said, *times])  # fmt: skip
    return table(["file", "size", "put in", "verdict", "channels [s]", "identify [s]", "discover [s]"], shown)


def main() -> None:
    """Run what is missing, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", nargs="+", choices=list(NEWCOMERS), default=list(NEWCOMERS))
    parser.add_argument("--page", action="store_true", help="write the table into docs/formats.md")
    given = parser.parse_args()
    rows = kept_lines(given.out)
    for name in (name for name in given.only if name not in {row["file"] for row in rows}):
        with tempfile.TemporaryDirectory() as scratch:
            row = judged(name, Path(scratch))
        rows.append(row)
        keep(given.out, row)
        print(name, row["seconds"], row["sentence"], flush=True)
    lines = lines_of(rows)
    print("\n".join(lines))
    if given.page:
        write_table("formats.md", "table of newcomers", lines)


if __name__ == "__main__":
    main()
