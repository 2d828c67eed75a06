"""Open the seal, check it, and score: `score.json`, `score.md`, `failures.csv`, figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from dieseltwin.atomic import atomic_folder, write_json, write_text
from dieseltwin.challenge import metrics
from dieseltwin.challenge.cases import DRAWN, PETROL, POINTS
from dieseltwin.challenge.processes import in_processes
from dieseltwin.challenge.records import CaseRow, Scoring, case_row, diesel_row, oracle_row, petrol_truth, verdict_row
from dieseltwin.challenge.run import RESULTS, read_manifest
from dieseltwin.challenge.seal import SEALED, check_file, open_answers, read_salt, salted_sha256
from dieseltwin.challenge.table import extra, lines, markdown
from dieseltwin.discovery.verdict.explain import plain
from dieseltwin.errors import InputError
from dieseltwin.sealed import sealed_json

SCORE = "score"
_HELD_OUT = {
    "held_out.csv": "held_out_salted_sha256", "held_out_clean.parquet": "held_out_clean_salted_sha256",
}  # fmt: skip
OF_A_LINE = ("key", "metric", "value", "pass_at", "aim", "passed", "aimed")


@dataclass(frozen=True)
class Score:
    """All rows of a benchmark, those of the baselines on their subset, and what fits the hashes of the manifest."""

    rows: tuple[CaseRow, ...]
    baselines: Mapping[str, tuple[CaseRow, ...]]
    manifest: Mapping[str, Any]
    fitting: tuple[str, ...]


def score_challenge(
    folder: Path, *, scoring: Scoring | None = None, jobs: int = 1, unrun: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Score:  # fmt: skip
    """Check every hash, compare results with answers.

    Args:
        folder: of `make` and `run`; scoring: the tool's library (`Scoring.of_the_tool`); jobs: processes;
        unrun: count cases that were never run as failures; else they are left out.

    Raises:
        InputError: no benchmark, nothing run, an answer or recording that is not the published one.
    """
    manifest = read_manifest(folder)
    answers = verified_answers(folder, manifest)
    fitting = _fitting(manifest, answers)
    if not unrun:
        answers = [a for a in answers if any((folder / RESULTS / a["case"]).glob("*.json"))]
    if not answers:
        raise InputError(str(folder), "no results", "results of `challenge run`", "run the tool first")
    if manifest["tier"] == PETROL:
        compare: Callable[[Mapping[str, Any]], CaseRow] = partial(verdict_row, folder, truth=petrol_truth)
    elif manifest["tier"] == POINTS:
        compare = partial(diesel_row, folder)
    else:
        scoring = Scoring.of_the_tool(manifest["tier"]) if scoring is None else scoring
        compare = partial(case_row, folder, scoring=scoring)
    found_rows: dict[int, CaseRow] = {}
    for k, row in in_processes(compare, answers, jobs):
        found_rows[k] = row
        if progress is not None:
            progress(len(found_rows), len(answers))
    rows = [found_rows[k] for k in range(len(answers))]
    from dieseltwin.challenge.baselines import baseline_rows

    found = baseline_rows(folder, rows)
    subset = {row.case for values in found.values() for row in values}
    baselines: dict[str, tuple[CaseRow, ...]] = {}
    if found:
        baselines["tool"] = tuple(row for row in rows if row.case in subset)
        baselines |= {name: tuple(values) for name, values in found.items()}
        baselines["oracle"] = tuple(oracle_row(row) for row in baselines["tool"])
    return Score(tuple(rows), baselines, manifest, fitting)


def verified_answers(folder: Path, manifest: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The answers of all cases, after every published hash was checked: `_fitting` says of what.

    Raises:
        InputError: something is missing or was changed.
    """
    sealed = folder / SEALED
    salt = read_salt(sealed)
    references = {item["recording"]: item["sha256"] for entry in manifest["cases"]
                  for item in entry.get("references", ())}  # fmt: skip
    for name, published in references.items():
        check_file(folder / name, published)
    found = []
    for entry in manifest["cases"]:
        answers = open_answers(sealed, entry["case"], entry["answers_salted_sha256"])
        check_file(folder / entry["recording"], entry["recording_sha256"])
        for name, key in _HELD_OUT.items():
            if entry.get(key) is not None:
                check_file(sealed / f"{entry['case']}_{name}", entry[key], salt)
        if answers["case"] != entry["case"] or answers["withhold"] != entry["withhold"]:
            raise InputError(f"{folder}: {entry['case']}", "answers of another case or another switch",
                             "the manifest that was published", "restore manifest.json")
        seed = str(answers.get("seed"))
        if "seed" in answers and salted_sha256(salt, seed.encode()) != manifest.get("seed_sha256"):
            raise InputError(f"{folder}: {entry['case']}", "answers of another seed than the published one",
                             "the manifest that was published", "restore manifest.json")
        found.append(answers)
    return found


