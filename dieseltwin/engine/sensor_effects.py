"""Effects on readings: offsets, gains and lags, after a simulation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dieseltwin.engine._compiled import follow_lanes
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.engine.parameters import EngineParameters
from dieseltwin.engine.terms import SENSOR_SLOTS, amounts, effect_terms
from dieseltwin.sensors import MEASURED


def slot_parts(slot: str) -> tuple[str, str]:
    """Column and fault ("lag", "gain" or "offset") of one of `SENSOR_SLOTS`."""
    if ":" in slot:
        column, _, fault = slot.partition(":")
        return column, fault
    return EFFECTS[slot].enters.name, EFFECTS[slot].enters.operator


def apply_sensor_effects(
    measured: np.ndarray,
    time_s: np.ndarray,
    magnitudes: Mapping[str, np.ndarray],
    schedules: Mapping[str, np.ndarray] | None = None,
    columns: tuple[str, ...] = MEASURED,
) -> np.ndarray:
    """Readings (B, n, C) under sensor effects; the lag first, then gains, then offsets. `measured` isn't changed.

    Args:
        measured: true values (B, n, C) in the order of `columns`.
        time_s: sample times [s], (n,); the lag is exact for values that run linearly between samples, and starts at
            rest.
        magnitudes: slot (`SENSOR_SLOTS`) -> (B,) or one magnitude; other names, and sensors that aren't in
            `columns`, are not looked at.
        schedules: slot -> (n,) factor of its magnitude, or (B, n) one per lane.
    """
    schedules = schedules or {}
    named = [name for name in SENSOR_SLOTS if name in magnitudes and np.any(magnitudes[name])]
    if not named:
        return measured
    out = np.array(measured, dtype=np.float64)
    for name in named:
        column, fault = slot_parts(name)
        if column not in columns:
            continue
        at = columns.index(column)
        size = np.broadcast_to(np.asarray(magnitudes[name], dtype=np.float64), (out.shape[0],))[:, None]
        amount = size * np.atleast_2d(schedules.get(name, np.ones(time_s.size)))
        if fault == "lag":
            time = np.ascontiguousarray(time_s, dtype=np.float64)
            out[..., at] = follow_lanes(time, np.ascontiguousarray(out[..., at]), amount)
        elif fault == "gain":
            out[..., at] *= 1.0 + amount
        else:
            out[..., at] += amount
    return out


def undo_sensor_terms(
    measured: np.ndarray, time_s: np.ndarray, start_s: float, conditions: dict[str, np.ndarray],
    parameters: EngineParameters,
) -> tuple[np.ndarray, EngineParameters]:  # fmt: skip
    """Readings without the offsets and gains that the engine's terms know of, and the engine without these terms.

    Args:
        measured: (.., n, C) readings in the order of `MEASURED`.
        time_s: sample times, (n,) [s]; start_s: the recording's start; conditions: input columns, (n,) each.
        parameters: with terms; a lag can't be undone and stays.
    """
    def undone(term: Any) -> bool:
        slot = getattr(term, "slot", "")
        return slot in SENSOR_SLOTS and slot_parts(slot)[1] != "lag"

    slots = {term.slot for term in effect_terms(parameters.terms) if undone(term)}
    names = sorted(slots, key=lambda slot: (slot_parts(slot)[1] == "gain", slot))  # offsets came last: they go first
    out = np.array(measured, dtype=np.float64)
    for name, amount in zip(names, amounts(parameters.terms, names, time_s, start_s, conditions), strict=True):
        column, fault = slot_parts(name)
        at = MEASURED.index(column)
        out[..., at] = out[..., at] - amount if fault == "offset" else out[..., at] / (1.0 + amount)
    if not names:
        return out, parameters
    return out, parameters.replace(terms=[term for term in parameters.terms if not undone(term)])
