"""MLflow: ``mlruns/mlflow.db`` (sqlite, or a PostgreSQL server: :mod:`tasks.databases`) and ``mlruns/artifacts/``.

Logging is apart from computing. A run is logged from the files of a result, and is known by the hash of what it shows:
logging the same result again changes nothing, a run that was cut off is dropped and logged anew. So cached results
appear, Ctrl-C leaves no half a run, and a second ``make run`` adds no doubles.

Artifacts are written to where ``mlflow server --artifacts-destination mlruns/artifacts`` reads them, under addresses
``mlflow-artifacts:/...``: no absolute path is stored, so a moved checkout keeps its figures.
"""

from __future__ import annotations

import filecmp
import json
import logging
import math
import os
import shutil
import subprocess
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from tasks import databases
from tasks.workspace import PROJECT, Workspace

SCHEME = "mlflow-artifacts:/"
_IDENTITY = "dieseltwin.result"
COMMIT, DIRTY = "mlflow.source.git.commit", "git.dirty"

# MLflow's "share view": columns and order of a table, stored with the experiment under a key that the address names.
_VIEW_TAG = "mlflow.sharedViewState."
_VIEW = "columns"

# MLflow's limits of one log_batch call.
_METRICS_A_BATCH = 1000
_PARAMS_A_BATCH = 100

# Points of a curve that are kept: a plot shows no more, and every point costs 0.15 ms.
_CURVE_POINTS = 400


@dataclass(frozen=True)
class Curve:
    """A metric over steps: ``steps`` (n,) whole numbers, ``values`` (n,)."""

    name: str
    steps: Sequence[int]
    values: Sequence[float]


@dataclass(frozen=True)
class Record:
    """What one MLflow run shows. ``identity`` is the hash of the result; ``children`` become nested runs.

    ``datasets``: name -> sha256 of what the result was made from.
    """

    name: str
    identity: str
    params: Mapping[str, Any] = field(default_factory=dict)
    metrics: Mapping[str, float | None] = field(default_factory=dict)
    curves: Sequence[Curve] = ()
    artifacts: Mapping[str, Path] = field(default_factory=dict)
    tags: Mapping[str, str] = field(default_factory=dict)
    description: str = ""
    seconds: float = 0.0
    children: Sequence[Record] = ()
    datasets: Mapping[str, str] = field(default_factory=dict)


