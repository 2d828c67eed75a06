"""Two cascaded water tanks: Torricelli's law is not enough. What is left out?

Recording: Schoukens, Noel 2017, "Three benchmarks addressing open challenges in nonlinear system identification",
IFAC-PapersOnLine 50(1): pump voltage in, level of the lower tank out, 4 s, 1024 samples. Levels are in volts of the
level sensor, whose range ends at 10 V. The twin knows two equal tanks with free outlets and a pump, nothing else.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from _show import show

from dieseltwin.discovery.twins.interface import Hypothesis, Parameter, Point
from dieseltwin.discovery.twins.simple import Model, SimpleTwin

RIM_V = 10.0  # level of the rim: the sensor's range ends there
DATA = Path("cascaded_tanks") / "estimation.csv"
PUBLISHED = (
    "published, on the benchmark's second record (not the same half): best linear 0.76 V, Volterra 0.54 V, polynomial "
    "state space 0.45 V, NLSS2 0.34 V (table 2 of doi 10.1155/2021/6613425)"
)


def root(level):
    return np.sqrt(np.maximum(level, 0.0))


def rates(x, u, p, s, e):
    pump = s("q_in", p.k_pump * (np.maximum(u.pump - e.pump_dead_zone, 0.0) + e.pump_curve * u.pump * abs(u.pump)))
    upper = s("q_upper", p.k_upper * root(x.h_upper + e.upper_outlet_head))
    lower = s("q_lower", p.k_lower * root(x.h_lower + e.lower_outlet_head))
    lost, into_lower, over_lower = (
        e.upper_overflow_lost * np.maximum(x.h_upper - RIM_V, 0.0),
        e.upper_overflow * np.maximum(x.h_upper - RIM_V, 0.0),
        e.lower_overflow * np.maximum(x.h_lower - RIM_V, 0.0),
    )
    upper_balance = s("upper_balance", pump - upper - lost - into_lower - e.upper_leak * root(x.h_upper))
    into_lower = p.area_ratio * (upper + into_lower)
    return upper_balance, s("lower_balance", into_lower - lower - over_lower - e.lower_leak * x.h_lower)


def readings(x, u, p, s, e):
    return (np.minimum(s("level", x.h_lower + e.level_offset), RIM_V),)


def effect(name, site, law, unit, tolerance, limits, **more):
    return Hypothesis(name, site, law, unit, tolerance, limits, **more)


WEIR, STIFF = ("1/s", 0.005, (0, 0.5)), {"smooth": False, "sizes": (0.05, 0.3)}
MODEL = Model(
    states={"h_upper": 1.0, "h_lower": 1.0},
    parameters=(
        Parameter("k_pump", 0.05, 0.05, "1/s", 0.005),
        Parameter("k_upper", 0.07, 0.07, "V^0.5/s", 0.005),
        Parameter("k_lower", 0.07, 0.07, "V^0.5/s", 0.005),
        Parameter("area_ratio", 1.0, 0.3, "-", 0.1),  # upper tank over lower tank
    ),
    inputs=("pump",),
    channels=("level",),
    rates=rates,
    readings=readings,
    points=(
        Point("q_in", "pump_flow", True, "-", ("pump",)),
        Point("q_upper", "upper_outlet", True, "-", ("h_upper",)),
        Point("q_lower", "lower_outlet", True, "-", ("h_lower",)),
        Point("upper_balance", "upper_tank", False, "V/s", ("h_upper", "pump"), 0.01),
        Point("lower_balance", "lower_tank", False, "V/s", ("h_upper", "h_lower", "q_upper"), 0.01),
        Point("level", "sensor:level", False, "V", ("h_lower",), 0.1),
    ),
    hypotheses=(
        effect("upper_overflow", "lower_tank", "k max(0, h_upper - rim), falls into the lower tank", *WEIR, **STIFF),
        effect("upper_overflow_lost", "upper_tank", "k max(0, h_upper - rim), lost over the rim", *WEIR, **STIFF),
        effect("lower_overflow", "lower_tank", "k max(0, h_lower - rim), lost over the rim", *WEIR, **STIFF),
        effect("upper_leak", "upper_tank", "c sqrt(h_upper) lost", "V^0.5/s", 0.001, (0, 0.05)),
        effect("lower_leak", "lower_tank", "c h_lower lost", "1/s", 0.0005, (0, 0.05)),
        effect("pump_dead_zone", "pump_flow", "k (u - u0) for u > u0", "V", 0.05, (0, 1.5)),
        effect("pump_curve", "pump_flow", "k (u + c u |u|)", "1/V", 0.01, (-0.1, 0.5)),
        effect("upper_outlet_head", "upper_outlet", "k sqrt(h_upper + h0): outlet below the bottom", "V", 0.05, (0, 5)),
        effect("lower_outlet_head", "lower_outlet", "k sqrt(h_lower + h0): outlet below the bottom", "V", 0.05, (0, 5)),
        effect("level_offset", "sensor:level", "reading + b", "V", 0.05, (-1, 1), kind="sensor"),
    ),
    units={"h_upper": "V", "h_lower": "V", "pump": "V", "q_upper": "V/s"},
    sub_steps=2,
    nearest={"level": "h_lower"},
    first={"h_upper": 5.0},
)  # fmt: skip


def twin(path, window_s=None):
    """The twin bound to the recording."""
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    return SimpleTwin(MODEL, table[:, 0], {"pump": table[:, 1]}, table[:, 2:3], window_s)


if __name__ == "__main__":
    show(twin, DATA, PUBLISHED, window_s=350.0, held_window_s=None, floor=0.01, unit="V", fitted_rows=50)
