"""The benchmark's plant: the engine written a second time, so that a proof doesn't share its error with what it proves.

Nothing of `dieseltwin.engine` is imported. The formulas are those of Wahlström & Eriksson (2011) with the published
simulation's limiters, written anew over plain scalars; Heun's method at 5 ms instead of the twin's RK4 at 12.5 ms; the
cylinder's fixed point is carried from step to step; every empirical map is multiplied by a smooth error field of one's
choice. Left-out physics are switched on by `plant_effects.Fault`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dieseltwin.challenge.actuators import fine_command, fine_fuel, lag
from dieseltwin.challenge.driving import Driving
from dieseltwin.challenge.map_errors import MapErrors
from dieseltwin.challenge.plant_constants import plant_constants
from dieseltwin.challenge.plant_effects import KERNEL_EFFECTS, KERNEL_SLOT, Fault, schedule
from dieseltwin.inner import inner, kernel

STEP_S = 0.005
"""Integration step [s]: half the fastest time constant (p_em, 11 ms)."""

SAMPLE_S = 0.2
T_WALL = 360.0  # K, of the ports that heat the charge
SOLVED = 1e-10  # kg/s, of the flows through filter and back-pressure
WARM_UP_S = 40.0
"""Seconds of the first inputs, held, before a recording begins: actuators, pressures and most of the turbo settle."""

OUTPUTS = (
    "p_im_pa", "p_em_pa", "omega_t_rad_s", "w_egr_kg_s", "t_em_k", "w_c_kg_s", "w_t_kg_s", "w_ei_kg_s", "w_eo_kg_s",
    "t_im_k", "w_leak_im_kg_s", "w_leak_em_kg_s", "p_es_pa", "p_bc_pa", "p_f_w", "t_read_k", "eta_c", "eta_tm",
    "phi_c", "psi_c", "pi_t", "u_egr_act_pct", "u_vgt_act_pct",
)  # fmt: skip


_E = {name: k for k, name in enumerate(KERNEL_EFFECTS)}
(E_BOOST_LEAK, E_EXHAUST_LEAK, E_BACK_PRESSURE, E_FILTER, E_COOLER, E_EGR_HEATING, E_FRICTION, E_GAS_LAG, E_VALVE_LEAK,
 E_CLOGGING, E_VGT_OFFSET, E_INJECTOR, E_ETA_C, E_ETA_T, E_W_C, E_ETA_VOL, E_BLOW_BY, E_COUPLE_LAG, E_WINDAGE,
 E_PORT_HEAT, E_AFTERBURN, E_PICKUP, E_EGR_OFFSET) = range(len(KERNEL_EFFECTS))  # fmt: skip


@inner(forceinline=True, error_model="numpy")
def _nozzle(area, p_up, T_up, p_down, R, gamma):  # type: ignore[no-untyped-def]
    """Isentropic nozzle without discharge coefficient [kg/s]; no back-flow."""
    if area == 0.0 or p_up <= p_down:
        return 0.0
    critical = (2.0 / (gamma + 1.0)) ** (gamma / (gamma - 1.0))
    ratio = max(p_down / p_up, critical)
    psi = np.sqrt(2.0 * gamma / (gamma - 1.0) * (ratio ** (2.0 / gamma) - ratio ** ((gamma + 1.0) / gamma)))
    return area * p_up / np.sqrt(R * T_up) * psi


@inner(forceinline=True, error_model="numpy")
def _table(table, low, high, x, y):  # type: ignore[no-untyped-def]
    """Bilinear look-up, held beyond the edge; coordinates over [low, high]."""
    nx, ny = table.shape
    a = min(max((x - low[0]) / (high[0] - low[0]), 0.0), 1.0) * (nx - 1)
    b = min(max((y - low[1]) / (high[1] - low[1]), 0.0), 1.0) * (ny - 1)
    i = min(int(a), nx - 2)
    j = min(int(b), ny - 2)
    a -= i
    b -= j
    return (1.0 - a) * ((1.0 - b) * table[i, j] + b * table[i, j + 1]) + a * (
        (1.0 - b) * table[i + 1, j] + b * table[i + 1, j + 1]
    )


@inner(forceinline=True, error_model="numpy")
def _compressor(p_im, omega, p_bc, c, errors, low, high):  # type: ignore[no-untyped-def]
    """Flow [kg/s], pressure quotient, heating factor, Psi, Phi of the compressor behind p_bc."""
    Pi_c = max(p_im / p_bc, 1.0)
    heating = Pi_c ** ((c.gamma_a - 1.0) / c.gamma_a) - 1.0
    tip = c.R_c * omega
    psi = 2.0 * c.c_pa * c.T_amb * heating / (tip * tip)
    e_psi = max(c.c_omega_psi2 + omega * (c.c_omega_psi1 + omega * c.c_omega_psi0), 0.0)
    e_phi = max(c.c_omega_phi2 + omega * (c.c_omega_phi1 + omega * c.c_omega_phi0), 0.1)
    phi = np.sqrt(max((1.0 - e_psi * (psi - c.c_psi2) ** 2) / e_phi, 0.0)) + c.c_phi2
    phi *= 1.0 + _table(errors[5], low[5], high[5], psi, omega)
    flow = max(p_bc * np.pi * c.R_c**3 * omega / (c.R_a * c.T_amb) * phi, 1e-4)
    return flow, Pi_c, heating, psi, phi


@inner(forceinline=True, error_model="numpy")
def _turbine(p_em, T_em, position, p_es, c, errors, low, high):  # type: ignore[no-untyped-def]
    """Flow [kg/s] and pressure quotient of the turbine before p_es."""
    Pi_t = min(p_es / p_em, 0.9999)
    angle = (position - c.c_vgt2) / c.c_vgt1
    opening = c.c_f2 + c.c_f1 * np.sqrt(max(1.0 - angle * angle, 0.0))
    opening *= np.sqrt(max(1.0 - Pi_t**c.K_t, 0.0)) * (1.0 + _table(errors[2], low[2], high[2], position, Pi_t))
    return c.A_vgtmax * p_em * opening / np.sqrt(T_em * c.R_e), Pi_t


@inner(error_model="numpy")
def rates(y, carry, n_e, u_delta, u_egr, u_vgt, c, e, errors, low, high, sweeps, dy, out):  # type: ignore[no-untyped-def]
    """Right-hand side dy of y = (p_im, p_em, omega_t, lagged gas temperature); `carry` = (x_r, T_1, T_im).

    e: magnitudes of `KERNEL_EFFECTS` in force now; errors (7, k, k) map errors over [low, high], each (7, 2);
    out: `OUTPUTS` but for the thermocouple's reading.
    """
    p_im, p_em, omega = y[0], y[1], y[2]
    fuel = u_delta * (1.0 + e[E_INJECTOR])
    W_f = fuel * 1e-6 * c.n_cyl * n_e / 120.0

    # compressor, through a filter that is solved and not lagged: the flow falls with the flow's own pressure loss
    p_bc = c.p_amb
    W_c, Pi_c, heating, psi, phi = _compressor(p_im, omega, p_bc, c, errors, low, high)
    if e[E_FILTER] > 0.0:
        # Illinois: the excess of the flow over its guess falls with the guess and is W_c at no guess at all
        least, at_least, most, at_most, side = 0.0, W_c, W_c, 0.0, 0
        guess = W_c
        for _ in range(60):
            p_bc = max(c.p_amb - e[E_FILTER] * guess * guess, 0.3 * c.p_amb)
            W_c, Pi_c, heating, psi, phi = _compressor(p_im, omega, p_bc, c, errors, low, high)
            excess = W_c - guess
            if abs(excess) < SOLVED:
                break
            if excess > 0.0:
                least, at_least = guess, excess
                at_most *= 0.5 if side == 1 else 1.0
                side = 1
            else:
                most, at_most = guess, excess
                at_least *= 0.5 if side == -1 else 1.0
                side = -1
            guess = (least * at_most - most * at_least) / (at_most - at_least)
    W_c *= 1.0 - e[E_W_C]
    bent = (Pi_c - 1.0) ** c.c_pi - c.pi_copt
    off = W_c - c.W_copt
    eta_c = max(c.eta_cmax - (c.Q_c0 * off * off + 2.0 * c.Q_c2 * off * bent + c.Q_c1 * bent * bent), 0.2)
    eta_c *= (1.0 + _table(errors[4], low[4], high[4], W_c, Pi_c)) * (1.0 - e[E_ETA_C])
    P_c = W_c * c.c_pa * c.T_amb * heating / eta_c

    # cylinder: intake temperature, flow, limited-pressure cycle
    eta_vol = c.c_vol0 * np.sqrt(p_im) + c.c_vol1 * np.sqrt(n_e) + c.c_vol2
    eta_vol *= 1.0 + _table(errors[0], low[0], high[0], p_im, n_e)
    eta_vol *= (1.0 - e[E_ETA_VOL] * (p_em / p_im - 1.0)) * (1.0 - e[E_PORT_HEAT] * (1.0 - n_e / 2000.0))
    u = min(u_egr + e[E_EGR_OFFSET], -c.c_egr1 / (2.0 * c.c_egr0))
    f_egr = max(c.c_egr2 + u * (c.c_egr1 + u * c.c_egr0), 0.0) * (1.0 + errors_1d(errors[1], low[1], high[1], u))
    A_egr = c.A_egrmax * (f_egr + e[E_VALVE_LEAK]) * max(1.0 - e[E_CLOGGING], 0.0)
    Pi_egr = min(max(p_im / p_em, c.Pi_egropt), 1.0)
    parabola = (1.0 - Pi_egr) / (1.0 - c.Pi_egropt) - 1.0
    egr_factor = A_egr * p_em * (1.0 - parabola * parabola)

    compression = c.r_c ** (c.gamma_a - 1.0)
    pressure_quotient = p_em / p_im
    blow_down = pressure_quotient ** (1.0 / c.gamma_a)
    x_r, T_1, T_im = carry[0], carry[1], carry[2]
    cooled = c.T_im + e[E_COOLER] * c.T_amb * heating / eta_c
    W_ei, W_eo, T_em, T_gas, W_egr = 0.0, 0.0, 0.0, 0.0, 0.0
    if e[E_EGR_HEATING] > 0.0 or e[E_PICKUP] > 0.0:
        sweeps += 2
    else:
        T_im = cooled
    for _ in range(sweeps):
        W_ei = eta_vol * p_im * n_e * c.V_d / (120.0 * c.R_a * T_im)
        W_eo = W_f + W_ei * (1.0 - e[E_BLOW_BY])
        q = W_f * c.q_HV / (W_ei + W_f) * (1.0 - x_r)
        hot = T_1 * compression
        x_p = 1.0 + q * c.x_cv / (c.c_va * hot)
        x_v = 1.0 + q * (1.0 - c.x_cv) / (c.c_pa * (q * c.x_cv / c.c_va + hot))
        peak = x_p ** (1.0 / c.gamma_a)
        x_r = min(max(blow_down / (peak * c.r_c * x_v), 0.0), 1.0)
        T_e = q * ((1.0 - c.x_cv) / c.c_pa + c.x_cv / c.c_va) + hot
        T_e *= c.eta_sc * pressure_quotient / blow_down / compression * peak / x_p
        T_1 = max(x_r * T_e + (1.0 - x_r) * T_im, 273.0)
        loss = c.h_tot * np.pi * c.d_pipe * c.l_pipe * c.n_pipe / (max(W_eo, 1e-6) * c.c_pe)
        T_gas = c.T_amb + (T_e - c.T_amb) * np.exp(-loss)
        T_gas += e[E_AFTERBURN] * c.q_HV * W_f / (max(W_eo, 1e-6) * c.c_pe)
        T_em = y[3] if e[E_GAS_LAG] > 0.0 else T_gas
        W_egr = egr_factor / np.sqrt(T_em * c.R_e)
        if e[E_EGR_HEATING] > 0.0:
            T_im = cooled + e[E_EGR_HEATING] * (T_em - cooled) * W_egr / (W_c + W_egr)
        if e[E_PICKUP] > 0.0:  # the walls' heat goes into what the cylinders draw
            come = T_im if e[E_EGR_HEATING] > 0.0 else cooled
            T_im = come + e[E_PICKUP] * (T_WALL - come) / (W_ei * c.c_pa)
    carry[0], carry[1], carry[2] = x_r, T_1, T_im

    # turbine, before a back-pressure that is solved: the flow falls with the pressure that it makes
    position = u_vgt + e[E_VGT_OFFSET]
    p_es = c.p_amb
    W_t, Pi_t = _turbine(p_em, T_em, position, p_es, c, errors, low, high)
    if e[E_BACK_PRESSURE] > 0.0:
        least, at_least, most, at_most, side = 0.0, W_t, W_t, 0.0, 0
        guess = W_t
        for _ in range(60):
            p_es = c.p_amb + e[E_BACK_PRESSURE] * guess * guess * T_em / 700.0
            W_t, Pi_t = _turbine(p_em, T_em, position, p_es, c, errors, low, high)
            excess = W_t - guess
            if abs(excess) < SOLVED:
                break
            if excess > 0.0:
                least, at_least = guess, excess
                at_most *= 0.5 if side == 1 else 1.0
                side = 1
            else:
                most, at_most = guess, excess
                at_least *= 0.5 if side == -1 else 1.0
                side = -1
            guess = (least * at_most - most * at_least) / (at_most - at_least)
    drop = 1.0 - Pi_t ** ((c.gamma_e - 1.0) / c.gamma_e)
    bsr = min(c.R_t * omega / np.sqrt(2.0 * c.c_pe * T_em * drop), 2.0 * c.BSR_opt)
    if omega > c.omega_tlin:
        curvature = c.c_m0 * (omega - c.c_m1) ** c.c_m2
    else:
        curvature = max(c.c_mlin * (omega - c.c_m1) / (c.omega_tlin - c.c_m1), 0.0)
    eta_tm = min(max(c.eta_tmmax - curvature * (bsr - c.BSR_opt) ** 2, 0.2), 1.0)
    off = _table(errors[3], low[3], high[3], omega, Pi_t) + _table(errors[6], low[6], high[6], omega, bsr)
    eta_tm *= (1.0 + off) * (1.0 - e[E_ETA_T])
    P_t = eta_tm * W_t * c.c_pe * T_em * drop
    P_f = omega * omega * (e[E_FRICTION] + omega * e[E_WINDAGE])

    leak_im = _nozzle(e[E_BOOST_LEAK], p_im, T_im, c.p_amb, c.R_a, c.gamma_a)
    leak_em = _nozzle(e[E_EXHAUST_LEAK], p_em, T_em, c.p_amb, c.R_e, c.gamma_e)
    dy[0] = c.R_a * T_im / c.V_im * (W_c + W_egr - W_ei - leak_im)
    dy[1] = c.R_e * T_em / c.V_em * (W_eo - W_t - W_egr - leak_em)
    dy[2] = (P_t - P_c - P_f) / (c.J_t * omega)
    dy[3] = (T_gas - y[3]) / e[E_GAS_LAG] if e[E_GAS_LAG] > 0.0 else 0.0
    if e[E_GAS_LAG] == 0.0:
        y[3] = T_gas
    out[0], out[1], out[2], out[3], out[4], out[5], out[6] = p_im, p_em, omega, W_egr, T_em, W_c, W_t
    out[7], out[8], out[9], out[10], out[11], out[12], out[13] = W_ei, W_eo, T_im, leak_im, leak_em, p_es, p_bc
    out[14], out[16], out[17], out[18], out[19], out[20] = P_f, eta_c, eta_tm, phi, psi, Pi_t
    out[21], out[22] = u_egr, u_vgt


@inner(forceinline=True, error_model="numpy")
def errors_1d(table, low, high, x):  # type: ignore[no-untyped-def]
    """Look-up of a map of one argument: the first row of its table runs over it."""
    n = table.shape[0]
    a = min(max((x - low[0]) / (high[0] - low[0]), 0.0), 1.0) * (n - 1)
    i = min(int(a), n - 2)
    return table[i, 0] + (a - i) * (table[i + 1, 0] - table[i, 0])


@kernel(error_model="numpy", nogil=True)
def _integrate(inputs, step, every, first, c, which, sizes, factors, errors, low, high, start, out):  # type: ignore[no-untyped-def]
    """Heun's method over the fine inputs (4, N + 1); from step `first` on every `every`-th becomes a row of out."""
    y = np.array([start[0], start[1], start[2], 600.0])
    carry = np.array([0.03, 310.0, c.T_im])
    e = np.zeros(factors_of_kernel)
    dy_0, dy_1, guess, row, scratch = np.empty(4), np.empty(4), np.empty(4), np.empty(23), np.empty(23)
    couple, sample = -1.0, 0
    steps = inputs.shape[1] - 1
    # variables, no numbers: for each number the right-hand side would be compiled once more, seconds each
    once, twice, until_settled = np.int64(1), np.int64(2), np.int64(20)
    for k in range(which.size):
        e[which[k]] += sizes[k] * factors[k, 0]
    rates(y, carry, inputs[0, 0], inputs[1, 0], inputs[2, 0], inputs[3, 0], c, e, errors, low, high,
          until_settled, dy_0, row)  # fmt: skip
    if e[E_GAS_LAG] > 0.0:  # settle the lagged gas temperature: the lag is off for one evaluation
        tau, e[E_GAS_LAG] = e[E_GAS_LAG], 0.0
        rates(y, carry, inputs[0, 0], inputs[1, 0], inputs[2, 0], inputs[3, 0], c, e, errors, low, high,
              until_settled, dy_0, row)  # fmt: skip
        e[E_GAS_LAG] = tau
    for i in range(steps + 1):
        for k in range(which.size):
            e[which[k]] = 0.0
        for k in range(which.size):
            e[which[k]] += sizes[k] * factors[k, i]
        rates(y, carry, inputs[0, i], inputs[1, i], inputs[2, i], inputs[3, i], c, e, errors, low, high, twice, dy_0,
              row)  # fmt: skip
        if couple < 0.0 or e[E_COUPLE_LAG] == 0.0:
            couple = row[4]
        else:  # the couple follows the gas, held over the step at its temperature at the step's end
            couple += (row[4] - couple) * (1.0 - np.exp(-step / e[E_COUPLE_LAG]))
        if i >= first and (i - first) % every == 0:
            for j in range(23):
                out[sample, j] = row[j]
            out[sample, 15] = couple
            sample += 1
        if i == steps:
            break
        for j in range(4):
            guess[j] = y[j] + step * dy_0[j]
        rates(guess, carry, inputs[0, i + 1], inputs[1, i + 1], inputs[2, i + 1], inputs[3, i + 1], c, e, errors, low,
              high, once, dy_1, scratch)  # fmt: skip
        for j in range(4):
            y[j] += 0.5 * step * (dy_0[j] + dy_1[j])
        if e[E_GAS_LAG] == 0.0:
            y[3] = guess[3]
        y[0] = min(max(y[0], 0.5 * c.p_amb), 10.0 * c.p_amb)
        y[1] = min(max(y[1], 0.5 * c.p_amb), 20.0 * c.p_amb)
        y[2] = min(max(y[2], 100.0 * np.pi / 30.0), 2e5 * np.pi / 30.0)


