"""What neither ruff nor mypy sees: machine paths, big files, unfit locks, overlong modules. Prints `file: problem`."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

MODULE_LINES = 400  # longer modules get split
FILE_BYTES = 1_500_000  # reference tables are below a megabyte; data and models belong to DVC
TEXT_SUFFIXES = {".py", ".md", ".toml", ".yaml", ".yml", ".cff", ".html", ".lock", ".txt", ".json", ".j2", ""}

# Assembled, so that this file does not find itself. Unix system folders (/dev, /proc) are not a machine's own.
_OWN_FOLDERS = "|".join(["work", "root", "home", "Users", "opt", "mnt"])
MACHINE_PATH = re.compile(rf"(?:file://|(?<![\w.:/]))/(?:{_OWN_FOLDERS})/\w")
MADE = {"data", "models", "results", "discoveries", "proof", "evaluation", "reports", "mlruns", "dieseltwin.egg-info"}
LOCK_LINE = re.compile(r"^[A-Za-z0-9][A-Za-z0-9._-]*==[A-Za-z0-9.]+$")
DOCUMENT = re.compile(r"\b[\w./-]+\.md\b")
WRITTEN = {"score.md"}  # by the benchmark
CONFLICT = re.compile(r"^(<{7} |>{7} )", flags=re.MULTILINE)


def tracked_files(root: Path) -> list[Path]:
    """Files that git knows or would add; without git (an unpacked archive) everything but hidden and made folders."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=root, check=False, capture_output=True)
    if listed.returncode == 0:
        return sorted(root / name for name in listed.stdout.decode().split("\0") if name and (root / name).is_file())
    names = (path.relative_to(root) for path in root.rglob("*") if path.is_file())
    kept = (name for name in names if name.parts[0] not in MADE and not any(p.startswith(".") for p in name.parts[:-1]))
    return sorted(root / name for name in kept if "__pycache__" not in name.parts)


def file_problems(path: Path, name: str) -> Iterator[str]:
    """Problems of one file; `name` is its path for the message."""
    if path.stat().st_size > FILE_BYTES:
        yield f"{name}: {path.stat().st_size / 1e6:.1f} MB; data and models belong to DVC"
        return
    if path.suffix not in TEXT_SUFFIXES:
        return
    text = path.read_bytes().decode("utf-8", errors="replace")
    for number, line in enumerate(text.splitlines(), start=1):
        if MACHINE_PATH.search(line):
            yield f"{name}:{number}: a path of one machine: {line.strip()[:80]}"
    if "\r" in text:
        yield f"{name}: carriage returns"
    if CONFLICT.search(text):
        yield f"{name}: conflict markers"
    if name.startswith("dieseltwin/") and path.suffix == ".py" and text.count("\n") >= MODULE_LINES:
        yield f"{name}: {text.count(chr(10))} lines; split modules at {MODULE_LINES}"


def lock_problems(lines: Iterable[str]) -> Iterator[str]:
    """A plain lock: `name==version` only, no local builds, no index or folder, nothing twice."""
    seen: set[str] = set()
    for line in (raw.strip() for raw in lines):
        if not line or line.startswith("#"):
            continue
        if not LOCK_LINE.match(line):
            yield f"requirements.lock: {line!r} is not name==version"
            continue
        name = re.sub(r"[-_.]+", "-", line.split("==")[0]).lower()
        if name in seen:
            yield f"requirements.lock: {name} twice"
        seen.add(name)


def missing_documents(root: Path, names: Iterable[str]) -> Iterator[str]:
    """Pages that a file refers to and the repository doesn't hold; what a program writes is named in `WRITTEN`."""
    listed = list(names)
    known = {Path(name).name for name in listed if name.endswith(".md")} | WRITTEN
    for name in listed:
        if not name.endswith((".py", ".md", ".yaml", ".toml")):
            continue
        text = (root / name).read_text(encoding="utf-8", errors="replace")
        for page in sorted({Path(found).name for found in DOCUMENT.findall(text)} - known):
            yield f"{name}: refers to {page}, which the repository doesn't hold"


def problems(root: Path = ROOT) -> list[str]:
    """All problems of a checkout."""
    names = [path.relative_to(root).as_posix() for path in tracked_files(root)]
    found = [p for name in names for p in file_problems(root / name, name)]
    found += missing_documents(root, names)
    found += lock_problems((root / "requirements.lock").read_text().splitlines())
    return found


def main() -> int:
    found = problems()
    print("\n".join(found) if found else "hygiene: kept")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
