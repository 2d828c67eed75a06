"""Where a run keeps its files, and the settings of Prefect, MLflow and DVC that go with it.

Everything lies inside the project, git-ignored: ``.cache/`` (results by content), ``.prefect/`` (Prefect's home),
``mlruns/`` (MLflow), ``data/``, ``models/``, ``results/`` (DVC), ``reports/``. Paths that are stored are relative to
the project, so that a moved checkout goes on working.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from tasks import databases

PROJECT = Path(__file__).resolve().parents[1]

_ROOT_VARIABLE = "DIESELTWIN_WORKSPACE"


@dataclass(frozen=True)
class Workspace:
    """The folders of one project checkout (or of a test's temporary one)."""

    root: Path

    @classmethod
    def current(cls) -> Workspace:
        """The checkout, or the folder that the environment names (tests)."""
        return cls(Path(os.environ.get(_ROOT_VARIABLE, PROJECT)).resolve())

    @property
    def cache(self) -> Path:
        """Results by content hash."""
        return self.root / ".cache"

    @property
    def prefect_home(self) -> Path:
        """Prefect's database, profiles and result records."""
        return self.root / ".prefect"

    @property
    def mlruns(self) -> Path:
        """MLflow's database and artifacts."""
        return self.root / "mlruns"

    @property
    def mlflow_uri(self) -> str:
        """Address of MLflow's database (:mod:`tasks.databases`)."""
        return databases.address(databases.MLFLOW) or f"sqlite:///{self.mlruns / 'mlflow.db'}"

    @property
    def reports(self) -> Path:
        """HTML reports and run times: not compared, not versioned."""
        return self.root / "reports"

    @property
    def params(self) -> Path:
        """params.yaml of this workspace."""
        return self.root / "params.yaml"

    def relative(self, path: Path) -> str:
        """``path`` relative to the root where it lies below it."""
        path = path.resolve()
        return str(path.relative_to(self.root)) if path.is_relative_to(self.root) else str(path)


def quiet_settings(workspace: Workspace) -> dict[str, str]:
    """Environment of Prefect and MLflow: files inside the project, no analytics, no chatter."""
    home = workspace.prefect_home
    rows = databases.address(databases.PREFECT)
    return {
        **({"PREFECT_SERVER_DATABASE_CONNECTION_URL": rows} if rows else {}),
        "PREFECT_HOME": str(home),
        "PREFECT_LOCAL_STORAGE_PATH": str(home / "storage"),
        "PREFECT_SERVER_EPHEMERAL_ENABLED": "true",
        "PREFECT_SERVER_EPHEMERAL_STARTUP_TIMEOUT_SECONDS": "180",
        "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
        "PREFECT_LOGGING_LEVEL": "CRITICAL",
        "PREFECT_LOGGING_SERVER_LEVEL": "CRITICAL",
        "PREFECT_LOGGING_TO_API_ENABLED": "false",
        "PREFECT_CLI_WRAP_LINES": "false",
        "DO_NOT_TRACK": "true",
        "MLFLOW_DISABLE_TELEMETRY": "true",
        "MLFLOW_LOGGING_LEVEL": "CRITICAL",
        "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false",
        "MLFLOW_TRACKING_URI": workspace.mlflow_uri,
        "DVC_NO_ANALYTICS": "true",
        "DASK_LOGGING__DISTRIBUTED": "critical",
    }


def prepare_environment() -> Workspace:
    """Set what isn't set yet. Call before ``prefect`` or ``mlflow`` is imported: both read the environment then."""
    workspace = Workspace.current()
    for name, value in quiet_settings(workspace).items():
        os.environ.setdefault(name, value)
    return workspace
