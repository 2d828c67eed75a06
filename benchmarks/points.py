"""How often a channel that was withheld falls into the 90 % interval that `imply` states, on real settled points.

    python benchmarks/points.py OUT.jsonl --seeds 5 6 7 [--flapless]

Of the 145 points of the real heavy-duty engine two thirds are drawn to calibrate and discover, and the rest is asked
with each of six channels withheld, and with all of them. Beside the shares: median and rms error, the standard
deviation over the errors' (1 is honest), what was found, and the plausibility of what nobody measured. One line a seed
is appended; lines that are there aren't made again. Without the points it says so and ends.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from kept import keep, kept_lines

import dieseltwin as dt
from dieseltwin.engine import we2011
from dieseltwin.errors import InputError
from dieseltwin.recordings.public_data import path_of, wanted
from dieseltwin.recordings.steady_points import STATES

GEOMETRY = {"bore_mm": 130, "stroke_mm": 162, "n_cyl": 6, "r_c": 19}
TRAINED = 97
QUANTILE_90 = 1.6449  # of a Gaussian, both sides
HIDDEN = ("p_es_pa", "p_bc_pa", "t_im_k", "t_c_k", "t_es_k", "eta_vol", "eta_c")


def asked(seed: int, table: pd.DataFrame, folder: Path, flap: bool) -> dict[str, Any]:
    """What was found on drawn points, and how the others' withheld channels fall into their intervals.

    Args:
        seed: of the draw; folder: for files that are made; flap: whether its position was recorded.
    """
    table = table if flap else table.drop(columns="u_flap_pct")
    order = np.random.default_rng(seed).permutation(len(table))
    train, test = folder / f"train_{seed}.csv", table.iloc[np.sort(order[TRAINED:])].reset_index(drop=True)
    table.iloc[np.sort(order[:TRAINED])].to_csv(train, index=False)
    geometry = folder / "geometry.yaml"
    geometry.write_text("".join(f"{key}: {value}\n" for key, value in GEOMETRY.items()))
    began = time.process_time()
    engine = dt.calibrate(train, we2011.PARAMETERS, geometry=geometry).save(folder / f"engine_{seed}.yaml")
    found = dt.discover(train, engine)
    row: dict[str, Any] = {"seed": seed, "flap": flap, "sentence": found.sentence, "withheld": {}}
    for gone in [*((name,) for name in STATES), STATES]:
        path = folder / f"asked_{seed}.csv"
        test.drop(columns=list(gone)).to_csv(path, index=False)
        implied = dt.imply(path, found).table()
        row["withheld"]["all" if len(gone) > 1 else gone[0]] = {
            name: {"error": _rounded(implied[name] - test[name]), "std": _rounded(implied[f"{name}_std"]),
                   "true": _rounded(test[name])}
            for name in gone
        }  # fmt: skip
    test.to_csv(path, index=False)
    implied = dt.imply(path, found).table()
    row["hidden"] = {name: [float(implied[name].mean()), float(implied[name].std()),
                            float(implied[f"{name}_std"].mean())] for name in HIDDEN}  # fmt: skip
    row["cpu_s"] = time.process_time() - began
    return row


def _rounded(values: pd.Series) -> list[float]:
    return [float(f"{v:.6g}") for v in values]


def shares(rows: list[dict[str, Any]]) -> str:
    """Share inside, rms error and honesty of every channel, as a table in Markdown."""
    lines = ["| withheld | " + " | ".join(STATES) + " |", "|---" * (1 + len(STATES)) + "|"]
    for flap in (True, False):
        some = [row for row in rows if row["flap"] == flap]
        for together in (False, True):
            cells = []
            for name in STATES:
                parts = [row["withheld"]["all" if together else name][name] for row in some]
                error, std, true = (np.concatenate([p[key] for p in parts] or [[]]) for key in ("error", "std", "true"))
                if not error.size:
                    continue
                inside = np.mean(np.abs(error) < QUANTILE_90 * std)
                z = np.sqrt(np.mean((error / std) ** 2))
                rms = np.sqrt(np.mean(error**2)) / np.mean(np.abs(true))
                cells.append(f"{100 * inside:.0f} %, {100 * rms:.1f} %, {z:.2f}")
            if cells:
                what = "all six" if together else "this channel alone"
                lines.append(f"| {what}{'' if flap else ', flap not recorded'} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n(inside 90 %, rms error, rms of error over stated deviation)\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seeds", type=int, nargs="+", default=[5, 6, 7])
    parser.add_argument("--flapless", action="store_true")
    args = parser.parse_args()
    try:
        table = pd.read_csv(path_of(wanted("uw_hd_diesel/steady_state_points.csv")[0]))
    except InputError as missing:
        sys.exit(f"skipped: {missing}")
    rows = kept_lines(args.out)
    done = {(row["seed"], row["flap"]) for row in rows}
    folder = args.out.with_suffix(".files")
    folder.mkdir(exist_ok=True)
    for seed in args.seeds:
        if (seed, not args.flapless) in done:
            continue
        rows.append(asked(seed, table, folder, not args.flapless))
        keep(args.out, rows[-1])
        print(seed, rows[-1]["sentence"], f"[{rows[-1]['cpu_s']:.0f} s]", flush=True)
        print({k: [float(f"{v:.4g}") for v in values] for k, values in rows[-1]["hidden"].items()}, flush=True)
    print(shares(rows))


if __name__ == "__main__":
    main()