@dataclass
class Tracker:
    """The MLflow store of one workspace."""

    workspace: Workspace

    @property
    def uri(self) -> str:
        """Address of the database, relative paths resolved."""
        return self.workspace.mlflow_uri

    @cached_property
    def client(self) -> Any:
        """MLflow's client; the first use makes the database (some seconds)."""
        for name in ("mlflow", "alembic"):
            logging.getLogger(name).setLevel(logging.CRITICAL)  # what fails is told in one line, by `tasks.launch`
        self.workspace.mlruns.mkdir(parents=True, exist_ok=True)
        os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
        with self._alone():
            from mlflow import MlflowClient

            database = self.workspace.mlruns / "mlflow.db"
            if self.uri.startswith("sqlite") and not database.exists():
                _make_database(database)
            client = MlflowClient(tracking_uri=self.uri)
            empty = client.get_experiment("0")
            if empty.lifecycle_stage == "active":
                client.delete_experiment("0")  # "Default", which nobody logs to
        return client

    def _alone(self) -> AbstractContextManager[None]:
        return databases.one_at_a_time(databases.MLFLOW, self.workspace.mlruns / ".lock")

    def experiment(self, name: str, description: str, tags: Mapping[str, str] | None = None) -> str:
        """Find or make an experiment; returns its id."""
        client = self.client
        with self._alone():
            found = client.get_experiment_by_name(name)
            folder = name.replace(" ", "-")
            experiment_id = found.experiment_id if found else client.create_experiment(name, SCHEME + folder)
            wanted = {
                "mlflow.note.content": description,
                # without it MLflow shows its pages for chat programs first
                "mlflow.experimentKind": "custom_model_development",
                **(tags or {}),
            }
            present = found.tags if found else {}
            for key, value in wanted.items():
                if present.get(key) != value:
                    client.set_experiment_tag(experiment_id, key, value)
        return str(experiment_id)

    def page(self, name: str) -> str:
        """Address (path) of the page of an experiment, with its columns chosen where it has a view."""
        found = self.client.get_experiment_by_name(name)
        if found is None:
            return "/"
        view = f"?viewStateShareKey={_VIEW}" if f"{_VIEW_TAG}{_VIEW}" in found.tags else ""
        return f"/#/experiments/{found.experiment_id}/runs{view}"

    def log(self, experiment_id: str, record: Record) -> str:
        """Log a record and its children; returns the run id. An equal record that is complete is left as it is, but for
        files of it that were lost or damaged."""
        _ = self.client  # whose first use takes the lock itself
        # SQLite takes one writer at a time: of thirty at once it refuses some after five seconds.
        with self._alone() if self.uri.startswith("sqlite") else nullcontext():
            known = self._known(experiment_id, record.identity)
            if known is None:
                return self._logged(experiment_id, record)
            self._copy(self.client.get_run(known).info.artifact_uri, record.artifacts)
            return known

    def datasets(self, experiment_id: str, tag: str, value: str) -> frozenset[str]:
        """Digests (`digest_of`) of what the finished runs with that tag were made from."""
        asked = f"tags.`{tag}` = '{value}' and attributes.status = 'FINISHED'"
        digests: set[str] = set()
        token: str | None = None
        while True:
            page = self.client.search_runs([experiment_id], asked, page_token=token)
            digests |= {given.dataset.digest for run in page for given in run.inputs.dataset_inputs}
            token = page.token
            if not token:
                return frozenset(digests)

    def last_with(self, experiment_id: str, tag: str, value: str) -> Any | None:
        """MLflow's entry of the last finished run with that tag; None where there is none."""
        asked = f"tags.`{tag}` = '{value}' and attributes.status = 'FINISHED'"
        found = self.client.search_runs([experiment_id], asked, max_results=1, order_by=["attributes.start_time DESC"])
        return found[0] if found else None

    def _logged(self, experiment_id: str, record: Record, parent: str | None = None) -> str:
        ended = int(time.time() * 1000)
        tags = {"mlflow.runName": record.name, "mlflow.user": "dieseltwin", _IDENTITY: record.identity, **record.tags}
        if parent is not None:
            tags["mlflow.parentRunId"] = parent
        else:
            tags |= commit()
        if record.description:
            tags["mlflow.note.content"] = record.description
        run = self.client.create_run(
            experiment_id, start_time=ended - int(record.seconds * 1000), tags=tags, run_name=record.name
        )
        run_id = str(run.info.run_id)
        self._log_values(run_id, record, ended)
        self._copy(run.info.artifact_uri, record.artifacts)
        for child in record.children:
            self._logged(experiment_id, child, parent=run_id)
        self.client.set_terminated(run_id, "FINISHED", end_time=ended)
        return run_id

    def _known(self, experiment_id: str, identity: str) -> str | None:
        """The finished run of that identity; unfinished ones (a kill) are deleted with their children."""
        runs = self.client.search_runs([experiment_id], f"tags.`{_IDENTITY}` = '{identity}'")
        known = None
        for run in runs:
            if "mlflow.parentRunId" in run.data.tags:
                continue
            if run.info.status == "FINISHED":
                known = str(run.info.run_id)
                continue
            children = self.client.search_runs(
                [experiment_id], f"tags.`mlflow.parentRunId` = '{run.info.run_id}'", max_results=5000
            )
            for dead in (*children, run):
                self.client.delete_run(dead.info.run_id)
        return known

    def _log_values(self, run_id: str, record: Record, now: int) -> None:
        from mlflow.entities import Metric, Param

        metrics = [
            Metric(name, float(value), now, 0)
            for name, value in record.metrics.items()
            if value is not None and math.isfinite(value)
        ]
        for curve in record.curves:
            stride = max(1, math.ceil(len(curve.steps) / _CURVE_POINTS))
            picked = sorted({*range(0, len(curve.steps), stride), len(curve.steps) - 1} - {-1})
            metrics += [
                Metric(curve.name, float(curve.values[i]), now, int(curve.steps[i]))
                for i in picked
                if math.isfinite(curve.values[i])
            ]
        params = [Param(name, _text(value)) for name, value in record.params.items()]
        for start in range(0, len(params), _PARAMS_A_BATCH):
            self.client.log_batch(run_id, params=params[start : start + _PARAMS_A_BATCH])
        for start in range(0, len(metrics), _METRICS_A_BATCH):
            self.client.log_batch(run_id, metrics=metrics[start : start + _METRICS_A_BATCH])
        if record.datasets:
            self.client.log_inputs(run_id, datasets=[_dataset(*item) for item in record.datasets.items()])

    def _copy(self, uri: str, artifacts: Mapping[str, Path]) -> None:
        folder = self.workspace.mlruns / "artifacts" / uri.removeprefix(SCHEME).lstrip("/")
        for name, source in artifacts.items():
            target = folder / name
            if target.is_file() and filecmp.cmp(source, target, shallow=False):
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            partial = target.with_name(f"{target.name}.{os.getpid()}.partial")
            shutil.copyfile(source, partial)
            partial.replace(target)


