"""Variables of the diesel engine along a trajectory, by the names that ports, tolerances and laws use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dieseltwin.discovery.twins.interface import Array, Point
from dieseltwin.engine import Actuation, EngineParameters
from dieseltwin.engine.extended_frame import extended_frame

_W_EGR, _T_EM, _W_C = 3, 4, 5  # columns of readings


@np.errstate(invalid="ignore")  # of a lane that ran away
def variables_along(
    states: Array, readings: Array, actuation: Actuation, c: EngineParameters,
    signals_at: tuple[Mapping[str, Array], Sequence[Point]],
) -> dict[str, Array]:  # fmt: skip
    """Name -> (n,) [SI, %, mg/cycle, rpm]; where a signal enters a quantity, `<name>:before` is it without that signal.

    Args:
        states: (n, 6) as of `simulate_extended`; readings: (n, 6) in the order of `MEASURED`, without sensors' faults.
        actuation: of the trajectory.
        c: engine of the trajectory, without laws: these are among the signals.
        signals_at: point -> signal (n,), and the twin's points.
    """
    signals, points = signals_at
    frame = extended_frame(states, actuation, c)
    if signals:  # the frame knows none: the simulation's own flows and temperature do
        for name, column in (("w_egr_kg_s", _W_EGR), ("t_em_k", _T_EM), ("w_c_kg_s", _W_C)):
            frame[name] = readings[:, column]
    p_im, p_em = frame["p_im_pa"].to_numpy(), frame["p_em_pa"].to_numpy()
    omega, T_em = frame["omega_t_rad_s"].to_numpy(), frame["t_em_k"].to_numpy()
    p_es, p_bc = frame["p_es_pa"].to_numpy(), frame["p_bc_pa"].to_numpy()
    W_c, W_egr = frame["w_c_kg_s"].to_numpy(), frame["w_egr_kg_s"].to_numpy()
    n_e, u_delta = actuation.at_samples()[:2]
    Pi_t = np.minimum(p_es / p_em, 0.9999)
    velocity = np.sqrt(2.0 * c.c_pe * T_em * (1.0 - Pi_t ** (1.0 - 1.0 / c.gamma_e)))
    out = {
        "p_im": p_im, "p_em": p_em, "omega_t": omega, "n_e": n_e, "u_delta": u_delta,
        "u_egr": np.clip(actuation.u_egr, 0.0, None), "u_vgt": actuation.u_vgt, "T_em": T_em,
        "T_im": frame["t_im_k"].to_numpy(), "T_c": frame["t_c_k"].to_numpy(), "T_e": frame["t_e_k"].to_numpy(),
        "p_es": p_es, "p_bc": p_bc, "W_c": W_c, "W_t": frame["w_t_kg_s"].to_numpy(), "W_egr": W_egr,
        "W_ei": frame["w_ei_kg_s"].to_numpy(), "W_eo": frame["w_eo_kg_s"].to_numpy(),
        "W_f": frame["w_f_kg_s"].to_numpy(), "Pi_c": np.maximum(p_im / p_bc, 1.0), "Pi_t": Pi_t,
        "Pi_egr": p_im / p_em, "Pi_e": p_em / p_im, "BSR": c.R_t * omega / velocity,
        "Psi_c": 2.0 * c.c_pa * c.T_amb * (np.maximum(p_im / p_bc, 1.0) ** (1.0 - 1.0 / c.gamma_a) - 1.0)
        / (c.R_c * omega) ** 2,
        "egr_share": W_egr / np.maximum(W_egr + W_c, 1e-6), "t": actuation.time_s - actuation.time_s[0],
        "p_amb": np.full(p_im.size, c.p_amb), "T_amb": np.full(p_im.size, c.T_amb),
    }  # fmt: skip
    for point in points:
        if point.name in signals and point.name in out:
            own, signal = out[point.name], signals[point.name]
            if point.name in ("T_em", "W_c"):  # the simulation's, signal included
                out[f"{point.name}:before"] = own / (1.0 + signal) if point.relative else own - signal
            else:
                out[f"{point.name}:before"] = own
                out[point.name] = own * (1.0 + signal) if point.relative else own + signal
    return out
