"""Variables of the diesel engine along a trajectory, by the names that ports, tolerances and laws use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dieseltwin.discovery.twins.interface import Array, Point
from dieseltwin.engine import Actuation, EngineParameters, constants
from dieseltwin.engine.binding import numpy_model
from dieseltwin.engine.extended_terms import along, since_start

_W_EGR, _T_EM, _W_C = 3, 4, 5  # columns of readings
_DRIVEN = ("u_delta", "u_egr", "u_vgt")  # given without their signals


@np.errstate(invalid="ignore")  # of a lane that ran away
def variables_along(
    states: Array, readings: Array, actuation: Actuation, engine: EngineParameters,
    signals_at: tuple[Mapping[str, Array], Sequence[Point]],
) -> dict[str, Array]:  # fmt: skip
    """Name -> (n,) [SI, %, mg/cycle, rpm]; where a signal enters a quantity, `<name>:before` is it without that signal.

    Args:
        states: (n, 6) as of `simulate_extended`; readings: (n, C) in the order of `MEASURED`, without sensors' faults.
        actuation: of the trajectory.
        engine: of the trajectory, without laws: these are among the signals.
        signals_at: point -> signal (n,), and the twin's points.
    """
    signals, points = signals_at
    model, c = numpy_model(), constants(engine)
    q, _ = along(states, actuation, engine.terms, c, entered=signals)
    p_im, p_em, omega, x_r, T_1 = states[:, :5].T
    W_egr, T_em, W_c = q.W_egr, q.T_em, q.W_c
    if signals:  # from row to row a signal is linear, so that the simulation's own are nearer
        W_egr, T_em, W_c = readings[:, _W_EGR], readings[:, _T_EM], readings[:, _W_C]
    n_e, u_delta = actuation.at_samples()[:2]
    Pi_t, Pi_c, Psi_c, BSR, omega_c = model.map_arguments(p_im, p_em, omega, q.p_bc, q.p_es, T_em, c)
    named = {
        "p_im": p_im, "p_em": p_em, "omega_t": omega, "n_e": n_e, "u_delta": u_delta,
        "u_egr": np.clip(actuation.u_egr, 0.0, None), "u_vgt": actuation.u_vgt, "T_em": T_em, "T_im": q.T_im,
        "T_c": model.compressor_out_temperature(q.eta_c, q.Pi_c, c), "T_e": q.T_e, "p_es": q.p_es, "p_bc": q.p_bc,
        "W_c": W_c, "W_t": q.W_t, "W_egr": W_egr, "W_ei": q.W_ei, "W_eo": q.W_eo, "W_f": q.W_f, "Pi_c": Pi_c,
        "Pi_t": Pi_t, "eta_vol": q.eta_vol, "x_r": x_r, "T_1": T_1, "Pi_egr": p_im / p_em,
        "Pi_e": model.exhaust_to_intake_ratio(p_em, p_im), "BSR": BSR,
        "Psi_c": Psi_c, "omega_c": omega_c, "W_cc": model.corrected_flow(W_c, c),
        "egr_share": W_egr / np.maximum(W_egr + W_c, 1e-6),
        "t": since_start(actuation), "p_amb": c.p_amb, "T_amb": c.T_amb,
    }  # fmt: skip
    out = {name: np.broadcast_to(value, p_im.shape) for name, value in named.items()}
    for point in points:
        if point.name in signals and point.name in out:
            own, signal, name = out[point.name], signals[point.name], f"{point.name}:before"
            if point.name in _DRIVEN:
                out[name], out[point.name] = own, own * (1.0 + signal) if point.relative else own + signal
            else:
                out[name] = own / (1.0 + signal) if point.relative else own - signal
    return out
