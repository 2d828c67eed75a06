"""The whole chain: data, pretraining, the three identifications, the report."""

from __future__ import annotations

import sys
from typing import Any

from prefect import flow

from flows.identify import identify
from flows.pretrain import pretrain
from flows.simulate import simulate
from tasks.launch import run_alone
from tasks.settings import load_settings


@flow(name="run", description=__doc__)
def run(profile: str, settings: dict[str, Any] | None = None) -> None:
    """One flow after the other, in one process and with one server.

    The settings are read once, so that an edit in the middle of a run makes no mixture.
    """
    settings = settings or load_settings(profile)
    simulate(profile, settings)
    pretrain(profile, settings)
    identify(profile, settings)


if __name__ == "__main__":
    sys.exit(run_alone(run))
