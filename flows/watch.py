"""New recordings of a folder -> the history of their engine, its page, MLflow; once, or ``--serve`` on a schedule."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from prefect import flow

from tasks import discover
from tasks import records_watch as records
from tasks import watch as steps
from tasks.cluster import task_runner
from tasks.launch import run_alone
from tasks.prefect_task import submit
from tasks.served import serve, tell_failure
from tasks.settings import DEFAULT_PROFILE, load_settings


@flow(
    name="watch",
    description=__doc__,
    task_runner=task_runner(),
    on_failure=[tell_failure],
    on_crashed=[tell_failure],
)
def watch(profile: str, folder: str, engine: str, history: str) -> list[str]:
    """Add what is new. Returns the names of the recordings that were added.

    Those that are no good stop none; they end the flow behind all others.
    """
    settings = load_settings(profile)
    files = steps.engine_files(engine)
    arrived = steps.arrived(folder, engine, history)
    pending = {
        name: submit(
            steps.watched,
            recording=recording,
            kind=Path(name).stem,
            name=name,
            modified_s=steps.modified_s(recording.path, name),
            sections=steps.watched.sections_of(settings),
            **files,
        )
        for name, recording in arrived.new.items()
    }
    found, refused = discover.gathered(pending)
    refused, growing = steps.parted(refused)
    left = {**arrived.left, **growing}
    batch = steps.add(found, engine, history, settings["watch"])
    refused = {**refused, **batch.refused}
    if batch.recordings:  # also where nothing is new: an earlier run may have been killed before it logged
        records.watched(batch, found, refused, settings)
    steps.show(batch, [name for name in found if name not in {*batch.added, *batch.refused}], refused, left)
    return list(batch.added)


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--serve", action="store_true")
    parser.add_argument("--cron")
    chosen, rest = parser.parse_known_args()
    if chosen.cron is not None and not chosen.serve:
        parser.error("--cron: a schedule needs --serve")
    if not chosen.serve:
        return run_alone(watch, rest, options=_options, check=steps.check)
    full = argparse.ArgumentParser(description=__doc__)
    full.add_argument("--profile", default=DEFAULT_PROFILE, help="a profile of params.yaml")
    _options(full)
    arguments = vars(full.parse_args(rest))

    def cron() -> str:
        return str(chosen.cron or load_settings(arguments["profile"])["watch"]["schedule"])

    return serve(watch, cron, check=steps.check, **arguments)


def _options(parser: argparse.ArgumentParser) -> None:
    steps.options(parser)
    parser.epilog = "--serve stays and runs on the schedule: --cron, five fields, else watch.schedule of params.yaml"


if __name__ == "__main__":
    sys.exit(main())
