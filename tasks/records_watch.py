"""What MLflow is told of the histories of engines: one run a batch (see :mod:`tasks.records`)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tasks.failures import StepFailed
from tasks.records import identity, log
from tasks.run_context import seconds_of
from tasks.store import Artifact
from tasks.tracking import Record, flat
from tasks.watch import Batch


def watched(
    batch: Batch, found: Mapping[str, Artifact], refused: Mapping[str, StepFailed], settings: Mapping[str, Any]
) -> None:
    """Log a batch: what the history says after it, its page, the recordings that were added."""
    added = {name: found[name] for name in batch.added}
    hashes = sorted(artifact.sha256 for artifact in added.values())
    record = Record(
        f"{batch.history}: {len(added)} recordings",
        identity("watch", batch.history, *hashes),
        params={"history": batch.history} | flat(settings["watch"]),
        metrics={**batch.figures, "added": float(len(added)), "refused": float(len(refused))},
        artifacts={} if batch.page is None else {batch.page.name: batch.page},
        tags={"profile": settings["profile"]},
        description=batch.sentence,
        seconds=sum(seconds_of(artifact) for artifact in added.values()),
        datasets={name: artifact.sha256 for name, artifact in added.items()},
    )
    log("watch", record)
