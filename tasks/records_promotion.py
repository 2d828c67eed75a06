"""What MLflow is told of decisions about versions: every one is a run, whatever was decided before (see
:mod:`tasks.records`)."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from tasks.records import identity, last_with, log, settings_hash
from tasks.registry import Candidate, Decision, Version
from tasks.store import Artifact
from tasks.tracking import COMMIT, DIRTY, Record, commit, digest_of, flat


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
    metrics = measured(candidate)
    metrics |= {f"champion_error_pct/{name}": value for name, value in (before or {}).items()}
    log(
        "promote",
        settings,
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


def measured(candidate: Candidate) -> dict[str, float | None]:
    """What is known of new networks as metrics: errors on the validation driving, figures of the physical tests."""
    metrics: dict[str, float | None] = {f"new_error_pct/{name}": value for name, value in candidate.figures.items()}
    return metrics | {f"acceptance/{test['name']}": test["figure"] for test in candidate.tests}


def training_of(networks: Artifact, settings: Mapping[str, Any]) -> tuple[dict[str, str], dict[str, str]]:
    """Tags and parameters that tell how networks were trained: those of the run ``models`` that made them; where it is
    unknown to this database, the commit and the settings of today."""
    run = last_with("pretrain", "models", digest_of(networks.sha256))
    if run is None:
        return {**commit(), **settings_hash("pretrain", settings)}, {}
    params = dict(run.data.params)
    known = {name: run.data.tags[name] for name in (COMMIT, DIRTY) if name in run.data.tags}
    hashed = {name: params[name] for name in ("params_sha256",) if name in params}
    return {**known, **hashed, "trained_in": run.info.run_id}, params


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
    log("promote", settings, record)


def _now() -> str:
    """The identity of a decision is when it was made: the same one made again is another."""
    return identity("promote", datetime.now(UTC).isoformat())
