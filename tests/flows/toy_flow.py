"""A flow of one toy step as a user starts it: ``python toy_flow.py WORKSPACE``; tests end it."""

from __future__ import annotations

import sys
from pathlib import Path

import toy_library
import toy_steps

from tasks import run_context
from tasks.launch import launch
from tasks.workspace import prepare_environment


def main() -> int:
    prepare_environment()
    run_context.use(toy_library.fresh_context(Path(sys.argv[1])))
    from prefect import flow

    from tasks.prefect_task import submit

    @flow(name="inner")
    def inner() -> list[str]:
        numbers = submit(toy_steps.make, count=5, seed=1).result()
        pending = [submit(toy_steps.total, numbers=numbers, scale=float(scale)) for scale in range(4)]
        return [waiting.result().sha256 for waiting in pending]

    @flow(name="toy")
    def outer() -> None:
        inner()

    return launch(outer)


if __name__ == "__main__":
    sys.exit(main())
