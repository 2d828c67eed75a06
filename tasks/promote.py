"""Steps of the flow ``promote``: validation driving, figures of a set of networks on it, the registry."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from tasks.failures import StepFailed
from tasks.registry import CHAMPION, Decision, Registry, Version, decide
from tasks.run_context import Pending, current, step
from tasks.store import Artifact
from tasks.tracking import Tracker

RECORDING = "validation.parquet"
FIGURES = "validation.json"


@step("validation-driving", "driving to compare networks on", expected_s=10.0)
def validation_driving(
    out: Path, progress: Any, *, driving: dict[str, Any], engine: dict[str, Any], seed: int, minutes: float
) -> None:
    """``validation.parquet``: a clean recording of random driving, health values of its own; not Case-V."""
    from types import SimpleNamespace

    from dieseltwin.recordings.datasets import make_validation
    from dieseltwin.recordings.reader import write_recording
    from dieseltwin.settings.params import DrivingConfig, EngineConfig

    settings: Any = SimpleNamespace(driving=DrivingConfig(**driving), engine=EngineConfig(**engine))
    recording, _ = make_validation(seed, settings, duration_s=60.0 * minutes)
    write_recording(recording, out / RECORDING)


class UnreadableNetworks(ValueError):
    """A file of networks that today's code cannot read."""


def _loaded(load: Callable[[Path], Any], path: Path) -> Any:
    """``load(path)``. Raises ``UnreadableNetworks`` for a file that this code cannot read, whatever it stumbled over;
    a machine that fails (disk, memory) says nothing about the file and stays what it is."""
    try:
        return load(path)
    except Exception as error:
        if any(isinstance(found, OSError | MemoryError) for found in (error, error.__cause__)):
            raise
        raise UnreadableNetworks(f"{path.name}: {error}") from error


@step("network-validation", "validation of the networks", expected_s=15.0)
def validate(out: Path, progress: Any, *, recording: Path, networks: Path) -> None:
    """``validation.json``: relative L2 error [%] of every map, operator and body on the recording."""
    import json

    import pandas as pd

    from dieseltwin.surrogates.bodies import Bodies
    from dieseltwin.surrogates.empirical import EmpiricalMaps
    from dieseltwin.surrogates.operators import ActuatorOperators

    frame = pd.read_parquet(recording / RECORDING)
    figures: dict[str, float] = {}
    for path in sorted(networks.glob("*.pt")):
        name, _, kind = path.stem.partition("_")
        if name == "maps":
            table = _loaded(EmpiricalMaps.load, path).error_table({"validation": frame}).set_index("map")["l2_rel"]
            found = {str(key): 100.0 * float(value) for key, value in table.items()}
        elif name == "operators":
            found = _loaded(ActuatorOperators.load, path).errors(frame)
        else:
            found = _loaded(Bodies.load, path).errors([frame], "linear")
        figures |= {f"{name}/{kind}/{key}" if kind else f"{name}/{key}": value for key, value in found.items()}
    (out / FIGURES).write_text(json.dumps(figures, indent=1, sort_keys=True, allow_nan=False) + "\n", encoding="utf-8")


def registry() -> Registry:
    """The registry of the run's workspace."""
    return Registry(Tracker(current().workspace))


def champion() -> Version | None:
    """The version in use."""
    return registry().version(CHAMPION)


def figures_of(pending: Pending) -> dict[str, float]:
    """The figures of a validation that was submitted."""
    figures: dict[str, float] = json.loads((pending.result().path / FIGURES).read_text(encoding="utf-8"))
    return figures


def figures_unless_unreadable(pending: Pending) -> dict[str, float] | None:
    """The same of the champion; None where today's code cannot read its files, which ends its use.

    Raises ``StepFailed`` where the validation failed for another reason (a full disk, no memory): without figures there
    is no comparison, and without a comparison no promotion.
    """
    try:
        return figures_of(pending)
    except StepFailed as error:
        if f"{UnreadableNetworks.__module__}.{UnreadableNetworks.__qualname__}" not in error.kinds:
            raise
        return None


def promote(
    models: Artifact,
    figures: Mapping[str, float],
    before: Mapping[str, float] | None,
    settings: Mapping[str, Any],
) -> Decision:
    """Register the networks, decide, set the aliases, log the comparison, say so."""
    from tasks import records

    store, limits = registry(), settings["promotion"]
    in_use = store.version(CHAMPION)
    if in_use is not None and in_use.sha256 == models.sha256:
        decision = Decision(True, "these networks are in use already")
        current().display.say(f"registry: version {in_use.number} stays {CHAMPION}: {decision.reason}")
        return decision
    decision = decide(
        figures, before, mean_ratio_max=limits["mean_ratio_max"], worst_ratio_max=limits["worst_ratio_max"]
    )
    experiment = records.experiment("promote")
    version = store.register(models, experiment, {"profile": settings["profile"]})
    store.record(version, decision)
    records.promoted(version, figures, before, decision, settings)
    verb = f"is {CHAMPION}" if decision.promoted else "is not promoted"
    current().display.say(f"registry: version {version.number} {verb}: {decision.reason}")
    return decision
