"""The same ensembles on threads, on a Dask cluster of two workers, and with a worker killed in the middle.

``python benchmarks/cluster.py`` after ``make run`` (it needs ``data/field``): six ensembles of the evaluation's
classical method. Prints for each way the hash over all results, wall seconds, and how many steps ran twice.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

CASES = ("clean-151", "clean-301", "noisy-301")
SENSORS = {"five": None, "three": ["p_im_pa", "p_em_pa", "omega_t_rad_s"]}
KILL_AFTER_S = 2.0  # a step is at work then, its process started


def kill_one(cache: Path, killed: list[int]) -> None:
    """Kill the Dask worker behind the first step that has been at work for a while."""
    deadline = time.monotonic() + 300.0
    seen: dict[str, float] = {}
    while time.monotonic() < deadline and not killed:
        for partial in cache.glob("ensemble-classical/.partial-*"):
            if time.monotonic() - seen.setdefault(partial.name, time.monotonic()) > KILL_AFTER_S:
                killed.append(int(partial.name.split("-")[-2]))
                os.kill(killed[0], signal.SIGKILL)
                return
        time.sleep(0.1)


def run(where: str, root: Path, members: int, *, kill: bool = False) -> tuple[str, float]:
    """Hash over all results, wall seconds. ``where``: value of DIESELTWIN_CLUSTER; ``root``: an empty workspace."""
    os.environ["DIESELTWIN_WORKSPACE"] = str(root)
    shutil.copyfile(ROOT / "params.yaml", root / "params.yaml")
    (root / "data").mkdir()
    shutil.copytree(ROOT / "data" / "field", root / "data" / "field")
    from prefect import flow

    from tasks import ensembles, run_context
    from tasks.cluster import task_runner
    from tasks.prefect_task import submit
    from tasks.publish import published
    from tasks.settings import load_settings, own_settings

    run_context.use(None)
    run_context.current().display.console.quiet = True
    settings = load_settings("quick")

    @flow(name="cluster-benchmark", task_runner=task_runner(where))
    def ensemble_flow() -> str:
        field = published(root / "data" / "field", "simulate")
        pending = []
        for case in CASES:
            for name, channels in SENSORS.items():
                what = {
                    "case": case, "members": members, "noise_seed": 1, "seed": 2, "start": "lab", "channels": channels,
                    "held_out_share": 0.0, "weight_share": 1.0, "scale_x_r": None, "first": 0, "runs": members,
                }  # fmt: skip
                own, step = own_settings(settings, "classical"), ensembles.STEPS["classical"]
                pending.append(
                    submit(step, method="classical", field=field, settings=own, what=what, kind=f"{case}-{name}")
                )
        return hashlib.sha256(" ".join(waiting.result().sha256 for waiting in pending).encode()).hexdigest()

    killed: list[int] = []
    if kill:
        threading.Thread(target=kill_one, args=(root / ".cache", killed), daemon=True).start()
    began = time.perf_counter()
    digest = ensemble_flow()
    seconds = time.perf_counter() - began
    if kill:
        print(f"  killed worker {killed[0]}" if killed else "  no worker was killed: the steps were too quick")
    return digest, seconds


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--members", type=int, default=5)
    members = parser.parse_args().members
    from tasks.server import prefect_server
    from tasks.workspace import prepare_environment

    workspace = prepare_environment()
    digests = set()
    ways = (("threads", "", False), ("dask, 2 workers", "local", False), ("worker killed", "local", True))
    with prefect_server(workspace):
        for label, where, kill in ways:
            with tempfile.TemporaryDirectory() as folder:
                digest, seconds = run(where, Path(folder), members, kill=kill)
            digests.add(digest)
            print(f"{label:<16} {digest[:16]}  {seconds:6.1f} s", flush=True)
    print("same numbers" if len(digests) == 1 else "DIFFERENT numbers")
    return 0 if len(digests) == 1 else 1


if __name__ == "__main__":
    sys.exit(main())
