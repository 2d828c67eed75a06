"""A second process that gets ready to draw while this one searches: a fork, so that nothing is copied or loaded twice.

A fork inherits the locks that other threads hold (one that reads standard input holds it for ever), so a process with
threads other than the simulator's, such as a server or a worker of the flows, doesn't fork.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import get_all_start_methods, get_context
from multiprocessing.connection import Connection
from typing import Concatenate, ParamSpec

from dieseltwin.engine.observations import SIMULATOR_THREADS, thread_count

P = ParamSpec("P")

_PATIENCE_S = 120.0  # for a page, of which ten seconds on a busy machine are usual
_LOADING_S = 10.0  # that it may still load when it is wanted; who never says that it is ready would never read its task


@dataclass
class _Waiting:
    """A process that waits, and whether it has said that it is ready."""

    here: Connection
    said: bool = False

    def is_ready(self, patience_s: float) -> bool:
        self.said = self.said or _said(self.here, patience_s)
        return self.said


_ready: list[_Waiting] = []


def may_fork() -> bool:
    """Whether this process may be forked, and use a second core (DIESELTWIN_THREADS, its own processors)."""
    others = [thread for thread in threading.enumerate() if thread is not threading.main_thread()]
    return (thread_count() > 1 and "fork" in get_all_start_methods()
            and threading.current_thread() is threading.main_thread()
            and all(thread.name.startswith(SIMULATOR_THREADS) for thread in others))  # fmt: skip


@contextmanager
def ready_beside(load: Callable[[], object]) -> Iterator[None]:
    """While the block runs, a process that has called `load` waits for one task of `begin_beside`, where one may, and
    for what `begin_ahead` gives it to do before."""
    if _ready or not may_fork():
        yield
        return
    context = get_context("fork")
    here, there = context.Pipe()
    process = context.Process(target=_wait, args=(here, there, load))
    process.start()
    there.close()
    _ready.append(_Waiting(here))
    try:
        yield
    finally:
        _ready.clear()
        here.close()
        process.kill()  # it has done its task, or nobody wants it any more
        process.join()


def begin_ahead(
    task: Callable[Concatenate[Callable[[], bool], P], object], *arguments: P.args, **options: P.kwargs
) -> None:
    """Give the process that waits something that its task will need; nothing where none is ready.

    `task` gets a function that says whether the task itself has come, which then goes first. Whatever it meets is
    passed over: the task does all that isn't there.
    """
    if _ready and _ready[-1].is_ready(0.0):
        with suppress(OSError):  # it was killed: `begin_beside` will know
            _ready[-1].here.send((True, task, arguments, options))


def begin_beside(task: Callable[P, object], *arguments: P.args, **options: P.kwargs) -> Callable[[], None]:
    """Begin a task in the process that waits; the function returned ends when it is done.

    Where none waits, or the task failed there, that function does it in this process: its errors are raised here.
    """
    waiting = _ready.pop() if _ready else None
    here = None if waiting is None else waiting.here
    if here is not None and waiting is not None and waiting.is_ready(_LOADING_S):
        with suppress(OSError):  # it was killed: `finish` will know
            here.send((False, task, arguments, options))
    else:
        here = None

    def finish() -> None:
        if here is None or not _said(here, _PATIENCE_S):
            task(*arguments, **options)

    return finish


def _said(here: Connection, patience_s: float) -> bool:
    """Whether the process that waits says in time that it is ready, or done."""
    try:
        return here.poll(patience_s) and bool(here.recv())
    except (EOFError, OSError):
        return False


def _wait(here: Connection, there: Connection, load: Callable[[], object]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who waits for it ends it
    here.close()
    with suppress(Exception):  # whatever it is: the first process does it all itself, and says what it meets
        load()
        there.send(True)
        ahead, task, arguments, options = there.recv()
        while ahead:
            with suppress(Exception):
                task(there.poll, *arguments, **options)
            ahead, task, arguments, options = there.recv()
        task(*arguments, **options)
        there.send(True)