factors_of_kernel = len(KERNEL_EFFECTS)


@dataclass(frozen=True)
class PlantRun:
    """Clean signals of the plant at the samples of its driving: column -> (n,) [SI]; `time_s` among them."""

    columns: dict[str, np.ndarray]

    def __getitem__(self, name: str) -> np.ndarray:
        return self.columns[name]


def run_plant(
    driving: Driving,
    parameters: Mapping[str, Any],
    faults: Sequence[Fault] = (),
    maps: MapErrors | None = None,
    *,
    initial: np.ndarray | None = None,
    step_s: float = STEP_S,
    warm_up_s: float = WARM_UP_S,
) -> PlantRun:
    """Clean signals of the plant over its driving.

    Args:
        driving: inputs at equal steps, linear in between.
        parameters: published parameter values by name (health parameters included).
        faults: left-out physics and actuator faults; those of sensors are applied by `sensors.read`.
        maps: errors of the empirical maps; None for the published maps.
        initial: p_im, p_em [Pa], omega_t [rad/s] at the first sample; None: settled at the first inputs.
        step_s: integration step [s], a whole part of the driving's step.
        warm_up_s: time at the first inputs before the recording [s]; ignored with `initial`.
    """
    sample_s = float(driving.time_s[1] - driving.time_s[0])
    every = round(sample_s / step_s)
    steps = (driving.time_s.size - 1) * every
    before = 0 if initial is not None else round(warm_up_s / step_s)
    fine_s = driving.time_s[0] + step_s * np.arange(-before, steps + 1)
    maps = MapErrors.none() if maps is None else maps
    inputs = np.empty((4, fine_s.size))
    inputs[0] = np.interp(fine_s, driving.time_s, driving.n_e_rpm)
    inputs[1] = fine_fuel(fine_s, driving, faults)
    egr = fine_command(fine_s, driving, "egr", float(parameters["tau_degr"]), faults)
    vgt = fine_command(fine_s, driving, "vgt", float(parameters["tau_dvgt"]), faults)
    overshoot = float(parameters["K_egr"])
    inputs[2] = overshoot * lag(egr, step_s, float(parameters["tau_egr1"])) - (overshoot - 1.0) * lag(
        egr, step_s, float(parameters["tau_egr2"])
    )
    inputs[3] = lag(vgt, step_s, float(parameters["tau_vgt"]))
    slots = [KERNEL_SLOT.get(fault.effect, fault.effect) for fault in faults]
    inside = [(slot, fault) for slot, fault in zip(slots, faults, strict=True) if slot in KERNEL_EFFECTS]
    factors = np.array([schedule(fault, fine_s, driving) for _, fault in inside]).reshape(len(inside), fine_s.size)
    which = np.array([_E[slot] for slot, _ in inside], dtype=np.int64)
    sizes = np.array([fault.magnitude for _, fault in inside], dtype=np.float64)
    start = np.array([1.2e5, 1.3e5, 3000.0]) if initial is None else np.asarray(initial, dtype=np.float64)
    out = np.empty((driving.time_s.size, len(OUTPUTS)))
    _integrate(inputs, step_s, every, before, plant_constants(parameters), which, sizes, factors, maps.tables, maps.low,
               maps.high, start, out)  # fmt: skip
    columns = dict(driving.columns())
    columns.update({name: out[:, j].copy() for j, name in enumerate(OUTPUTS)})
    return PlantRun(columns)
