"""Noisy field recording -> health parameters, three ways, compared: ``results/``, and the report in ``reports/``."""

from __future__ import annotations

import sys
from typing import Any

from prefect import flow
from prefect.task_runners import ThreadPoolTaskRunner

from tasks import identify as methods
from tasks import records
from tasks import report as steps
from tasks.launch import run_alone
from tasks.prefect_task import submit
from tasks.publish import publish, publish_beside, published
from tasks.run_context import WORKERS, current, seed_for
from tasks.settings import about, load_settings, network_files, own_settings, runs_of

COMPARED = ("classical", "few-shot-newton", "few-shot-adam")
"""The methods of the report; the evaluation has all."""


def short(method: str) -> str:
    """The method's name in seeds and in the report's steps."""
    return method.removeprefix("few-shot-")


@flow(name="identify", description=__doc__, task_runner=ThreadPoolTaskRunner(max_workers=WORKERS))
def identify(profile: str, settings: dict[str, Any] | None = None) -> str:
    """Identify with every method, compare, report. Returns the hash of ``results/``.

    ``settings``: as of ``simulate``.
    """
    context = current()
    root = context.workspace.root
    settings = settings or load_settings(profile)
    field = published(root / "data" / "field", "simulate")
    sets = published(root / "data" / "sets", "simulate")
    models = published(root / "models", "pretrain")

    # One after the other: seconds per run are those of an idle machine.
    found = {
        name: submit(
            methods.STEPS[name],
            method=name,
            field=field,
            settings=own_settings(settings, name),
            runs=runs_of(settings, name),
            seed=seed_for(settings["seed"], short(name)),
            **network_files(name, models),
        ).result()
        for name in COMPARED
    }
    pending = submit(steps.driving_pictures, sets=sets, driving=settings["driving"], dpi=settings["report"]["dpi"])
    by_name = {short(name): artifact for name, artifact in found.items()}
    common = submit(
        steps.comparison,
        **by_name,
        field=field,
        errors=models / "errors",
        settings=own_settings(settings, "classical"),
        about=about(settings, field, ("seed", "engine", "noise", "identify")),
    ).result()
    page = submit(
        steps.report,
        **by_name, common=common, pictures=pending.result(), run_times=steps.run_times(found)
    ).result()
    parts = {name: artifact.path for name, artifact in found.items()}
    results = publish(root / "results", {"": common.path, **parts})
    publish_beside(context.workspace.reports, {"": page.path})
    records.identified(found, common, page, {"field recordings": field, "models": models}, settings)
    steps.show(page, context.workspace.reports)
    return results.sha256


if __name__ == "__main__":
    sys.exit(run_alone(identify))
