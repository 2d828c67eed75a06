"""params.yaml for the flows: one profile, as plain values that a step's key can hold."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from tasks.run_context import StepFailed, current
from tasks.store import Artifact

DEFAULT_PROFILE = "quick"


def load_settings(profile: str) -> dict[str, Any]:
    """Validated settings of a profile, as plain JSON values. Raises ``StepFailed`` (exit status 2) with the reader's
    one-line message."""
    from dieseltwin.config import load_params
    from dieseltwin.errors import InputError

    try:
        params = load_params(current().workspace.params, profile)
    except InputError as error:
        raise StepFailed(str(error), exit_code=2) from error
    plain: dict[str, Any] = params.model_dump(mode="json")
    return plain


def about(settings: Mapping[str, Any], recording: Artifact) -> dict[str, Any]:
    """What the report says about where its numbers come from; nothing that differs between two equal runs."""
    from dieseltwin import __version__

    canonical = json.dumps(settings, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return {
        "title": "Health of a heavy-duty diesel from noisy driving",
        "recording": "Case-V, field parameters, noisy (simulated)",
        "sha256": recording.sha256,
        "profile": settings["profile"],
        "seed": settings["seed"],
        "params_sha256": hashlib.sha256(canonical.encode()).hexdigest(),
        "code_version": __version__,
        "methods": {
            "classical": "exact formulae, nothing learned",
            "few-shot-newton": "conditioned bodies, exact formulae",
            "few-shot-adam": "bodies, maps with dropout and actuator operators as printed, "
            f"{settings['identify']['adam']['epochs']:,} epochs of the paper's 30,000",
        },
        "commands": "make run, dvc repro",
    }
