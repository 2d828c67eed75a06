"""MLflow's pages over ``mlruns/``: ``python -m tasks.ui --port 5000`` (``make ui``)."""

from __future__ import annotations

import os
import sys

from tasks import evaluation_records
from tasks.listening import answered, listening
from tasks.records import EXPERIMENTS
from tasks.tracking import Tracker
from tasks.workspace import prepare_environment


def main() -> int:
    """Open the database, print the addresses of the pages, become the server."""
    arguments = listening("make ui", __doc__, 5000)
    if arguments is None:
        return 2
    workspace = prepare_environment()
    tracker = Tracker(workspace)
    if tracker.uri.startswith("sqlite") and not (workspace.mlruns / "mlflow.db").exists():
        print("nothing to show yet: `make run` first", file=sys.stderr)
        return 2
    address = f"http://{arguments.host}:{arguments.port}"
    evaluated = [evaluation_records.NAME] if tracker.client.get_experiment_by_name(evaluation_records.NAME) else []
    for name in (*EXPERIMENTS, *evaluated):
        print(f"{name:<10} {address}{tracker.page(name)}")
    print("Ctrl-C ends it", flush=True)
    command = [
        *(sys.executable, "-m", "mlflow", "server"),
        *("--artifacts-destination", str(workspace.mlruns / "artifacts")),
        *("--host", arguments.host),
        *("--port", str(arguments.port)),
        *("--workers", "1"),
    ]
    # In the environment, not on the command line: there other users would read a database's password.
    os.execve(command[0], command, {**os.environ, "MLFLOW_BACKEND_STORE_URI": tracker.uri})


if __name__ == "__main__":
    sys.exit(answered(main))
