"""Write a benchmark: recordings and the manifest in the open, answers and held-out recordings sealed apart."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from dieseltwin.atomic import atomic_path, check_folder, check_writable, write_json
from dieseltwin.challenge.cases import DRAWN, DURATION_S, MAP_RMS, PETROL, POINTS, Plan, Tier, build_case, make_plans
from dieseltwin.challenge.own_engine import REFERENCE_MIN
from dieseltwin.challenge.petrol_cases import draw_healthy, draw_petrol
from dieseltwin.challenge.points_cases import draw_points
from dieseltwin.challenge.processes import in_processes
from dieseltwin.challenge.seal import SEALED, new_salt, salted_sha256, write_answers, write_salt
from dieseltwin.engine import we2011
from dieseltwin.errors import InputError
from dieseltwin.paths import file_sha256
from dieseltwin.sealed import sealed_json
from dieseltwin.settings.strict import unknown_name
from dieseltwin.version import __version__

MANIFEST = "manifest.json"
SCHEMA = 1
HEALTHY = "healthy.csv"  # what petrol engines are calibrated on
MOST_CASES = 10_000
SHORTEST_S, LONGEST_S = 60.0, 36_000.0
_DIGITS = "%.10g"


def make_challenge(
    out: Path, n: int, seed: int, *, tier: Tier = "main", sensors: int = 6, healthy_only: bool = False,
    duration_s: float = DURATION_S, reference_min: float = REFERENCE_MIN, jobs: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Make a benchmark of n cases in `out`; returns the manifest.

    `out`/case_0001/recording.csv is what the tool sees; `out`/sealed holds answers, salt, the second recording of each
    machine and its clean signals. The seed stands in the sealed part only. Cases of the tier `petrol` have drawn
    lengths (5 to 60 min) and gaps, and `out`/healthy.csv to calibrate on; those of the tier `points` are 60 to 150
    settled points, most beside points of the healthy engine.

    Raises:
        InputError: bad arguments, or a folder that holds a benchmark already.
    """
    if tier not in (*MAP_RMS, *DRAWN):
        raise unknown_name("challenge: --tier", tier, [*MAP_RMS, *DRAWN])
    if not 1 <= n <= MOST_CASES:
        raise InputError("challenge: --n", n, f"1 to {MOST_CASES}", "choose another number")
    if not SHORTEST_S <= duration_s <= LONGEST_S:
        raise InputError("challenge: --duration", f"{duration_s:g} s", f"{SHORTEST_S:g} to {LONGEST_S:g} s",
                         "choose another")  # fmt: skip
    check_folder(out)
    if (out / MANIFEST).exists() or (out / SEALED).exists():
        raise InputError(str(out), "a benchmark already", "a new folder", "choose another --out; nothing was written")
    plans = () if tier in DRAWN else make_plans(n, seed, sensors=sensors, healthy_only=healthy_only)
    (out / SEALED).mkdir(parents=True, exist_ok=True)
    check_writable(out / MANIFEST)
    salt = new_salt()
    write_salt(out / SEALED, salt)
    made: dict[int, dict[str, Any]] = {}
    if tier == PETROL:
        _write_csv(draw_healthy(seed), out / HEALTHY)
        reference = [{"recording": HEALTHY, "sha256": file_sha256(out / HEALTHY)}]
        of_petrol = partial(_write_petrol, out=out, seed=seed, healthy=healthy_only, salt=salt, references=reference)
        entries_of = in_processes(of_petrol, range(1, n + 1), jobs)
    elif tier == POINTS:
        of_points = partial(_write_points, out=out, seed=seed, healthy=healthy_only, salt=salt)
        entries_of = in_processes(of_points, range(1, n + 1), jobs)
    else:
        write = partial(_write_case, out=out, seed=seed, tier=tier, sensors=sensors, duration_s=duration_s,
                        reference_min=reference_min, salt=salt)  # fmt: skip
        entries_of = in_processes(write, plans, jobs)
    for k, entry in entries_of:
        made[k] = entry
        if progress is not None:
            progress(len(made), n)
    entries = [made[k] for k in range(n)]
    manifest = {
        "schema": SCHEMA, "code_version": __version__, "n": n, "tier": tier,
        "sensors": None if tier in DRAWN else sensors, "duration_s": None if tier in DRAWN else duration_s,
        "healthy_only": healthy_only,
        "seed_sha256": salted_sha256(salt, str(seed).encode()), "cases": entries,
    }  # fmt: skip
    write_json(out / MANIFEST, sealed_json(manifest))
    return manifest


