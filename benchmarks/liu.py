"""The petrol engine's real recordings (LiU-ICE): documented faults, planted faults, and false alarms, at every length.

    python benchmarks/liu.py OUT.jsonl [--part documented|healthy|planted] [--seconds 600] [--table FILE]

Maps are learned on the fault-free run alone, and a piece of it is judged by maps that did not see that half. Thirty
minutes that no map saw are the faulty runs with their documented fault taken back. One line a judgement is appended;
lines that are there aren't made again, so that a stopped run goes on. Without the recordings it says so and ends.
A leak is planted as it looks under control: the throttle closes until it lets in no more than it ever did, and from
there on the manifold's pressure rises as the calibrated engine says.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from kept import keep, kept_lines

from dieseltwin.errors import InputError
from dieseltwin.petrol.calibrate import fit_maps
from dieseltwin.petrol.components import signed_leak
from dieseltwin.petrol.discover import discover_petrol
from dieseltwin.petrol.maps import spline_basis
from dieseltwin.petrol.model import ALPHA_SHIFT
from dieseltwin.petrol.parameters import PetrolParameters, PetrolTerm
from dieseltwin.petrol.recording import PetrolRecording, Signals, read_petrol
from dieseltwin.petrol.simulate import simulate_petrol
from dieseltwin.recordings.public_data import path_of, wanted

FAULT_FREE = "wltp_NF.csv"
DOCUMENTED: Mapping[str, tuple[str, str, float]] = {
    "pim_090": ("p_im", "p_im_gain", -0.10), "waf_110": ("W_af", "w_af_gain", 0.10),
    "pic_110": ("p_ic", "p_ic_gain", 0.10),
}  # fmt: skip
ONSET_S = 100.0  # of what is planted
DOCUMENTED_ONSET_S = {"pim_090": 190.0, "waf_110": 121.0, "pic_110": 123.0}  # as the data show them
MINUTES = (5, 15, 30)
LEAKS_MM2 = (2.0, 5.0, 10.0, 20.0, 40.0)
GAIN = 0.05
LEAST_QUANTILE = 0.002  # of the flow and of the opening: the least that this throttle lets in, recorded
LAG_S = 0.5


@dataclass(frozen=True)
class Fault:
    """What is planted: the name the verdict has to give ("" for none of the catalogue), column or kind, and size."""

    name: str
    column: str
    size: float
    kind: str = "gain"

    @property
    def key(self) -> str:
        return f"{self.kind} {self.column} {self.size:+.4g}" if self.column else "healthy"


NOTHING = Fault("", "", 0.0, "healthy")
SENSORS = {"p_im": "p_im_gain", "p_ic": "p_ic_gain", "W_af": "w_af_gain", "T_ic": "t_ic_offset",
           "alpha": "throttle_gain", "p_amb": "p_amb_gain", "omega_e": "", "T_amb": "t_amb_offset"}
LATE = {"p_im": "p_im_late", "W_af": "w_af_late", "alpha": "throttle_late"}
PLANTED: tuple[Fault, ...] = (
    *(Fault(name, column, sign * GAIN) for column, name in SENSORS.items() for sign in (1.0, -1.0)),
    *(Fault("intake_leak", "intake", 1e-6 * size, "leak") for size in LEAKS_MM2),
    *(Fault("boost_leak", "boost", 1e-6 * size, "leak") for size in LEAKS_MM2),
    Fault("p_im_offset", "p_im", 5e3, "offset"), Fault("p_ic_offset", "p_ic", 5e3, "offset"),
    Fault("w_af_offset", "W_af", 5e-4, "offset"), Fault("throttle_offset", "alpha", 0.5, "offset"),
    *(Fault("", column, 0.0, "frozen") for column in ("p_im", "p_ic", "W_af", "T_ic")),
    *(Fault(name, column, LAG_S, "lag") for column, name in LATE.items()),
)  # fmt: skip


def opening_for(factor: np.ndarray, alpha: np.ndarray, engine: PetrolParameters) -> np.ndarray:
    """Throttle position [%] that lets through `factor` of the flow at `alpha`."""
    positions = np.linspace(0.0, 100.0, 4000)
    knots = np.array(engine.maps[1].knots_x)
    basis = spline_basis(np.log(positions + ALPHA_SHIFT), knots)
    log_area = np.maximum.accumulate(basis @ np.array(engine.maps[1].coefficients[: basis.shape[1]]))
    log_area += 1e-9 * np.arange(len(log_area))
    return np.interp(np.interp(alpha, positions, log_area) + np.log(factor), log_area, positions)


def leaking(s: Signals, area: float, onset_s: float, engine: PetrolParameters, floor: tuple[float, float]) -> Signals:
    """The signals with a hole of the intake manifold: what the engine's equations change is put on what was read.

    Args:
        s: without a leak; area: [m2]; onset_s: since when.
        engine: calibrated.
        floor: least flow [kg/s] and opening [%] of the throttle.
    """
    active = s.time_s >= onset_s
    least_flow, least_alpha = floor
    wanted = s.W_af - np.where(active, signed_leak(area, s.p_im, s.T_ic, s.p_amb, s.T_amb), 0.0)
    factor = np.where(active, np.maximum(wanted, np.minimum(least_flow, s.W_af)) / s.W_af, 1.0)
    closing = np.maximum(opening_for(factor, s.alpha, engine), np.minimum(least_alpha, s.alpha))
    alpha = np.where(active, closing, s.alpha)
    term = PetrolTerm(effect="intake_leak", magnitude=area, onset_s=onset_s, found_in="planted")
    closed, holed = replace(s, alpha=alpha), engine.model_copy(update={"terms": (term,)})
    before = simulate_petrol(engine, PetrolRecording(s, 0.0, "", "planted", ()))
    after = simulate_petrol(holed, PetrolRecording(closed, 0.0, "", "planted", ()))
    return replace(closed, p_im=s.p_im * (after.p_im_pa / before.p_im_pa).to_numpy(),
                   W_af=s.W_af * (after.w_af_kg_s / before.w_af_kg_s).to_numpy())  # fmt: skip


def planted(s: Signals, fault: Fault, engine: PetrolParameters, floor: tuple[float, float], onset_s: float) -> Signals:
    """The signals with a fault from `onset_s` [s] on."""
    if not fault.column:
        return s
    active = s.time_s >= onset_s
    if fault.kind == "leak" and fault.column == "intake":
        return leaking(s, fault.size, onset_s, engine, floor)
    if fault.kind == "leak":
        lost = -signed_leak(fault.size, s.p_ic, s.T_ic, s.p_amb, s.T_amb)
        return replace(s, W_af=s.W_af + np.where(active, lost, 0.0))
    values = getattr(s, fault.column)
    changed = {
        "gain": lambda: values * (1.0 + fault.size), "offset": lambda: values + fault.size,
        "frozen": lambda: np.full_like(values, values[np.argmax(active)]),
        "lag": lambda: np.interp(s.time_s - fault.size, s.time_s, values),
    }[fault.kind]()  # fmt: skip
    return replace(s, **{fault.column: np.where(active, changed, values)})


@dataclass(frozen=True)
class Case:
    """One judgement: where its signals come from, what is planted since when, its length, and who judges."""

    base: str
    start_s: float
    minutes: float
    fault: Fault
    onset_s: float
    learned: tuple[float, float] | None  # span of the fault-free run that its maps did not see [s]

    @property
    def key(self) -> str:
        return f"{self.base} {self.start_s:.0f} {self.minutes:g} {self.fault.key} {self.onset_s:.0f}"


def documented_cases() -> Iterator[Case]:
    """Whole runs and pieces of five minutes of the faulty runs."""
    for run, (_, name, size) in DOCUMENTED.items():
        onset, fault = DOCUMENTED_ONSET_S[run], Fault(name, run, size, "documented")
        yield Case(run, 0.0, 30.0, fault, onset, None)
        for k in range(6):
            yield Case(run, 300.0 * k, 5.0, fault, max(onset - 300.0 * k, 0.0), None)


def healthy_cases() -> Iterator[Case]:
    """Nothing wrong: halves and pieces of the fault-free run by the other half's maps; faulty runs taken back."""
    for half in (0.0, 900.0):
        unseen = (half, half + 905.0)
        yield Case("NF", half, 15.0, NOTHING, 0.0, unseen)
        for k in range(3):
            yield Case("NF", half + 300.0 * k, 5.0, NOTHING, 0.0, unseen)
    for run in DOCUMENTED:
        for minutes in MINUTES:
            for k in range(30 // minutes):
                yield Case(run + " taken back", 60.0 * minutes * k, float(minutes), NOTHING, 0.0, None)


def planted_cases() -> Iterator[Case]:
    """Every fault at every length, in recordings that no map saw."""
    first, second = (0.0, 905.0), (900.0, 1805.0)
    places = [
        ("NF", 900.0, 5.0, second), ("NF", 900.0, 15.0, second), ("pic_110 taken back", 0.0, 30.0, None),
        ("NF", 300.0, 5.0, first), ("NF", 0.0, 15.0, first), ("waf_110 taken back", 0.0, 30.0, None),
    ]  # fmt: skip
    for base, start, minutes, unseen in places:
        for fault in PLANTED:
            yield Case(base, start, minutes, fault, ONSET_S, unseen)


CASES: Mapping[str, Callable[[], Iterator[Case]]] = {
    "documented": documented_cases, "healthy": healthy_cases, "planted": planted_cases,
}  # fmt: skip


class Bench:
    """Recordings and calibrated engines, each made once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.signals: dict[str, Signals] = {}
        self.engines: dict[tuple[float, float] | None, PetrolParameters] = {}
        healthy = self.of("NF")
        self.floor = float(np.quantile(healthy.W_af, LEAST_QUANTILE)), float(np.quantile(healthy.alpha, LEAST_QUANTILE))

    def of(self, base: str) -> Signals:
        """Signals of a whole run, its documented fault taken back if `base` says so."""
        if base not in self.signals:
            run = base.split()[0]
            s = read_petrol(self.folder / (FAULT_FREE if run == "NF" else f"wltp_f_{run}.csv")).signals
            if base.endswith("taken back"):
                column, _, size = DOCUMENTED[run]
                active = s.time_s >= DOCUMENTED_ONSET_S[run]
                s = replace(s, **{column: np.where(active, getattr(s, column) / (1.0 + size), getattr(s, column))})
            self.signals[base] = s
        return self.signals[base]

    def engine(self, unseen: tuple[float, float] | None) -> PetrolParameters:
        """Learned on the fault-free run without a span."""
        if unseen not in self.engines:
            self.engines[unseen] = fit_maps(self.of("NF"), PetrolParameters(), without=unseen)[0]
        return self.engines[unseen]

    def judged(self, case: Case) -> dict[str, object]:
        """What the twin says of a case."""
        piece = self.of(case.base).part(case.start_s, case.start_s + 60.0 * case.minutes)
        fault = case.fault if case.fault.kind not in ("documented", "healthy") else NOTHING
        piece = planted(piece, fault, self.engine(None), self.floor, case.onset_s)
        began = time.process_time()
        found = discover_petrol(PetrolRecording(piece, 0.0, case.key, "", ()), self.engine(case.learned))
        d = found.document
        return {
            "key": case.key, "base": case.base, "minutes": case.minutes, "kind": case.fault.kind,
            "fault": asdict(case.fault), "onset_s": case.onset_s, "mismatch": d.mismatch,
            "site": None if d.location is None else d.location.site,
            "effects": [{"name": e.name, "size": e.magnitude, "std": e.std, "same": list(e.equivalent_names)}
                        for e in d.effects],
            "found_onset_s": None if d.location is None else d.location.onset_s,
            "sentence": found.sentence, "cpu_s": round(time.process_time() - began, 2),
        }  # fmt: skip


def right(row: dict, strict: bool = False) -> bool:
    """Whether the first effect is the planted one, or one that is said not to be told from it."""
    if not row["effects"]:
        return False
    first = row["effects"][0]
    return row["fault"]["name"] in ([first["name"]] if strict else [first["name"], *first["same"]])


def table(rows: list[dict]) -> str:
    """Counts by fault and length, as a table in Markdown."""
    frame = pd.DataFrame([
        {"fault": Fault(**r["fault"]).key, "minutes": r["minutes"], "seen": r["mismatch"], "named": right(r)}
        for r in rows
    ])  # fmt: skip
    lengths = sorted(frame.minutes.unique())
    lines = ["| fault | " + " | ".join(f"{m:g} min: seen, named" for m in lengths) + " |",
             "|---" * (1 + len(lengths)) + "|"]  # fmt: skip
    for fault, own in frame.groupby("fault", sort=False):
        cells = []
        for minutes in lengths:
            some = own[own.minutes == minutes]
            cells.append(f"{some.seen.sum()}, {some.named.sum()} of {len(some)}" if len(some) else "")
        lines.append(f"| {fault} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--part", choices=[*CASES], action="append")
    parser.add_argument("--only", default="", help="cases whose key holds this")
    parser.add_argument("--seconds", type=float, default=np.inf, help="stop after")
    parser.add_argument("--table", type=Path)
    args = parser.parse_args()
    try:
        folder = path_of(wanted(f"liu_ice/{FAULT_FREE}")[0]).parent
    except InputError as missing:
        sys.exit(f"skipped: {missing}")
    began = time.monotonic()
    rows = kept_lines(args.out)
    done = {row["key"] for row in rows}
    bench = Bench(folder)
    for part in args.part or CASES:
        for case in CASES[part]():
            if case.key in done or args.only not in case.key or time.monotonic() - began > args.seconds:
                continue
            row = {"part": part, **bench.judged(case)}
            rows.append(row)
            keep(args.out, row)
            print(f"{case.key}: {row['sentence'][:150]} [{row['cpu_s']} s]", flush=True)
    if args.table is not None and rows:
        args.table.write_text("\n".join(f"{part}\n\n{table([r for r in rows if r['part'] == part])}" for part in CASES
                                        if any(r["part"] == part for r in rows)))


if __name__ == "__main__":
    main()
