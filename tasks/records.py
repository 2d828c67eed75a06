"""What MLflow is told: one experiment a flow, metrics named as the paper's symbols, figures, run times, members.

Everything is read from the results' files, so that a result from the cache is logged as a fresh one is.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from tasks.run_context import current, seconds_of
from tasks.store import Artifact
from tasks.tracking import Curve, Record, Tracker, digest_of, flat, view

# Experiments in the order of the chain; MLflow shows the note above the table.
EXPERIMENTS = {
    "simulate": "Driving sets and recordings (Cases I to VII). One run per data set made; pictures under Artifacts.",
    "pretrain": "What is learned from laboratory data. `test_error_pct/…`: relative L2 error on Case-V, by output, in "
    "per cent; `training/…`: curves.",
    "identify": "Health parameters of the field engine from noisy recordings (Case-V). Compare the three methods: "
    "`A_egrmax`, `A_vgtmax`, `eta_sc`, `h_tot` are pooled estimates (SI units), `…_std` their standard deviation, "
    "`…_error_pct` the deviation from the truth, `…_ratio_to_bound` the error over the Cramér-Rao bound. Runs nested "
    "below a method are its members. `comparison` holds the HTML report.",
    "discover": "What the twin left out of a recording. `p_value` and `probability` are of the mismatch and of the "
    "first name, `magnitude` and `std` in `unit`, `nll_…` negative log-likelihood per sample on the held-out part, "
    "`…_before` health parameters of the fit without the effect; `detectable/…` the smallest size that the recording "
    "could show. The report is under Artifacts.",
    "prove": "The concealed benchmark: shares with their 95 % intervals (`…_low`, `…_high`), runs nested below are the "
    "machines. The table is `score.md` under Artifacts.",
    "watch": "Histories of engines: a run for every batch of new recordings. `alarm` is 1 where something besides wear "
    "has changed, `evidence` against 1 / `alarms_per_year`; `…_since_reference` is health over that of the reference.",
    "promote": "Trained networks against the ones in use: relative L2 error in per cent on validation driving, "
    "`mean_ratio` is the geometric mean of new / in use; `acceptance/…`: figures of the physical tests. Every "
    "decision is a run, roll-backs too. The versions are under Models.",
}


# Sections of params.yaml that the results of a flow rest on.
SECTIONS = {
    "simulate": ("engine", "driving", "noise"),
    "pretrain": ("seed", "engine", "driving", "noise", "pretrain"),
    "identify": ("seed", "engine", "noise", "identify"),
    "discover": ("discover", "learn"),
    "prove": ("discover", "learn", "proof"),
    "watch": ("discover", "learn", "watch"),
    "promote": ("engine", "driving", "noise", "identify", "promotion"),
    "evaluate": ("seed", "engine", "noise", "pretrain", "identify", "evaluation"),
}

HEALTH = ("A_egrmax", "A_vgtmax", "eta_sc", "h_tot")

# Columns that each experiment's page shows.
VIEWS = {
    "simulate": view(["seconds", "rows/case_i", "rows/case_v_noisy"]),
    "pretrain": view(
        [
            "seconds",
            *(f"test_error_pct/{name}" for name in ("u_egr1", "u_egr2", "u_vgt")),
            *(f"test_error_pct/{name}" for name in ("eta_vol", "f_egr", "F_vgt_Pi_t", "eta_tm", "eta_c", "Phi_c")),
            *(f"held_out_error_pct/{name}" for name in ("p_im", "p_em", "omega_t", "x_r", "T_1")),
        ]
    ),
    "identify": view(
        [
            *(f"{name}_error_pct" for name in HEALTH),
            *(f"{name}_ratio_to_bound" for name in HEALTH),
            "seconds_per_run",
        ],
        ["runs"],
    ),
    "discover": view(
        [
            *("mismatch", "p_value", "probability", "magnitude", "std", "nll_before", "nll_after"),
            *(f"{name}{ending}" for name in HEALTH for ending in ("", "_before")),
            "seconds",
        ],
        ["effects", "site", "unit"],
    ),
    "prove": view(
        [
            *("false_alarms", "detection", "site", "name_in_set", "set_size", "top_name", "withheld_none"),
            *("false_none", "law", "magnitude_median", "magnitude_p90", "coverage", "health_factor", "gain_median"),
            "seconds",
        ],
        ["cases", "tier", "sensors"],
    ),
    "watch": view(
        ["alarm", "evidence", "recordings", "added", "refused", *(f"{name}_since_reference" for name in HEALTH)],
        ["history"],
    ),
    "promote": view(["mean_ratio", "worst_ratio", "version"], ["decision"]),
}


def _tracker() -> Tracker:
    return Tracker(current().workspace)


def warm_up() -> None:
    """Make or open the database: some seconds, best spent while the first step computes. A database that can't be used
    is told of when a result is logged."""
    tracker = _tracker()
    with suppress(Exception):
        for name in EXPERIMENTS:
            tracker.experiment(name, EXPERIMENTS[name], VIEWS[name])


def experiment(name: str) -> str:
    """Id of the flow's experiment, made on first use."""
    return _tracker().experiment(name, EXPERIMENTS[name], VIEWS[name])


