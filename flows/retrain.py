"""The whole chain and the registry, once, now, or ``--serve`` on a schedule, Sundays at 3:00 where none is named."""

from __future__ import annotations

import sys

from prefect import flow

from flows.promote import promote
from flows.run import run
from tasks.launch import check_place
from tasks.served import run_or_serve, tell_failure
from tasks.settings import load_settings

SUNDAYS_AT_3 = "0 3 * * 0"


@flow(name="retrain", description=__doc__, on_failure=[tell_failure], on_crashed=[tell_failure])
def retrain(profile: str) -> None:
    """What changed since the last time is computed again: new data, new settings, new code. New networks become a
    version of the registry, and the one in use unless they are worse."""
    settings = load_settings(profile)
    check_place()
    run(profile, settings)
    promote(profile, settings)


def main() -> int:
    """Command line."""
    return run_or_serve(retrain, lambda parameters: SUNDAYS_AT_3)


if __name__ == "__main__":
    sys.exit(main())
