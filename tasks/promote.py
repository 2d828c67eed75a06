"""Steps of the flow ``promote``: validation driving, figures and physical tests of a set of networks on it, the model
that MLflow serves, the registry."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from dieseltwin.errors import InputError, one_line
from dieseltwin.settings.methods import find
from tasks import rollback
from tasks.failures import StepFailed
from tasks.identify import rests_on
from tasks.registry import CHAMPION, Candidate, Decision, Registry, Version, decide
from tasks.rollback import BY_HAND, take_note, taken_out, target
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


def options(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--back", action="store_true", help="put the version that was in use before in use again")
    parser.add_argument("--to", type=int, metavar="N", help="the same with version N, which was in use once")
    parser.add_argument("--reason", help="of --back and --to: why; the version that is taken out keeps it")
    parser.add_argument(
        "--again", action="store_true", help="networks that were taken out of use may come back if they aren't worse"
    )


def check(parameters: Mapping[str, Any]) -> None:
    """Raise ``InputError`` for options that don't go together."""
    asked = [name for name in ("back", "to") if parameters[name] not in (None, False)]
    reason = str(parameters["reason"] or "").strip()
    if len(asked) == 2 or (asked and parameters["again"]):
        raise InputError("promote", "several ways at once", "--back, --to N or --again", "take one of them")
    if asked and not reason:
        raise InputError(f"promote --{asked[0]}", "no reason", "a few words", "say why with --reason")
    if reason and not asked:
        raise InputError("promote --reason", repr(reason), "a reason of --back or --to", "add one of these")


def promote(
    candidate: Candidate, before: Mapping[str, float] | None, settings: Mapping[str, Any], *, again: bool = False
) -> Decision:
    """Register the networks, decide, log the decision, set the aliases, say so.

    ``again``: networks that were taken out of use are compared as others are; else they are refused.
    """
    from tasks import records, records_promotion

    store, limits = _registry_as_it_is(), settings["promotion"]
    in_use, out = store.version(CHAMPION), taken_out(store, candidate.networks.sha256)
    if in_use is not None and in_use.sha256 == candidate.networks.sha256 and in_use.served:
        failed = "; ".join(("", *(f"it fails today's test: {words}" for words in candidate.failures)))
        decision = Decision(True, f"these networks are in use already{failed}")
        records_promotion.promoted(in_use, candidate, before, decision, settings)
        current().display.say(f"registry: version {in_use.number} stays {CHAMPION}: {decision.reason}")
        return decision
    if out is not None and not again:
        decision = Decision(False, f"it was taken out of use on {out}; --again compares it with the champion")
    else:
        decision = decide(
            candidate.figures, before, mean_ratio_max=limits["mean_ratio_max"],
            worst_ratio_max=limits["worst_ratio_max"], failures=candidate.failures,
        )  # fmt: skip
    experiment = records.experiment("promote")
    origin, params = records_promotion.training_of(candidate.networks, settings)
    version = store.register(
        candidate.networks, candidate.model, experiment, {"profile": settings["profile"], **origin},
        params=params, metrics=records_promotion.measured(candidate),
    )  # fmt: skip
    records_promotion.promoted(version, candidate, before, decision, settings)
    store.record(version, decision, candidate.tests)
    verb = f"is {CHAMPION}" if decision.promoted else "is not promoted"
    current().display.say(f"registry: version {version.number} {verb}: {decision.reason}")
    return decision


def roll_back(to: int | None, reason: str, settings: Mapping[str, Any]) -> bool:
    """Put an earlier version in use (``to``, or the one before), log the decision, say so. Returns True.

    Raises ``InputError`` where there is no such version.
    """
    from tasks import records_promotion

    store = _registry_as_it_is()
    back, reason = target(store, to), one_line(reason)
    records_promotion.rolled_back(back, store.number(CHAMPION), reason, settings)
    out = rollback.roll_back(store, back, reason)
    place = "" if out is None else f" in place of version {out}, which is taken out of use"
    current().display.say(f"registry: version {back.number} is {CHAMPION}{place}: {reason}")
    return True


def _registry_as_it_is() -> Registry:
    """The registry, after what somebody moved by hand was noted and said."""
    store = registry()
    for number in take_note(store):
        current().display.say(f"registry: version {number} is taken out of use: {BY_HAND}")
    return store
