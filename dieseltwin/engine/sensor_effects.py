"""Effects on readings: offsets, gains and the lag of a thermocouple, after a simulation."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dieseltwin.engine._compiled import follow_lanes
from dieseltwin.engine.effect_catalogue import EFFECTS

SENSOR_EFFECTS = tuple(name for name, effect in EFFECTS.items() if effect.kind == "sensor")


def apply_sensor_effects(
    measured: np.ndarray,
    time_s: np.ndarray,
    magnitudes: Mapping[str, np.ndarray],
    schedules: Mapping[str, np.ndarray] | None = None,
    columns: tuple[str, ...] = ("p_im_pa", "p_em_pa", "omega_t_rad_s", "w_egr_kg_s", "t_em_k", "w_c_kg_s"),
) -> np.ndarray:
    """Readings (B, n, C) under sensor effects; the lag first, then gains, then offsets. `measured` isn't changed.

    Args:
        measured: true values (B, n, C) in the order of `columns`.
        time_s: sample times [s], (n,); the lag is exact for values that run linearly between samples, and starts at
            rest.
        magnitudes: effect name -> (B,) or one magnitude; names that are no sensor effects, and sensors that aren't
            in `columns`, are not looked at.
        schedules: effect name -> (n,) factor of its magnitude.
    """
    schedules = schedules or {}
    named = [name for name in SENSOR_EFFECTS if name in magnitudes and np.any(magnitudes[name])]
    if not named:
        return measured
    out = np.array(measured, dtype=np.float64)
    for ending in ("_lag", "_gain", "_offset"):
        for name in named:
            column = EFFECTS[name].site.removeprefix("sensor:")
            if not name.endswith(ending) or column not in columns:
                continue
            at = columns.index(column)
            size = np.broadcast_to(np.asarray(magnitudes[name], dtype=np.float64), (out.shape[0],))[:, None]
            amount = size * schedules.get(name, np.ones(time_s.size))[None, :]
            if ending == "_lag":
                time = np.ascontiguousarray(time_s, dtype=np.float64)
                out[..., at] = follow_lanes(time, np.ascontiguousarray(out[..., at]), amount)
            elif ending == "_gain":
                out[..., at] *= 1.0 + amount
            else:
                out[..., at] += amount
    return out
