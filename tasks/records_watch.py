"""What MLflow is told of the histories of engines: one run a batch (see :mod:`tasks.records`)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tasks.failures import StepFailed
from tasks.records import identity, log, tracked
from tasks.run_context import seconds_of
from tasks.store import Artifact
from tasks.tracking import Record, digest_of, flat
from tasks.watch import Batch

_HISTORY = "dieseltwin.history"


def watched(
    batch: Batch, found: Mapping[str, Artifact], refused: Mapping[str, StepFailed], settings: Mapping[str, Any]
) -> None:
    """Log what a history says, its page, and the recordings of it that no earlier run shows.

    Those of this batch are; and those of one that was killed, or had no database, after they were in the history.
    """
    tag = identity(batch.history)
    shown = tracked("watch", _HISTORY, tag)
    new = {sha256: name for sha256, name in batch.recordings.items() if digest_of(sha256) not in shown}
    if not new:
        return
    named: dict[str, str] = {}
    for sha256, name in new.items():
        named[name if name not in named else f"{name} {digest_of(sha256)}"] = sha256
    record = Record(
        f"{batch.history}: {len(new)} recordings",
        identity("watch", batch.history, *sorted(batch.recordings)),
        params={"history": batch.history} | flat(settings["watch"]),
        metrics={**batch.figures, "added": float(len(new)), "refused": float(len(refused))},
        artifacts={} if batch.page is None else {batch.page.name: batch.page},
        tags={"profile": settings["profile"], _HISTORY: tag},
        description=batch.sentence,
        seconds=sum(seconds_of(found[name]) for name in batch.added),
        datasets=named,
    )
    log("watch", settings, record)
