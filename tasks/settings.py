"""params.yaml for the flows: one profile, as plain values that a step's key can hold."""

from __future__ import annotations

from typing import Any

from tasks.run_context import StepFailed
from tasks.workspace import Workspace

DEFAULT_PROFILE = "quick"


def load_settings(profile: str) -> dict[str, Any]:
    """Validated settings of a profile, as plain JSON values. Raises ``StepFailed`` (exit status 2) with the reader's
    one-line message."""
    from dieseltwin.config import load_params
    from dieseltwin.errors import InputError

    try:
        params = load_params(Workspace.current().params, profile)
    except InputError as error:
        raise StepFailed(str(error), exit_code=2) from error
    plain: dict[str, Any] = params.model_dump(mode="json")
    return plain
