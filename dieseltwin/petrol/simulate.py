"""Free run of the calibrated petrol engine: manifold pressure and metered air flow from the inputs, effects included.

Inputs are what the model doesn't describe: speed, throttle position, state before the throttle (p_ic, T_ic: no model of
the turbocharger) and surroundings. The one state is p_im; it is solved implicitly, as the throttle is stiff when wide
open. Faults of the inputs' sensors are undone first, faults of the foretold sensors (p_im, W_af) are put on their
readings, so that a repaired engine foretells what the faulty sensors read.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dieseltwin.arrays import Array
from dieseltwin.engine.binding import bind
from dieseltwin.errors import InputError
from dieseltwin.inner import kernel
from dieseltwin.notes import Note
from dieseltwin.petrol.blocks import LEAST_FLOW
from dieseltwin.petrol.components import (
    CHOKED_FACTOR,
    CRITICAL,
    GAMMA,
    LEAK_LINEAR_ABOVE,
    LINEAR_ABOVE,
    R_A,
    displaced_flow,
    nozzle_factor,
    storage_flow,
)
from dieseltwin.petrol.effects import HYPOTHESES, later, metered, undo_all
from dieseltwin.petrol.maps import STRAIGHT, spline_basis, tensor_value
from dieseltwin.petrol.model import opening, outside
from dieseltwin.petrol.parameters import PetrolParameters
from dieseltwin.petrol.recording import PetrolRecording, Signals, gaps
from dieseltwin.petrol.terms import active_sizes

SPEEDS, PRESSURES, FACTORS = 78, 192, 80  # points of the tables that the maps are looked up in
LEAST_PRESSURE, ABOVE_P_IC = 5e3, 1.02  # Pa; largest p_im over p_ic [-]: the solution is looked for between
HALVINGS = 40
LONGEST_ROW_S, LEAST_BEYOND_S = 1.0, 1.0  # a row counts for no more behind a gap; less than that is no news
SLOPE_S = 0.35  # over which the filling of the volume before the throttle is taken, as in the balances
READ = ("p_im_gain", "p_im_offset", "p_im_late")  # faults of the state's sensor


_nozzle_flow_factor = bind("numba").nozzle_flow_factor


@kernel()  # type: ignore[untyped-decorator]
def _psi(quotient, linear_above):  # type: ignore[no-untyped-def]
    """Flow factor of a nozzle, as `components.nozzle_factor`."""
    if quotient >= 1.0:
        return 0.0
    if quotient <= CRITICAL:  # most of the time; a known number is faster
        return CHOKED_FACTOR
    psi = _nozzle_flow_factor(min(quotient, linear_above), GAMMA, CRITICAL)
    return psi * min((1.0 - quotient) / (1.0 - linear_above), 1.0)


@kernel()  # type: ignore[untyped-decorator]
def _looked_up(x, low, step, table):  # type: ignore[no-untyped-def]
    place = min(max((x - low) / step, 0.0), len(table) - 1.000001)
    k = int(place)
    return table[k] + (place - k) * (table[k + 1] - table[k])


@kernel()  # type: ignore[untyped-decorator]
def _inflow(p, k, inputs, eta, eta_low, eta_step, factor, factor_step):  # type: ignore[no-untyped-def]
    """Flow through the throttle, through a leak into the manifold, and into the cylinders at pressure p [kg/s]."""
    area, p_ic, T_ic, leak, p_amb, T_amb, per_p, row = inputs[k]
    psi = _psi(p / p_ic, LINEAR_ABOVE)
    through = area * np.exp(_looked_up(psi, 0.0, factor_step, factor)) * p_ic / np.sqrt(R_A * T_ic) * psi
    inward = 0.0
    if leak > 0.0:
        out = p / np.sqrt(R_A * T_ic) * _psi(p_amb / p, LEAK_LINEAR_ABOVE)
        inward = leak * (p_amb / np.sqrt(R_A * T_amb) * _psi(p / p_amb, LEAK_LINEAR_ABOVE) - out)
    place = min(max(row, 0.0), eta.shape[0] - 1.000001)
    i = int(place)
    share, x = place - i, np.log(p)
    log_eta = (1.0 - share) * _looked_up(x, eta_low, eta_step, eta[i])
    log_eta += share * _looked_up(x, eta_low, eta_step, eta[i + 1])
    return through, inward, np.exp(log_eta) * per_p * p


@kernel()  # type: ignore[untyped-decorator]
def _integrated(time_s, starts, inputs, first, V_im, eta, eta_low, eta_step, factor, factor_step):  # type: ignore[no-untyped-def]
    """p_im [Pa] at the rows, implicit Euler; anew at `starts`, at rest where `first` is not a number."""
    out = np.empty(len(time_s))
    piece = 0
    for k in range(len(time_s)):
        begins = piece < len(starts) and starts[piece] == k
        known = first[piece] if begins else out[k - 1]
        if begins:
            piece += 1
            if np.isfinite(known):
                out[k] = known
                continue
        # p - p_before = h R T/V (inflow - outflow): the right side falls with p, so halving finds the only solution
        stiff = 1e12 if begins else (time_s[k] - time_s[k - 1]) * R_A * inputs[k, 2] / V_im
        low, high = LEAST_PRESSURE, ABOVE_P_IC * max(inputs[k, 1], inputs[k, 4])
        for _ in range(HALVINGS):
            p = 0.5 * (low + high)
            through, inward, outward = _inflow(p, k, inputs, eta, eta_low, eta_step, factor, factor_step)
            rise = stiff * (through + inward - outward) - (0.0 if begins else p - known)
            if rise > 0.0:
                low = p
            else:
                high = p
        out[k] = 0.5 * (low + high)
    return out


def simulate_petrol(engine: PetrolParameters, recording: PetrolRecording) -> pd.DataFrame:
    """Readings and inner flows over the inputs of a recording; each row one of its rows.

    Args:
        engine: calibrated; its terms act.
        recording: gives inputs, and p_im at the first row of each piece between gaps.

    Returns:
        time_s, the inputs as read, p_im_pa and w_af_kg_s as the sensors would read them, and true p_im_true_pa,
        w_th_kg_s, w_ei_kg_s, w_leak_kg_s, eta_vol.

    Raises:
        InputError: not calibrated, or a result that is not finite.
    """
    sizes = active_sizes(engine, recording)
    of_inputs = {n: v for n, v in sizes.items() if n not in READ and HYPOTHESES[n].kind in ("sensor", "actuator")}
    of_inputs = {n: v for n, v in of_inputs.items() if not n.startswith("w_af")}
    s = undo_all(engine.clocks, undo_all(of_inputs, recording.signals))
    inputs, tables = _inputs(engine, s, sizes)
    starts = gaps(s.time_s)
    true = undo_all({n: v for n, v in sizes.items() if n in READ}, recording.signals)
    p_im = _integrated(s.time_s, starts, inputs, true.p_im[starts], engine.volumes.V_im, *tables)
    flows = np.array([_inflow(p_im[k], k, inputs, *tables) for k in range(len(p_im))])
    through, inward, taken_in = flows.T
    leak_before = undo_all({n: v for n, v in sizes.items() if n == "boost_leak"}, s).leak_ic
    filling = storage_flow(_rate(s.p_ic, s.time_s, starts), s.T_ic, engine.volumes.V_ic)
    W_af = np.maximum(through + filling + (0.0 if leak_before is None else leak_before), LEAST_FLOW)
    read = p_im * (1.0 + sizes.get("p_im_gain", 0.0)) + sizes.get("p_im_offset", 0.0)
    read = later(s.time_s, read, sizes.get("p_im_late", 0.0))
    late = sizes.get("w_af_late", 0.0) + engine.clocks.get("w_af_late", 0.0)
    metered_late = later(s.time_s, metered(sizes, W_af), late)
    raw = recording.signals
    table = pd.DataFrame({
        "time_s": raw.time_s + recording.time0_s, "p_ic_pa": raw.p_ic, "t_ic_k": raw.T_ic, "omega_e_rad_s": raw.omega_e,
        "alpha_th_pct": raw.alpha, "p_amb_pa": raw.p_amb, "t_amb_k": raw.T_amb, "p_im_pa": read,
        "w_af_kg_s": metered_late, "p_im_true_pa": p_im, "w_th_kg_s": through, "w_ei_kg_s": taken_in,
        "w_leak_kg_s": inward, "eta_vol": taken_in / displaced_flow(p_im, s.omega_e, s.T_ic, engine.volumes.V_d),
    })  # fmt: skip
    if not np.isfinite(table.to_numpy(dtype=np.float64)).all():
        raise InputError(f"simulating {recording.path}", "values that are not finite", "inputs of a running engine",
                         "check the inputs and --engine")  # fmt: skip
    return table


def beyond_maps(engine: PetrolParameters, frame: pd.DataFrame) -> list[Note]:
    """How long a simulation (`simulate_petrol`) is too far beyond what was learned; none where it isn't."""
    p_im = frame["p_im_true_pa"].to_numpy()
    rows: Any = SimpleNamespace(
        omega_e=frame["omega_e_rad_s"].to_numpy(), p_im=p_im, alpha=frame["alpha_th_pct"].to_numpy(),
        psi=nozzle_factor(p_im / frame["p_ic_pa"].to_numpy()),
    )  # fmt: skip
    both = outside(rows, *engine.maps).values()
    far = np.any([np.abs(steps) > STRAIGHT for arguments in both for steps in arguments], axis=0)
    steps = np.diff(frame["time_s"].to_numpy(), append=frame["time_s"].iloc[-1])
    seconds = float(np.sum(np.minimum(steps, LONGEST_ROW_S)[far]))
    if seconds < LEAST_BEYOND_S:
        return []
    return [Note(f"{seconds:.0f} s lie too far beyond the driving that the engine was learned from, and are "
                 "extrapolated; learn it from driving that goes as far", "extrapolated")]  # fmt: skip