def _fitting(manifest: Mapping[str, Any], answers: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """What `verified_answers` compared with published hashes: benchmarks made long ago have fewer of them."""
    cases = manifest["cases"]
    checked = {
        "seed": all("seed" in case for case in answers),
        "answers": True,
        "recordings": True,
        "references": any(entry.get("references") for entry in cases),
        "second recordings": all(entry.get("held_out_salted_sha256") is not None for entry in cases),
        "their clean signals": all(entry.get("held_out_clean_salted_sha256") is not None for entry in cases),
    }
    return tuple(name for name, done in checked.items() if done)


def write_score(score: Score, folder: Path, *, figures: bool = True) -> Path:
    """Write `folder`/score: score.json, score.md, failures.csv, rows.json and figures; returns the folder."""
    manifest = score.manifest
    out = folder / SCORE
    notes = [
        f"{len(score.rows)} of {manifest['n']} cases, tier {manifest['tier']}{_size(manifest)}. What fits the hashes "
        f"published beforehand: {', '.join(score.fitting)}."
    ]
    document = {
        "schema": 1, "cases": len(score.rows), "of": manifest["n"], "tier": manifest["tier"],
        "sensors": manifest["sensors"], "code_version": manifest["code_version"],
        "lines": [_line(line) for line in lines(score.rows)],
        "extra": {name: {"hits": s.hits, "of": s.of, "interval": list(s.interval)}
                  for name, s in extra(score.rows).items()},
        "baselines": {name: {line.key: _line(line) for line in lines(rows)} for name, rows in score.baselines.items()},
        "peak_rss_mib": max((row.peak_rss_mib or 0.0 for row in score.rows), default=0.0),
    }  # fmt: skip
    found = metrics.failures(score.rows)
    columns = ["failure", "case", "kind", "route", "ratio", "true", "said", "site", "p_value", "detail"]
    with atomic_folder(out, owned=("figures",)) as temporary:
        write_json(temporary / "score.json", sealed_json(plain(document)))
        write_json(temporary / "rows.json", sealed_json(plain({"rows": [row.document() for row in score.rows]})))
        write_text(temporary / "score.md", markdown("Concealed benchmark", score.rows, score.baselines, notes))
        table = pd.DataFrame(found, columns=columns)
        write_text(temporary / "failures.csv", table.to_csv(index=False, lineterminator="\n"))
        if figures and manifest["tier"] not in DRAWN:
            from dieseltwin.challenge.figures import write_figures

            (temporary / "figures").mkdir()
            write_figures(score.rows, temporary / "figures")
    return out


def _size(manifest: Mapping[str, Any]) -> str:
    if manifest["tier"] == PETROL:
        return ", 5 to 60 min each"
    if manifest["tier"] == POINTS:
        return ", 60 to 150 settled points each"
    return f", {manifest['sensors']} sensors, {manifest['duration_s']:g} s each"


def _line(line: Any) -> dict[str, Any]:
    return {name: getattr(line, name) for name in OF_A_LINE} | {"numbers": dict(line.numbers)}