@lru_cache(maxsize=1)
def commit() -> Mapping[str, str]:
    """MLflow's tag for the commit that is checked out, and whether files of it were changed since; none where there is
    no git, or nothing was committed. ``dvc.lock`` doesn't count: DVC writes it while it runs the stages."""
    tags: dict[str, str] = {}
    with suppress(OSError, subprocess.CalledProcessError):
        tags[COMMIT] = _git("rev-parse", "HEAD")
        changed = _git("status", "--porcelain", "--untracked-files=no", "--", ".", ":(exclude)dvc.lock")
        tags[DIRTY] = str(bool(changed)).lower()
    return tags


def _git(*arguments: str) -> str:
    # it may not write the index, which another git in the checkout may hold
    command = ("git", "--no-optional-locks", "-C", str(PROJECT), *arguments)
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def _make_database(path: Path) -> None:
    """Make the tables under another name: killed while it does, MLflow leaves a database that it can't use later."""
    from mlflow.store.tracking.sqlalchemy_store import SqlAlchemyStore

    for stale in path.parent.glob(f"{path.name}.*.partial"):
        stale.unlink()
    partial = path.with_name(f"{path.name}.{os.getpid()}.partial")
    store = SqlAlchemyStore(f"sqlite:///{partial}", f"{SCHEME}default")
    store.engine.dispose()
    partial.rename(path)


def view(metrics: Sequence[str], params: Sequence[str] = (), filtered: str = "") -> dict[str, str]:
    """Tags of an experiment whose page shows these columns of filtered runs (see :meth:`Tracker.page`)."""
    columns = [f"metrics.`{name}`" for name in metrics] + [f"params.`{name}`" for name in params]
    state = {
        "searchFilter": filtered,
        "orderByKey": "attributes.start_time",
        "orderByAsc": False,
        "startTime": "ALL",
        "lifecycleFilter": "Active",
        "datasetsFilter": [],
        "modelVersionFilter": "All Runs",
        "selectedColumns": columns,
        "columnOrder": [],
        "columnWidths": {},
        "runsExpanded": {},
        "runsPinned": [],
        "runsHidden": [],
        "runsVisibilityMap": {},
        "runsHiddenMode": "SHOW_ALL",
        "viewMaximized": False,
        "runListHidden": False,
        "isAccordionReordered": False,
        "groupBy": None,
        "groupsExpanded": {},
        "autoRefreshEnabled": True,
        "useGroupedValuesInCharts": True,
        "hideEmptyCharts": True,
    }
    return {f"{_VIEW_TAG}{_VIEW}": json.dumps(state)}


def flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested settings as dotted names, as MLflow shows parameters."""
    result: dict[str, Any] = {}
    for name, value in settings.items():
        if isinstance(value, Mapping):
            result |= flat(value, f"{prefix}{name}.")
        else:
            result[f"{prefix}{name}"] = value
    return result


def digest_of(sha256: str) -> str:
    """What MLflow keeps of a hash: its digests are at most 36 characters."""
    return sha256[:12]


def _dataset(name: str, sha256: str) -> Any:
    from mlflow.entities import Dataset, DatasetInput

    source = json.dumps({"path": name, "sha256": sha256})
    return DatasetInput(Dataset(name=name, digest=digest_of(sha256), source_type="local", source=source), tags=[])


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)

