"""What a person waits for `discover` on sealed cases, and, with the true names withheld, how often it says so.

    dieseltwin challenge make --n 60 --seed 240124 --out cases
    python benchmarks/whole_commands.py cases --out times.jsonl

Each case is one process from start to the last file, alone on its core. Cases with a fault come a second time with all
their true names out of the catalogue, where it has them. Resumable: a case that stands in the file of JSON lines isn't
run again.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from bench import twin
from kept import keep, kept_lines

from dieseltwin.discovery.verdict.document import NONE_OF_THESE
from dieseltwin.engine.effects import EFFECTS

SLOW_S = (8.0, 15.0, 60.0)  # asked of the median, of nine in ten, of all


def cases(folder: Path) -> Iterator[tuple[str, Path, list[str]]]:
    """Name, recording, true names."""
    for sealed in sorted((folder / "sealed").glob("case_????.json")):
        truth = json.loads(sealed.read_text())
        yield truth["case"], folder / truth["case"] / "recording.csv", [e["effect"] for e in truth["effects"]]


def judged(recording: Path, true: list[str], withhold: list[str]) -> dict[str, Any]:
    """Seconds of the whole command, and what it said."""
    options = ("--withhold", ",".join(withhold)) if withhold else ()
    with tempfile.TemporaryDirectory() as name:
        told = twin("discover", recording.resolve(), "--out", Path(name) / "out", *options)
        document = json.loads((Path(name) / "out" / "discrepancy.json").read_text())
    named = sorted(effect["name"] for effect in document["effects"])
    return {"seconds": told.seconds, "processor": told.processor, "peak": told.peak, "true": true, "named": named,
            "mismatch": document["mismatch"]}  # fmt: skip


def table(rows: list[dict[str, Any]]) -> Iterator[str]:
    """One row for cases with the whole catalogue and one with the true names withheld; seconds, and how often
    `none_of_these` is said."""
    yield ("| catalogue | cases | middle | nine in ten | longest | processor, middle | none of these said |\n"
           "|---|---|---|---|---|---|---|")  # fmt: skip
    for withheld in (False, True):
        some = [row for row in rows if row["withheld"] == withheld]
        if some:
            seconds = np.array([row["seconds"] for row in some])
            middle = np.median([row["processor"] for row in some])
            none = sum(NONE_OF_THESE in row["named"] for row in some)
            yield (f"| {'true names withheld' if withheld else 'whole'} | {len(some)} | {np.median(seconds):.1f} s"
                   f" | {np.quantile(seconds, 0.9):.1f} s | {seconds.max():.1f} s | {middle:.1f} s"
                   f" | {none} of {len(some)} |")  # fmt: skip
    yield "asked: " + ", ".join(f"{seconds:g} s" for seconds in SLOW_S)


def main() -> None:
    """Run what isn't there yet and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--minutes", type=float, default=600.0, help="no new case after so long")
    asked = parser.parse_args()
    rows = kept_lines(asked.out)
    done = {(row["case"], row["withheld"]) for row in rows}
    until = time.monotonic() + 60.0 * asked.minutes
    for withheld in (False, True):
        for case, recording, true in cases(asked.folder):
            names = [name for name in true if withheld and name in EFFECTS]
            if (case, withheld) in done or (withheld and not names) or time.monotonic() > until:
                continue
            row = {"case": case, "withheld": withheld, **judged(recording, true, names)}
            rows.append(row)
            keep(asked.out, row)
            print(f"{case} {row['seconds']:.1f} s: {row['named']} (true {true})", flush=True)
    print("\n".join(table(rows)))


if __name__ == "__main__":
    main()
