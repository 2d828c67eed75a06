"""Trained networks -> a version of MLflow's registry; the champion's alias if they are not worse than the champion."""

from __future__ import annotations

import sys

from prefect import flow

from tasks import promote as steps
from tasks.cluster import task_runner
from tasks.launch import run_alone
from tasks.publish import published
from tasks.run_context import current
from tasks.settings import load_settings


@flow(name="promote", description=__doc__, task_runner=task_runner())
def promote(profile: str) -> bool:
    """Compare ``models/`` with the champion on driving that neither was trained on. Returns whether it is in use."""
    settings = load_settings(profile)
    models = published(current().workspace.root / "models", "pretrain")
    recording = steps.validation_driving.submit(
        driving=settings["driving"],
        engine=settings["engine"],
        seed=settings["promotion"]["seed"],
        minutes=settings["promotion"]["minutes"],
    ).result()
    figures = steps.figures_of(steps.validate.submit(recording=recording, networks=models))
    champion = steps.champion()
    before = None
    if champion is not None:
        pending = steps.validate.submit(recording=recording, networks=champion.artifact)
        before = steps.figures_unless_unreadable(pending)
    return steps.promote(models, figures, before, settings).promoted


if __name__ == "__main__":
    sys.exit(run_alone(promote))
