"""Commands under random faults: killed, interrupted, on a full disk, short of memory, with a clock that jumps.

    python benchmarks/soak.py --runs 200 --out soak.jsonl
    python benchmarks/soak.py --runs 12 --flow --out soak-flow.jsonl     # the flow `discover` with Prefect and MLflow

A run is one command with one fault at a random moment, in a folder where an older result lies. Then:

  * every file there is as it was or as an undisturbed run leaves it, to the last bit; what a `kill -9` leaves besides
    is named `.partial-*`, which nothing reads;
  * the fault was told in one line without a traceback (a killed process can't), Ctrl-C within two seconds;
  * the same command again, undisturbed, ends as it always does, to the last bit.

A full disk needs the right to mount (root), a clock that jumps Debian's `libfaketime`. Run times and the pages that
show them are compared with nothing. Resumable: a run is known by its number and the seed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from kept import keep, kept_lines

ROOT = Path(__file__).resolve().parents[1]
PARTS = (("field_random_300s.csv", "drive.csv", 0.0, 120.0), ("lab_whtc_500s_800s.csv", "2026-03-01.csv", 0.0, 150.0),
         ("lab_whtc_500s_800s.csv", "2026-03-02.csv", 150.0, 300.0))  # fmt: skip
FAKETIME = Path("/usr/lib/x86_64-linux-gnu/faketime/libfaketime.so.1")
NOISE = {"p_im_pa": 3e3, "p_em_pa": 4e3, "omega_t_rad_s": 50.0, "w_egr_kg_s": 0.001, "t_em_k": 8.0, "w_c_kg_s": 0.004}
TIMED = ("runtime.json", "report.html", "history.html")  # they show run times or dates
KEPT_APART = (".numba_cache", ".prefect", "mlruns", "logs", "expected_seconds")
LATE_S = 2.0
MESSAGE = 300

FAILED = "failed.json"  # of a case that had no memory: told, and tried again next time

FAULTS = ("kill", "interrupt", "disk", "memory", "clock")

FLOW_FAULTS = FAULTS[:-1]  # under libfaketime `time.sleep` fails in Python's own `subprocess`: no flow starts

Tree = dict[str, str]
"""Name of a file in a folder -> hash of its content."""


@dataclass(frozen=True)
class Command:
    """A command that is disturbed.

    Attributes:
        name: for the table.
        arguments: of Python; {in} is the folder of inputs, {out} that of results.
        before: commands whose results lie there already.
    """

    name: str
    arguments: tuple[str, ...]
    before: tuple[tuple[str, ...], ...] = ()


def _tool(*arguments: str) -> tuple[str, ...]:
    return ("-m", "dieseltwin", *arguments)


COMMANDS = (
    Command("channels", _tool("channels", "{in}/drive.csv", "--out", "{out}/map.yaml")),
    Command("simulate", _tool("simulate", "{in}/drive.csv", "--out", "{out}/simulated.parquet"),
            (_tool("simulate", "{in}/drive.csv", "--effect", "boost_leak=3e-5", "--out", "{out}/simulated.parquet"),)),
    Command("identify", _tool("identify", "{in}/drive.csv", "--runs", "2", "--out", "{out}/found"),
            (_tool("identify", "{in}/drive.csv", "--runs", "1", "--out", "{out}/found"),)),
    Command("discover", _tool("discover", "{in}/drive.csv", "--out", "{out}/discovery")),
    Command("learn", _tool("learn", "{in}/drive.csv", "--out", "{out}/mine.yaml")),
    Command("watch add", _tool("watch", "add", "{in}/2026-03-02.csv", "--engine", "{in}/mine.yaml", "--history",
                               "{out}/history"),
            (_tool("watch", "add", "{in}/2026-03-01.csv", "--engine", "{in}/mine.yaml", "--history",
                   "{out}/history"),)),
    Command("challenge run", _tool("challenge", "run", "{out}/bench", "--jobs", "1"),
            (_tool("challenge", "make", "--n", "2", "--seed", "3", "--duration", "60", "--jobs", "1", "--out",
                   "{out}/bench"),)),
    Command("export", _tool("export", "we2011", "--c", "{out}/engine.c")),
)  # fmt: skip
OFTEN = {"channels": 4, "simulate": 4, "export": 4, "watch add": 4, "challenge run": 2}
"""Runs of each command in twenty-one, one of the others: those that take seconds come more often."""
FLOW = (Command("flow discover", ("-m", "flows.discover", "--profile", "tiny", "{in}/drive.csv")),)


@dataclass(frozen=True)
class Ended:
    """What became of one run.

    Attributes:
        number, command, fault: of the run.
        strength: moment [s], room [bytes], memory [bytes] or jump [s].
        code: of the disturbed command; None where it was killed.
        late_s: from the signal to its end [s].
        hit: whether the fault met a command that was at work.
        faults: what was wrong; none is good.
        said: its last line.
    """

    number: int
    command: str
    fault: str
    strength: float
    code: int | None
    late_s: float
    hit: bool
    faults: tuple[str, ...]
    said: str


def write_inputs(folder: Path) -> None:
    """Recordings, and an engine learned from one of them."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng(1)
    for source, name, since_s, until_s in PARTS:
        frame = pd.read_csv(ROOT / "tests" / "reference" / source)
        for column, sigma in NOISE.items():
            frame[column] += sigma * rng.standard_normal(len(frame))
        seconds = frame["time_s"] - frame["time_s"].iloc[0]
        part = frame[(seconds >= since_s) & (seconds <= until_s)]
        part.assign(time_s=part["time_s"] - part["time_s"].iloc[0]).to_csv(folder / name, index=False)
    done = _run(_tool("learn", "{in}/drive.csv", "--out", "{in}/mine.yaml"), folder, folder)
    if done.returncode:
        raise SystemExit(f"the inputs can't be made: {done.stderr}")