def log(name: str, settings: Mapping[str, Any], *records: Record) -> list[str]:
    """Log records of a flow, each with the hash of the settings that the flow's results rest on; returns run ids."""
    tracker, experiment_id, hashed = _tracker(), experiment(name), settings_hash(name, settings)
    return [tracker.log(experiment_id, replace(one, params={**hashed, **one.params})) for one in records]


def settings_hash(name: str, settings: Mapping[str, Any]) -> dict[str, str]:
    """A parameter ``params_sha256``: the sections of the settings that a flow's results rest on, as of the report."""
    from dieseltwin.settings.params import params_sha256

    return {"params_sha256": params_sha256({section: settings[section] for section in SECTIONS[name]})}


def last_with(name: str, tag: str, value: str) -> Any | None:
    """MLflow's entry of the last finished run of a flow with that tag; None where there is none."""
    return _tracker().last_with(experiment(name), tag, value)


def tracked(name: str, tag: str, value: str) -> frozenset[str]:
    """Digests of the datasets of the runs of a flow that have a tag."""
    return _tracker().datasets(experiment(name), tag, value)


def identity(*parts: Any) -> str:
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def made_by(artifact: Artifact) -> dict[str, str]:
    """Tags that tell runs of one name apart: the result's key in the cache, and a digest of the code that made it."""
    manifest = current().store.manifest(artifact)
    return {"key": manifest["key"], "code_digest": identity(manifest["provenance"]["modules"])[:12]}


def outputs(**made: Artifact) -> dict[str, str]:
    """Tags that name what a run made as the runs that use it show it: `models`, `field recordings`, and the digest."""
    return {name.replace("_", " "): digest_of(artifact.sha256) for name, artifact in made.items()}


