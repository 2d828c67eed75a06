"""Drawn settled points: the plant held at operating points, its noisy readings averaged, when it was well and now.

The machine is that of the own-engine tier: maps off by 2 %, health apart, worn since. Points of an engine with an
exhaust flap come without a reference, as a test bed gives them, and so do some healthy ones (maps off by 0.5 %); all
others stand beside points of the healthy engine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from dieseltwin.challenge.driving import INPUTS, Driving
from dieseltwin.challenge.map_errors import MapErrors
from dieseltwin.challenge.own_engine import TIERS, draw_health, weather, with_ambient, worn
from dieseltwin.challenge.plant import OUTPUTS, SAMPLE_S, run_plant
from dieseltwin.challenge.plant_effects import FAMILIES, FLAP, Fault
from dieseltwin.challenge.sensors import SENSORS, SensorSet, read
from dieseltwin.engine import we2011

HEALTHY_SHARE, WITHOUT_REFERENCE = 0.25, 0.5  # of all cases; of the healthy ones
COUNTS, REFERENCE_COUNT = (60, 100, 150), 150
ALONE_RMS = 0.005  # of maps without a reference, beside what the coefficients take up: as submodels are believed
LARGEST_RATIO = 10.0  # of magnitude to tolerance; log-uniform from 1
HOLD_S, AVERAGED_S = 60.0, 16.0  # a point is held so long, and averaged over its end
DRIFTING = 0.003  # a point whose turbo speed or boost still moves by more between the halves of its average is left out
AIR_LEAST, BOOST_LEAST = 1.15, 1.03  # lambda and p_im over the ambient; below, nobody measures a point
LOW, HIGH = (800.0, 35.0, 0.0, 24.0), (1900.0, 195.0, 80.0, 62.0)  # of `INPUTS`
FLAP_PCT = (25.0, 100.0)
SPARE = 1.6  # of the points that are asked for: so many are held

SETTLED = (
    "boost_leak", "exhaust_leak", "back_pressure", "air_filter_restriction", "charge_cooler_loss", "egr_heating",
    "bearing_friction", "egr_valve_leak", "vgt_offset", "injector_drift", "compressor_efficiency_loss",
    "turbine_efficiency_loss", "compressor_flow_loss", "volumetric_efficiency_residual", "blow_by", "p_im_offset",
    "p_em_offset", "p_em_gain", "w_egr_gain", "w_c_gain", "t_em_gain", FLAP,
)  # fmt: skip
"""Families that an engine at rest shows."""


@dataclass(frozen=True)
class _Machine:
    parameters: Mapping[str, Any]
    maps: MapErrors
    sensors: SensorSet


def draw_points(
    number: int, seed: int, *, healthy: bool = False
) -> tuple[pd.DataFrame, pd.DataFrame | None, dict[str, Any]]:
    """Points as they are now, those of the reference (None without one), and the answers.

    Args:
        number: of the case, from 1 on; seed: of the benchmark.
        healthy: nothing is wrong in any.
    """
    rng = np.random.default_rng([seed, number])
    laboratory: Mapping[str, Any] = we2011.PARAMETERS.model_dump()
    faulty = rng.random() >= HEALTHY_SHARE and not healthy
    family = FAMILIES[str(rng.choice(SETTLED))]
    size = min(family.tolerance * LARGEST_RATIO ** rng.random(), family.upper)
    size *= -1.0 if family.signed and rng.random() < 0.5 else 1.0
    faults = (Fault(family.name, size),) if faulty else ()
    flap = faulty and family.name == FLAP
    alone = flap or (not faulty and rng.random() < WITHOUT_REFERENCE)
    then, wear = draw_health(laboratory, rng)
    if alone:  # there is no before
        wear = dict.fromkeys(wear, 1.0)
    maps, sensors = MapErrors.draw(ALONE_RMS if alone else TIERS["own-engine"], rng), SensorSet.draw(rng)
    now = _Machine(weather(worn(then, wear), laboratory, rng), maps, sensors)
    count = REFERENCE_COUNT if alone else int(rng.choice(COUNTS))
    table = _measured(now, count, faults, flap or (alone and rng.random() < 0.5), rng)
    before = _Machine(weather(then, laboratory, rng), maps, sensors)
    reference = None if alone else _measured(before, REFERENCE_COUNT, (), False, rng)
    answers = {
        "case": f"case_{number:04d}", "kind": "single" if faulty else "healthy", "withhold": [], "route": "points",
        "partial": None, "points": len(table), "reference": 0 if reference is None else len(reference),
        "effects": [fault.document() for fault in faults],
        "health": {name: now.parameters[name] for name in wear}, "sensors": sensors.document(),
        **({} if alone else {"since_reference": wear}),
    }  # fmt: skip
    return table, reference, answers


def _measured(
    machine: _Machine, count: int, faults: Sequence[Fault], flap: bool, rng: np.random.Generator
) -> pd.DataFrame:
    """`count` settled points: averages of what the sensors show at the end of each."""
    held = round(SPARE * count)
    low, high = np.array(LOW), np.array(HIGH)
    at = low + (high - low) * rng.random((held, len(INPUTS)))
    at = at[np.argsort(at[:, 0] * at[:, 1])]  # from low to high power: neighbours settle soon
    rows = round(HOLD_S / SAMPLE_S)
    inputs = dict(zip(INPUTS, np.repeat(at, rows, axis=0).T, strict=True))
    position = rng.uniform(*FLAP_PCT, held)
    driving = Driving(SAMPLE_S * np.arange(held * rows), **inputs, kind="points", u_flap_pct=np.repeat(position, rows))
    run = run_plant(driving, machine.parameters, faults, machine.maps)
    shown = read(run, driving, faults, machine.sensors, len(SENSORS), rng)
    end = round(AVERAGED_S / SAMPLE_S)

    def halves(values: np.ndarray) -> np.ndarray:
        """Means of the two halves of what is averaged, (2, held)."""
        return values.reshape(held, rows)[:, -end:].reshape(held, 2, end // 2).mean(axis=2).T

    clean = {name: halves(run[name]).mean(axis=0) for name in OUTPUTS}
    drift = [np.abs(np.diff(halves(run[name]), axis=0)[0] / clean[name]) for name in ("omega_t_rad_s", "p_im_pa")]
    n_cyl, stoichiometric = float(machine.parameters["n_cyl"]), 14.57
    fuel = 1e-6 / 120.0 * at[:, 1] * n_cyl * at[:, 0]
    usable = (
        (np.max(drift, axis=0) < DRIFTING) & (clean["w_c_kg_s"] > AIR_LEAST * stoichiometric * fuel)
        & (clean["p_im_pa"] > BOOST_LEAST * machine.parameters["p_amb"]) & (clean["p_em_pa"] > clean["p_im_pa"])
    )  # fmt: skip
    chosen = rng.permutation(np.flatnonzero(usable))[:count]
    columns = dict(zip(INPUTS, at.T, strict=True))
    columns |= {name: halves(shown[name].to_numpy()).mean(axis=0) for name in SENSORS}
    if flap:
        columns["u_flap_pct"] = position
    table = pd.DataFrame({name: values[chosen] for name, values in columns.items()})
    return with_ambient(table, machine.parameters)
