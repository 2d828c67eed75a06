"""params.yaml for the flows: one profile, as plain values that a step's key can hold."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from tasks.run_context import StepFailed, current
from tasks.store import Artifact

DEFAULT_PROFILE = "quick"

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

    How many runs there are is an argument of its own. Raises ``InputError`` for an unknown method.
    """
    own = {method: section_of(settings, method)}
    shared = {name: value for name, value in settings["identify"].items() if name != "runs"}
    return {"identify": {**shared, "methods": own}, "engine": settings["engine"], "noise": settings["noise"]}


def section_of(settings: Mapping[str, Any], method: str) -> dict[str, Any]:
    """A method's section of ``identify.methods``; its own defaults where the file names none."""
    from dieseltwin.settings.methods import find

    found = settings["identify"]["methods"].get(method)
    plain: dict[str, Any] = find(method).settings().model_dump(mode="json") if found is None else dict(found)
    return plain


def runs_of(settings: Mapping[str, Any], method: str) -> int:
    """Runs a segment: the method's own number where it has one."""
    return int(section_of(settings, method).get("members") or settings["identify"]["runs"])


def network_files(method: str, models: Artifact) -> dict[str, Artifact]:
    """Kind of networks -> what a method takes of the trained ones; empty for the exact formulae alone."""
    from dieseltwin.settings.methods import find
    from dieseltwin.surrogates.files import files_of

    return {kind: models / name for kind, name in files_of(find(method).needs).items()}


def source_of(method: str) -> str | None:
    """The method whose trained networks another one begins with; None for one that begins by itself."""
    from dieseltwin.settings.methods import find

    return find(method).sources


def about(settings: Mapping[str, Any], recording: Artifact, sections: Iterable[str]) -> dict[str, Any]:
    """What the report says about where its numbers come from; nothing that differs between two equal runs.

    ``sections``: those of params.yaml that the numbers rest on; only they are part of the hash that is shown.
    """
    from dieseltwin.settings.methods import in_order
    from dieseltwin.settings.params import params_sha256
    from dieseltwin.version import __version__

    return {
        "title": "Health of a heavy-duty diesel from noisy driving",
        "recording": "Case-V, field parameters, noisy (simulated)",
        "sha256": recording.sha256,
        "profile": settings["profile"],
        "seed": settings["seed"],
        "params_sha256": params_sha256({name: settings[name] for name in sections}),
        "code_version": __version__,
        "methods": {method.name: _said(method, settings) for method in in_order()},
        "commands": "make run, dvc repro",
    }


def _said(method: Any, settings: Mapping[str, Any]) -> str:
    """What is learned of a method, and for how many epochs it trains."""
    section = method.settings.model_validate(section_of(settings, method.name))
    epochs = section.trained_epochs
    return method.learned if epochs is None else f"{method.learned}; {epochs:,} epochs"
