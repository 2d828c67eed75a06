"""Why a name was or wasn't chosen, from what a discovery kept in `details.json`."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from dieseltwin.discovery.verdict.curves import Discovery
from dieseltwin.discovery.verdict.document import FILE_NAME, NONE_OF_THESE, load_discrepancy
from dieseltwin.discovery.verdict.unseen import most_first
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.errors import InputError
from dieseltwin.notes import listing
from dieseltwin.sealed import read_json
from dieseltwin.settings.strict import unknown_name

DETAILS = "details.json"


def plain(value: Any) -> Any:
    """JSON types without NaN: arrays become lists, numbers that are not finite become null."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, str | int | bool) else str(value)


def details_of(found: Discovery, options: Mapping[str, Any], notes: list[str]) -> dict[str, Any]:
    """Content of `details.json`: what was asked, every candidate with its reason, the laws, the limits."""
    curves = found.curves
    return plain(
        {
            "recording_sha256": found.document.recording.sha256,
            "options": dict(options),
            "notes": notes,
            "candidates": [dict(candidate) for candidate in curves.candidates],
            "laws": [dict(law) for law in curves.laws],
            "minimum_detectable": dict(found.document.minimum_detectable),
            "tolerance": dict(curves.tolerance),
            "units": dict(curves.units),
            **found.details,
        }
    )


def load_details(folder: str | Path) -> dict[str, Any]:
    """What `details.json` in an --out folder holds.

    Raises:
        InputError: no such file, or not one of `dieseltwin discover`.
    """
    path = Path(folder) / DETAILS
    do = "run `dieseltwin discover RECORDING --out DIR` first"
    content = read_json(path, "JSON that `dieseltwin discover` wrote", do)
    if not {"candidates", "options", "equivalent_gain"} <= set(content):
        raise InputError(str(path), "other content", "JSON that `dieseltwin discover` of this version wrote", do)
    return content


def answers(folder: Path, asked: Mapping[str, Any], recording_sha256: str) -> bool:
    """Whether a folder holds the answer to just this question about just this recording."""
    if not (folder / DETAILS).is_file() or not (folder / FILE_NAME).is_file():
        return False
    details = load_details(folder)
    same = details["options"] == json.loads(json.dumps(asked))
    return bool(same and details["recording_sha256"] == recording_sha256)


class Known(Protocol):
    """What is said of an effect: those of the diesel engine have it, and every twin's hypotheses."""

    @property
    def site(self) -> str:
        """Where it enters."""
        ...

    @property
    def law(self) -> str:
        """What it does."""
        ...

    @property
    def unit(self) -> str:
        """Of its size."""
        ...

    @property
    def tolerance(self) -> float:
        """Smallest size of interest [unit]."""
        ...


def check_name(name: str, catalogue: Mapping[str, Known] = EFFECTS) -> None:
    """Refuse a name that the catalogue doesn't hold.

    Raises:
        InputError: with the closest names.
    """
    if name != NONE_OF_THESE and name not in catalogue:
        raise unknown_name("--explain", name, [*catalogue, NONE_OF_THESE])


def _value(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{value:.4g} {unit}".rstrip(" -")


def explain(name: str, folder: str | Path, catalogue: Mapping[str, Known] = EFFECTS) -> list[str]:
    """Lines that say why `name` was or wasn't chosen.

    Args:
        name: of the catalogue, or none_of_these.
        folder: an --out folder of `dieseltwin discover`.
        catalogue: effects by name; those of the diesel engine if not given.

    Raises:
        InputError: an unknown name, or a folder without results.
    """
    check_name(name, catalogue)
    details, document = load_details(folder), load_discrepancy(folder)
    reported = [effect for effect in document.effects if effect.name == name]
    beside = [effect.name for effect in document.effects if name in effect.equivalent_names]
    if name == NONE_OF_THESE:
        verdict = _none_of_these(details, bool(reported), document.mismatch)
        return [f"{name}: {'chosen' if reported else 'not chosen'}", verdict]
    effect = catalogue[name]
    symbol = f"{EFFECTS[name].symbol} " if catalogue is EFFECTS else ""
    lines = [
        f"{name} ({effect.site}): {effect.law}, {symbol}in {effect.unit}",
        "chosen" if reported else (f"not told apart from {beside[0]}" if beside else "not chosen"),
    ]
    smallest = details.get("minimum_detectable", {}).get(name)
    lines.append(
        f"smallest size that this recording could show: {_value(smallest, effect.unit)} "
        f"(tolerance {_value(effect.tolerance, effect.unit)})"
    )
    if moved := [f"{each} by {100 * change:+.2g} %" for each, change in most_first(document.health_bias, name)]:
        lines.append(f"of that size and unseen it would move {listing(moved)}")
    candidates = {entry["name"]: entry for entry in details["candidates"]}
    entry = candidates.get(name)
    if name in details["options"].get("withhold", ()):
        return [*lines, "it was withheld from the catalogue for this run (--withhold)"]
    if entry is None:
        column = effect.site.removeprefix("sensor:")
        if effect.site.startswith("sensor:") and column not in document.recording.channels:
            return [*lines, f"its sensor {column} was not used"]
        if not document.mismatch:
            return [*lines, f"nothing was refitted: no mismatch beyond noise, health and map tolerance "
                            f"(p = {document.p_value:.2g})"]  # fmt: skip
        return [*lines, "it was not weighed: its linear score is too small for a refit"]
    gains = [e["log_likelihood_gain"] for e in details["candidates"] if e["log_likelihood_gain"] is not None]
    gain = entry["log_likelihood_gain"]
    if gain is not None:
        behind, apart = max(gains) - gain, 0.5 * details["equivalent_gain"]
        best = _best(details["candidates"])
        lines.append(
            f"log-likelihood gained over the health parameters alone: {gain:.1f}"
            + (f", {behind:.1f} behind the best ({best}); below {apart:g} can't be told apart"
               if behind > 0 else ", the best of all")
        )  # fmt: skip
    if entry["magnitude"] is not None:
        spread = "" if entry["std"] is None else f" ± {entry['std']:.2g}"
        lines.append(f"fitted size: {entry['magnitude']:.4g}{spread} {effect.unit}".rstrip(" -"))
    if entry["probability"] is not None:
        lines.append(f"probability: {entry['probability']:.3g}")
    lines.append(f"why: {entry['reason']}")
    return lines


def _best(candidates: list[dict[str, Any]]) -> str:
    known = [entry for entry in candidates if entry["log_likelihood_gain"] is not None]
    return str(max(known, key=lambda entry: entry["log_likelihood_gain"])["name"])


def _none_of_these(details: Mapping[str, Any], chosen: bool, mismatch: bool) -> str:
    candidates = {entry["name"]: entry for entry in details["candidates"]}
    if NONE_OF_THESE in candidates:
        return f"why: {candidates[NONE_OF_THESE]['reason']}"
    if not mismatch:
        return "there is no mismatch to name"
    if not chosen:
        return "an effect of the catalogue fits within noise, its physical range and both halves of the data"
    refused = "no effect of the catalogue passes the tests of fit"
    weighed = [entry for entry in details["candidates"] if entry["log_likelihood_gain"] is not None]
    if not weighed:
        return refused
    best = _best(weighed)
    return f"{refused}; the best of them, {best}: {candidates[best]['reason']}"
