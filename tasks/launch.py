"""How a flow is started from a command line: settings, server, bars, Ctrl-C, one-line errors.

``launch(module, name, ...)`` takes the flow by name, since Prefect may be imported only once its settings stand.
"""

from __future__ import annotations

import importlib
import signal
import sys
import warnings
from types import FrameType
from typing import Any

from tasks import run_context
from tasks.server import ServerFailed, prefect_server
from tasks.workspace import prepare_environment

_INTERRUPTED = 130


def launch(module: str, flow: str, **parameters: Any) -> int:
    """Run a flow with a server of its own. Returns the exit status: 0 well, 2 wrong input, 130 Ctrl-C, else 1."""
    workspace = prepare_environment()
    warnings.filterwarnings("ignore")
    signal.signal(signal.SIGINT, _interrupt)
    signal.signal(signal.SIGTERM, _interrupt)
    context = run_context.current()
    try:
        with context.display.showing(), prefect_server(workspace):
            getattr(importlib.import_module(module), flow)(**parameters)
    except KeyboardInterrupt:
        print("interrupted: what is finished is kept, the next run goes on from there", file=sys.stderr)
        return _INTERRUPTED
    except (run_context.StepFailed, ServerFailed) as error:
        print(f"error: {error}", file=sys.stderr)
        return getattr(error, "exit_code", 1)
    except Exception as error:
        code = getattr(error, "exit_code", None)
        if code is None:
            raise
        print(f"error: {error}", file=sys.stderr)
        return int(code)
    return 0


def _interrupt(signum: int, frame: FrameType | None) -> None:
    """End the workers first: Prefect waits for its threads, and they wait for them."""
    run_context.stop_workers()
    raise KeyboardInterrupt
