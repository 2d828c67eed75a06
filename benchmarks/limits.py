"""How far the commands go: 5 million rows, ten hours, 1,000 files; seconds, peak memory, and what they say.

    python benchmarks/limits.py [--only TEXT] [--folder FOLDER]

The recordings are random driving of the laboratory engine with the paper's noise, repeated: five minutes that come
again and again, with the noise drawn anew. Peak memory is that of the process and of its children.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

ROOT = Path(__file__).resolve().parents[1]
LIMIT_S = 900
NOISE = {"p_im_pa": 0.03, "p_em_pa": 0.03, "omega_t_rad_s": 0.01, "w_egr_kg_s": 0.05, "t_em_k": 0.03, "w_c_kg_s": 0.03}
KEPT = ("n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct", *NOISE)
MANY = 1000


def driving(rows: int, step_s: float) -> pd.DataFrame:
    """So many rows of driving; a step other than 0.2 s repeats readings, as a logger that runs faster does."""
    frame = pd.read_csv(ROOT / "tests" / "reference" / "field_random_300s.csv")[list(KEPT)]
    once = frame.to_numpy()[np.arange(rows) % len(frame)]
    rng = np.random.default_rng(1)
    table = pd.DataFrame(once, columns=list(KEPT))
    for name, share in NOISE.items():
        table[name] += share * table[name].mean() * rng.standard_normal(rows)
    table.insert(0, "time_s", np.round(step_s * np.arange(rows), 4))
    return table


def write(folder: Path) -> None:
    """The three inputs."""
    ten_hours = driving(180_001, 0.2)
    ten_hours.to_csv(folder / "ten_hours.csv", index=False)
    driving(5_000_000, 0.1).to_csv(folder / "five_million.csv", index=False, float_format="%.9g")
    (folder / "many").mkdir()
    for number in range(MANY):
        part = ten_hours.iloc[179 * number : 179 * number + 600]
        day = f"2026-{1 + number // 84:02d}-{1 + number // 3 % 28:02d}"
        part.to_csv(folder / "many" / f"{day}_{number:04d}.csv", index=False)


def cases(folder: Path) -> list[tuple[str, list[str]]]:
    """What is run."""
    found = []
    for name in ("five_million", "ten_hours"):
        path = str(folder / f"{name}.csv")
        found += [
            (f"{name}: channels", ["channels", path, "--out", str(folder / "map.yaml")]),
            (f"{name}: simulate", ["simulate", path, "--out", str(folder / "simulated.parquet")]),
            (f"{name}: identify, one start", ["identify", path, "--runs", "1", "--out", str(folder / "found")]),
            (f"{name}: discover", ["discover", path, "--out", str(folder / "discovery")]),
            (f"{name}: learn", ["learn", path, "--out", str(folder / "mine.yaml")]),
        ]
    files = [str(path) for path in sorted((folder / "many").iterdir())]
    return [
        *found,
        ("1,000 files: a folder for a file", ["discover", str(folder / "many"), "--out", str(folder / "discovery")]),
        ("1,000 files: discover", ["discover", *files, "--out", str(folder / "discovery")]),
        ("1,000 files: learn", ["learn", *files, "--out", str(folder / "mine.yaml")]),
    ]


def _limited() -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (LIMIT_S, LIMIT_S))


def measured(arguments: list[str]) -> tuple[int, float, float, float, str]:
    """Exit code, wall and processor seconds, peak memory [MB], last line."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    began = time.perf_counter()
    with tempfile.TemporaryFile("w+") as heard:
        process = subprocess.Popen([sys.executable, "-m", "dieseltwin", *arguments], cwd=ROOT, env=environment,
                                   stdout=heard, stderr=subprocess.STDOUT, preexec_fn=_limited)  # fmt: skip
        _, status, usage = os.wait4(process.pid, 0)
        heard.seek(0)
        lines = heard.read().strip().splitlines()
    return (os.waitstatus_to_exitcode(status), time.perf_counter() - began, usage.ru_utime + usage.ru_stime,
            usage.ru_maxrss / 1024.0, lines[-1] if lines else "")  # fmt: skip


def main() -> None:
    """Print a row a case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="cases whose name contains this text")
    parser.add_argument("--folder", type=Path, help="kept, and used again; else a temporary one")
    asked = parser.parse_args()
    folder = asked.folder or Path(tempfile.mkdtemp(prefix="limits-"))
    try:
        if not (folder / "many").exists():
            folder.mkdir(parents=True, exist_ok=True)
            write(folder)
        print("| case | exit | s | processor s | peak MB | last line |\n|---|---|---|---|---|---|")
        for name, arguments in cases(folder):
            if asked.only in name:
                code, wall, cpu, peak, last = measured(arguments)
                told = last.replace(str(folder), "...")[:160]
                print(f"| {name} | {code} | {wall:.0f} | {cpu:.0f} | {peak:.0f} | {told} |", flush=True)
    finally:
        if asked.folder is None:
            shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main()
