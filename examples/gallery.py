"""Runs the examples that are written in cells and writes docs/gallery.md: code, what it printed, its figures.

    python examples/gallery.py

Some ninety seconds of processor time. The figures go to docs/figures/gallery_*.png.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
from PIL import Image

HERE = Path(__file__).resolve().parent
DOCS = HERE.parent / "docs"
SCRIPTS = ("health_parameters.py", "from_file_to_repaired_twin.py")
FOLDER = re.compile(r"^FOLDER = .*$", re.MULTILINE)
WIDTH, COLOURS = 900, 48  # of a figure [pixels]: what a page shows, and lines and text need
HEAD = """# Gallery

Examples that were run as they stand here: the code, what it printed, the figures it drew. The scripts lie in
`examples/`; `python examples/gallery.py` runs them and writes this page.
"""


def cells(script: Path) -> Iterator[tuple[str, str]]:
    """Kind ("markdown" or "code") and text of every cell of a script."""
    for part in re.split(r"^# %%", script.read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]:
        head, _, body = part.partition("\n")
        if "[markdown]" in head:
            yield "markdown", "\n".join(line.removeprefix("#").removeprefix(" ") for line in body.strip().splitlines())
        else:
            yield "code", body.strip("\n")


def section(script: Path, folder: Path) -> Iterator[str]:
    """Parts of the page for one script; what it writes goes to `folder`."""
    names: dict[str, Any] = {"__name__": "__main__"}
    drawn: set[Path] = set()
    titled = False
    for kind, text in cells(script):
        if kind == "markdown":
            first, _, rest = text.partition("\n")
            yield text if titled else f"## {first}\n{rest}\n\n`examples/{script.name}`"
            titled = True
            continue
        yield f"```python\n{text}\n```"
        said = io.StringIO()
        with contextlib.redirect_stdout(said):
            exec(compile(FOLDER.sub(f"FOLDER = Path({str(folder)!r})", text), script.name, "exec"), names)
        plt.close("all")
        printed = "\n".join(line.rstrip() for line in said.getvalue().replace(str(folder), "FOLDER").splitlines())
        if printed.strip():
            yield f"```text\n{printed.strip(chr(10))}\n```"
        for picture in sorted(set(folder.glob("*.png")) - drawn):
            drawn.add(picture)
            yield f"![{picture.stem} of {script.stem}](figures/{kept(picture, script)})"


def kept(picture: Path, script: Path) -> str:
    """Name of the small copy of a picture in docs/figures."""
    name = f"gallery_{script.stem}_{picture.stem}.png"
    with Image.open(picture) as opened:
        whole = opened.convert("RGB")
    small = whole.resize((WIDTH, round(WIDTH * whole.height / whole.width)), Image.Resampling.LANCZOS)
    small.quantize(COLOURS, dither=Image.Dither.NONE).save(DOCS / "figures" / name, optimize=True)
    return name


def main() -> None:
    """Write the page; nothing is written where a script fails."""
    matplotlib.use("Agg")
    os.environ.setdefault("TQDM_DISABLE", "1")
    parts = [HEAD.strip()]
    for name in SCRIPTS:
        with tempfile.TemporaryDirectory() as folder:
            parts += section(HERE / name, Path(folder))
        print(f"{name} has run", file=sys.stderr)
    (DOCS / "gallery.md").write_text("\n\n".join(parts) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
