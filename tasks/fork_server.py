"""A process that has loaded the heavy libraries and forks the steps' processes, which so begin in a moment.

Loading torch, numba and pandas takes three seconds, longer than most steps of the quick profile. A fork shares what was
loaded and nothing else: the server has one thread and never computes, so every step begins from the same state.

``multiprocessing`` has such a server, too, but its children import the main module of the process that asked, which is
a flow here, and with it Prefect; joblib's workers are used again, each with what the last step left in it.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from types import TracebackType
from typing import TextIO

# Libraries worth loading beforehand, where the step's code imports them. `torch._dynamo` is a second that torch's
# optimisers load when the first one is made.
HEAVY = (
    "numpy", "scipy.optimize", "scipy.signal", "scipy.stats", "pandas", "pyarrow.dataset", "pydantic", "numba", "torch",
    "torch._dynamo", "matplotlib.figure", "matplotlib.backends.backend_agg",
)  # fmt: skip

_MESSAGE_BYTES = 4096
_KILLED = -signal.SIGKILL


class ForkedProcess:
    """A process that the server forked, with the methods of `subprocess.Popen` that are needed.

    Attributes:
        pid: process id; None where the server ended before it could say one. Then a process may have been forked all
            the same, which ends as its standard input does; nothing is to be asked of it.
        stdin, stdout: text pipes to and from it.
        returncode: None while it runs; below 0 a signal's number.
    """

    def __init__(self, stdin: TextIO, stdout: TextIO, status: TextIO) -> None:
        self.stdin, self.stdout, self._status = stdin, stdout, status
        said = status.readline()
        self.pid = int(said) if said else None
        self.returncode: int | None = None if said else _KILLED
        if not said:
            self.stdin.close()

    def kill(self) -> None:
        """End it at once, where it still runs."""
        if self.returncode is None and self.pid is not None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)

    def wait(self) -> int:
        """Wait for its end. Returns the exit status; that of a kill where the server ended before it could say."""
        if self.returncode is None:
            said = self._status.readline()
            if not said:
                self.kill()
            self.returncode = int(said) if said else _KILLED
        return self.returncode

    def __enter__(self) -> ForkedProcess:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for pipe in (self.stdin, self.stdout):
            with suppress(BrokenPipeError):
                pipe.close()
        self.wait()
        self._status.close()


class ForkServer:
    """The server as its parent sees it; it ends with its parent, after the processes that it forked."""

    def __init__(self, module: str, environment: Mapping[str, str]) -> None:
        """``module``: what it runs: `serve` with the function of its children, the descriptor as its argument."""
        here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with there:
            self._process = subprocess.Popen(
                [sys.executable, "-m", module, str(there.fileno())],
                env=dict(environment),
                pass_fds=(there.fileno(),),
                stdin=subprocess.DEVNULL,
                # Ctrl-C goes to the parent alone.
                start_new_session=True,
            )
        self._socket = here

    @property
    def runs(self) -> bool:
        """Whether it can still be asked."""
        return self._process.poll() is None

    def start(self, libraries: Sequence[str], log: TextIO) -> ForkedProcess:
        """Fork a process that has loaded those libraries. ``log`` is its standard error."""
        in_read, in_write = os.pipe()
        out_read, out_write = os.pipe()
        status_read, status_write = os.pipe()
        given = [in_read, out_write, log.fileno(), status_write]
        try:
            with suppress(BrokenPipeError, ConnectionResetError):  # it was killed: the status says so
                socket.send_fds(self._socket, [json.dumps(list(libraries)).encode()], given)
        finally:
            for descriptor in (in_read, out_write, status_write):
                os.close(descriptor)
        return ForkedProcess(
            os.fdopen(in_write, "w", encoding="utf-8"),
            os.fdopen(out_read, encoding="utf-8"),
            os.fdopen(status_read, encoding="utf-8"),
        )

    def close(self) -> None:
        """Ask it nothing more; it ends when what it forked has ended."""
        self._socket.close()

    def kill(self) -> None:
        """End it at once; the processes that it forked see the end of their parent's pipe."""
        self._process.kill()
        self._process.wait()


def serve(descriptor: int, function: Callable[[], int]) -> int | None:
    """Fork when asked until the parent is gone and every child has ended. In a child: what ``function`` returns."""
    asked = socket.socket(fileno=descriptor)
    woken, wake = os.pipe()
    for end in (woken, wake):
        os.set_blocking(end, False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(wake)
    children: dict[int, int] = {}
    listening = True
    while listening or children:
        ready, _, _ = select.select([woken, descriptor] if listening else [woken], [], [])
        if woken in ready:
            with suppress(BlockingIOError):
                os.read(woken, _MESSAGE_BYTES)
            _report_ended(children)
        if descriptor in ready:
            message, given, _, _ = socket.recv_fds(asked, _MESSAGE_BYTES, 4)
            if not message:
                listening = False
                continue
            for library in json.loads(message):
                with suppress(Exception):  # the step meets it, too, and says it
                    _load(library)
            gc.freeze()  # else the first collection of a child would copy every page
            pid = os.fork()
            if pid == 0:
                signal.set_wakeup_fd(-1)
                signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                for end in (woken, wake, *children.values()):
                    os.close(end)
                asked.close()
                _become(given)
                return function()
            for end in given[:3]:
                os.close(end)
            children[pid] = given[3]
            _say(given[3], pid)
    return None


def _load(library: str) -> None:
    if library in sys.modules:
        return
    importlib.import_module(library)
    if library == "numba":  # a quarter of a second that every step's first compiled function would take
        target = importlib.import_module("numba.core.registry").cpu_target
        target.typing_context.refresh()
        target.target_context.refresh()


def _report_ended(children: dict[int, int]) -> None:
    for pid in tuple(children):
        ended, status = os.waitpid(pid, os.WNOHANG)
        if ended:
            _say(children[pid], os.waitstatus_to_exitcode(status))
            os.close(children.pop(pid))


def _say(descriptor: int, number: int) -> None:
    with suppress(BrokenPipeError):  # nobody waits for it any more
        os.write(descriptor, f"{number}\n".encode())


def _become(given: Sequence[int]) -> None:
    """The step's process has a session and standard streams of its own."""
    os.setsid()
    for descriptor, stream in zip(given[:3], range(3), strict=True):
        os.dup2(descriptor, stream)
    for descriptor in given:
        os.close(descriptor)
