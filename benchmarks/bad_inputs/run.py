"""Run cases through the command line and judge how they end."""

from __future__ import annotations

import contextlib
import io
import multiprocessing
import os
import shutil
import tempfile
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path

from benchmarks.bad_inputs.case import Case
from benchmarks.bad_inputs.cases import cases, good_files
from dieseltwin.cli.app import main as dieseltwin

LONGEST_LINE = 300
LIMIT_S = 30.0  # a refusal that takes longer is none: the command had begun to compute
STARTING_S = 60.0  # for a new process, which loads the library
STOPPED = "stopped"


@dataclass(frozen=True)
class Outcome:
    """What a case ended in.

    Attributes:
        name: of the case; code: exit code, None for a traceback or a run that was stopped.
        lines: on standard error.
        traceback: the exception and its place, "" without.
        changed: files that were written, changed or removed.
        seconds: wall time [s].
    """

    name: str
    code: int | None
    lines: tuple[str, ...]
    traceback: str
    changed: tuple[str, ...]
    seconds: float

    @property
    def faults(self) -> tuple[str, ...]:
        """What is wrong with it; empty for a proper refusal."""
        found = []
        if self.traceback:
            found.append("too slow" if self.traceback == STOPPED else "traceback")
        elif self.code != 2:
            found.append(f"exit code {self.code}")
        if self.code != 0 and self.changed:
            found.append("partial file")
        if any(len(line) > LONGEST_LINE for line in self.lines):
            found.append("long line")
        if self.code == 2 and len(self.lines) != 1:
            found.append("not one line")
        return tuple(found)


def _state(folder: Path) -> dict[str, tuple[int, int]]:
    return {str(p.relative_to(folder)): (p.lstat().st_mtime_ns, 0 if p.is_dir() else p.lstat().st_size)
            for p in sorted(folder.rglob("*")) if not p.is_dir()}  # fmt: skip


def run_case(case: Case, folder: Path) -> Outcome:
    """Run one case in an empty folder, which is left as the command left it."""
    good_files(folder)
    arguments = case.make(folder)
    before = _state(folder)
    said, heard = io.StringIO(), io.StringIO()
    kept = dict(os.environ)
    os.environ.update({name: value.replace("{}", str(folder)) for name, value in case.environment})
    code: int | None = None
    fault = ""
    began = time.perf_counter()

    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(heard):
            code = dieseltwin(arguments)
    except SystemExit as error:
        fault = f"SystemExit({error.code})"
    except BaseException as error:  # a fault is what is looked for
        place = traceback.extract_tb(error.__traceback__)[-1]
        fault = f"{type(error).__name__}: {str(error)[:120]} ({Path(place.filename).name}:{place.lineno})"
    finally:
        os.environ.clear()
        os.environ.update(kept)
    after = _state(folder)
    changed = tuple(name for name in sorted({*before, *after}) if before.get(name) != after.get(name))
    return Outcome(case.name, code, tuple(heard.getvalue().splitlines()), fault, changed, time.perf_counter() - began)


def _work(connection: Connection) -> None:
    """Run the cases whose numbers come in, and send back what they ended in."""
    everything = cases()
    while (number := connection.recv()) is not None:
        folder = Path(tempfile.mkdtemp(prefix="bad-input-"))
        try:
            connection.send(run_case(everything[number], folder))
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def run(numbers: list[int], limit_s: float = LIMIT_S) -> Iterator[Outcome]:
    """Run cases by their number, one after the other in one process, which is replaced when a case doesn't end."""
    context = multiprocessing.get_context("spawn")
    names = [case.name for case in cases()]
    worker: BaseProcess | None = None
    for number in numbers:
        first = worker is None
        if worker is None:
            ours, theirs = context.Pipe()
            worker = context.Process(target=_work, args=(theirs,))
            worker.start()
        ours.send(number)
        if ours.poll(limit_s + (STARTING_S if first else 0.0)):
            try:
                yield ours.recv()
                continue
            except EOFError:
                yield Outcome(names[number], None, (), "the process died", (), 0.0)
        else:
            yield Outcome(names[number], None, (), STOPPED, (), limit_s)
        worker.kill()
        worker.join()
        worker = None
    if worker is not None:
        ours.send(None)
        worker.join()