def _filled(arguments: tuple[str, ...], inputs: Path, out: Path) -> list[str]:
    return [sys.executable, *(a.replace("{in}", str(inputs)).replace("{out}", str(out)) for a in arguments)]


def _environment(out: Path) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "DIESELTWIN_WORKSPACE": str(out)}


def _run(arguments: tuple[str, ...], inputs: Path, out: Path) -> subprocess.CompletedProcess[str]:
    """An undisturbed run."""
    return subprocess.run(_filled(arguments, inputs, out), env=_environment(out), cwd=ROOT, capture_output=True,
                          text=True, check=False)  # fmt: skip


def tree(folder: Path) -> Tree:
    """What is compared of a folder; a history by its entries, as SQLite's pages hold more than them."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        timed = path.name in TIMED or (name.startswith(".cache/") and path.name == "manifest.json")
        if not path.is_file() or timed or any(part in name for part in KEPT_APART):
            continue
        if path.name == "history.sqlite":
            from dieseltwin.learning.history import History, to_json

            rows = [to_json(entry) for entry in History(path.parent).entries()]
            found.update({f"{name} row {i}": hashlib.sha256(row.encode()).hexdigest() for i, row in enumerate(rows)})
        elif not path.name.startswith("history.sqlite"):
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def temporary(name: str) -> bool:
    """Whether a file's name is of one that was being written."""
    return any(part.startswith(".partial-") or part.endswith(".partial") for part in Path(name).parts)


@dataclass
class Bench:
    """Inputs, what lies there before each command, and what an undisturbed run makes of it."""

    work: Path

    @property
    def inputs(self) -> Path:
        return self.work / "inputs"

    def prepare(self, command: Command) -> tuple[Path, Tree, Tree, float]:
        """Folder to begin with, its files, the files after an undisturbed run, and its seconds."""
        place = self.work / command.name.replace(" ", "_")
        kept = place / "known.json"
        if not kept.exists():
            shutil.rmtree(place, ignore_errors=True)
            (place / "before").mkdir(parents=True)
            self._workspace(place / "before", command)
            for arguments in command.before:
                self._good(_run(arguments, self.inputs, place / "before"))
            shutil.copytree(place / "before", place / "after")
            self._good(_run(command.arguments, self.inputs, place / "after"))  # kernels are compiled
            shutil.rmtree(place / "after")
            shutil.copytree(place / "before", place / "after")
            began = time.perf_counter()
            self._good(_run(command.arguments, self.inputs, place / "after"))
            seconds = time.perf_counter() - began
            kept.write_text(json.dumps([tree(place / "before"), tree(place / "after"), seconds]))
        before, after, seconds = json.loads(kept.read_text())
        return place / "before", before, after, seconds

    @staticmethod
    def _workspace(folder: Path, command: Command) -> None:
        if command in FLOW:
            shutil.copyfile(ROOT / "params.yaml", folder / "params.yaml")

    @staticmethod
    def _good(done: subprocess.CompletedProcess[str]) -> None:
        if done.returncode:
            raise SystemExit(f"undisturbed, {' '.join(done.args)} ended with {done.returncode}: {done.stderr[-500:]}")


