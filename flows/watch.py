"""New recordings of a folder -> the history of their engine, its page, MLflow; once, or ``--serve`` on a schedule
(``watch.schedule`` of params.yaml where none is named)."""

from __future__ import annotations

import sys
from typing import Any

from prefect import flow

from tasks import discover
from tasks import records_watch as records
from tasks import watch as steps
from tasks.cluster import task_runner
from tasks.launch import check_place
from tasks.prefect_task import submit
from tasks.served import run_or_serve, tell_failure
from tasks.settings import load_settings


@flow(
    name="watch",
    description=__doc__,
    task_runner=task_runner(),
    on_failure=[tell_failure],
    on_crashed=[tell_failure],
)
def watch(profile: str, folder: str, engine: str, history: str) -> list[str]:
    """Add what is new. Returns the names of the recordings that were added.

    Those that are no good stop none; they end the flow behind all others, the first time.
    """
    settings = load_settings(profile)
    check_place()
    arrived = steps.arrived(folder, engine, history)
    asked = steps.asked(arrived.new, engine, history, settings)
    pending = {name: submit(steps.watched, **arguments) for name, arguments in asked.arguments.items()}
    found, refused = discover.gathered(pending)
    refused, growing = steps.parted(refused)
    batch = steps.add(found, engine, history, settings["watch"])
    refused = {**refused, **batch.refused}
    if batch.recordings:  # also where nothing is new: an earlier run may have been killed before it logged
        records.watched(batch, found, refused, settings)
    steps.show(batch, asked, list(found), refused, {**arrived.left, **growing})
    return list(batch.added)


def main() -> int:
    """Command line."""
    return run_or_serve(watch, _schedule, options=steps.options, check=steps.check)


def _schedule(parameters: dict[str, Any]) -> str:
    return str(load_settings(parameters["profile"])["watch"]["schedule"])


if __name__ == "__main__":
    sys.exit(main())