def _write_case(
    plan: Plan, *, out: Path, seed: int, tier: Tier, sensors: int, duration_s: float, reference_min: float,
    salt: bytes,
) -> dict[str, Any]:
    laboratory: Mapping[str, Any] = we2011.PARAMETERS.model_dump()
    case = build_case(plan, seed, laboratory, tier=tier, sensors=sensors, duration_s=duration_s,
                      reference_min=reference_min)  # fmt: skip
    folder, sealed = out / plan.name, out / SEALED
    folder.mkdir(exist_ok=True)
    _write_csv(case.recording, folder / "recording.csv")
    references = []
    for k, frame in enumerate(case.references):
        name = f"{plan.name}/reference_{k + 1}.csv"
        _write_csv(frame, out / name)
        references.append({"recording": name, "sha256": file_sha256(out / name)})
    _write_csv(case.held_out, sealed / f"{plan.name}_held_out.csv")
    clean = sealed / f"{plan.name}_held_out_clean.parquet"
    with atomic_path(clean) as temporary:
        pd.DataFrame(case.held_out_clean.columns).to_parquet(temporary, index=False)
    answers_hash = write_answers(sealed, plan.name, case.answers, salt)
    return {
        **({"references": references} if references else {}),
        "case": plan.name, "recording": f"{plan.name}/recording.csv",
        "recording_sha256": file_sha256(folder / "recording.csv"), "withhold": list(plan.withhold),
        "answers_salted_sha256": answers_hash,
        "held_out_salted_sha256": salted_sha256(salt, (sealed / f"{plan.name}_held_out.csv").read_bytes()),
        "held_out_clean_salted_sha256": salted_sha256(salt, clean.read_bytes()),
    }  # fmt: skip


def _write_petrol(
    number: int, *, out: Path, seed: int, healthy: bool, salt: bytes, references: Sequence[Mapping[str, str]]
) -> dict[str, Any]:
    frame, answers = draw_petrol(number, seed, healthy=healthy)
    return _write_drawn(frame, {**answers, "seed": seed}, out, salt, references)


def _write_points(number: int, *, out: Path, seed: int, healthy: bool, salt: bytes) -> dict[str, Any]:
    frame, reference, answers = draw_points(number, seed, healthy=healthy)
    answers["seed"] = seed
    if reference is None:
        return _write_drawn(frame, answers, out, salt, [])
    name = f"{answers['case']}/reference.csv"
    (out / name).parent.mkdir(exist_ok=True)
    _write_csv(reference, out / name)
    return _write_drawn(frame, answers, out, salt, [{"recording": name, "sha256": file_sha256(out / name)}])


def _write_drawn(
    frame: pd.DataFrame, answers: Mapping[str, Any], out: Path, salt: bytes, references: Sequence[Mapping[str, str]]
) -> dict[str, Any]:
    """A case that is told by its verdict alone: no second recording."""
    name = str(answers["case"])
    (out / name).mkdir(exist_ok=True)
    recording = f"{name}/recording.csv"
    _write_csv(frame, out / recording)
    return {
        "case": name, "recording": recording, "recording_sha256": file_sha256(out / recording), "withhold": [],
        "references": list(references), "answers_salted_sha256": write_answers(out / SEALED, name, answers, salt),
    }  # fmt: skip


def _write_csv(frame: pd.DataFrame, path: Path) -> None:
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        frame.to_csv(file, index=False, lineterminator="\n", float_format=_DIGITS)