@contextmanager
def place_for(size: float | None, before: Path) -> Iterator[Path]:
    """A folder that begins as `before`; with a size, on a file system of its own that has so much room besides."""
    folder = Path(tempfile.mkdtemp(prefix="soak-"))
    try:
        if size is not None:
            used = sum(path.stat().st_size + 8192 for path in before.rglob("*"))
            subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={int(used + size)}", "tmpfs", str(folder)], check=True)
        shutil.copytree(before, folder, dirs_exist_ok=True)
        yield folder
    finally:
        if size is not None:
            subprocess.run(["umount", "-l", str(folder)], check=False)
        shutil.rmtree(folder, ignore_errors=True)


def disturbed(
    command: Command, inputs: Path, out: Path, fault: str, moment: float, strength: float
) -> tuple[int, float, bool, str]:
    """Exit code, seconds from the signal to the end, whether it was at work by then, what it printed."""
    environment, limit = _environment(out), None
    stamp = out.parent / f"{out.name}.clock"
    if fault == "clock":
        stamp.write_text("+0")
        environment |= {"LD_PRELOAD": str(FAKETIME), "FAKETIME_TIMESTAMP_FILE": str(stamp), "FAKETIME_NO_CACHE": "1",
                        "FAKETIME_DONT_FAKE_MONOTONIC": "1", "DONT_FAKE_MONOTONIC": "1"}  # fmt: skip
    if fault == "memory":
        limit = lambda: resource.setrlimit(resource.RLIMIT_AS, (int(strength), int(strength)))  # noqa: E731
    with tempfile.TemporaryFile("w+") as heard:
        process = subprocess.Popen(_filled(command.arguments, inputs, out), env=environment, cwd=ROOT, stdout=heard,
                                   stderr=subprocess.STDOUT, start_new_session=True, preexec_fn=limit)  # fmt: skip
        late, hit = 0.0, fault in ("disk", "memory")
        if fault in ("kill", "interrupt", "clock"):
            try:
                process.wait(timeout=moment)
            except subprocess.TimeoutExpired:
                hit = True
                if fault == "clock":
                    stamp.write_text(f"{strength:+.0f}")
                else:
                    process.send_signal(signal.SIGKILL if fault == "kill" else signal.SIGINT)
        began = time.perf_counter()
        process.wait(timeout=600.0)
        late = time.perf_counter() - began if fault == "interrupt" else 0.0
        heard.seek(0)
        text = heard.read().strip()
    stamp.unlink(missing_ok=True)
    return process.returncode, late, hit, text


def faults_of(command: Command) -> tuple[str, ...]:
    """What it is tried under."""
    return FLOW_FAULTS if command in FLOW else FAULTS


