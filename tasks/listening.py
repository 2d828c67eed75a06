"""Where a command that becomes a server of MLflow's listens."""

from __future__ import annotations

import argparse
import sys

from dieseltwin.addresses import check_address
from dieseltwin.errors import InputError


def listening(command: str, description: str | None, port: int) -> argparse.Namespace | None:
    """The command's arguments ``port`` and ``host``; None, and a line that says why, for what can't be listened on:
    MLflow would end in a traceback, with status 0."""
    parser = argparse.ArgumentParser(prog=command, description=description)
    parser.add_argument("--port", type=int, default=port)
    parser.add_argument("--host", default="127.0.0.1")
    arguments = parser.parse_args()
    try:
        check_address(arguments.host, arguments.port)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return None
    return arguments
