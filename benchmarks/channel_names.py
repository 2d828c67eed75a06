"""How good the first guess of `dieseltwin channels` is: files with foreign names, and the same without any names.

    python benchmarks/channel_names.py [--page]

The files are those of `tests/recordings/guess`: 30 made up for this, 32 with names from public sources (control units,
diagnosis programs, apps, ships, benches; their docstring says which). Each is written from two drives: the simulated
reference, and ten minutes of the benchmark's plant with noise on every reading (`benchmarks/formats.py`). A guess is
right where its values are, unit and formula included. Without names each channel is "ch07" and keeps its unit.
`--page` writes the table into docs/formats.md.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import formats
import numpy as np
import pandas as pd
from pages import table, write_table

from dieseltwin.recordings.guess.propose import propose
from dieseltwin.recordings.importers.read import read_raw

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests/recordings/guess"))
from foreign import CYLINDERS, FILES, Foreign, drive, expected, without_names, written  # noqa: E402
from foreign_later import LATER  # noqa: E402
from foreign_public import AGAIN, PUBLIC  # noqa: E402
from foreign_unseen import UNSEEN  # noqa: E402
from test_propose import judged  # noqa: E402

MADE_UP = (*FILES, *LATER)


def counted(files: Sequence[Foreign], known: Mapping[str, np.ndarray], folder: Path) -> list[str]:
    """Cells of one line: right of asked, wrong with a warning, wrong without, seconds a file."""
    right = warned = silent = asked = 0
    began = time.perf_counter()
    for file in files:
        path = folder / "drive.csv"
        path.write_text(written(file, dict(known)), encoding="utf-8")
        found = judged(file, propose(read_raw(path), cylinders=CYLINDERS), dict(known))
        right, warned, silent = right + len(found[0]), warned + len(found[1]), silent + len(found[2])
        asked += len(expected(file))
    seconds = (time.perf_counter() - began) / len(files)
    return [f"{right} of {asked} ({right / asked:.0%})", str(warned), str(silent), f"{seconds:.2f} s"]


def has_units(file: Foreign) -> bool:
    """Whether most channels have a unit, in a row of their own or in their names."""
    units = without_names(file).units.values()
    return sum(unit != "" for unit in units) > len(file.channels) / 2


def main() -> None:
    """Judge all files on both drives, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--page", action="store_true", help="write the table into docs/formats.md")
    page = parser.parse_args().page
    drives = {"reference": drive(pd.read_csv(ROOT / "tests/reference/field_random_300s.csv")),
              "benchmark's plant, noise": drive(formats.drive())}  # fmt: skip
    lists: dict[str, Sequence[Foreign]] = {
        "30 files made up": MADE_UP, "20 files with names from public sources": (*PUBLIC, *AGAIN),
        "12 more, written down before they were tried": UNSEEN,
        "those that give units, without names": [without_names(f) for f in (*MADE_UP, *PUBLIC, *AGAIN) if has_units(f)],
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as scratch:
        rows = [[name, title, *counted(files, known, Path(scratch))]
                for name, files in lists.items() for title, known in drives.items()]  # fmt: skip
    lines = table(["files", "drive", "right at the first try", "wrong, warned", "wrong, silent", "time a file"], rows)
    print("\n".join(lines))
    if page:
        write_table("formats.md", "table of names", lines)


if __name__ == "__main__":
    main()
