"""Where a flow's steps run, by one setting: the environment's ``DIESELTWIN_CLUSTER``.

  * not set or empty: two at a time on this machine (Prefect's threads; each step is a process of its own anyway),
  * ``local`` or ``local:4``: a Dask cluster of two (four) workers on this machine, started and ended with the flow,
  * ``tcp://HOST:8786``: the Dask cluster whose scheduler listens there. Its workers need this checkout and its
    ``.cache`` under one path (a shared file system), and ``PREFECT_API_URL`` set to a server that they reach.

The numbers are the same in all three: a step's result is known by its content hash, wherever it was computed. A Dask
worker that dies takes its step along (the step's process ends with it); the step runs again on another one.
"""

from __future__ import annotations

import logging
import os
import re
from typing import Any

from tasks.run_context import QUIET_VARIABLE, WORKERS, StepFailed

VARIABLE = "DIESELTWIN_CLUSTER"

_LOCAL = re.compile(r"local(?::([1-9][0-9]*))?")
_ADDRESS = re.compile(r"(tcp|tls|ucx|ws|wss)://\S+:\d+")
_LOCAL_WORKERS = 2


def check_setting(where: str | None = None) -> None:
    """Raise ``StepFailed`` (exit status 2) for a value that is none of the three."""
    where = os.environ.get(VARIABLE, "") if where is None else where
    if where and not _LOCAL.fullmatch(where) and not _ADDRESS.fullmatch(where):
        raise StepFailed(
            f"{VARIABLE}: got {where!r}; allowed: nothing, local, local:4, tcp://HOST:PORT; change it", exit_code=2
        )


def task_runner(where: str | None = None) -> Any:
    """Prefect's task runner for the setting (``where``: another value than the environment's).

    Flows ask for it when they are imported; a value that :func:`check_setting` refuses gives threads, so that the
    refusal is one line of the command and no traceback of an import.
    """
    where = os.environ.get(VARIABLE, "") if where is None else where
    local = _LOCAL.fullmatch(where)
    if local is None and not _ADDRESS.fullmatch(where):
        from prefect.task_runners import ThreadPoolTaskRunner

        return ThreadPoolTaskRunner(max_workers=WORKERS)
    from prefect_dask import DaskTaskRunner

    if local is None:
        return DaskTaskRunner(address=where)
    return DaskTaskRunner(
        cluster_kwargs={
            "n_workers": int(local.group(1) or _LOCAL_WORKERS),
            "threads_per_worker": 1,  # a step uses one core
            "memory_limit": 0,  # a worker holds paths and hashes; what computes is a process below it
            "dashboard_address": None,
            # below Prefect's home, or Dask leaves its folder where the flow was started
            "local_directory": os.environ.get("PREFECT_HOME"),
            "env": {QUIET_VARIABLE: "1"},
            "silence_logs": logging.CRITICAL,
        }
    )
