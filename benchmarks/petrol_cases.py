"""Drawn faults of the made-up petrol engine: gains, offsets, leaks, healthy; 5 to 30 minutes, half of them with a gap.

    PYTHONPATH=. python benchmarks/petrol_cases.py [CASES] [SEED]

The plant (`tests/petrol/plant.py`) imports nothing of the twin but a constant. Faults start at a drawn time or before
the recording. Counted: right name among the names reported, size, onset, false alarms.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from dieseltwin.petrol.calibrate import fit_maps
from dieseltwin.petrol.discover import discover_petrol
from dieseltwin.petrol.parameters import PetrolParameters
from dieseltwin.petrol.recording import read_petrol
from tests.petrol.plant import drive

CALIBRATION_S, CALIBRATION_SEED = 1800.0, 90001
MINUTES = (5.0, 10.0, 20.0, 30.0)
LARGEST_GAP_S = 40.0
FAULTS = {  # fault -> (column or argument of the plant, name, smallest and largest size)
    "p_im": ("p_im_Pa", "p_im_gain", 0.04, 0.15), "p_ic": ("p_ic_Pa", "p_ic_gain", 0.04, 0.15),
    "w_af": ("W_af_kg_s", "w_af_gain", 0.05, 0.15), "leak": ("leak_m2", "intake_leak", 2e-6, 4e-5),
    "p_im_offset": ("p_im_Pa", "p_im_offset", 2e3, 6e3), "w_af_offset": ("W_af_kg_s", "w_af_offset", 2e-4, 6e-4),
}  # fmt: skip


def case(number: int, seed: int, folder: Path) -> tuple[str, float, float | None, Path, str]:
    """Name (or healthy), size, onset (None: from the start), the file, and what it is in words."""
    rng = np.random.default_rng([seed, number])
    kind = "healthy" if number % 3 == 0 else rng.choice(list(FAULTS))
    duration = 60.0 * rng.choice(MINUTES)
    onset = None if rng.random() < 0.4 else float(rng.uniform(0.15, 0.6) * duration)
    arguments: dict[str, float] = {"onset_s": onset or 0.0}
    name, size = "healthy", 0.0
    if kind != "healthy":
        column, name, low, high = FAULTS[kind]
        size = float(np.exp(rng.uniform(np.log(low), np.log(high))))
        if kind in ("p_im", "p_ic", "w_af"):
            size *= rng.choice([-1.0, 1.0])
        if not name.endswith("offset"):
            arguments[column] = size
    table = drive(duration, int(rng.integers(1 << 30)), **arguments)
    if name.endswith("offset"):
        table.loc[table.time_s >= (onset or 0.0), column] += size
    gap = rng.random() < 0.5
    if gap:
        start = rng.uniform(0.1, 0.9) * duration
        table = table[~table.time_s.between(start, start + rng.uniform(1.5, LARGEST_GAP_S))]
    path = folder / f"case_{number:03d}.csv"
    table.to_csv(path, index=False)
    since = "from the start" if onset is None else f"at {onset:.0f} s"
    return name, size, onset, path, f"{duration / 60:.0f} min{', gap' if gap else ''}, {name} {size:.3g} {since}"


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 24
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    marks: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        drive(CALIBRATION_S, CALIBRATION_SEED).to_csv(folder / "healthy.csv", index=False)
        engine = fit_maps(read_petrol(folder / "healthy.csv").signals, PetrolParameters())[0]
        for number in range(count):
            true, size, onset, path, words = case(number, seed, folder)
            began = time.perf_counter()
            d = discover_petrol(read_petrol(path), engine).document
            path.unlink()
            first = d.effects[0] if d.effects else None
            told = "nothing" if first is None else f"{' or '.join(first.names)} {first.magnitude or float('nan'):.3g}"
            if true == "healthy":
                marks["healthy"] += 1
                marks["false alarms"] += d.mismatch
            else:
                right = first is not None and true in first.names
                marks["faults"] += 1
                marks["seen"] += d.mismatch
                marks["right name reported"] += right
                marks["a second effect beside it"] += len(d.effects) > 1
                if first is not None and first.name == true and first.magnitude is not None:
                    marks["first name right"] += 1
                    marks["size within 10 %"] += abs(first.magnitude / size - 1.0) < 0.1
                    found = None if d.location is None else d.location.onset_s
                    marks["onset within 10 s"] += abs((found or 0.0) - (onset or 0.0)) < 10.0
            print(f"{number:3d} {words:<52} {told}  ({time.perf_counter() - began:.1f} s)", flush=True)
            print("    " + ", ".join(f"{k} {v}" for k, v in marks.items()), flush=True)


if __name__ == "__main__":
    main()
