"""What MLflow is told of the evaluation: one run a method and case, its members nested, and tables with the page."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from tasks.evaluation_plan import Plan
from tasks.records import HEALTH, curves_of, identity, settings_hash
from tasks.run_context import current
from tasks.store import RUNTIME, Artifact
from tasks.tracking import Curve, Record, Tracker, view

NAME = "evaluate"
NOTE = (
    "The paper's tables. A run is an ensemble of one method on one case (clean-151, clean-301, noisy-301) or a variant;"
    " `…_rmse_pct` is the median RMSE over the minutes that can be known, in per cent of the truth, `seconds_per_run`"
    " wall seconds, `training/…` curves along the epochs (health parameters in SI units). Clear the filter to see the"
    " nested runs, the members. `tables` holds every table, `…/better_pct` the share of the paper's cells where we are"
    " as close."
)
_WHOLE = "ensemble"
VIEW = view(
    [*(f"{name}_rmse_pct" for name in HEALTH), "seconds_per_run", "diverged", "converged_share"],
    ["method", "case", "variant", "members", "epochs"],
    f"tags.level = '{_WHOLE}'",  # without the members, which fill a page of their own
)


def evaluated(
    plans: Sequence[Plan],
    found: Mapping[str, Artifact],
    common: Artifact,
    page: Artifact,
    inputs: Mapping[str, Artifact],
    settings: Mapping[str, Any],
) -> None:
    """Log each ensemble with its members, and the tables with the page."""
    tracker = Tracker(current().workspace)
    experiment = tracker.experiment(NAME, NOTE, VIEW)
    datasets = {name: artifact.sha256 for name, artifact in inputs.items()}
    tags = {"profile": settings["profile"], "level": _WHOLE}
    hashed = settings_hash(NAME, settings)
    for plan, artifact in zip(plans, found.values(), strict=True):
        one = _ensemble(plan, artifact, tags, datasets)
        tracker.log(experiment, replace(one, params={**hashed, **one.params}))
    metrics = json.loads((common.path / "metrics.json").read_text(encoding="utf-8"))
    flat = {
        f"{method}/{name}": None if value is None else round(value, 4)
        for method, values in metrics.items()
        for name, value in values.items()
    }
    figures = {f"figures/{p.parent.name}/{p.name}": p for p in sorted((page.path / "figures").rglob("*.*"))}
    tracker.log(
        experiment,
        Record(
            "tables",
            identity("tables", common.sha256, page.sha256),
            params=hashed | {"ensembles": ", ".join(plan.slug for plan in plans)},
            metrics=flat,
            artifacts={
                **{path.name: path for path in sorted(common.path.glob("*.csv"))},
                "evaluation.html": page.path / "evaluation.html",
                **figures,
            },
            tags=tags,
            description="`evaluation.html` under Artifacts shows the tables beside the paper's.",
            datasets=datasets,
        ),
    )


def _ensemble(plan: Plan, artifact: Artifact, tags: Mapping[str, str], datasets: Mapping[str, str]) -> Record:
    import pandas as pd

    from dieseltwin.identification.bound import IDENTIFIABLE_BELOW

    members = pd.read_parquet(artifact.path / "members.parquet")
    runtime = json.loads((artifact.path / RUNTIME).read_text(encoding="utf-8"))
    known = members[(members["bound"] <= IDENTIFIABLE_BELOW) & ~members["diverged"]]
    per_cell = known.groupby(["parameter", "segment"])["ratio"]
    rmse = ((per_cell.mean() - 1.0) ** 2 + per_cell.std().fillna(0.0) ** 2) ** 0.5
    metrics: dict[str, float | None] = {
        f"{name}_rmse_pct": round(100.0 * float(value), 4) for name, value in rmse.groupby("parameter").median().items()
    }
    metrics["diverged"] = float(members.groupby(["segment", "member"])["diverged"].first().sum())
    metrics["converged_share"] = round(float(members["converged"].mean()), 4)
    metrics["seconds_per_run"] = round(sum(runtime["seconds_per_run"]) / max(1, len(runtime["seconds_per_run"])), 4)
    return Record(
        " ".join(part for part in (plan.method, plan.case, plan.variant) if part),
        identity(plan.slug, artifact.sha256, runtime["seconds"]),
        params={
            "method": plan.method, "case": plan.case, "variant": plan.variant, "members": plan.what["members"],
            "epochs": plan.epochs, "seed": plan.what["seed"], "start": plan.what["start"],
            "channels": plan.what["channels"] or "all five",
        },
        metrics=metrics,
        curves=curves_of(artifact.path / "curves.parquet"),
        artifacts={"members.parquet": artifact.path / "members.parquet"},
        tags=tags,
        seconds=float(runtime["seconds"]),
        children=_members(plan, members, artifact.sha256),
        datasets=datasets,
    )  # fmt: skip


def _members(plan: Plan, members: Any, sha256: str) -> list[Record]:
    """One nested run for each member: the estimate over the truth, minute by minute as steps."""
    records = []
    for number, part in members.groupby("member", sort=True):
        curves = []
        for name, rows in part.groupby("parameter", sort=True):
            finite = rows[rows["ratio"].abs() < 1e6]
            curves.append(Curve(f"ratio/{name}", finite["segment"].tolist(), finite["ratio"].tolist()))
        records.append(
            Record(
                f"{plan.slug} member {number:02d}",
                identity(sha256, int(number)),
                curves=[curve for curve in curves if curve.steps],
                tags={
                    "level": "member",
                    "converged": str(bool(part["converged"].all())).lower(),
                    "diverged": str(bool(part["diverged"].any())).lower(),
                },
            )
        )
    return records
