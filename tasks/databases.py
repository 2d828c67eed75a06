"""Where MLflow and Prefect keep their rows, by one setting each: the environment's ``DIESELTWIN_MLFLOW`` and
``DIESELTWIN_PREFECT``.

  * not set or empty: a sqlite file of the workspace, ``mlruns/mlflow.db`` and ``.prefect/prefect.db``,
  * ``postgresql://USER:PASSWORD@HOST:PORT/DATABASE``: that database, which must exist; tables are made at first use.

Files (results, figures, networks) lie in the workspace either way.
"""

from __future__ import annotations

import errno
import fcntl
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from tasks.failures import StepFailed

MLFLOW, PREFECT = "DIESELTWIN_MLFLOW", "DIESELTWIN_PREFECT"

API = "PREFECT_API_URL"  # Prefect's own: a server that runs already
_TRACKING = "MLFLOW_TRACKING_URI"  # MLflow's own

_DRIVERS = {MLFLOW: "psycopg", PREFECT: "asyncpg"}
_SCHEME = "postgresql://"
_ADDRESS = re.compile(r"postgresql://[^/@\s]*(:[^/@\s]*)?@?[^/@\s]+/[^/\s]+")
_PASSWORD = re.compile(r"(//[^:]*:).*(?=@)", re.DOTALL)  # up to the last @: it may hold any of / : @
_CONNECT_S = 5
_THEIRS = {"mlflow", "sqlalchemy", "alembic", "sqlite3", "psycopg", "prefect", "httpx"}  # packages of errors
_OF_THE_DISK = {
    errno.ENOSPC: "free some space", errno.EDQUOT: "free some space", errno.EROFS: "make it writable",
    errno.EACCES: "make it writable", errno.EPERM: "make it writable", errno.EIO: "look after the disk",
}  # fmt: skip
_FULL, _READ_ONLY = "disk is full", "readonly database"  # SQLite's words
_LOCK = 20250  # of PostgreSQL's advisory locks: any number that is ours


def address(variable: str) -> str | None:
    """The setting with its driver, as SQLAlchemy reads it; None where it isn't set."""
    given = os.environ.get(variable, "")
    return given.replace(_SCHEME, f"postgresql+{_DRIVERS[variable]}://", 1) if given else None


def shown(uri: str) -> str:
    """An address without its password."""
    return _PASSWORD.sub(r"\1...", uri)


def check_settings() -> None:
    """Raise ``StepFailed`` (exit status 2) for an address of another kind, or one where no database answers."""
    for variable in _DRIVERS:
        given = os.environ.get(variable, "")
        if not given:
            continue
        if not _ADDRESS.fullmatch(given):
            raise StepFailed(f"{variable}: got {shown(given)[:80]!r}; allowed: nothing, or postgresql://USER:PASSWORD@"
                             "HOST:PORT/DATABASE; change it", exit_code=2)  # fmt: skip
        try:
            import psycopg
        except ImportError:
            raise StepFailed(f"{variable}: got {shown(given)}, but no driver; allowed: with psycopg; "
                             "pip install 'dieseltwin[postgresql]'", exit_code=2) from None  # fmt: skip
        try:
            psycopg.connect(given, connect_timeout=_CONNECT_S).close()
        except psycopg.Error as error:
            said = " ".join(str(error).split())[:150]
            raise StepFailed(f"{variable}: got no answer of {shown(given)}: {said}; allowed: a database that exists; "
                             "start the server or unset the variable", exit_code=2) from error  # fmt: skip


def unused_setting(mlflow_uri: str) -> str | None:
    """One line where MLflow's own variable names another store than the one in use, None where not.

    It may stand in a user's environment for other work, and it would tear runs and files of a workspace apart.
    """
    given = os.environ.get(_TRACKING, "")
    if given in ("", mlflow_uri):
        return None
    return (f"{_TRACKING}={shown(given)} isn't used: runs go with their files in mlruns/, rows to {shown(mlflow_uri)}; "
            f"{MLFLOW} names a PostgreSQL server for the rows")  # fmt: skip


def failure(error: BaseException, mlflow_uri: str) -> str | None:
    """One line for an error of MLflow's or Prefect's database or of the server before it, of the disk or of the memory;
    None for any other.

    What was computed lies in the cache and in the published folders by then, so the next run goes on from there.
    """
    if isinstance(error, RuntimeError) and "Failed to reach API" in str(error):  # Prefect's, of a builtin class
        given = os.environ.get(API)
        if given:
            return (f"{API}: got no answer of {shown(given)}; what was computed is kept: start that server or unset "
                    "the variable, and run again")  # fmt: skip
        return ("Prefect's server doesn't answer (.prefect/server.log): is memory short, or the machine very busy? "
                "What was computed is kept, run again")  # fmt: skip
    if isinstance(error, MemoryError):
        return "out of memory; what was computed is kept: run again where there is more"
    if isinstance(error, OSError) and error.errno in _OF_THE_DISK:
        place = "the disk" if error.filename is None else str(error.filename)
        return f"{place}: {error.strerror}; what was computed is kept: {_OF_THE_DISK[error.errno]}, and run again"
    if not {base.__module__.partition(".")[0] for base in type(error).__mro__} & _THEIRS:
        return None
    whose = f"MLflow's database {shown(mlflow_uri)}" if _is_mlflows(error) else "Prefect's server (.prefect/server.log)"
    said = " ".join(str(error).partition("[SQL")[0].split())[:150] or type(error).__name__
    advice = "free the database, or move it away to start a new one"
    if _FULL in said or _READ_ONLY in said:
        advice = _OF_THE_DISK[errno.ENOSPC if _FULL in said else errno.EROFS]
    return f"{whose}: {said}; what was computed is kept: {advice}, and run again"


def _is_mlflows(error: BaseException) -> bool:
    """Prefect reaches its database through a server alone, so a database's own error is MLflow's."""
    return {base.__module__.partition(".")[0] for base in type(error).__mro__}.isdisjoint({"prefect", "httpx"})


@contextmanager
def one_at_a_time(variable: str, file: Path) -> Iterator[None]:
    """Two writers at once would both make the tables: a lock of the server's where a setting names one, which holds
    across machines, else of a file. Either goes with the process. Who may not write there can read without one."""
    given = os.environ.get(variable, "")
    if given:
        import psycopg

        with psycopg.connect(given) as connection:
            connection.execute("SELECT pg_advisory_lock(%s)", [_LOCK])
            yield
        return
    file.parent.mkdir(parents=True, exist_ok=True)
    opened = _opened(file)
    if opened is None:
        yield
        return
    with opened:
        fcntl.flock(opened, fcntl.LOCK_EX)
        try:
            yield
        finally:
            fcntl.flock(opened, fcntl.LOCK_UN)


def _opened(file: Path) -> TextIO | None:
    try:
        return file.open("a", encoding="utf-8")
    except OSError as error:
        if error.errno not in (errno.EROFS, errno.EACCES):
            raise
        return None
