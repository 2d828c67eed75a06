"""No promotion without a comparison: what failed is told from a champion that isn't there or can't be read."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest

from tasks import promote
from tasks.failures import StepFailed, WorkerKilled
from tasks.registry import CHAMPION, Registry
from tasks.store import content_hash
from tasks.workspace import Workspace


class Registered:
    """MLflow's client as far as the registry reads it: one model with aliases; ``broken`` fails the n-th question."""

    def __init__(self, aliases: dict[str, str], source: str = "", sha256: str = "", broken: int = 0) -> None:
        self.aliases, self.source, self.sha256, self.broken, self.asked = aliases, source, sha256, broken, 0

    def _ask(self) -> None:
        from mlflow.exceptions import MlflowException  # here, not in every process that collects tests
        from mlflow.protos.databricks_pb2 import INTERNAL_ERROR

        self.asked += 1
        if self.asked == self.broken:
            raise MlflowException("database is locked", INTERNAL_ERROR)

    def get_registered_model(self, name: str) -> Any:
        self._ask()
        return SimpleNamespace(aliases=self.aliases)

    def search_registered_models(self, filter_string: str) -> list[Any]:
        return [self.get_registered_model(filter_string)]

    def get_model_version(self, name: str, version: str) -> Any:
        self._ask()
        if version not in self.aliases.values():
            from mlflow.exceptions import MlflowException
            from mlflow.protos.databricks_pb2 import RESOURCE_DOES_NOT_EXIST

            raise MlflowException("no such version", RESOURCE_DOES_NOT_EXIST)
        return SimpleNamespace(version=version, source=self.source, tags={"dieseltwin.sha256": self.sha256})

    def get_model_version_by_alias(self, name: str, alias: str) -> Any:
        return self.get_model_version(name, self.aliases[alias])


def registry(root: Path, client: Registered) -> Registry:
    tracker: Any = SimpleNamespace(workspace=Workspace(root), client=client)
    return Registry(tracker)


def test_a_registry_that_cannot_be_read_is_not_one_without_a_champion(tmp_path: Path) -> None:
    from mlflow.exceptions import MlflowException

    folder = Workspace(tmp_path).mlruns / "artifacts" / "promote" / "networks"
    folder.mkdir(parents=True)
    (folder / "bodies.pt").write_text("weights")
    known = {"aliases": {CHAMPION: "3"}, "source": "mlflow-artifacts:/promote/networks"}
    known |= {"sha256": content_hash(folder)}
    found = registry(tmp_path, Registered(**known)).version(CHAMPION)
    assert found is not None and (found.number, found.path) == (3, folder)
    assert registry(tmp_path, Registered({})).version(CHAMPION) is None
    for broken in (1, 2):
        with pytest.raises(MlflowException, match="locked"):
            registry(tmp_path, Registered(**known, broken=broken)).version(CHAMPION)


class Waiting:
    """A submitted validation with its end."""

    def __init__(self, end: Path | StepFailed) -> None:
        self.end = end

    def result(self) -> Any:
        if isinstance(self.end, StepFailed):
            raise self.end
        return SimpleNamespace(path=self.end)


def unless_unreadable(end: Path | StepFailed) -> dict[str, float] | None:
    waiting: Any = Waiting(end)
    return promote.figures_unless_unreadable(waiting)


def test_only_networks_that_cannot_be_read_give_no_figures(tmp_path: Path) -> None:
    (tmp_path / promote.FIGURES).write_text(json.dumps({"maps/eta_c": 1.5}))
    assert unless_unreadable(tmp_path) == {"maps/eta_c": 1.5}
    assert unless_unreadable(StepFailed("old format", kinds=["tasks.promote.UnreadableNetworks", "ValueError"])) is None
    for failure in (
        StepFailed("no space left on device", kinds=["builtins.OSError", "builtins.Exception"]),
        StepFailed("broken", kinds=["builtins.ValueError", "builtins.Exception"]),
        StepFailed("the worker ended with status 1"),
        WorkerKilled("killed"),
    ):
        with pytest.raises(StepFailed) as raised:
            unless_unreadable(failure)
        assert raised.value is failure


def test_a_damaged_file_of_networks_is_named_and_a_full_machine_is_not_taken_for_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording, networks = tmp_path / "recording", tmp_path / "networks"
    recording.mkdir(), networks.mkdir()
    pd.DataFrame({"time_s": [0.0]}).to_parquet(recording / promote.RECORDING)
    (networks / "operators.pt").write_bytes(b"no network")

    def validate() -> None:
        promote.validate.function(tmp_path, None, recording=recording, networks=networks)

    with pytest.raises(promote.UnreadableNetworks, match=r"operators\.pt"):
        validate()
    import torch

    with zipfile.ZipFile(networks / "operators.pt", "w") as archive:  # a whole archive: its content is torch's to read
        archive.writestr("data.pkl", b"no network")
    for error in (OSError(28, "No space left on device"), MemoryError()):
        monkeypatch.setattr(torch, "load", lambda *_, error=error, **__: (_ for _ in ()).throw(error))
        with pytest.raises(Exception) as raised:
            validate()
        assert not isinstance(raised.value, promote.UnreadableNetworks)
