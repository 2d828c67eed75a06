"""Trained networks -> a version of MLflow's registry; the champion's alias if they pass the physical tests and are not
worse than the champion."""

from __future__ import annotations

import sys
from typing import Any

from prefect import flow

from tasks import promote as steps
from tasks.cluster import task_runner
from tasks.launch import run_alone
from tasks.model_folder import CODE
from tasks.prefect_task import submit
from tasks.publish import published
from tasks.registry import Candidate
from tasks.run_context import current
from tasks.settings import load_settings, own_settings
from tasks.store import Artifact


@flow(name="promote", description=__doc__, task_runner=task_runner())
def promote(
    profile: str,
    settings: dict[str, Any] | None = None,
    *,
    again: bool = False,
    back: bool = False,
    to: int | None = None,
    reason: str | None = None,
) -> bool:
    """Test ``models/`` and compare them with the champion on driving that neither was trained on; with ``back`` or
    ``to`` put an earlier version in use instead. Returns whether the version is in use.

    ``settings``: as of ``simulate``; ``again``: networks that were taken out of use may come back.
    """
    settings = settings or load_settings(profile)
    if back or to is not None:
        return steps.roll_back(to, str(reason), settings)
    models = published(current().workspace.root / "models", "pretrain")
    recording = submit(
        steps.validation_driving,
        driving=settings["driving"],
        engine=settings["engine"],
        seed=settings["promotion"]["seed"],
        minutes=settings["promotion"]["minutes"],
    ).result()
    validated = submit(steps.validate, recording=recording, networks=models)
    tested = submit(
        steps.acceptance,
        recording=recording,
        networks=models,
        limits=settings["promotion"]["acceptance"],
        identify=own_settings(settings, steps.KNOWN_ENGINE.name)["identify"],
    )
    packed = submit(steps.served_model, recording=recording, networks=models, code=Artifact.of(CODE))
    champion = steps.champion()
    before = None
    if champion is not None:
        pending = submit(steps.validate, recording=recording, networks=champion.artifact)
        before = steps.figures_unless_unreadable(pending)
    candidate = Candidate(models, packed.result() / steps.MODEL, steps.figures_of(validated), steps.tests_of(tested))
    return steps.promote(candidate, before, settings, again=again).promoted


if __name__ == "__main__":
    sys.exit(run_alone(promote, options=steps.options, check=steps.check))
