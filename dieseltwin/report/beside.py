"""A second process that gets ready to draw while this one searches: a fork, so that nothing is copied or loaded twice.

A fork inherits the locks that other threads hold (one that reads standard input holds it for ever), so a process with
threads other than the simulator's, such as a server or a worker of the flows, doesn't fork.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import get_all_start_methods, get_context
from multiprocessing.connection import Connection
from typing import ParamSpec

from dieseltwin.engine.observations import SIMULATOR_THREADS, thread_count

P = ParamSpec("P")

_PATIENCE_S = 120.0  # for a page, of which ten seconds on a busy machine are usual
_LOADING_S = 10.0  # that it may still load when it is wanted; who never says that it is ready would never read its task
_ready: list[Connection] = []


def may_fork() -> bool:
    """Whether this process may be forked, and use a second core (DIESELTWIN_THREADS, its own processors)."""
    others = [thread for thread in threading.enumerate() if thread is not threading.main_thread()]
    return (thread_count() > 1 and "fork" in get_all_start_methods()
            and threading.current_thread() is threading.main_thread()
            and all(thread.name.startswith(SIMULATOR_THREADS) for thread in others))  # fmt: skip


@contextmanager
def ready_beside(load: Callable[[], object]) -> Iterator[None]:
    """While the block runs, a process that has called `load` waits for one task of `begin_beside`, where one may."""
    if _ready or not may_fork():
        yield
        return
    context = get_context("fork")
    here, there = context.Pipe()
    process = context.Process(target=_wait, args=(here, there, load))
    process.start()
    there.close()
    _ready.append(here)
    try:
        yield
    finally:
        _ready.clear()
        here.close()
        process.kill()  # it has done its task, or nobody wants it any more
        process.join()


def begin_beside(task: Callable[P, object], *arguments: P.args, **options: P.kwargs) -> Callable[[], None]:
    """Begin a task in the process that waits; the function returned ends when it is done.

    Where none waits, or the task failed there, that function does it in this process: its errors are raised here.
    """
    here = _ready.pop() if _ready else None
    if here is not None and _said(here, _LOADING_S):
        with suppress(OSError):  # it was killed: `finish` will know
            here.send((task, arguments, options))
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
        task, arguments, options = there.recv()
        task(*arguments, **options)
        there.send(True)
