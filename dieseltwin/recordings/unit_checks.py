"""Notes on columns that carry our names and may not be in our units: what balances between them say.

`plausibility` refuses what can't be; here is what can, and hardly is.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dieseltwin.recordings.derived import fuel_per_stroke
from dieseltwin.recordings.guess.physics import WHEEL_RADIUS_M, exhaust_in_doubt, wheel_radius

LOW_QUANTILE = 0.05
BELOW_AMBIENT = {"p_im_pa": 0.6, "p_em_pa": 0.9}  # of the ambient pressure: a throttle makes 0.7 of it, an exhaust none
UNMEASURED = 0.75  # of these, where nobody measured the ambient: roads end at 4 km
DRIVEN = 1.2  # pressure ratio from which the compressor's speed follows from it
RADIUS_SLACK = 1.5  # of the wheels in `WHEEL_RADIUS_M`
LEAST_ROWS = 20
LEAST_FUEL_MG = 2.0  # in the richest twentieth of the rows of any engine under load
FUEL_OFF = 0.15  # that a flow may be off from the injected fuel: injectors drift by less
MOST_EGR = 0.8  # of the charge, in the twentieth of the rows with the highest share
UPHILL = 0.8  # of the rows with much EGR flow: it can't flow against the pressure for long
SHUT_PCT = 1.0  # a position below is a shut valve; a turbine with variable geometry has none
SHUT_ROWS = 0.1  # of the rows, from which a valve is shut now and then
STOPS = 0.1  # of its usual flow: EGR stops there


def unit_notes(columns: Mapping[str, np.ndarray], p_amb_pa: float, cylinders: int) -> list[str]:
    """A sentence for each column that may be in another unit, gauge, or count the wrong way.

    Args:
        columns: our column name -> (n,), NaN where missing.
        p_amb_pa: ambient pressure, for recordings without one [Pa].
        cylinders: of the engine.
    """
    found = [*_gauge(columns, p_amb_pa), *_turbo_speed(columns, p_amb_pa)]
    fuel = columns.get("u_delta_mg")
    if fuel is not None and (most := float(np.nanquantile(fuel, 1.0 - LOW_QUANTILE))) < LEAST_FUEL_MG:
        found.append(f"u_delta_mg is hardly ever above {most:.3g}: is this g or kg instead of mg/cycle?")
    found += _fuel_flow(columns, cylinders)
    air, egr = columns.get("w_c_kg_s"), columns.get("w_egr_kg_s")
    if air is not None and egr is not None:
        flows = np.isfinite(air) & np.isfinite(egr) & (air + egr > 0.0)
        if np.count_nonzero(flows) >= LEAST_ROWS:
            share = float(np.quantile(egr[flows] / (air + egr)[flows], 1.0 - LOW_QUANTILE))
            if share > MOST_EGR:
                found.append(f"w_egr_kg_s is up to {share:.0%} of the charge: is it in the unit of w_c_kg_s, or are "
                             "the two swapped?")  # fmt: skip
    doubt = exhaust_in_doubt(columns, cylinders)
    return [*found, *([f"t_em_k {doubt}"] if doubt else []), *_swapped(columns)]


def _fuel_flow(columns: Mapping[str, np.ndarray], cylinders: int) -> list[str]:
    """A fuel flow that isn't what the injected fuel says."""
    flow, fuel, speed = (columns.get(name) for name in ("w_f_kg_s", "u_delta_mg", "n_e_rpm"))
    if flow is None or fuel is None or speed is None:
        return []
    injected = np.isfinite(fuel) & (fuel > LEAST_FUEL_MG)
    ratio = fuel_per_stroke(flow, speed, cylinders)[injected] / fuel[injected]
    if np.count_nonzero(np.isfinite(ratio)) < LEAST_ROWS:
        return []
    middle = float(np.nanmedian(ratio))
    if abs(middle - 1.0) < FUEL_OFF:
        return []
    return [f"w_f_kg_s is {middle:.3g} times what u_delta_mg gives {cylinders} cylinders: are the units and the number "
            "of cylinders right?"]  # fmt: skip


def _swapped(columns: Mapping[str, np.ndarray]) -> list[str]:
    """Columns that stand for each other: what the EGR flow says of the pressures and of the positions."""
    egr = columns.get("w_egr_kg_s")
    if egr is None or not np.isfinite(egr).any():
        return []
    found = []
    boost, exhaust = columns.get("p_im_pa"), columns.get("p_em_pa")
    much = egr > max(0.0, float(np.nanmedian(egr)))
    if boost is not None and exhaust is not None:
        both = much & np.isfinite(boost) & np.isfinite(exhaust)
        if np.count_nonzero(both) >= LEAST_ROWS and (share := float(np.mean((exhaust < boost)[both]))) > UPHILL:
            found.append(f"p_em_pa lies below p_im_pa in {share:.0%} of rows with much EGR flow: are the two swapped?")
    valve, turbine = columns.get("u_egr_pct"), columns.get("u_vgt_pct")
    if valve is not None and turbine is not None:
        shut = (turbine <= SHUT_PCT) & np.isfinite(egr)
        open_ = (turbine > SHUT_PCT) & np.isfinite(egr)
        if min(shut.sum(), open_.sum()) >= max(LEAST_ROWS, SHUT_ROWS * egr.size) and (
            np.nanmedian(egr[shut]) < STOPS * np.nanmedian(egr[open_])
        ):
            found.append("EGR flows only where u_vgt_pct is above 0: are u_egr_pct and u_vgt_pct swapped?")
    return found


def _gauge(columns: Mapping[str, np.ndarray], p_amb_pa: float) -> list[str]:
    ambient = columns.get("p_amb_pa")
    measured = ambient is not None and bool(np.isfinite(ambient).any())
    level = float(np.nanmedian(ambient)) if ambient is not None and measured else UNMEASURED * p_amb_pa
    notes = []
    for name, share in BELOW_AMBIENT.items():
        if name not in columns:
            continue
        low = float(np.nanquantile(columns[name], LOW_QUANTILE))
        if low < share * level:
            notes.append(f"{name} comes down to {low:.4g} Pa, far below the ambient's {level:.4g}: if it is a gauge "
                         "pressure, say via: gauge in a channel map (--channels)")  # fmt: skip
    return notes


def _turbo_speed(columns: Mapping[str, np.ndarray], p_amb_pa: float) -> list[str]:
    speed, boost = columns.get("omega_t_rad_s"), columns.get("p_im_pa")
    if speed is None or boost is None:
        return []
    ratio = boost / columns.get("p_amb_pa", np.full(boost.size, p_amb_pa))
    driven = (ratio > DRIVEN) & np.isfinite(speed)
    if np.count_nonzero(driven) < LEAST_ROWS:
        return []
    radius = wheel_radius(speed[driven], ratio[driven])
    if WHEEL_RADIUS_M[0] / RADIUS_SLACK <= radius <= WHEEL_RADIUS_M[1] * RADIUS_SLACK:
        return []
    return [f"omega_t_rad_s makes the boost with a wheel of {1e3 * radius:.0f} mm radius: is it in Hz or another unit?"]
