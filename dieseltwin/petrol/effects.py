"""What may be wrong with the air path or its sensors, and how a recording looks with that taken back.

An effect is undone on the signals: a gain is divided out of its channel, a leak's flow is given to the balance. So
one function serves for any onset and size, exactly, and a refit is an evaluation of the balances.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from dieseltwin.arrays import Array
from dieseltwin.discovery.twins.interface import Hypothesis
from dieseltwin.discovery.twins.windows import ends_of, window_of_rows
from dieseltwin.petrol.components import signed_leak
from dieseltwin.petrol.recording import Signals, gaps

Undo = Callable[[Signals, "Array | float"], Signals]


def later(time_s: Array, values: Array, delay_s: Array | float) -> Array:
    """A channel (n,) as it is read `delay_s` [s] later, linear between its rows; no piece between gaps sees another."""
    starts, n = gaps(time_s), len(time_s)
    piece, ends = window_of_rows(starts, n), ends_of(starts, n) - 1
    return np.interp(np.clip(time_s - delay_s, time_s[starts][piece], time_s[ends][piece]), time_s, values)


_NOZZLE = "A p_up/sqrt(R_a T_up) Psi(p_down/p_up)"
LEAST_PRESSURE = 1e3  # Pa, what an undone offset leaves at least
LEAST_FLOW = 1e-5  # kg/s
MIDDLE_FLOW = 0.01  # kg/s, at which a meter whose gain bends with the flow reads right: the middle of a car's driving
LATE_S = (-1.0, 3.0)  # s, a channel's delay; negative where the reference channel is late
NEEDS: Mapping[str, tuple[str, ...]] = {
    "cylinder": ("w_af_kg_s", "p_im_pa", "omega_e_rad_s", "p_ic_pa", "t_ic_k"),
    "throttle": ("w_af_kg_s", "p_im_pa", "alpha_th_pct", "p_ic_pa", "t_ic_k"),
    "boost": ("p_ic_pa", "p_amb_pa"),
    "cooler": ("t_ic_k", "t_amb_k"),
}
"""Columns that each balance is made of."""


@dataclass(frozen=True)
class PetrolEffect:
    """One effect: what is known of it, the signals of an engine without it, and `phrase`, words around its size."""

    hypothesis: Hypothesis
    undo: Undo
    phrase: str


def _gain(field: str) -> Undo:
    return lambda s, m: replace(s, **{field: getattr(s, field) / (1.0 + m)})


def _offset(field: str, least: float = -np.inf) -> Undo:
    return lambda s, m: replace(s, **{field: np.maximum(getattr(s, field) - m, least)})


def _late(field: str) -> Undo:
    return lambda s, m: replace(s, **{field: later(s.time_s, getattr(s, field), -m)})


_ERRORS = {"gain": "a gain error", "offset": "an offset"}
SHOWN: Mapping[str, tuple[float, str]] = {
    "-": (100.0, "%"), "m2": (1e6, "mm²"), "Pa": (1e-3, "kPa"), "kg/s": (3600.0, "kg/h"),
}  # fmt: skip
"""Unit of a size -> factor to the unit that is shown, and its name; others are shown as they are."""

Kind = Literal["physics", "actuator", "input", "sensor"]


def _effect(
    name: str, kind: Kind, site: str, law: str, tolerance: tuple[float, str], limits: tuple[float, float], undo: Undo,
    phrase: str | None = None,
) -> PetrolEffect:
    size, unit = tolerance
    late = unit == "s"  # a signal pulsates from row to row: its derivative to a delay says nothing of a longer one
    kinked = late or name.startswith(("p_im_", "p_ic_"))  # at a throttle wide open there is only one way to go
    sizes = (-size, size) if kinked else (size,)
    if phrase is None:  # of a reading
        reading, what = name.rsplit("_", 1)
        reading = reading[0].upper() + reading[1:] if reading[0] in "tw" else reading  # T and W, as in `Signals`
        phrase = f"the {reading} reading {{m}} late" if late else f"{_ERRORS[what]} of the {reading} reading of {{m}}"
    return PetrolEffect(Hypothesis(name, site, law, unit, size, limits, not kinked, sizes, kind), undo, phrase)


_ALL = (
    _effect("p_im_gain", "sensor", "sensor:p_im_pa", "reading = p_im (1 + g)", (0.02, "-"), (-0.5, 1.0), _gain("p_im")),
    _effect("p_ic_gain", "sensor", "sensor:p_ic_pa", "reading = p_ic (1 + g)", (0.01, "-"), (-0.5, 1.0), _gain("p_ic")),
    _effect("w_af_gain", "sensor", "sensor:w_af_kg_s", "reading = W_af (1 + g)", (0.02, "-"), (-0.5, 1.0),
            _gain("W_af")),
    _effect("p_im_offset", "sensor", "sensor:p_im_pa", "reading = p_im + b", (1000.0, "Pa"), (-1.5e4, 4e4),
            _offset("p_im", LEAST_PRESSURE)),
    _effect("p_ic_offset", "sensor", "sensor:p_ic_pa", "reading = p_ic + b", (1000.0, "Pa"), (-4e4, 6e4),
            _offset("p_ic", LEAST_PRESSURE)),
    _effect("w_af_offset", "sensor", "sensor:w_af_kg_s", "reading = W_af + b", (1e-4, "kg/s"), (-1.2e-3, 5e-3),
            _offset("W_af", LEAST_FLOW)),
    _effect("w_af_bend", "sensor", "sensor:w_af_kg_s", f"reading = W_af (W_af/{1e3 * MIDDLE_FLOW:g} g/s)^c",
            (0.02, "-"), (-0.3, 0.3),
            lambda s, m: replace(s, W_af=MIDDLE_FLOW * (s.W_af / MIDDLE_FLOW) ** (1.0 / (1.0 + m))),
            "a gain of the W_af reading that bends by {m} with every factor e of the flow"),
    _effect("t_ic_offset", "sensor", "sensor:t_ic_k", "reading = T_ic + b", (8.0, "K"), (-60.0, 80.0), _offset("T_ic")),
    _effect("t_amb_offset", "sensor", "sensor:t_amb_k", "reading = T_amb + b", (8.0, "K"), (-60.0, 80.0),
            _offset("T_amb")),
    _effect("p_amb_gain", "sensor", "sensor:p_amb_pa", "reading = p_amb (1 + g)", (0.01, "-"), (-0.3, 0.3),
            _gain("p_amb")),
    _effect("p_im_late", "sensor", "sensor:p_im_pa", "reading = p_im(t - d)", (0.3, "s"), LATE_S, _late("p_im")),
    _effect("p_ic_late", "sensor", "sensor:p_ic_pa", "reading = p_ic(t - d)", (0.6, "s"), LATE_S, _late("p_ic")),
    _effect("w_af_late", "sensor", "sensor:w_af_kg_s", "reading = W_af(t - d)", (0.3, "s"), LATE_S, _late("W_af")),
    _effect("throttle_late", "actuator", "throttle_actuator", "alpha(t - d)", (0.3, "s"), LATE_S, _late("alpha"),
            "the throttle {m} late"),
    _effect("throttle_offset", "actuator", "throttle_actuator", "alpha + b", (0.3, "%"), (-5.0, 5.0), _offset("alpha"),
            "an offset of the throttle's position of {m}"),
    _effect("throttle_gain", "actuator", "throttle_actuator", "alpha (1 + g)", (0.03, "-"), (-0.5, 1.0),
            _gain("alpha"), "a gain error of the throttle's position of {m}"),
    _effect("volumetric_efficiency_change", "physics", "cylinder_flow", "eta_vol (1 + k)", (0.03, "-"), (-0.5, 1.0),
            lambda s, m: replace(s, log_eta=np.log1p(m) * np.ones_like(s.p_im)),
            "a volumetric efficiency changed by {m}"),
    _effect("throttle_area_change", "physics", "throttle_flow", "A_th (1 + k)", (0.03, "-"), (-0.6, 1.5),
            lambda s, m: replace(s, log_area=np.log1p(m) * np.ones_like(s.p_im)),
            "a throttle whose area is changed by {m}"),
    _effect("intake_leak", "physics", "intake_mass_balance", f"W_leak = {_NOZZLE}, intake manifold and surroundings",
            (5e-7, "m2"), (0.0, 5e-5),
            lambda s, m: replace(s, leak_im=signed_leak(m, s.p_im, s.T_ic, s.p_amb, s.T_amb)),
            "a hole of {m} in the intake manifold"),
    _effect("boost_leak", "physics", "intercooler_mass_balance", f"W_leak = {_NOZZLE}, from before the throttle",
            (4e-6, "m2"), (0.0, 2e-4),
            lambda s, m: replace(s, leak_ic=-signed_leak(m, s.p_ic, s.T_ic, s.p_amb, s.T_amb)),
            "a hole of {m} before the throttle"),
)  # fmt: skip
EFFECTS: Mapping[str, PetrolEffect] = {e.hypothesis.name: e for e in _ALL}
HYPOTHESES: Mapping[str, Hypothesis] = {name: e.hypothesis for name, e in EFFECTS.items()}


def sized(name: str, size: float, std: float | None = None) -> str:
    """An effect with its size [its unit] in words and in the unit that is shown: 'a hole of 15.0 ± 0.2 mm² in ...'."""
    return EFFECTS[name].phrase.format(m=_shown(name, size, std, signed=True))


def smallest(name: str, size: float, otherwise: Sequence[float]) -> str:
    """The smallest size [its unit] that shows, with those under other circumstances: 'a hole of 0.5 mm² (0.5; 1.1 mm²)
    in ...'. One beyond what an effect can be is 'none'."""
    most = EFFECTS[name].hypothesis.limits[1]
    others = [_shown(name, value) if value <= most else "none" for value in otherwise]
    return EFFECTS[name].phrase.format(m=f"{_shown(name, size)} ({'; '.join(others)})")


