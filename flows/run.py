"""The whole chain: data, pretraining, the three identifications, the report."""

from __future__ import annotations

import sys

from prefect import flow

from flows.identify import identify
from flows.pretrain import pretrain
from flows.simulate import simulate
from tasks.launch import run_alone


@flow(name="run", description=__doc__)
def run(profile: str) -> None:
    """One flow after the other, in one process and with one server."""
    simulate(profile)
    pretrain(profile)
    identify(profile)


if __name__ == "__main__":
    sys.exit(run_alone(run))
