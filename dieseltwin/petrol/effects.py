"""What may be wrong with the air path or its sensors, and how a recording looks with that taken back.

An effect is undone on the signals: a gain is divided out of its channel, a leak's flow is given to the balance. So
one function serves for any onset and size, exactly, and a refit is an evaluation of the balances.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dieseltwin.discovery.twins.interface import Hypothesis
from dieseltwin.petrol.components import nozzle_flow, signed_leak
from dieseltwin.petrol.recording import Signals

Array = NDArray[np.float64]

_NOZZLE = "A p_up/sqrt(R_a T_up) Psi(p_down/p_up)"


def _h(name: str, site: str, law: str, unit: str, tolerance: float, limits: tuple[float, float], kind: str,
       confused: tuple[str, ...] = ()) -> Hypothesis:
    return Hypothesis(name, site, law, unit, tolerance, limits, True, (tolerance,), kind, confused)  # type: ignore[arg-type]


_ALL = (
    _h("p_im_gain", "sensor:p_im_pa", "reading = p_im (1 + g)", "-", 0.02, (-0.5, 1.0), "sensor"),
    _h("p_ic_gain", "sensor:p_ic_pa", "reading = p_ic (1 + g)", "-", 0.01, (-0.5, 1.0), "sensor", ("p_ic_offset",)),
    _h("w_af_gain", "sensor:w_af_kg_s", "reading = W_af (1 + g)", "-", 0.02, (-0.5, 1.0), "sensor"),
    _h("intake_leak", "intake_mass_balance", f"W_leak = {_NOZZLE}, intake manifold and surroundings", "m2", 5e-7,
       (0.0, 5e-5), "physics", ("w_af_gain",)),
    _h("boost_leak", "intercooler_mass_balance", f"W_leak = {_NOZZLE}, from before the throttle", "m2", 4e-6,
       (0.0, 2e-4), "physics"),
    _h("volumetric_efficiency_change", "cylinder_flow", "eta_vol (1 + k)", "-", 0.03, (-0.5, 1.0), "physics",
       ("p_im_gain",)),
    _h("throttle_area_change", "throttle_flow", "A_th (1 + k)", "-", 0.03, (-0.6, 1.5), "physics"),
    _h("throttle_offset", "throttle_actuator", "alpha + b", "%", 0.3, (-5.0, 5.0), "actuator"),
    _h("p_im_offset", "sensor:p_im_pa", "reading = p_im + b", "Pa", 1000.0, (-1.5e4, 4e4), "sensor"),
    _h("p_ic_offset", "sensor:p_ic_pa", "reading = p_ic + b", "Pa", 1000.0, (-4e4, 6e4), "sensor", ("p_ic_gain",)),
    _h("w_af_offset", "sensor:w_af_kg_s", "reading = W_af + b", "kg/s", 1e-4, (-1.2e-3, 5e-3), "sensor"),
    _h("t_ic_offset", "sensor:t_ic_k", "reading = T_ic + b", "K", 8.0, (-60.0, 80.0), "sensor"),
    _h("p_amb_gain", "sensor:p_amb_pa", "reading = p_amb (1 + g)", "-", 0.01, (-0.3, 0.3), "sensor"),
)
HYPOTHESES: Mapping[str, Hypothesis] = {h.name: h for h in _ALL}

# The benchmark's documentation names gains of sensors and a leak as what happens; offsets and map changes are rarer.
# In units of log-probability.
LOG_PRIOR: Mapping[str, float] = {
    "p_im_offset": -3.0, "p_ic_offset": -3.0, "w_af_offset": -3.0, "t_ic_offset": -3.0, "p_amb_gain": -3.0,
}

# balances that an effect touches: the others need no refit
TOUCHES: Mapping[str, tuple[str, ...]] = {
    "p_im_gain": ("cylinder", "throttle"), "p_im_offset": ("cylinder", "throttle"),
    "p_ic_gain": ("cylinder", "throttle", "boost"), "p_ic_offset": ("cylinder", "throttle", "boost"),
    "w_af_gain": ("cylinder", "throttle"), "w_af_offset": ("cylinder", "throttle"),
    "intake_leak": ("cylinder",), "boost_leak": ("cylinder", "throttle"),
    "volumetric_efficiency_change": ("cylinder",), "throttle_area_change": ("throttle",),
    "throttle_offset": ("throttle",), "t_ic_offset": ("cylinder", "throttle", "cooler"), "p_amb_gain": ("boost",),
}

LEAST_PRESSURE = 1e3  # Pa, what an undone offset leaves at least
LEAST_FLOW = 1e-5  # kg/s


def undo(effect: str, magnitude: float, active: Array, s: Signals) -> Signals:
    """The signals of a healthy engine, were `effect` present with `magnitude` where `active` is 1.

    Args:
        effect: name in HYPOTHESES.
        magnitude: in the hypothesis' unit.
        active: (n,) 0 before the onset and 1 after it.
        s: measured signals.
    """
    m = magnitude * active
    if effect == "p_im_gain":
        return replace(s, p_im=s.p_im / (1.0 + m))
    if effect == "p_ic_gain":
        return replace(s, p_ic=s.p_ic / (1.0 + m))
    if effect == "w_af_gain":
        return replace(s, W_af=s.W_af / (1.0 + m))
    if effect == "p_im_offset":
        return replace(s, p_im=np.maximum(s.p_im - m, LEAST_PRESSURE))
    if effect == "p_ic_offset":
        return replace(s, p_ic=np.maximum(s.p_ic - m, LEAST_PRESSURE))
    if effect == "w_af_offset":
        return replace(s, W_af=np.maximum(s.W_af - m, LEAST_FLOW))
    if effect == "t_ic_offset":
        return replace(s, T_ic=s.T_ic - m)
    if effect == "p_amb_gain":
        return replace(s, p_amb=s.p_amb / (1.0 + m))
    if effect == "intake_leak":
        return replace(s, leak_im=signed_leak(m, s.p_im, s.T_ic, s.p_amb, s.T_amb))
    if effect == "boost_leak":
        return replace(s, leak_ic=nozzle_flow(m, s.p_ic, s.T_ic, s.p_amb))
    if effect == "volumetric_efficiency_change":
        return replace(s, log_eta=np.log1p(m))
    if effect == "throttle_area_change":
        return replace(s, log_area=np.log1p(m))
    if effect == "throttle_offset":
        return replace(s, alpha=s.alpha - m)
    raise KeyError(effect)
