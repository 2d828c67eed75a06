"""Thirty writers at once on MLflow's and on Prefect's database: what landed, what was refused, and how long it took.

    python benchmarks/writers.py                                    # sqlite, in a temporary workspace
    DIESELTWIN_MLFLOW=postgresql://USER@HOST/mlflow DIESELTWIN_PREFECT=postgresql://USER@HOST/prefect \\
        python benchmarks/writers.py                                # a server

A writer of MLflow is a process of its own that logs results as the flows do (`tasks.tracking`): a run with a curve, two
nested runs and a figure. A writer of Prefect is a process that runs a flow of three tasks against one server. Then
everything is read back. The first writers find no tables: they are made while all others wait at the door.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

TASKS, MEMBERS, POINTS = 3, 2, 400
BATCH = f"writers-{os.getpid()}-{int(time.time())}"  # a server's database may hold others


def log_results(root: str, writer: int, results: int, told: multiprocessing.Queue[str]) -> None:
    """What a writer of MLflow does."""
    from tasks.tracking import Curve, Record, Tracker
    from tasks.workspace import Workspace

    tracker = Tracker(Workspace(Path(root)))
    figure = Path(root) / f"figure-{writer}.svg"
    figure.write_text("<svg/>")
    for number in range(results):
        name = f"writer {writer} result {number}"
        members = [Record(f"{name} member {i}", f"{name} {i}", metrics={"value": float(i)}) for i in range(MEMBERS)]
        curve = Curve("loss", range(POINTS), [1.0 / (i + 1) for i in range(POINTS)])
        record = Record(name, name, params={"writer": writer}, metrics={"value": writer + number / 100.0},
                        curves=[curve], artifacts={"figure.svg": figure}, children=members)  # fmt: skip
        try:
            tracker.log(tracker.experiment(BATCH, "thirty at once"), record)
            told.put("landed")
        except Exception as error:  # what is looked for
            told.put(f"refused: {type(error).__name__}: {' '.join(str(error).split())[:150]}")


def run_flows(root: str, writer: int, results: int, told: multiprocessing.Queue[str]) -> None:
    """What a writer of Prefect does."""
    from prefect import flow, task

    @task(name="step", persist_result=False)
    def step(number: int) -> int:
        return number

    @flow(name=f"{BATCH}-{writer}")
    def chain() -> int:
        return sum(step(number) for number in range(TASKS))

    for _ in range(results):
        try:
            chain()
            told.put("landed")
        except Exception as error:  # what is looked for
            told.put(f"refused: {type(error).__name__}: {' '.join(str(error).split())[:150]}")


def at_once(what: Callable[..., None], root: Path, writers: int, results: int) -> tuple[Counter[str], float]:
    """What the writers told, and wall seconds."""
    context = multiprocessing.get_context("fork")  # the imports are done once
    told: multiprocessing.Queue[str] = context.Queue()
    began = time.perf_counter()
    processes = [context.Process(target=what, args=(str(root), i, results, told)) for i in range(writers)]
    for process in processes:
        process.start()
    counts = Counter(told.get(timeout=900.0) for _ in range(writers * results))
    for process in processes:
        process.join()
    return counts, time.perf_counter() - began


def logged(root: Path) -> tuple[int, int]:
    """Finished runs of MLflow that hold all they should, and nested ones."""
    from tasks.tracking import Tracker
    from tasks.workspace import Workspace

    client = Tracker(Workspace(root)).client
    experiment = client.get_experiment_by_name(BATCH)
    runs = client.search_runs([experiment.experiment_id], max_results=50_000)
    nested = [run for run in runs if "mlflow.parentRunId" in run.data.tags]
    whole = [run for run in runs if "mlflow.parentRunId" not in run.data.tags and run.info.status == "FINISHED"
             and {"value", "loss"} <= set(run.data.metrics)]  # fmt: skip
    curves = client.get_metric_history(whole[0].info.run_id, "loss") if whole else []
    return len(whole) if len(curves) == POINTS else 0, len(nested)


def orchestrated() -> tuple[int, int]:
    """Completed runs of the flows and of their tasks, as the server knows them."""
    from prefect.client.orchestration import get_client
    from prefect.client.schemas.filters import FlowFilter, FlowFilterName

    with get_client(sync_client=True) as client:
        flows, tasks = [], []
        ours = FlowFilter(name=FlowFilterName(like_=BATCH))
        while chunk := client.read_flow_runs(flow_filter=ours, offset=len(flows), limit=200):
            flows += chunk
        while chunk := client.read_task_runs(flow_filter=ours, offset=len(tasks), limit=200):
            tasks += chunk
    done = sum(run.state is not None and run.state.is_completed() for run in flows)
    return done, sum(run.state is not None and run.state.is_completed() for run in tasks)


def main() -> int:
    """Print a line for each database; 1 where something is missing that wasn't refused."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--writers", type=int, default=30)
    parser.add_argument("--results", type=int, default=5, help="of each writer of MLflow")
    parser.add_argument("--flows", type=int, default=1, help="of each writer of Prefect")
    parser.add_argument("--only", choices=["mlflow", "prefect"])
    arguments = parser.parse_args()
    writers, results, flows_each = arguments.writers, arguments.results, arguments.flows
    from tasks import databases

    databases.check_settings()
    missing = 0
    with tempfile.TemporaryDirectory(prefix="writers-") as folder:
        root = Path(folder)
        os.environ["DIESELTWIN_WORKSPACE"] = folder
        from tasks.workspace import prepare_environment

        workspace = prepare_environment()
        if arguments.only != "prefect":
            import mlflow.store.tracking.sqlalchemy_store  # noqa: F401

            told, seconds = at_once(log_results, root, writers, results)
            runs, nested = logged(root)
            missing += told["landed"] - runs
            print(f"MLflow on {databases.shown(workspace.mlflow_uri).partition(':')[0]}: {writers} writers, "
                  f"{writers * results} results: {runs} landed with {nested} nested runs, {seconds:.0f} s")
            print("\n".join(f"    {count} {line}" for line, count in told.items()), flush=True)
        if arguments.only != "mlflow":
            from tasks.server import prefect_server

            kind = os.environ.get("PREFECT_SERVER_DATABASE_CONNECTION_URL", "sqlite").partition(":")[0]
            with prefect_server(workspace):
                told, seconds = at_once(run_flows, root, writers, flows_each)
                time.sleep(5.0)  # events of tasks are written a moment later
                flows, tasks = orchestrated()
            missing += told["landed"] - flows
            print(f"Prefect on {kind}: {writers} writers, {writers * flows_each} flows: {flows} landed with {tasks} of "
                  f"{TASKS * writers * flows_each} tasks, {seconds:.0f} s")
            print("\n".join(f"    {count} {line}" for line, count in told.items()), flush=True)
    return int(missing > 0)


if __name__ == "__main__":
    sys.exit(main())
