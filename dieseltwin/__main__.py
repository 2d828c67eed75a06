"""The command line: `python -m dieseltwin`, and the script `dieseltwin`."""

from __future__ import annotations

import _thread
import signal
import sys
import threading

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


if __name__ == "__main__":
    sys.exit(main())
