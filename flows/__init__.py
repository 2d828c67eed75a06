"""Order only: which step after which. What a step does is in ``tasks``, what it computes in ``dieseltwin``."""

from tasks.workspace import prepare_environment

prepare_environment()  # before any flow imports Prefect, which reads its settings then
