"""Every speed that the documents name, by one command: measures part by part and writes docs/speed.md.

    python benchmarks/bench.py             # quick: some minutes
    python benchmarks/bench.py --full      # an hour: ten hours of driving, all loops, 300 members
    python benchmarks/bench.py discover --again      # one part, anew

Each part is a process of its own, so that its memory is its own. What is measured is kept in `.cache/bench.json` and
isn't measured again, so that a run that was interrupted goes on; `--again` measures anew. Seconds are wall seconds of
the whole command unless it says otherwise: read them on an idle machine.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from dieseltwin.atomic import write_json, write_text
from dieseltwin.version import __version__

HERE = Path(__file__).parent
PROJECT = HERE.parent
KEPT = PROJECT / ".cache" / "bench.json"
PAGE = PROJECT / "docs" / "speed.md"
MODELS = PROJECT / "models"
SEED = 41
LEAVE = "boost_leak"

Rows = list[list[str]]


@dataclass(frozen=True)
class Part:
    """One table: title, a sentence about it, heads, and what measures its rows (argument: full)."""

    title: str
    about: str
    heads: tuple[str, ...]
    measure: Callable[[bool], Rows]


@dataclass(frozen=True)
class Told:
    """A process that has ended: wall and processor time [s], peak memory [MiB], standard output."""

    seconds: float
    processor: float
    peak: float
    text: str

    @property
    def cells(self) -> list[str]:
        """Of a table."""
        return [f"{self.seconds:.1f} s", f"{self.processor:.1f} s", f"{self.peak:.0f} MiB"]


def command(*arguments: object, folder: Path | None = None, refused: bool = False) -> Told:
    """Run a Python process; `refused`: an input error is expected.

    Raises:
        CalledProcessError: it failed.
    """
    script = "import resource, subprocess, sys; r = subprocess.run(sys.argv[1:]).returncode; " \
             "u = resource.getrusage(resource.RUSAGE_CHILDREN); " \
             "print('used', u.ru_maxrss, u.ru_utime + u.ru_stime, file=sys.stderr); sys.exit(r)"
    begin = time.perf_counter()
    told = subprocess.run(
        [sys.executable, "-c", script, sys.executable, *map(str, arguments)], cwd=folder or PROJECT, text=True,
        capture_output=True, env={
            **os.environ, "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1",  # one loop against another, whoever calls
            "PYTHONPATH": f"{PROJECT}{os.pathsep}{HERE}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"},
    )  # fmt: skip
    seconds = time.perf_counter() - begin
    if told.returncode != (2 if refused else 0):
        raise subprocess.CalledProcessError(told.returncode, list(map(str, arguments)), told.stdout, told.stderr)
    peak, processor = told.stderr.rsplit("used", 1)[1].split()
    return Told(seconds, float(processor), int(peak) / 1024.0, told.stdout)


def twin(*arguments: object) -> Told:
    """`command` of the command line."""
    return command("-m", "dieseltwin", *arguments)


def driving(folder: Path, minutes: float) -> Path:
    """A concealed machine driven for some minutes."""
    cases = folder / f"driven_{minutes:g}"
    twin("challenge", "make", "--n", 1, "--seed", SEED, "--duration", 60.0 * minutes, "--out", cases, "--jobs", 1)
    return cases / "case_0001" / "recording.csv"


def start(full: bool) -> Rows:
    """Waiting before anything is done."""
    kinds: Mapping[str, tuple[bool, tuple[object, ...]]] = {
        "`dieseltwin --help`": (False, ("--help",)),
        "a file that isn't there": (True, ("discover", "nowhere.csv", "--out", "nowhere")),
    }
    return [
        [name, f"{min(command('-m', 'dieseltwin', *given, refused=refused).seconds for _ in range(3)):.2f} s"]
        for name, (refused, given) in kinds.items()
    ]


def simulator(full: bool) -> Rows:
    """The simulator, and what a user would take otherwise."""
    from peers import REFERENCE, SEGMENT, measure, timed

    from dieseltwin.engine import actuate, parameter_batch, simulate_states, we2011
    from dieseltwin.paper.datasets import benchmark_segments

    rows = [
        [row.name, row.setting, f"{row.error_pct:.4f} %", f"{1e3 * row.seconds:.4g} ms", f"{row.times_real_time:,.0f}"]
        for row in measure(3 if full else 1)
    ]
    _, segments = benchmark_segments(REFERENCE, we2011.FIELD)
    inputs, initial = segments[SEGMENT].inputs, segments[SEGMENT].measured[0, :3]
    actuation = actuate(inputs, we2011.FIELD)
    for engines in (1, 8, 64, 512):
        batch = parameter_batch(we2011.FIELD, size=engines)
        def run(batch: Any = batch) -> Any:
            return simulate_states(actuation, batch, initial, threads=1).states

        _, seconds = timed(run, 5)
        rows.append([f"this simulator, {engines} engines, one core", "its own step", "", f"{1e3 * seconds:.4g} ms",
                     f"{60.0 * engines / seconds:,.0f}"])  # fmt: skip
    return rows


def loops(full: bool) -> Rows:
    """The paper's loop beside the programs, in one process."""
    given: list[object] = [HERE / "paper_loop.py"]
    if (MODELS / "maps_paper.pt").is_file():
        given += ["--models", MODELS]
    if not full:
        given += ["--methods", "few-shot", "--lanes", 30]
    rows, second = [], False
    for line in command(*given).text.splitlines()[1:]:
        words = line.split()
        if line.startswith("s a run"):
            second = True
        elif second:
            rows.append([words[0], words[1], "", f"{words[2]} s a run", f"{words[3]} s a run", words[4]])
        else:
            rows.append([words[0], words[1], words[5], f"{words[3]} ms", f"{words[6]} ms", words[7]])
    return rows


