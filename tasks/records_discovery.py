"""What MLflow is told of discoveries and of the concealed benchmark (see :mod:`tasks.records`)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from tasks.records import files, identity, log, made_by, read
from tasks.run_context import seconds_of
from tasks.store import RUNTIME, Artifact
from tasks.tracking import Record, flat

_DOCUMENT = "discrepancy.json"
_TIMES = {"seconds", "peak_rss_mib"}


def discovered(
    found: Mapping[str, Artifact],
    inputs: Mapping[str, Artifact],
    engine: Artifact | None,
    sensors: Sequence[str] | None,
    settings: Mapping[str, Any],
) -> None:
    """Log each discovery: the document's figures, the report and its figures.

    ``inputs``: the recordings by name; ``engine``: the engine file that was given, None for the published engine;
    ``sensors``: columns that were asked for.
    """
    asked = {
        "engine": "published" if engine is None else engine.path.name,
        "sensors": "all" if sensors is None else ", ".join(sensors),
    }
    beside = {} if engine is None else {"engine file": engine.sha256}
    records = []
    for name, artifact in found.items():
        document = read(artifact.path / _DOCUMENT)
        first = next(iter(document["effects"]), None)
        location = document["location"]
        records.append(
            Record(
                name,
                identity("discover", name, artifact.sha256),
                params=asked
                | {
                    "effects": ", ".join(effect["name"] for effect in document["effects"]) or "none",
                    "site": "none" if location is None else location["site"],
                    "law": "none" if first is None else str(first["law"]),
                    "unit": "-" if first is None or first["unit"] is None else first["unit"],
                    "equivalent_names": "-" if first is None else ", ".join(first["equivalent_names"]) or "-",
                    "channels": ", ".join(document["recording"]["channels"]),
                }
                | flat(settings["discover"]),
                metrics=dict(document_metrics(document)) | _times(artifact.path / RUNTIME),
                artifacts={
                    **files(artifact.path, "*.json"),
                    **files(artifact.path, "*.html"),
                    **files(artifact.path, "*.yaml"),
                    **files(artifact.path / "figures", "*", "figures/"),
                },
                tags={"profile": settings["profile"], **made_by(artifact)},
                seconds=seconds_of(artifact),
                datasets={name: inputs[name].sha256} | beside,
            )
        )
    log("discover", settings, *records)


def document_metrics(document: Mapping[str, Any]) -> Iterator[tuple[str, float | None]]:
    """Every number of a document of schema 1 that can be compared between recordings."""
    yield "mismatch", float(document["mismatch"])
    yield "p_value", document["p_value"]
    if document["location"] is not None:
        yield "site_probability", document["location"]["probability"]
    for place, effect in enumerate(document["effects"]):
        ending = f"_{place + 1}" if place else ""
        for name in ("probability", "magnitude", "std"):
            yield f"{name}{ending}", effect[name]
        yield f"equivalents{ending}", float(len(effect["equivalent_names"]))
    for name, value in document["health"].items():
        yield name, value["value"]
        yield f"{name}_std", value["std"]
        yield f"{name}_before", value["before"]
    fit = document["fit"]
    yield "nll_before", fit["held_out_nll_before"]
    yield "nll_after", fit["held_out_nll_after"]
    yield "chi2_before", fit["chi2_per_sample_before"]
    yield "chi2_after", fit["chi2_per_sample_after"]
    for when in ("before", "after"):
        for name, value in fit[f"rmse_{when}"].items():
            yield f"rmse_{when}/{name}", value
    for name, value in document["minimum_detectable"].items():
        yield f"detectable/{name}", value


def proved(scored: Artifact, made: Artifact, settings: Mapping[str, Any]) -> None:
    """Log a benchmark: the table's numbers, the files, each machine as a nested run, the baselines beside it."""
    document = read(scored.path / "score.json")
    rows = read(scored.path / "rows.json")["rows"]
    config = {key: value for key, value in settings["proof"].items()}
    tags = {"profile": settings["profile"]}
    datasets = {"concealed recordings": made.sha256}
    times = [row["seconds"] for row in rows if row["seconds"] is not None]
    record = Record(
        f"benchmark {document['cases']} cases",
        identity("prove", scored.sha256),
        params=config,
        metrics={
            **read(scored.path / "metrics.json"),
            "seconds": sorted(times)[len(times) // 2] if times else None,
            "lines_passed": float(sum(line["passed"] is True for line in document["lines"])),
            "lines_failed": float(sum(line["passed"] is False for line in document["lines"])),
        },
        artifacts={
            **files(scored.path, "*.*"),
            **files(scored.path / "figures", "*", "figures/"),
            "manifest.json": made.path / "benchmark" / "manifest.json",
        },
        tags=tags,
        description=(scored.path / "score.md").read_text(encoding="utf-8"),
        seconds=sum(times),
        children=[_machine(row, scored.sha256) for row in rows],
        datasets=datasets,
    )
    baselines = [
        Record(
            f"{name} ({document['cases']} cases' baseline)",
            identity("baseline", name, scored.sha256),
            params=config,
            metrics=dict(_numbers(lines)),
            tags=tags | {"baseline": name},
            datasets=datasets,
        )
        for name, lines in document["baselines"].items()
    ]
    log("prove", settings, record, *baselines)


def _machine(row: Mapping[str, Any], sha256: str) -> Record:
    said = ", ".join(effect["name"] for effect in row["said"]) or "nothing"
    true = ", ".join(effect["name"] for effect in row["truth"]) or "healthy"
    numbers = ("p_value", "nll_before", "nll_after", "nll_oracle", "law_error", "seconds", "peak_rss_mib")
    return Record(
        row["case"],
        identity(sha256, row["case"]),
        params={"true": true, "said": said, "kind": row["kind"], "route": row["route"], "site": row["site"] or "-"},
        metrics={name: row[name] for name in numbers}
        | {"mismatch": float(row["mismatch"]), "ratio": max((e["ratio"] for e in row["truth"]), default=0.0)},
        tags={"problem": row["problem"]} if row["problem"] else {},
    )


def _numbers(lines: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, float]]:
    from tasks.prove import flat_numbers

    for key, line in lines.items():
        yield from flat_numbers(key, line["numbers"])


def _times(path: Path) -> dict[str, float]:
    content = read(path) if path.exists() else {}
    return {name: float(content[name]) for name in sorted(_TIMES & set(content)) if content[name] is not None}