def _inputs(
    engine: PetrolParameters, s: Signals, sizes: Mapping[str, Array]
) -> tuple[Array, tuple[Array, float, float, Array, float]]:
    """(n, 8) inputs of each row, and the tables of the maps: log eta_vol over speed and log p_im, c over Psi."""
    cylinder, throttle = engine.maps
    none = np.zeros(len(s.time_s))
    knots = np.array(throttle.knots_x)
    theta = np.array(throttle.coefficients)
    log_area = spline_basis(opening(s.alpha), knots) @ theta[: len(knots) + 2]
    area = np.exp(log_area) * (1.0 + sizes.get("throttle_area_change", none))
    speeds, pressures = _table_axis(cylinder.knots_x, SPEEDS), _table_axis(cylinder.knots_y, PRESSURES)
    x, y = (grid.ravel() for grid in np.meshgrid(speeds, pressures, indexing="ij"))
    eta = tensor_value(x, y, np.array(cylinder.knots_x), np.array(cylinder.knots_y), np.array(cylinder.coefficients))
    psi = np.linspace(0.0, throttle.knots_y[-1], FACTORS)
    factor = spline_basis(psi, np.array(throttle.knots_y)) @ theta[len(knots) + 2 :]
    change = 1.0 + sizes.get("volumetric_efficiency_change", none)
    per_pressure = change * displaced_flow(np.ones(len(area)), s.omega_e, s.T_ic, engine.volumes.V_d)
    row = (s.omega_e - speeds[0]) / (speeds[1] - speeds[0])
    inputs = np.stack(
        [area, s.p_ic, s.T_ic, sizes.get("intake_leak", none), s.p_amb, s.T_amb, per_pressure, row], axis=1
    )
    return inputs, (eta.reshape(SPEEDS, PRESSURES), float(pressures[0]), float(pressures[1] - pressures[0]), factor,
                    float(psi[1] - psi[0]))  # fmt: skip


def _table_axis(knots: tuple[float, ...], points: int) -> Array:
    """(points,) arguments of a map's table, evenly: as far beyond the knots as the map goes straight on."""
    first, last = STRAIGHT * (knots[1] - knots[0]), STRAIGHT * (knots[-1] - knots[-2])
    return np.linspace(knots[0] - first, knots[-1] + last, points)


def _rate(x: Array, time_s: Array, starts: NDArray[np.int64]) -> Array:
    """dx/dt over SLOPE_S about each row [unit/s], within the pieces between gaps."""
    out = np.empty(len(x))
    for a, b in pairwise([*starts, len(x)]):
        half = max(round(0.5 * SLOPE_S / float(np.median(np.diff(time_s[a:b])))), 1) if b - a > 1 else 0
        at = np.arange(a, b)
        low, high = np.maximum(at - half, a), np.minimum(at + half, b - 1)
        out[a:b] = (x[high] - x[low]) / np.maximum(time_s[high] - time_s[low], 1e-3)
    return out
