"""Order only: which step after which. What a step does is in ``tasks``, what it computes in ``dieseltwin``."""

import signal
import sys

from tasks.failures import interrupted_early
from tasks.workspace import prepare_environment

if sys.argv[0] == "-m":  # ``python -m flows.NAME``: Prefect takes seconds to load, and `launch` listens only then
    signal.signal(signal.SIGINT, interrupted_early)
prepare_environment()  # before any flow imports Prefect, which reads its settings then
