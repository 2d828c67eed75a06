"""What MLflow is told of decisions about versions: every one is a run, whatever was decided before (see
:mod:`tasks.records`)."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from tasks.records import identity, log
from tasks.registry import Candidate, Decision, Version
from tasks.tracking import Record, flat


def promoted(
    version: Version,
    candidate: Candidate,
    before: Mapping[str, float] | None,
    decision: Decision,
    settings: Mapping[str, Any],
) -> None:
    """Log a comparison of new networks with those in use."""
    ratios: dict[str, float | None] = {"mean_ratio": decision.mean_ratio, "version": float(version.number)}
    if decision.worst is not None:
        ratios["worst_ratio"] = decision.worst[1]
    metrics: dict[str, float | None] = {f"new_error_pct/{name}": value for name, value in candidate.figures.items()}
    metrics |= {f"acceptance/{test['name']}": test["figure"] for test in candidate.tests}
    metrics |= {f"champion_error_pct/{name}": value for name, value in (before or {}).items()}
    log(
        "promote",
        Record(
            f"version {version.number}",
            _now(),
            params={"decision": "promoted" if decision.promoted else "refused", "reason": decision.reason}
            | flat(settings["promotion"]),
            metrics={name: value if value is None else round(value, 5) for name, value in (metrics | ratios).items()},
            tags={"profile": settings["profile"]},
            datasets={"models": version.sha256},
        ),
    )


def rolled_back(back: Version, out: int | None, reason: str, settings: Mapping[str, Any]) -> None:
    """Log that an earlier version is in use again, in place of the version ``out``."""
    record = Record(
        f"back to version {back.number}",
        _now(),
        params={"decision": "rolled back", "reason": reason, "taken_out": "none" if out is None else f"version {out}"},
        metrics={"version": float(back.number)},
        tags={"profile": settings["profile"]},
        datasets={"models": back.sha256},
    )
    log("promote", record)


def _now() -> str:
    """The identity of a decision is when it was made: the same one made again is another."""
    return identity("promote", datetime.now(UTC).isoformat())
