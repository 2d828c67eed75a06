"""The command line: `python -m dieseltwin`, and the script `dieseltwin`."""

from __future__ import annotations

import _thread
import atexit
import os
import signal
import sys
import threading
from typing import NoReturn

_AGAIN_S = 0.02


def interrupt_again(met: sys.UnraisableHookArgs) -> None:
    """Python drops what is raised in a finaliser or while it forks: a Ctrl-C that fell there comes again at once."""
    if issubclass(met.exc_type, KeyboardInterrupt):
        threading.Timer(_AGAIN_S, _thread.interrupt_main).start()  # raised here it would be dropped once more
    else:
        sys.__unraisablehook__(met)


def main() -> int:
    """Run it; returns the exit code. Ctrl-C while the library is loaded, a second or so, is one sentence as well."""
    sys.unraisablehook = interrupt_again
    try:
        from dieseltwin.cli.app import main as command_line
    except KeyboardInterrupt:
        print("dieseltwin: interrupted; nothing was begun", file=sys.stderr)
        return 130
    try:
        return command_line()
    finally:  # what is left is the interpreter's own end, which a late Ctrl-C would fill with tracebacks
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def program() -> NoReturn:
    """`main` as a process of its own, which ends at once: Python takes half a second to free what was loaded."""
    told: list[int] = []
    if atexit._ncallbacks() == 0:  # who has registered before, such as a coverage, would be passed over
        atexit.register(_end, told)  # the first to be registered is the last to be called: all others have tidied up
    told.append(main())
    sys.exit(told[0])


def _end(told: list[int]) -> None:
    """Leave with the code that `main` returned; without one, or with words that nobody takes, Python ends as ever."""
    try:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
    except (AttributeError, OSError, ValueError):  # no such stream, nobody who reads it, closed
        return
    if told:
        os._exit(told[0])


if __name__ == "__main__":
    program()