def run(number: int, seed: int, bench: Bench, commands: tuple[Command, ...], only: str | None) -> Ended:
    """One command with one fault, what it left, and the same command again."""
    rng = np.random.default_rng([seed, number])
    cycle = [command for command in commands for _ in range(OFTEN.get(command.name, 1))]
    command = cycle[number % len(cycle)]
    faulty = faults_of(command)
    fault = only or faulty[number % len(faulty)]
    before_folder, before, after, seconds = bench.prepare(command)
    new = sum((bench.work / command.name.replace(" ", "_") / "after" / name.partition(" row ")[0]).stat().st_size
              for name in after if before.get(name) != after[name])  # fmt: skip
    moment = float(rng.uniform(0.05, 1.05)) * seconds
    strength = {
        "kill": moment, "interrupt": moment,
        "disk": rng.uniform(0.0, 1.0) * (new + 8192), "memory": float(np.exp(rng.uniform(np.log(2e8), np.log(4e9)))),
        "clock": float(rng.choice([-1, 1]) * rng.uniform(1e4, 1e8)),
    }[fault]  # fmt: skip
    faults: list[str] = []
    with place_for(strength if fault == "disk" else None, before_folder) as out:
        code, late, hit, text = disturbed(command, bench.inputs, out, fault, moment, strength)
        lines = text.splitlines()
        if "Traceback" in text:
            faults.append("traceback")
        if code == -signal.SIGINT and "Traceback" not in text:  # while the interpreter ended: a shell says 130 of both
            code = 130 if "interrupted" in text else 0
        if fault == "interrupt" and hit and code not in (0, 130):
            faults.append(f"exit code {code}")
        if fault == "interrupt" and code == 130 and not (lines and "interrupted" in lines[-1]):
            faults.append("no sentence")
        if fault == "interrupt" and late > LATE_S:
            faults.append(f"{late:.1f} s late")
        if (fault == "disk" and code not in (0, 2)) or (fault == "clock" and code != 0):
            faults.append(f"exit code {code}")
        if code and fault != "kill" and lines and len(lines[-1]) > MESSAGE:
            faults.append(f"a line of {len(lines[-1])} characters")
        left = tree(out)
        for name, digest in left.items():
            if temporary(name):
                if fault != "kill" and code != -signal.SIGKILL and code != -signal.SIGSEGV and code != -signal.SIGABRT:
                    faults.append(f"left {name}")
            elif digest not in (before.get(name), after.get(name)) and not (code == 1 and name.endswith(FAILED)):
                faults.append(f"other content in {name}")
        faults += [f"lost {name}" for name in before if name not in left and name in after]
        if code == 0 and not set(after.items()) <= set(left.items()):
            faults.append("exit code 0 without the whole result")
        if fault == "disk":
            subprocess.run(["mount", "-o", "remount,size=2g", str(out)], check=True)
        complete = left == after  # nothing is left to be done again, even if it was killed right behind that
        again = None if complete else _run(command.arguments, bench.inputs, out)
        if again is not None and again.returncode:
            faults.append(f"again: exit code {again.returncode}: {again.stderr.strip().splitlines()[-1][:200]}")
        elif again is not None:
            found = {name: digest for name, digest in tree(out).items() if not temporary(name)}
            faults += [f"again: another {name}" for name in {*found, *after} if found.get(name) != after.get(name)]
    last = lines[-1][:MESSAGE] if lines else ""
    return Ended(number, command.name, fault, float(strength), code, late, hit, tuple(faults), last)


def summary(ended: list[Ended]) -> list[str]:
    """Counts by fault and by command."""
    lines = [f"{'':<16} {'runs':>5} {'met':>5} {'told':>5} {'done':>5} {'wrong':>6}  longest wait [s]"]
    groups: list[tuple[str, Callable[[Ended], bool]]] = [
        *((fault, lambda e, fault=fault: e.fault == fault) for fault in FAULTS),
        *((name, lambda e, name=name: e.command == name) for name in dict.fromkeys(e.command for e in ended)),
        ("all", lambda e: True),
    ]
    for name, wanted in groups:
        some = [e for e in ended if wanted(e)]
        if some:
            told = sum(e.code in (1, 2, 130) for e in some)
            lines.append(f"{name:<16} {len(some):>5} {sum(e.hit for e in some):>5} {told:>5} "
                         f"{sum(e.code == 0 for e in some):>5} {sum(bool(e.faults) for e in some):>6}  "
                         f"{max(e.late_s for e in some):.1f}")  # fmt: skip
    wrong = Counter(f"{e.command} under {e.fault}: {fault}" for e in ended for fault in e.faults)
    return [*lines, *(f"    {count} {text}" for text, count in wrong.most_common(30))]


def main() -> int:
    """Run, append a line of JSON a run, print the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("soak.jsonl"), help="file of JSON lines; goes on with it")
    parser.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "dieseltwin-soak")
    parser.add_argument("--flow", action="store_true", help="the flow `discover` in place of commands")
    parser.add_argument("--only", choices=FAULTS, help="one fault")
    parser.add_argument("--seconds", type=float, default=1e9, help="stop after so much time")
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell that starts this behind `&` has it ignored
    asked = parser.parse_args()
    began = time.perf_counter()
    bench = Bench(asked.work)
    if not bench.inputs.exists():
        write_inputs(bench.inputs)
    ended = [Ended(**{**line, "faults": tuple(line["faults"])}) for line in kept_lines(asked.out)]
    done = {item.number for item in ended}
    for number in range(asked.runs):
        if number in done:
            continue
        if time.perf_counter() - began > asked.seconds:
            break
        ended.append(run(number, asked.seed, bench, FLOW if asked.flow else COMMANDS, asked.only))
        keep(asked.out, asdict(ended[-1]))
        if ended[-1].faults:
            print(ended[-1], flush=True)
    print("\n".join(summary(ended)))
    return int(any(item.faults for item in ended))


if __name__ == "__main__":
    sys.exit(main())