def _shown(name: str, size: float, std: float | None = None, signed: bool = False) -> str:
    """A size in the unit that is shown; `signed`: with a plus where it may be either."""
    hypothesis = EFFECTS[name].hypothesis
    factor, unit = SHOWN.get(hypothesis.unit, (1.0, hypothesis.unit))
    value, spread = factor * size, 0.0 if std is None else factor * std
    plus = "+" if signed and hypothesis.limits[0] < 0.0 else ""
    if np.isfinite(spread) and spread > 0.0:
        digits = min(max(1 - int(np.floor(np.log10(spread))), 0), 6)
        text = f"{round(value, digits) + 0.0:{plus}.{digits}f} ± {spread:.{digits}f} {unit}"  # no -0.0
    else:
        text = f"{value:{plus}.2g} {unit}"
    return text.replace("-", "−")


LOG_PRIOR: Mapping[str, float] = dict.fromkeys(
    ("p_im_offset", "p_ic_offset", "w_af_offset", "w_af_bend", "t_ic_offset"), -3.0
)
"""Log-probability of names that a recording can't tell apart: the recordings' documentation names gains of sensors and
a leak as what happens (Jung, Frisk, Krysander 2024); the others 0."""
CLOCKS = ("p_im_late", "w_af_late", "throttle_late", "p_ic_late")
"""Effects that are the clock of a channel."""
AIR_FLOW = ("w_af_gain", "w_af_offset", "w_af_bend")
"""Faults of the air-flow sensor: the balances foretell what it reads."""


def metered(magnitudes: Mapping[str, Array], W_af: Array) -> Array:
    """What the air-flow sensor reads of a true flow [kg/s] with its faults among `magnitudes`."""
    if "w_af_bend" in magnitudes:
        W_af = W_af * (np.maximum(W_af, LEAST_FLOW) / MIDDLE_FLOW) ** magnitudes["w_af_bend"]
    return np.asarray(W_af * (1.0 + magnitudes.get("w_af_gain", 0.0)) + magnitudes.get("w_af_offset", 0.0))


def undo(effect: str, magnitude: Array | float, s: Signals) -> Signals:
    """The signals of an engine without `effect`, were it present with `magnitude`: (n,) over the rows or one value."""
    return EFFECTS[effect].undo(s, magnitude)


def undo_all(magnitudes: Mapping[str, Array | float], s: Signals) -> Signals:
    """The signals without any of several effects; sensors first, as a leak runs between the true pressures."""
    for name in sorted(magnitudes, key=lambda n: EFFECTS[n].hypothesis.kind not in ("sensor", "actuator")):
        s = undo(name, magnitudes[name], s)
    return s
