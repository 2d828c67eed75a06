"""Laboratory data -> empirical maps, actuator operators, multi-head bodies: ``models/``."""

from __future__ import annotations

import sys
from typing import Any

from prefect import flow
from prefect.task_runners import ThreadPoolTaskRunner

from tasks import pretrain as steps
from tasks import records
from tasks.launch import run_alone
from tasks.prefect_task import submit
from tasks.publish import publish, published
from tasks.run_context import WORKERS, current, seed_for
from tasks.settings import load_settings


@flow(name="pretrain", description=__doc__, task_runner=ThreadPoolTaskRunner(max_workers=WORKERS))
def pretrain(profile: str, settings: dict[str, Any] | None = None) -> str:
    """Train everything that is learned. Returns the folder's hash. ``settings``: as of ``simulate``."""
    root = current().workspace.root
    settings = settings or load_settings(profile)
    engine, driving, config = (settings[name] for name in ("engine", "driving", "pretrain"))
    lab = published(root / "data" / "lab", "simulate")
    field = published(root / "data" / "field", "simulate")
    sets = published(root / "data" / "sets", "simulate")

    def seed(name: str) -> int:
        return seed_for(settings["seed"], name)

    # The longest first: two at a time.
    pending = {
        "operators": submit(
            steps.operators,
            lab=lab, field=field, config=config["operators"], engine=engine, seed=seed("operators")
        )
    }
    labels = submit(steps.eta_tm_labels, sets=sets, driving=driving, engine=engine)
    for kind in steps.BODY_KINDS:
        pending[f"bodies_{kind}"] = submit(
            steps.bodies,
            lab=lab, kind=kind, config=config["bodies"], seed=seed(f"bodies {kind}")
        )
    fine = labels.result()
    for kind in steps.MAP_KINDS:
        pending[f"maps_{kind}"] = submit(
            steps.maps,
            lab=lab,
            fine=fine,
            field=field,
            kind=kind,
            config=config["maps"],
            engine=engine,
            label_noise_rel=settings["noise"]["label_rel"],
            seed=seed(f"maps {kind}"),
        )
    trained = {name: waiting.result() for name, waiting in pending.items()}
    models = publish(root / "models", steps.files_to_publish(trained))
    records.pretrained(trained, models, lab, settings)
    return models.sha256


if __name__ == "__main__":
    sys.exit(run_alone(pretrain))
