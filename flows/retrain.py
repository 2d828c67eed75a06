"""The whole chain and the registry, on a schedule (``python -m flows.retrain --serve``) or once, now."""

from __future__ import annotations

import argparse
import sys

from prefect import flow

from flows.promote import promote
from flows.run import run
from tasks.launch import launch
from tasks.served import serve, tell_failure
from tasks.settings import DEFAULT_PROFILE, load_settings

SUNDAYS_AT_3 = "0 3 * * 0"


@flow(name="retrain", description=__doc__, on_failure=[tell_failure], on_crashed=[tell_failure])
def retrain(profile: str) -> None:
    """What changed since the last time is computed again: new data, new settings, new code. New networks become a
    version of the registry, and the one in use unless they are worse."""
    settings = load_settings(profile)
    run(profile, settings)
    promote(profile, settings)


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--profile", default=DEFAULT_PROFILE, help="a profile of params.yaml")
    parser.add_argument("--serve", action="store_true", help="stay and run on the schedule")
    parser.add_argument("--cron", help="schedule of --serve, five fields (default: Sundays at 3:00)")
    arguments = parser.parse_args()
    if arguments.cron is not None and not arguments.serve:
        parser.error("--cron: a schedule needs --serve")
    if arguments.serve:
        cron = SUNDAYS_AT_3 if arguments.cron is None else arguments.cron
        return serve(retrain, lambda: cron, profile=arguments.profile)
    return launch(retrain, profile=arguments.profile)


if __name__ == "__main__":
    sys.exit(main())
