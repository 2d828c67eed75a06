"""Where a command that becomes a server of MLflow's listens, and what it says of a store that can't be read."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable

from dieseltwin.addresses import check_address
from dieseltwin.errors import InputError
from tasks import databases
from tasks.workspace import Workspace


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


def answered(main: Callable[[], int]) -> int:
    """The exit status of such a command; an error of MLflow's database or of the disk is one line."""
    try:
        return main()
    except Exception as error:
        told = databases.failure(error, Workspace.current().mlflow_uri)
        if told is None:
            raise
        print(f"error: {told}", file=sys.stderr)
        return 1
