"""Steps after the identification: the comparison of the methods (results/), pictures, the HTML report (reports/)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tasks.identify import declarations
from tasks.run_context import Progress, current, step
from tasks.store import RUNTIME, SCRATCH, Artifact, content_hash, scratch

PAGE = "index.html"
METRICS = "metrics.json"
SUMMARY = "summary.csv"
TABLE = "summary.txt"

_BETWEEN_COLUMNS = r"\s{2,}"


@step("driving-pictures", "pictures of the driving", expected_s=15.0)
def driving_pictures(out: Path, progress: Progress, *, sets: Path, driving: dict[str, Any], dpi: int) -> None:
    """``set_i.png`` ...: what each set looks like."""
    import pandas as pd

    from dieseltwin.paper.comparison.driving import set_figure
    from dieseltwin.settings.params import EcuConfig

    ecu = EcuConfig(**driving["ecu"])
    paths = sorted((sets / "response").glob("*.parquet"))
    for done, path in enumerate(paths, start=1):
        figure = set_figure(path.stem, pd.read_parquet(path), ecu=ecu)
        (out / f"{path.stem}.png").write_bytes(figure.encode(dpi))
        progress(done, len(paths))


def _linked(folder: Path, methods: dict[str, Path]) -> None:
    """The methods' results under the names that the report expects."""
    for name, path in methods.items():
        (folder / name).symlink_to(path.resolve(), target_is_directory=True)


@step("comparison", "comparison of the methods", expected_s=10.0, entries=declarations())
def comparison(
    out: Path,
    progress: Progress,
    *,
    field: Path,
    errors: Path,
    classical: Path,
    newton: Path,
    adam: Path,
    settings: dict[str, Any],
    about: dict[str, Any],
) -> None:
    """What all methods share (readings, truth, pretraining errors) and how they compare: summary.csv, metrics.json."""
    import json
    import shutil

    from dieseltwin.report.inputs import write_report_inputs
    from dieseltwin.report.results import load_results
    from dieseltwin.report.tables import summary_table
    from tasks.identify import problems_of

    problems, truth_states = problems_of(field, settings)
    write_report_inputs(out, problems, truth_states=truth_states, about=about)
    groups: dict[str, dict[str, Any]] = {}
    for path in sorted(errors.glob("*.json")):
        group, _, kind = path.stem.partition("_")
        content = json.loads(path.read_text(encoding="utf-8"))
        groups[group] = {**groups.get(group, {}), kind: content} if kind else content
    (out / "pretraining.json").write_text(json.dumps(groups, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    with scratch(out) as temporary:
        folder = temporary / "results"
        shutil.copytree(out, folder, ignore=shutil.ignore_patterns(f"{SCRATCH}*"))
        _linked(folder, {"classical": classical, "few-shot-newton": newton, "few-shot-adam": adam})
        table = summary_table(load_results(folder)).drop(columns="seconds_per_run")
    table.to_csv(out / SUMMARY, index=False)
    metrics: dict[str, dict[str, float | None]] = {}
    for row in table.to_dict("records"):
        name = row["parameter"]
        metrics.setdefault(row["method"], {}).update(
            {
                name: _finite(row["mean"]),
                f"{name}_std": _finite(row["std"]),
                f"{name}_error_pct": _finite(100.0 * row["error"]),
                f"{name}_ratio_to_bound": _finite(row["ratio_to_bound"]),
            }
        )
    (out / METRICS).write_text(json.dumps(metrics, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def _finite(value: float) -> float | None:
    import math

    return float(value) if math.isfinite(value) else None


@step("report", "report", expected_s=20.0, entries=declarations())
def report(
    out: Path,
    progress: Progress,
    *,
    common: Path,
    pictures: Path,
    classical: Path,
    newton: Path,
    adam: Path,
    run_times: dict[str, str],
) -> None:
    """``index.html``, ``figures/``, and the table for the terminal.

    ``run_times``: hashes of the methods' runtime.json, which are no part of their results' hashes but are shown.
    """
    import shutil

    from dieseltwin.paper.comparison.page import build_report
    from dieseltwin.report.results import load_results
    from dieseltwin.report.tables import summary_table, summary_text

    with scratch(out) as temporary:
        folder = temporary / "results"
        shutil.copytree(common, folder)
        _linked(folder, {"classical": classical, "few-shot-newton": newton, "few-shot-adam": adam})
        (folder / "driving").symlink_to(pictures.resolve(), target_is_directory=True)
        build_report(folder, out / PAGE, figures_dir=out / "figures")
        progress(1, 2)
        results = load_results(folder)
        (out / TABLE).write_text(summary_text(results) + "\n", encoding="utf-8")
        summary_table(results).to_csv(out / SUMMARY, index=False)


def run_times(methods: Mapping[str, Artifact]) -> dict[str, str]:
    """Hash of each method's runtime.json."""
    return {name: content_hash(artifact.path / RUNTIME) for name, artifact in methods.items()}


def show(page: Artifact, folder: Path) -> None:
    """Print the table, and where the report is."""
    from rich.table import Table

    display = current().display
    head, *lines = (page.path / TABLE).read_text(encoding="utf-8").splitlines()
    table = Table(title="Health parameters of the field engine (Case-V, noisy)", title_justify="left")
    for column in re.split(_BETWEEN_COLUMNS, head):
        table.add_column(column, no_wrap=True)
    method = ""
    for line in lines:
        cells = re.split(_BETWEEN_COLUMNS, line)
        if cells[0] != method:
            table.add_section()
        table.add_row("" if cells[0] == method else cells[0], *cells[1:])
        method = cells[0]
    display.say("")
    display.say(table)
    display.say(f"report: {folder / PAGE}")
    display.say("compare runs: make ui")
