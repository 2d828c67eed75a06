"""A flow of two toy steps on a schedule: ``python toy_served.py``; tests end it."""

from __future__ import annotations

import sys

import toy_library
import toy_steps
from prefect import flow

from tasks import run_context
from tasks.prefect_task import submit
from tasks.served import serve
from tasks.workspace import Workspace


@flow(name="toy-served")
def served(profile: str) -> None:
    """Two toy steps."""
    run_context.use(toy_library.fresh_context(Workspace.current().root))
    numbers = submit(toy_steps.make, count=5, seed=1).result()
    submit(toy_steps.total, numbers=numbers, scale=2.0).result()


if __name__ == "__main__":
    sys.exit(serve(served, lambda: "* * * * *", profile="quick"))
