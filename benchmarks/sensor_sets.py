"""What six, five, four and three sensors can tell: `discover` against the truth. With fewer it refuses.

    python benchmarks/sensor_sets.py OUT.jsonl [--page]

Machines of the plant of docs/benchmark.md (maps off by 0.3 %, tolerances of sensors, the paper's noise, 12 bits), ten
minutes at 5 Hz each: two that are healthy, seven with an effect each. Each is judged with every set, and what
`discover` says beforehand that the set can show is held against what it finds; `identify` is asked about the healthy
ones. Lines that are in OUT.jsonl aren't run again; `--page` writes the tables into docs/formats.md.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from drawn_machine import DrawnMachine
from kept import keep, kept_lines
from pages import table, write_table

import dieseltwin as dt
from dieseltwin.challenge.plant_effects import Fault
from dieseltwin.challenge.sensors import SENSORS
from dieseltwin.engine import HEALTH
from dieseltwin.engine.effects import EFFECTS

SEED = 8301
SETS: dict[str, tuple[str, ...]] = {
    "six": SENSORS,
    "five (no w_c)": SENSORS[:5],
    "four (no w_c, w_egr)": (*SENSORS[:3], "t_em_k"),
    "three (p_im, p_em, omega_t)": SENSORS[:3],
}
MACHINES: dict[str, Fault | None] = {
    "healthy 1": None, "healthy 2": None, "boost leak": Fault("boost_leak", 2.5e-5),
    "back pressure": Fault("back_pressure", 9e4), "bearing friction": Fault("bearing_friction", 7e-6),
    "EGR valve leak": Fault("egr_valve_leak", 0.02), "turbine loss": Fault("turbine_efficiency_loss", 0.03),
    "exhaust leak": Fault("exhaust_leak", 2.5e-5), "compressor flow loss": Fault("compressor_flow_loss", 0.06),
}  # fmt: skip
"""The last four were added later, with sizes between what six and what three sensors were said to show."""
IDENTIFIABLE = 0.25  # relative deviation up to which a parameter counts as told
OUT_OF_REACH = 10.0  # times the smallest size that six sensors show


def recorded(name: str) -> tuple[pd.DataFrame, dict[str, float]]:
    """The recording of a machine with all sensors, and its health."""
    rng = np.random.default_rng([SEED, list(MACHINES).index(name)])
    machine, fault = DrawnMachine.draw(600.0, rng), MACHINES[name]
    return machine.recorded([] if fault is None else [fault], rng), machine.health


def judged(machine: str, chosen: str) -> dict[str, Any]:
    """What `discover` says of a machine with a set of sensors."""
    frame, truth = recorded(machine)
    began = time.perf_counter()
    document = dt.discover(frame, sensors=SETS[chosen]).document
    found: dict[str, list[float]] = {}
    if MACHINES[machine] is None:
        values = dt.identify(frame, runs=1, setup=dt.Setup(sensors=SETS[chosen])).table()
        found = {key: [float(values.loc[key, "mean"]), float(values.loc[key, "std"])] for key in HEALTH}
    return {
        "machine": machine, "set": chosen, "seconds": time.perf_counter() - began, "truth": truth,
        "effects": [[effect.name, *effect.equivalent_names] for effect in document.effects],
        "health": {key: [value.value, value.std] for key, value in document.health.items()},
        "smallest": dict(document.minimum_detectable), "identify": found,
    }  # fmt: skip


def health_lines(rows: list[dict[str, Any]]) -> list[str]:
    """Deviation of each parameter, the error in deviations, and what was named, by set."""
    shown = []
    for chosen in SETS:
        here = [row for row in rows if row["set"] == chosen]
        if not here:
            continue
        cells = []
        for key in HEALTH:
            told = [(row["health"][key][0] - row["truth"][key], row["health"][key][1], row["truth"][key])
                    for row in here if row["health"][key][1]]  # fmt: skip
            rel = float(np.median([std / abs(true) for _, std, true in told])) if told else np.inf
            if rel > IDENTIFIABLE:
                cells.append("out of reach" if not told else f"no ({100.0 * rel:.0f} %)")
                continue
            cells.append(f"{100.0 * rel:.1f} % ({max(abs(error) / std for error, std, _ in told):.1f})")
        said = []
        for row in here:
            names = " and ".join("/".join(effect) for effect in row["effects"]) or "nothing"
            said.append(f"{row['machine']}: {names.replace('_', ' ')}")
        shown.append([chosen, *cells, "; ".join(said)])
    return table(["sensors", *HEALTH, "said"], shown)


def effect_lines(rows: list[dict[str, Any]]) -> list[str]:
    """Smallest size of each effect that shows, beside that with six sensors."""
    smallest: dict[str, dict[str, float]] = {}
    for chosen in SETS:
        found = [row["smallest"] for row in rows if row["set"] == chosen and row["machine"].startswith("healthy")]
        smallest[chosen] = {name: float(np.median([one[name] for one in found if name in one])) for name in EFFECTS
                            if any(name in one for one in found)}  # fmt: skip
    lines = []
    for name in sorted(smallest["six"]):
        least = smallest["six"][name]
        cells = []
        for chosen in list(SETS)[1:]:
            ratio = smallest[chosen].get(name, np.inf) / least
            cells.append("-" if ratio > OUT_OF_REACH else f"{ratio:.1f}")
        lines.append([name.replace("_", " "), f"{least:.2g} {EFFECTS[name].unit}", *cells])
    return table(["effect", "smallest with six", *list(SETS)[1:]], lines)


def identify_lines(rows: list[dict[str, Any]]) -> list[str]:
    """Deviation of each parameter by `identify` on the healthy machines, and its largest error in deviations."""
    shown = []
    for chosen in SETS:
        here = [row for row in rows if row["set"] == chosen and row["identify"]]
        cells = []
        for key in HEALTH if here else ():
            rel = float(np.median([row["identify"][key][1] / row["truth"][key] for row in here]))
            off = max(abs(row["identify"][key][0] - row["truth"][key]) / row["truth"][key] for row in here)
            cells.append(f"{100.0 * rel:.2f} % ({100.0 * off:.1f} %)")
        if here:
            shown.append([chosen, *cells])
    return table(["sensors", *HEALTH], shown)


def visible_lines(rows: list[dict[str, Any]]) -> list[str]:
    """Each planted effect over the smallest size that `discover` said it could show, and what it then named."""
    shown = []
    for machine, fault in MACHINES.items():
        if fault is None:
            continue
        cells = []
        for chosen in SETS:
            row = next((r for r in rows if r["machine"] == machine and r["set"] == chosen), None)
            if row is None:
                cells.append("")
                continue
            smallest = row["smallest"].get(fault.effect)
            size = "out of reach" if smallest is None else f"{fault.magnitude / smallest:.1f}"
            named = "nothing" if not row["effects"] else "its name" if row["effects"][0] == [fault.effect] else (
                "one of " + str(len(row["effects"][0])) if fault.effect in row["effects"][0] else row["effects"][0][0])
            cells.append(f"{size}: {named.replace('_', ' ')}")
        shown.append([f"{machine}, {fault.magnitude:.2g} {EFFECTS[fault.effect].unit}", *cells])
    return table(["put in", *SETS], shown)


def main() -> None:
    """Run what is missing, print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--page", action="store_true", help="write the tables into docs/formats.md")
    given = parser.parse_args()
    rows = kept_lines(given.out)
    known = {(row["machine"], row["set"]) for row in rows}
    for machine, chosen in ((m, s) for m in MACHINES for s in SETS if (m, s) not in known):
        row = judged(machine, chosen)
        rows.append(row)
        keep(given.out, row)
        print(machine, "|", chosen, row["effects"], f"{row['seconds']:.0f} s", flush=True)
    first, second, third, fourth = health_lines(rows), effect_lines(rows), visible_lines(rows), identify_lines(rows)
    print("\n".join([*first, "", *second, "", *third, "", *fourth]))
    if given.page:
        write_table("formats.md", "table of sensor sets", first)
        write_table("formats.md", "table of sensor sets, effects", second)
        write_table("formats.md", "table of sensor sets, visible", third)
        write_table("formats.md", "table of sensor sets, identify", fourth)


if __name__ == "__main__":
    main()
