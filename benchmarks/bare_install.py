"""A wheel in a bare environment: what installs, how large, how long, and which commands work without torch.

    python benchmarks/bare_install.py [--keep FOLDER] [--quick]

Builds the wheel and the source distribution of this checkout, unpacks the latter and builds a wheel from it, installs
the first wheel into a new virtual environment with the package index that pip is set up for, and runs commands from
a folder that is no checkout. As root the installation is then also run as another user: read-only, without a home.
`--quick` leaves the long commands (identify, learn, discover, calibrate) out.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
import zipfile
from pathlib import Path

import numpy as np
import pandas as pd

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from tests.calibration.simulated import GEOMETRY, made_points  # noqa: E402

NOBODY = 65534
NOISE = {"p_im_pa": 3e3, "p_em_pa": 4e3, "omega_t_rad_s": 50.0, "w_egr_kg_s": 0.001, "t_em_k": 8.0, "w_c_kg_s": 0.004}
"""Noise of the readings that the reference trace gets [SI]: without any, `learn` and `discover` refuse it."""
BUILD = "from setuptools import build_meta as b; import sys; print(b.{what}(sys.argv[1]))"


def built(what: str, source: Path, out: Path) -> Path:
    """A wheel or a source distribution of a source tree, built in a copy of it."""
    copy = out / f"{what}_tree"
    if not copy.exists():
        unwanted = shutil.ignore_patterns(".*", "mlruns", "models", "results", "__pycache__")
        shutil.copytree(source, copy, ignore=unwanted, symlinks=True)
    done = subprocess.run([sys.executable, "-c", BUILD.format(what=what), str(out)], cwd=copy, check=True,
                          capture_output=True, text=True)  # fmt: skip
    return out / done.stdout.strip().splitlines()[-1]


def size_mb(folder: Path) -> float:
    """Size of all files below a folder."""
    return sum(path.lstat().st_size for path in folder.rglob("*") if path.is_file()) / 1e6


def timed(command: list[str], cwd: Path, **changes: str) -> tuple[int, float, str]:
    """Exit code, seconds and last line of a command that sees nothing of this checkout."""
    kept = {name: value for name, value in os.environ.items() if name in ("PATH", "LANG", "TMPDIR", "PIP_INDEX_URL")}
    start = time.perf_counter()
    done = subprocess.run(command, cwd=cwd, env=kept | changes, capture_output=True, text=True, check=False)
    text = (done.stdout + done.stderr).strip()
    return done.returncode, time.perf_counter() - start, text.splitlines()[-1][:90] if text else ""


def commands(quick: bool) -> list[tuple[str, list[str]]]:
    """What is run, and what it shows."""
    short = [
        ("version", ["--version"]), ("completion", ["--show-completion", "bash"]), ("engine", ["engine", "show"]),
        ("params", ["params", "show"]), ("effects", ["effects"]), ("channels", ["channels", "drive.csv"]),
        ("simulate, kernels compiled", ["simulate", "drive.csv", "--out", "out.parquet"]),
        ("simulate again", ["simulate", "drive.csv", "--effect", "boost_leak=3e-5", "--out", "leak.csv"]),
        ("export", ["export", "we2011", "--c", "engine.c"]),
        ("needs networks", ["identify", "drive.csv", "--method", "few-shot-newton", "--out", "no"]),
    ]  # fmt: skip
    long = [
        ("identify", ["identify", "drive.csv", "--method", "classical", "--runs", "1", "--out", "found"]),
        ("learn", ["learn", "drive.csv", "--out", "mine.yaml"]),
        ("calibrate", ["calibrate", "points.csv", "--geometry", "geometry.yaml", "--out", "engine.yaml"]),
        ("discover", ["discover", "drive.csv", "--out", "discovery"]),
    ]  # fmt: skip
    return short if quick else short + long


def inputs(folder: Path) -> None:
    """Files that the commands read."""
    drive = pd.read_csv(ROOT / "tests" / "reference" / "field_random_300s.csv")
    rng = np.random.default_rng(1)
    for column, sigma in NOISE.items():
        drive[column] += sigma * rng.standard_normal(len(drive))
    drive.to_csv(folder / "drive.csv", index=False)
    pd.DataFrame(dict(made_points(noise=0.005).columns)).to_csv(folder / "points.csv", index=False)
    lines = [f"{name}: {getattr(GEOMETRY, name)}\n" for name in ("V_d", "r_c", "R_c", "R_t")]
    (folder / "geometry.yaml").write_text("".join(lines))


def as_others(python: Path, work: Path, place: Path) -> None:
    """The same installation, read-only, as another user: with a home, with none, with nothing writable but /tmp."""
    script = "import dieseltwin as dt; from numba import config; s = dt.simulate('drive.csv'); print(config.CACHE_DIR)"
    subprocess.run(["chmod", "-R", "a-w", str(place)], check=True)
    for folder in (*work.parents, work, *place.parents):
        if os.stat(folder).st_uid == os.getuid() and str(folder).startswith(tempfile.gettempdir() + "/"):
            folder.chmod(folder.stat().st_mode | 0o055)
    home = work / "home_of_another"
    home.mkdir()
    os.chown(home, NOBODY, NOBODY)
    user = ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups"]
    for words, changes in {
        "another user with a home": {"HOME": str(home)}, "another user again": {"HOME": str(home)},
        "no such home": {"HOME": "/nonexistent"}, "no HOME set": {},
    }.items():  # fmt: skip
        code, seconds, last = timed([*user, str(python), "-c", script], work, **changes)
        print(f"| {words} | {code} | {seconds:.1f} | {last.replace(str(work), '...')} |", flush=True)
    subprocess.run(["chmod", "-R", "u+w", str(place)], check=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", type=Path, help="folder to work in, kept; else a temporary one")
    parser.add_argument("--quick", action="store_true", help="without the long commands")
    options = parser.parse_args()
    folder = options.keep or Path(tempfile.mkdtemp(prefix="bare-"))
    folder.mkdir(parents=True, exist_ok=True)
    try:
        wheel = built("build_wheel", ROOT, folder)
        sdist = built("build_sdist", ROOT, folder)
        with tarfile.open(sdist) as archive:
            archive.extractall(folder / "unpacked", filter="data")
        (unpacked,) = (folder / "unpacked").iterdir()
        again = built("build_wheel", unpacked, folder / "unpacked")
        same = set(zipfile.ZipFile(wheel).namelist()) == set(zipfile.ZipFile(again).namelist())
        print(f"wheel {wheel.stat().st_size / 1e6:.2f} MB, source {sdist.stat().st_size / 1e6:.2f} MB, "
              f"the wheel of the source has {'the same' if same else 'OTHER'} files")
        place = folder / "environment"
        subprocess.run([sys.executable, "-m", "venv", str(place)], check=True)
        python = place / "bin" / "python"
        before = size_mb(place)
        start = time.perf_counter()
        install = [str(python), "-m", "pip", "install", "-q", "--disable-pip-version-check", str(wheel)]
        subprocess.run(install, check=True)
        print(f"installed in {time.perf_counter() - start:.0f} s, {size_mb(place) - before:.0f} MB")
        work, home = folder / "work", folder / "home"
        for new in (work, home):
            new.mkdir(exist_ok=True)
        inputs(work)
        print("\n| command | exit | s | last line |\n|---|---|---|---|")
        wrong = not same
        for words, arguments in commands(options.quick):
            code, seconds, last = timed([str(place / "bin" / "dieseltwin"), *arguments], work, HOME=str(home))
            wrong |= code != (2 if words == "needs networks" else 0)
            print(f"| {words} | {code} | {seconds:.1f} | {last} |", flush=True)
        if os.getuid() == 0:
            print("\n| as another user, read-only | exit | s | kernels in |\n|---|---|---|---|")
            as_others(python, work, place)
    finally:
        if options.keep is None:
            shutil.rmtree(folder, ignore_errors=True)
    return int(wrong)


if __name__ == "__main__":
    sys.exit(main())
