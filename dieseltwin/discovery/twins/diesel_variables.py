"""Variables of the diesel engine along a trajectory, by the names that ports, tolerances and laws use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dieseltwin.discovery.twins.interface import Array, Point
from dieseltwin.engine import Actuation, EngineParameters, constants
from dieseltwin.engine.binding import numpy_model
from dieseltwin.engine.extended_frame import extended_frame

_W_EGR, _T_EM, _W_C = 3, 4, 5  # columns of readings


@np.errstate(invalid="ignore")  # of a lane that ran away
def variables_along(
    states: Array, readings: Array, actuation: Actuation, engine: EngineParameters,
    signals_at: tuple[Mapping[str, Array], Sequence[Point]],
) -> dict[str, Array]:  # fmt: skip
    """Name -> (n,) [SI, %, mg/cycle, rpm]; where a signal enters a quantity, `<name>:before` is it without that signal.

    Args:
        states: (n, 6) as of `simulate_extended`; readings: (n, 6) in the order of `MEASURED`, without sensors' faults.
        actuation: of the trajectory.
        engine: of the trajectory, without laws: these are among the signals.
        signals_at: point -> signal (n,), and the twin's points.
    """
    signals, points = signals_at
    model, c = numpy_model(), constants(engine)
    frame = extended_frame(states, actuation, engine)
    if signals:  # the frame knows none: the simulation's own flows and temperature do
        for name, column in (("w_egr_kg_s", _W_EGR), ("t_em_k", _T_EM), ("w_c_kg_s", _W_C)):
            frame[name] = readings[:, column]
    p_im, p_em = frame["p_im_pa"].to_numpy(), frame["p_em_pa"].to_numpy()
    omega, T_em = frame["omega_t_rad_s"].to_numpy(), frame["t_em_k"].to_numpy()
    p_es, p_bc = frame["p_es_pa"].to_numpy(), frame["p_bc_pa"].to_numpy()
    W_c, W_egr = frame["w_c_kg_s"].to_numpy(), frame["w_egr_kg_s"].to_numpy()
    n_e, u_delta = actuation.at_samples()[:2]
    Pi_c = model.compressor_pressure_ratio(p_im, c._replace(p_amb=p_bc))
    Pi_t = model.turbine_pressure_ratio(p_em, c._replace(p_amb=p_es))
    out = {
        "p_im": p_im, "p_em": p_em, "omega_t": omega, "n_e": n_e, "u_delta": u_delta,
        "u_egr": np.clip(actuation.u_egr, 0.0, None), "u_vgt": actuation.u_vgt, "T_em": T_em,
        "T_im": frame["t_im_k"].to_numpy(), "T_c": frame["t_c_k"].to_numpy(), "T_e": frame["t_e_k"].to_numpy(),
        "p_es": p_es, "p_bc": p_bc, "W_c": W_c, "W_t": frame["w_t_kg_s"].to_numpy(), "W_egr": W_egr,
        "W_ei": frame["w_ei_kg_s"].to_numpy(), "W_eo": frame["w_eo_kg_s"].to_numpy(),
        "W_f": frame["w_f_kg_s"].to_numpy(), "Pi_c": Pi_c, "Pi_t": Pi_t, "eta_vol": frame["eta_vol"].to_numpy(),
        "x_r": frame["x_r"].to_numpy(), "T_1": frame["t_1_k"].to_numpy(),
        "Pi_egr": p_im / p_em, "Pi_e": model.exhaust_to_intake_ratio(p_em, p_im),
        "BSR": model.blade_speed_ratio(omega, T_em, Pi_t, c),
        "Psi_c": model.energy_transfer_coefficient(c.T_amb, Pi_c, omega, c),
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
