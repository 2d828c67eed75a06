"""MLflow's model registry: every set of trained networks is a version, the one in use carries the alias ``champion``.

A version is an MLflow model that can be served, and is known by the hash of its networks, so registering the same again
changes nothing. A version that fails a physical test is never promoted. Else validation figures (errors in per cent,
smaller is better) are compared with the champion's, both on the same driving: the new one takes the alias unless it is
worse. The one before keeps the alias ``previous``, to go back to (:mod:`tasks.rollback`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dieseltwin.atomic import write_json
from tasks.failures import StepFailed
from tasks.model_folder import MODEL_FILE, NETWORKS
from tasks.store import Artifact, content_hash
from tasks.tracking import SCHEME, Record, Tracker

NAME = "dieseltwin-networks"
CHAMPION, PREVIOUS, CHALLENGER = "champion", "previous", "challenger"

_DESCRIPTION = (
    "Everything that is learned from laboratory data: empirical maps, actuator operators, multi-head bodies. The alias "
    f"`{CHAMPION}` marks the version in use; tags say why a version got it or not."
)
# A version's tag `use`: in use, `superseded by version N`, or taken out; none where it never was in use.
USE, IN_USE, OUT = "use", "in use", "taken out"
OUT_REASON, OUT_DATE = "taken_out.reason", "taken_out.date"

_HASH = "dieseltwin.sha256"
_ACCEPTANCE = "acceptance"
_TESTS = "acceptance.json"
_FOLDER = "model"


@dataclass(frozen=True)
class Candidate:
    """Newly trained networks and what is known of them.

    Attributes:
        networks: their folder.
        model: the folder that MLflow serves.
        figures: name -> error on validation driving [%].
        tests: physical tests, as `identification.acceptance` writes them in JSON.
    """

    networks: Artifact
    model: Artifact
    figures: Mapping[str, float]
    tests: Sequence[Mapping[str, Any]]

    @property
    def failures(self) -> list[str]:
        """Sentences of the tests that were failed."""
        return [str(test["sentence"]) for test in self.tests if not test["passed"]]


@dataclass(frozen=True)
class Decision:
    """Whether a version takes over, and the figures behind it.

    Attributes:
        promoted: it takes the alias.
        reason: one sentence.
        mean_ratio: geometric mean over the figures of new / champion [-]; None without a champion.
        worst: name of the figure with the largest ratio, and that ratio [-].
    """

    promoted: bool
    reason: str
    mean_ratio: float | None = None
    worst: tuple[str, float] | None = None


def decide(
    new: Mapping[str, float], champion: Mapping[str, float] | None, *, mean_ratio_max: float, worst_ratio_max: float,
    failures: Sequence[str] = (),
) -> Decision:  # fmt: skip
    """Whether a version takes over: it fails no physical test, and by its validation figures (name -> error, positive,
    smaller is better) it is not worse than the champion.

    Args:
        new: of the new version.
        champion: of the champion on the same driving; None where there is none or today's code can't read it.
        mean_ratio_max: geometric mean of new / champion up to which the new one is "not worse" [-].
        worst_ratio_max: the same for each figure alone [-].
        failures: sentences of the physical tests that the new version fails; with one it is not promoted.
    """
    if failures:
        return Decision(False, f"it fails a physical test: {'; '.join(failures)}")
    wrong = sorted(name for name, value in new.items() if not (math.isfinite(value) and value >= 0.0))
    if wrong or not new:
        return Decision(False, f"no valid figure for {', '.join(wrong)}" if wrong else "no figures")
    if champion is None:
        return Decision(True, "no champion that could be compared")
    missing = sorted(set(champion) - set(new))
    if missing:
        return Decision(False, f"the champion has figures that the new version lacks: {', '.join(missing)}")
    ratios = {name: _ratio(new[name], champion[name]) for name in champion}
    mean = math.exp(sum(math.log(ratio) for ratio in ratios.values()) / len(ratios))
    name, worst = max(ratios.items(), key=lambda item: item[1])
    words = f"errors are {mean:.3f} of the champion's in the mean, {name} {worst:.3f}"
    if mean > mean_ratio_max:
        return Decision(False, f"{words}; in the mean at most {mean_ratio_max:g}", mean, (name, worst))
    if worst > worst_ratio_max:
        return Decision(False, f"{words}; each at most {worst_ratio_max:g}", mean, (name, worst))
    return Decision(True, words, mean, (name, worst))


_SMALLEST = 1e-12  # errors below it [%] count as equal


def _ratio(new: float, old: float) -> float:
    return max(new, _SMALLEST) / max(old, _SMALLEST)


@dataclass(frozen=True)
class Version:
    """A registered version.

    Attributes:
        number: of the version.
        folder: what was registered: an MLflow model, or the networks alone (versions of before 0.1.0).
        sha256: hash of its networks.
    """

    number: int
    folder: Path
    sha256: str

    @property
    def served(self) -> bool:
        """Whether it is a model that MLflow can serve."""
        return (self.folder / MODEL_FILE).is_file()

    @property
    def path(self) -> Path:
        """Folder of its networks."""
        return self.folder / NETWORKS if self.served else self.folder

    @property
    def artifact(self) -> Artifact:
        """Its networks as a step's input."""
        return Artifact(self.path, self.sha256)


