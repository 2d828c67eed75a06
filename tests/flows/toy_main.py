"""The toy chain as a user starts it: ``python toy_main.py WORKSPACE``; tests kill it."""

from __future__ import annotations

import sys
from pathlib import Path

import toy_library
import toy_steps

from tasks import run_context


def main() -> int:
    run_context.use(toy_library.fresh_context(Path(sys.argv[1])))
    numbers = toy_steps.make(count=5, seed=1)
    print(toy_steps.total(numbers=numbers, scale=2.0).sha256)
    return 0


if __name__ == "__main__":
    sys.exit(main())