def read(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def files(folder: Path, pattern: str, under: str = "") -> dict[str, Path]:
    return {f"{under}{path.name}": path for path in sorted(folder.glob(pattern))}


def simulated(sets: Artifact, recordings: Artifact, pictures: Artifact, settings: Mapping[str, Any]) -> None:
    """Log the data: how much there is, how it was made, what it looks like."""
    import pyarrow.parquet as parquet

    rows = {
        f"rows/{path.stem}": float(parquet.read_metadata(path).num_rows)
        for folder in (sets.path, recordings.path / "lab", recordings.path / "field")
        for path in sorted(folder.glob("*.parquet"))
    }
    record = Record(
        "data",
        identity(sets.sha256, recordings.sha256, pictures.sha256),
        params=flat({name: settings[name] for name in ("engine", "driving", "noise")}),
        metrics={**rows, "seconds": seconds_of(sets) + seconds_of(recordings)},
        artifacts=files(pictures.path, "*.png", "pictures/"),
        tags={
            "profile": settings["profile"],
            **made_by(recordings),
            **outputs(laboratory_recordings=recordings / "lab", field_recordings=recordings / "field"),
        },
        seconds=seconds_of(sets) + seconds_of(recordings),
    )
    log("simulate", settings, record)


def pretrained(
    trained: Mapping[str, Artifact], models: Artifact, data: Artifact, settings: Mapping[str, Any]
) -> None:
    """Log each training: errors by output, curves, settings, time; and ``models``, which they make together."""
    import pandas as pd

    records, tags = [], {"profile": settings["profile"]}
    for name, artifact in trained.items():
        group, _, kind = name.partition("_")
        errors = read(artifact.path / "errors.json")
        metrics = {
            f"{measure}_error_pct/{output}": value
            for output, values in errors.items()
            for measure, value in values.items()
        }
        curves = []
        path = artifact.path / "curves.parquet"
        if path.exists():
            for quantity, rows in pd.read_parquet(path).groupby("quantity"):
                curves.append(Curve(f"training/{quantity}", rows["epoch"].astype(int).tolist(), rows["value"].tolist()))
        section = settings["pretrain"][group]
        config = {key: value for key, value in section.items() if key not in ("paper", "improved", "conditioned")}
        noise = settings["noise"]["label_rel"]
        shared = {"seed": settings["seed"], "engine": settings["engine"], "noise.label_rel": noise}
        records.append(
            Record(
                name,
                identity(name, artifact.sha256),
                params=flat({**shared, **config, **(section[kind] if kind else {})}),
                metrics={**metrics, "seconds": seconds_of(artifact)},
                curves=curves,
                artifacts={path.name: path for path in sorted(artifact.path.glob("*.*")) if path.suffix != ".pt"},
                tags=tags | {"kind": kind or "-"} | made_by(artifact) | outputs(networks=artifact),
                seconds=seconds_of(artifact),
                datasets={"laboratory recordings": data.sha256},
            )
        )
    runs = log("pretrain", settings, *records)
    whole = Record(
        "models",
        identity("models", models.sha256),
        params=flat({name: settings[name] for name in SECTIONS["pretrain"]}),
        metrics={"seconds": sum(map(seconds_of, trained.values()))},
        tags={
            **tags,
            **outputs(models=models),
            **{f"run.{name}": run_id for name, run_id in zip(trained, runs, strict=True)},
        },
        description="The folder `models/`. Tags `run.…` are the ids of the runs that trained its parts.",
        datasets={"laboratory recordings": data.sha256},
    )
    log("pretrain", settings, whole)


def identified(
    methods: Mapping[str, Artifact],
    comparison: Artifact,
    report: Artifact,
    inputs: Mapping[str, Artifact],
    settings: Mapping[str, Any],
) -> None:
    """Log each method with its members, and the comparison with the report."""
    metrics = read(comparison.path / "metrics.json")
    figures = sorted((report.path / "figures").glob("*"))
    datasets = {name: artifact.sha256 for name, artifact in inputs.items()}
    tags = {"profile": settings["profile"]}
    shared = flat({name: settings[name] for name in ("seed", "engine", "noise")})
    records = []
    for name, artifact in methods.items():
        document = read(artifact.path / "identification.json")
        runtime = read(artifact.path / "runtime.json")
        words = name.replace("-", "_")
        records.append(
            Record(
                name,
                identity(name, artifact.sha256, metrics[name], runtime["seconds"]),
                params={"method": name, "runs": runtime["runs"], "segments": runtime["segments"]}
                | shared
                | flat(_own(settings["identify"], name)),
                metrics={
                    **{key: _shown(key, value) for key, value in metrics[name].items()},
                    "seconds_per_run": round(runtime["seconds_per_run"], 4),
                    "seconds": round(runtime["seconds"], 2),
                    "converged_share": _converged(document),
                },
                curves=curves_of(artifact.path / "curves.parquet"),
                artifacts={
                    "identification.json": artifact.path / "identification.json",
                    **{f"figures/{path.name}": path for path in figures if words in path.name},
                },
                tags=tags | made_by(artifact),
                seconds=seconds_of(artifact),
                children=_members(document, name, artifact.sha256),
                datasets=datasets,
            )
        )
    table = (report.path / "summary.txt").read_text(encoding="utf-8")
    records.append(
        Record(
            "comparison",
            identity("comparison", report.sha256),
            params={key: value for key, value in read(comparison.path / "report.json").items() if key != "nominal"},
            metrics={
                f"{name}/{key}": _shown(key, value)
                for name, values in metrics.items()
                for key, value in values.items()
                if key.endswith(("_error_pct", "_ratio_to_bound"))
            },
            artifacts={
                "report.html": report.path / "index.html",
                "summary.csv": report.path / "summary.csv",
                **{f"figures/{path.name}": path for path in figures},
            },
            tags=tags,
            description=f"```\n{table}```\nThe report is `report.html` under Artifacts.",
            datasets=datasets,
        )
    )
    log("identify", settings, *records)


def _shown(metric: str, value: float | None) -> float | None:
    """Errors and ratios as they are read: MLflow shows every digit it gets."""
    return value if value is None or metric in HEALTH or metric.endswith("_std") else round(value, 3)


def _own(section: Mapping[str, Any], method: str) -> dict[str, Any]:
    shared = {key: value for key, value in section.items() if key != "methods"}
    return {**shared, **section["methods"].get(method, {})}


def _converged(document: Mapping[str, Any]) -> float:
    runs = document["runs"]
    return sum(bool(run["converged"]) for run in runs) / max(1, len(runs))


def curves_of(path: Path) -> list[Curve]:
    """Median over segments and runs or members of every convergence curve."""
    import pandas as pd

    if not path.exists():
        return []
    curves = []
    for quantity, rows in pd.read_parquet(path).groupby("quantity"):
        middle = rows.groupby("epoch")["value"].median()
        curves.append(Curve(f"training/{quantity}", [int(epoch) for epoch in middle.index], middle.tolist()))
    return curves


def _members(document: Mapping[str, Any], method: str, sha256: str) -> list[Record]:
    """One nested run for each member: its pooled values, and its values by segment as steps."""
    members = []
    for run in document["runs"]:
        number = run["run"]
        by_segment = [segment.get("parameters", {}) for segment in run["segments"]]
        curves = []
        for name in run["parameters"]:
            pairs = [(i, values.get(name)) for i, values in enumerate(by_segment)]
            known = [(i, value) for i, value in pairs if isinstance(value, int | float)]
            curves.append(Curve(f"segments/{name}", [i for i, _ in known], [float(value) for _, value in known]))
        members.append(
            Record(
                f"{method} member {number:02d}",
                identity(sha256, number),
                metrics=run["parameters"],
                curves=[curve for curve in curves if curve.steps],
                tags={"converged": str(run["converged"]).lower()},
            )
        )
    return members