class Registry:
    """The versions of one workspace."""

    def __init__(self, tracker: Tracker) -> None:
        self.tracker = tracker

    @property
    def client(self) -> Any:
        """MLflow's client, with the registered model made on first use."""
        from mlflow.exceptions import MlflowException

        client = self.tracker.client
        try:
            client.get_registered_model(NAME)
        except MlflowException as error:
            if error.error_code != "RESOURCE_DOES_NOT_EXIST":
                raise
            client.create_registered_model(NAME, description=_DESCRIPTION)
        return client

    def _aliases(self) -> Mapping[str, str]:
        """Alias -> version; none where nothing was registered yet. Writes nothing: the store may be read-only."""
        found = self.tracker.client.search_registered_models(f"name='{NAME}'")
        return dict(found[0].aliases) if found else {}

    def version(self, alias: str) -> Version | None:
        """The version of an alias; None where nothing carries it or where its files are gone or changed.

        Raises ``MlflowException`` where the registry cannot be read: that is no answer.
        """
        number = self.number(alias)
        return None if number is None else self._checked(self.client.get_model_version(NAME, str(number)))

    def number(self, alias: str) -> int | None:
        """Number of the version of an alias, whatever became of its files; None where nothing carries it."""
        found = self._aliases().get(alias)
        return None if found is None else int(found)

    def numbered(self, number: int) -> Version | None:
        """The version of a number; None where there is none or where its files are gone or changed."""
        found = [known for known in self.versions() if int(known.version) == number]
        return self._checked(found[0]) if found else None

    def versions(self, sha256: str | None = None) -> list[Any]:
        """MLflow's entries of all versions, or of those whose networks have that hash."""
        known = self.client.search_model_versions(f"name='{NAME}'")
        return [one for one in known if sha256 is None or one.tags.get(_HASH) == sha256]

    def refusal(self) -> tuple[int, str] | None:
        """Number of the version that was refused last, and why; None where none was."""
        number = self._aliases().get(CHALLENGER)
        if number is None:
            return None
        return int(number), self.client.get_model_version(NAME, str(number)).tags.get("reason", "for no stated reason")

    def register(
        self,
        networks: Artifact,
        model: Artifact,
        experiment_id: str,
        tags: Mapping[str, str],
        *,
        params: Mapping[str, Any] | None = None,
        metrics: Mapping[str, float | None] | None = None,
    ) -> Version:
        """The version of these networks, made if it is new; the files of the model that holds them are copied beside
        MLflow's other artifacts, anew where they were lost or damaged. ``params`` and ``metrics`` are shown by the run
        that MLflow names as the version's source.

        Raises ``StepFailed`` where what was copied isn't what was given: no version is made of it then.
        """
        held = self._held(networks.sha256)
        if held is not None:
            return held
        files = {f"{_FOLDER}/{path.relative_to(model.path).as_posix()}": path for path in _files(model.path)}
        record = Record(
            "networks", f"registry model {networks.sha256}", artifacts=files, tags=dict(tags),
            params=params or {}, metrics=metrics or {}, datasets={"models": networks.sha256},
            description="Files of a version.",
        )  # fmt: skip
        run_id = self.tracker.log(experiment_id, record)
        source = f"{self.client.get_run(run_id).info.artifact_uri}/{_FOLDER}"
        copied = self._folder(source) / NETWORKS
        if not copied.is_dir() or content_hash(copied) != networks.sha256:
            raise StepFailed(f"networks: {copied} doesn't agree with what was trained, {model.path}; look whether the "
                             "disk is full or something writes there, and run again")  # fmt: skip
        held = self._held(networks.sha256)  # its files are whole again
        if held is not None:
            return held
        made = self.client.create_model_version(NAME, source, run_id, tags={_HASH: networks.sha256, **tags})
        return Version(int(made.version), self._folder(source), networks.sha256)

    def _held(self, sha256: str) -> Version | None:
        """The version of networks of that hash, if it is whole and can be served."""
        for known in self.versions(sha256):
            version = self._checked(known)
            if version is not None and version.served:
                return version
        return None

    def record(self, version: Version, decision: Decision, tests: Sequence[Mapping[str, Any]] = ()) -> None:
        """Set aliases and tags, write the tests beside the model; nothing of an earlier decision stays. Before the
        alias moves, the champion becomes ``previous``."""
        number = str(version.number)
        tags = {"decision": "promoted" if decision.promoted else "refused", "reason": decision.reason}
        if decision.mean_ratio is not None:
            tags["mean_ratio"] = f"{decision.mean_ratio:.4f}"
        if tests:
            write_json(version.folder / _TESTS, list(tests))
            tags[_ACCEPTANCE] = "passed" if all(test["passed"] for test in tests) else "failed"
            tags |= {f"{_ACCEPTANCE}.{test['name']}": _told(test) for test in tests}
        else:
            (version.folder / _TESTS).unlink(missing_ok=True)
        present = self.client.get_model_version(NAME, number).tags
        known = {name for name in present if name == "mean_ratio" or name.partition(".")[0] == _ACCEPTANCE}
        self.tag(number, tags | dict.fromkeys(known - set(tags)))
        if not decision.promoted:
            self.client.set_registered_model_alias(NAME, CHALLENGER, number)
            return
        aliases = self.client.get_registered_model(NAME).aliases
        before = aliases.get(CHAMPION)
        if before is not None and str(before) != number:
            self.client.set_registered_model_alias(NAME, PREVIOUS, str(before))
            self.tag(str(before), {USE: superseded_by(number)})
        for same in self.versions(version.sha256):
            self.tag(str(same.version), {USE: None, OUT_REASON: None, OUT_DATE: None})
        self.put_in_use(number)

    def put_in_use(self, number: str) -> None:
        """Give a version the champion's alias, and say so in its tags."""
        if str(self.client.get_registered_model(NAME).aliases.get(CHALLENGER)) == number:
            self.client.delete_registered_model_alias(NAME, CHALLENGER)
        self.client.set_registered_model_alias(NAME, CHAMPION, number)
        self.tag(number, {USE: IN_USE, OUT_REASON: None, OUT_DATE: None})

    def tag(self, number: str, tags: Mapping[str, str | None]) -> None:
        """Set tags of a version; those without a value are deleted."""
        present = self.client.get_model_version(NAME, number).tags
        for key, value in tags.items():
            if value is not None:
                self.client.set_model_version_tag(NAME, number, key, value)
            elif key in present:
                self.client.delete_model_version_tag(NAME, number, key)

    def _checked(self, found: Any) -> Version | None:
        wanted = found.tags.get(_HASH)
        version = Version(int(found.version), self._folder(str(found.source)), str(wanted))
        return version if version.path.is_dir() and content_hash(version.path) == wanted else None

    def _folder(self, source: str) -> Path:
        return self.tracker.workspace.mlruns / "artifacts" / source.removeprefix(SCHEME).lstrip("/")


def superseded_by(number: int | str) -> str:
    """The tag `use` of a version in whose place a better one came."""
    return f"superseded by version {number}"


def _told(test: Mapping[str, Any]) -> str:
    """A physical test as a tag."""
    figure = "no number" if test["figure"] is None else f"{test['figure']:.4g}"
    return f"{'passed' if test['passed'] else 'failed'}: {figure}, limit {test['limit']:g}"


def _files(folder: Path) -> list[Path]:
    return [path for path in sorted(folder.rglob("*")) if path.is_file()]
