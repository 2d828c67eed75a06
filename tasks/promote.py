"""Steps of the flow ``promote``: validation driving, figures and physical tests of a set of networks on it, the model
that MLflow serves, the registry."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from dieseltwin.settings.methods import find
from tasks.failures import StepFailed
from tasks.identify import rests_on
from tasks.registry import CHAMPION, Candidate, Decision, Registry, Version, decide
from tasks.run_context import Pending, Progress, current, step
from tasks.tracking import Tracker

RECORDING = "validation.parquet"
ENGINE = "engine.json"  # that drove
FIGURES = "validation.json"
TESTS = "acceptance.json"
MODEL = "model"
EXAMPLE_ROWS = 26  # five seconds

KNOWN_ENGINE = find("few-shot-newton")  # the method that finds it, with all that was learned


@step("validation-driving", "driving to compare networks on", expected_s=10.0)
def validation_driving(
    out: Path, progress: Progress, *, driving: dict[str, Any], engine: dict[str, Any], seed: int, minutes: float
) -> None:
    """``validation.parquet``: a clean recording of random driving, not Case-V; ``engine.json``: health of its own."""
    import json

    from dieseltwin.paper.datasets import make_validation
    from dieseltwin.recordings.reader import write_recording
    from tasks.simulate import sections_read

    settings = sections_read(driving=driving, engine=engine)
    recording, driven = make_validation(seed, settings, duration_s=60.0 * minutes)
    write_recording(recording, out / RECORDING)
    (out / ENGINE).write_text(json.dumps(driven.model_dump(mode="json"), indent=1) + "\n", encoding="utf-8")


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
def validate(out: Path, progress: Progress, *, recording: Path, networks: Path) -> None:
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


@step("acceptance", "physical tests of the networks", expected_s=30.0, entries=rests_on(KNOWN_ENGINE))
def acceptance(
    out: Path, progress: Progress, *, recording: Path, networks: Path, limits: dict[str, Any], identify: dict[str, Any]
) -> None:
    """``acceptance.json``: figure, limit and sentence of every physical test of the networks."""
    import json

    import pandas as pd

    from dieseltwin.engine import EngineParameters
    from dieseltwin.identification.acceptance import HeldOutDriving, acceptance_tests
    from dieseltwin.settings.discovery import AcceptanceConfig
    from dieseltwin.settings.params import IdentifyConfig
    from dieseltwin.surrogates.empirical import EmpiricalMaps
    from dieseltwin.surrogates.files import networks_for

    engine = EngineParameters(**json.loads((recording / ENGINE).read_text(encoding="utf-8")))
    driving = HeldOutDriving(pd.read_parquet(recording / RECORDING), engine)
    files = {path.stem.removeprefix("maps_"): path for path in sorted(networks.glob("maps_*.pt"))}
    maps = {kind: _loaded(EmpiricalMaps.load, path) for kind, path in files.items()}
    asked = AcceptanceConfig(**limits)
    learned = {} if asked.known_engine is None else networks_for(KNOWN_ENGINE, networks, maps="improved")
    tests = acceptance_tests(maps, learned, driving, asked, IdentifyConfig(**{"runs": 1, **identify}))
    found = [test.to_json() for test in tests]
    (out / TESTS).write_text(json.dumps(found, indent=1, allow_nan=False) + "\n", encoding="utf-8")


@step("served-model", "the model that MLflow serves", expected_s=10.0)
def served_model(out: Path, progress: Progress, *, recording: Path, networks: Path, code: Path) -> None:
    """``model/``: an MLflow model of the networks, with the code that runs them, signature and an input example."""
    import pandas as pd

    from tasks.model_folder import write_model

    example = pd.read_parquet(recording / RECORDING).head(EXAMPLE_ROWS)
    write_model(out / MODEL, networks, code, example)


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


def tests_of(pending: Pending) -> list[dict[str, Any]]:
    """The physical tests that were submitted."""
    tests: list[dict[str, Any]] = json.loads((pending.result().path / TESTS).read_text(encoding="utf-8"))
    return tests


def promote(candidate: Candidate, before: Mapping[str, float] | None, settings: Mapping[str, Any]) -> Decision:
    """Register the networks, decide, set the aliases, log the comparison, say so."""
    from tasks import records

    store, limits = registry(), settings["promotion"]
    in_use = store.version(CHAMPION)
    if in_use is not None and in_use.sha256 == candidate.networks.sha256 and in_use.served:
        failed = "; ".join(("", *(f"it fails today's test: {words}" for words in candidate.failures)))
        decision = Decision(True, f"these networks are in use already{failed}")
        current().display.say(f"registry: version {in_use.number} stays {CHAMPION}: {decision.reason}")
        return decision
    decision = decide(
        candidate.figures, before, mean_ratio_max=limits["mean_ratio_max"], worst_ratio_max=limits["worst_ratio_max"],
        failures=candidate.failures,
    )  # fmt: skip
    experiment = records.experiment("promote")
    version = store.register(candidate.networks, candidate.model, experiment, {"profile": settings["profile"]})
    store.record(version, decision, candidate.tests)
    records.promoted(version, candidate, before, decision, settings)
    verb = f"is {CHAMPION}" if decision.promoted else "is not promoted"
    current().display.say(f"registry: version {version.number} {verb}: {decision.reason}")
    return decision
