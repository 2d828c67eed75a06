"""A positioning axis: a mass with viscous friction is not enough. What is left out?

Recording: Janot, Gautier, Brunot 2019, "Data set and reference models of EMPS", Workshop on Nonlinear System
Identification Benchmarks, Eindhoven: position and drive force at 1 kHz (here every 5th sample, force averaged over the
interval). The force drives the twin without feedback, so its states start anew in every window.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from _show import show

from dieseltwin.discovery.twins.interface import Hypothesis, Parameter, Point
from dieseltwin.discovery.twins.simple import Model, SimpleTwin

KEEP = 5
SLOW = 1e-3  # m/s: width of the smoothed sign
DATA = Path("emps") / "emps_train.csv"
PUBLISHED = "published (same recording, inverse dynamics): M 95.11 kg, F_v 203.5 N s/m, F_c 20.39 N, offset -3.16 N"


def rates(x, u, p, s, e):
    force = s("force", u.force * (1.0 + e.drive_curve * abs(u.force)))
    way = np.tanh(x.v / SLOW)
    viscous = s("viscous", p.F_v * x.v)
    dry = e.coulomb_friction * way + e.drag * x.v * abs(x.v) + e.stribeck * way * np.exp(-abs(x.v) / 0.01)
    one_way = e.asymmetric_friction * (x.v > 0)
    spring = e.cable_spring * x.q
    net = s("force_balance", force - viscous - dry - one_way - spring - e.constant_force)
    return x.v, net / p.mass


def readings(x, u, p, s, e):
    return (s("position", x.q),)


def effect(name, law, unit, tolerance, limits, site="force_balance", **more):
    return Hypothesis(name, site, law, unit, tolerance, limits, **more)


MODEL = Model(
    states={"q": 0.01, "v": 0.05},
    parameters=(Parameter("mass", 100.0, 100.0, "kg", 10.0), Parameter("F_v", 300.0, 300.0, "N s/m", 30.0)),
    inputs=("force",),
    channels=("position",),
    rates=rates,
    readings=readings,
    points=(
        Point("force", "drive", True, "-", ("force",)),
        Point("viscous", "viscous_friction", True, "-", ("v",)),
        Point("force_balance", "force_balance", False, "N", ("v", "q", "force"), 10.0),
        Point("position", "sensor:position", False, "m", ("q",), 1e-3),
    ),
    hypotheses=(
        effect("coulomb_friction", "F_c sign(v)", "N", 0.2, (0, 100)),
        effect("constant_force", "a constant force against the motion's positive sense", "N", 0.2, (-50, 50)),
        effect("asymmetric_friction", "F where v > 0", "N", 0.2, (-50, 50)),
        effect("stribeck", "F sign(v) exp(-|v|/0.01 m/s)", "N", 0.2, (0, 50)),
        effect("drag", "c v |v|", "N s2/m2", 20.0, (0, 5000)),
        effect("cable_spring", "k q", "N/m", 2.0, (-500, 500)),
        effect("drive_curve", "force (1 + c |force|)", "1/N", 1e-5, (-3e-3, 3e-3), site="drive"),
    ),
    units={"q": "m", "v": "m/s", "force": "N"},
    nearest={"position": "q"},
    hold="held",
)


def twin(path, window_s=None):
    """The twin bound to the recording."""
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    n = len(table) // KEEP * KEEP
    force = table[:n, 4].reshape(-1, KEEP).mean(axis=1)
    return SimpleTwin(MODEL, table[:n:KEEP, 0], {"force": force}, table[:n:KEEP, 1:2], window_s)


if __name__ == "__main__":
    show(twin, DATA, PUBLISHED, window_s=1.0, held_window_s=3.0, floor=1e-5, unit="m")
