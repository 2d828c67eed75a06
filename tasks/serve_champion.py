"""The champion as a service: ``python -m tasks.serve_champion --port 5001`` (``make champion``).

It is `mlflow models serve` of the champion's folder, after its networks were compared with their checksum.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from tasks import databases
from tasks.listening import answered, listening
from tasks.registry import CHAMPION, NAME, Registry
from tasks.tracking import Tracker
from tasks.workspace import prepare_environment


def main() -> int:
    """Find the champion, become its server; exit status 2 where there is none that can be served."""
    arguments = listening("make champion", __doc__, 5001)
    if arguments is None:
        return 2
    tracker = Tracker(prepare_environment())
    version = refused = None
    if not tracker.uri.startswith("sqlite") or (tracker.workspace.mlruns / "mlflow.db").exists():
        registry = Registry(tracker)
        version, refused = registry.version(CHAMPION), registry.refusal()
    if version is None or not version.served:
        found = "none" if version is None else f"version {version.number}, which holds networks alone"
        advice = "run `make run` and `make promote`"
        if version is None and refused is not None:
            found += f" (version {refused[0]} was refused: {refused[1]})"
            advice = "train networks that pass and promote them, or give a version the alias by hand in `make ui`"
        print(f"error: {NAME}@{CHAMPION} in {databases.shown(tracker.uri)}: got {found}; allowed: a model whose "
              f"networks agree with their checksum; {advice}", file=sys.stderr)  # fmt: skip
        return 2
    print(f"version {version.number} answers at http://{arguments.host}:{arguments.port}/invocations once its "
          "simulator is compiled (a minute, once a machine); Ctrl-C ends it", flush=True)  # fmt: skip
    command = [
        *(sys.executable, "-m", "mlflow", "models", "serve", "--env-manager", "local"),
        *("--model-uri", str(version.folder), "--host", arguments.host, "--port", str(arguments.port)),
    ]
    # MLflow looks for its server on the path
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    os.execve(command[0], command, {**os.environ, "PATH": path})


if __name__ == "__main__":
    sys.exit(answered(main))