def identification(full: bool) -> Rows:
    """Whole command on five minutes, and what more members cost."""
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recording = driving(folder, 5.0)
        trained = (MODELS / "bodies_conditioned.pt").is_file()
        for method in ("classical", "few-shot-newton") if trained else ("classical",):
            for runs in (1, 30, 300) if full else (30,):
                asked = ("--method", method, "--runs", runs, "--out", folder / "o")
                rows.append([method, str(runs), *twin("identify", recording, *asked).cells])
    return rows


def discovery(full: bool) -> Rows:
    """Whole command against the length of the recording."""
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for minutes in (10.0, 60.0, 600.0) if full else (10.0, 60.0):
            recording = driving(folder, minutes)
            withheld = (f", {LEAVE} withheld", ("--withhold", LEAVE))
            for label, more in (("", ()), withheld) if full or minutes == 10.0 else (("", ()),):
                told = twin("discover", recording, "--out", folder / "o", *more)
                rows.append([f"{minutes:.0f} min{label}", *told.cells])
    return rows


PARTS = {
    "start": Part("Start", "Before anything is done; the least of three.", ("command", "seconds"), start),
    "simulator": Part(
        "Simulator and peers", "One minute of driving, the same equations and inputs; CPU seconds of one core, warm"
        " (`benchmarks/peers.py` says how).", ("what", "setting", "largest error", "CPU", "x real time"), simulator,
    ),
    "loops": Part(
        "The paper's loop", "In one process, one thread (`benchmarks/paper_loop.py`): an epoch of the few-shot,"
        " multi-stage and baseline loops; a whole run of the second-order methods.",
        ("method", "maps", "lanes", "loop", "ours", "ratio"), loops,
    ),
    "identify": Part(
        "`identify`, whole command", "Five minutes of driving.", ("method", "runs", "wall", "processor", "memory"),
        identification,
    ),
    "discover": Part(
        "`discover`, whole command", "Driving of a concealed machine, all files written; long recordings are judged by"
        " their liveliest stretches (`discover.minutes_max`).", ("recording", "wall", "processor", "memory"), discovery,
    ),
}  # fmt: skip


def page(known: Mapping[str, Any]) -> str:
    """The document."""
    lines = ["# Speed", "", "Written by `make bench` (`python benchmarks/bench.py`; `--full`: an hour). Wall seconds"
             " on the machine named; a busy one takes longer.", ""]  # fmt: skip
    for name, part in PARTS.items():
        entry = known.get(name)
        if entry is None:
            continue
        lines += [f"## {part.title}", "", part.about, ""]
        lines += [f"| {' | '.join(part.heads)} |", "|" + "---|" * len(part.heads)]
        lines += [f"| {' | '.join(row)} |" for row in entry["rows"]]
        lines += ["", f"{entry['machine']}, {entry['day']}, version {entry['version']}"
                  f"{'' if entry['full'] else ', quick'}.", ""]  # fmt: skip
    return "\n".join(lines)


def measured(name: str, full: bool) -> dict[str, Any]:
    """A part's rows, and where they come from; memory is that of a process of its own."""
    rows = PARTS[name].measure(full)
    peak = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    versions = f"Python {platform.python_version()}, numpy {np.__version__}"
    machine = f"{os.cpu_count()} cores, {platform.machine()}, {versions}"
    return {"rows": rows, "full": full, "day": datetime.now(UTC).date().isoformat(), "version": __version__,
            "machine": machine, "peak_mib": peak / 1024.0}  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what isn't known, write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}; all without it")
    parser.add_argument("--full", action="store_true", help="all sizes; about an hour")
    parser.add_argument("--again", action="store_true", help="measure anew what is known")
    parser.add_argument("--part", choices=list(PARTS), help=argparse.SUPPRESS)  # in a process of its own
    given = parser.parse_args(arguments)
    if given.part is not None:
        print("PART" + json.dumps(measured(given.part, given.full)))
        return 0
    known: dict[str, Any] = json.loads(KEPT.read_text(encoding="utf-8")) if KEPT.is_file() else {}
    unknown = sorted(set(given.parts) - set(PARTS))
    if unknown:
        parser.error(f"got {', '.join(unknown)}; allowed: {', '.join(PARTS)}")
    failed = []
    for name in given.parts or PARTS:
        if not given.again and name in known and (known[name]["full"] or not given.full):
            print(f"{name}: known", flush=True)
            continue
        begin = time.perf_counter()
        try:
            text = command(HERE / "bench.py", "--part", name, *(["--full"] if given.full else [])).text
        except subprocess.CalledProcessError as error:
            failed.append(name)
            print(f"{name}: failed\n{error.stderr}", file=sys.stderr, flush=True)
            continue
        known[name] = json.loads(text.rsplit("PART", 1)[1])
        KEPT.parent.mkdir(parents=True, exist_ok=True)
        write_json(KEPT, known)
        write_text(PAGE, page(known))
        print(f"{name}: {time.perf_counter() - begin:.0f} s", flush=True)
    write_text(PAGE, page(known))
    print(PAGE)
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
