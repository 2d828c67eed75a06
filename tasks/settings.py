"""params.yaml for the flows: one profile, as plain values that a step's key can hold."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from tasks.run_context import StepFailed, current
from tasks.store import Artifact

DEFAULT_PROFILE = "quick"

_SECTIONS = {
    "baseline": "baseline",
    "multi-stage": "multi_stage",
    "few-shot-adam": "adam",
    "few-shot-newton": "newton",
    "classical": "classical",
}
"""Method -> its section of ``identify``; only that one is part of a step's key."""


def load_settings(profile: str) -> dict[str, Any]:
    """Validated settings of a profile, as plain JSON values. Raises ``StepFailed`` (exit status 2) with the reader's
    one-line message."""
    from dieseltwin.errors import InputError
    from dieseltwin.settings.params import load_params

    try:
        params = load_params(current().workspace.params, profile)
    except InputError as error:
        raise StepFailed(str(error), exit_code=2) from error
    plain: dict[str, Any] = params.model_dump(mode="json")
    return plain


def own_settings(settings: Mapping[str, Any], method: str) -> dict[str, Any]:
    """What one method reads: the shared part of ``identify`` and its own section, the engine and the noise.

    How many runs there are is an argument of its own. Raises ``KeyError`` for an unknown method.
    """
    others = set(_SECTIONS.values()) - {_SECTIONS[method]} | {"runs"}
    shared = {name: value for name, value in settings["identify"].items() if name not in others}
    return {"identify": shared, "engine": settings["engine"], "noise": settings["noise"]}


def about(settings: Mapping[str, Any], recording: Artifact, sections: Iterable[str]) -> dict[str, Any]:
    """What the report says about where its numbers come from; nothing that differs between two equal runs.

    ``sections``: those of params.yaml that the numbers rest on; only they are part of the hash that is shown.
    """
    from dieseltwin import __version__
    from dieseltwin.settings.params import params_sha256

    return {
        "title": "Health of a heavy-duty diesel from noisy driving",
        "recording": "Case-V, field parameters, noisy (simulated)",
        "sha256": recording.sha256,
        "profile": settings["profile"],
        "seed": settings["seed"],
        "params_sha256": params_sha256({name: settings[name] for name in sections}),
        "code_version": __version__,
        "methods": {
            "classical": "exact formulae, nothing learned",
            "few-shot-newton": "conditioned bodies, exact formulae",
            "few-shot-adam": "bodies, maps with dropout and actuator operators as printed, "
            f"{settings['identify']['adam']['epochs']:,} epochs of the paper's 30,000",
        },
        "commands": "make run, dvc repro",
    }
