"""The command line: `python -m dieseltwin`, and the script `dieseltwin`."""

import signal
import sys


def main() -> int:
    """Run it; returns the exit code. Ctrl-C while the library is loaded, a second or so, is one sentence as well."""
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
