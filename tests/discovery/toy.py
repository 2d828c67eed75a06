"""A small machine for tests of the core: a leaking vessel with a heater, linear enough to know the answers."""

from __future__ import annotations

import numpy as np

from dieseltwin.discovery.likelihood.fit import Candidate, Fit, Linearisation, fit_fully
from dieseltwin.discovery.likelihood.metric import Whitening
from dieseltwin.discovery.twins.interface import Array, Hypothesis, Lanes, Parameter, Point, Twin, TwinDefaults
from dieseltwin.settings.defaults import default_search

STEP_S = 0.2
SETTINGS = default_search().driving.model_copy(update={"sensor_gain": 0.0, "sensor_offset": 0.0})  # perfect sensors


def null_fit(
    twin: Twin, whitening: Whitening, parameters: Array | None = None, nuisance_response: Array | None = None
) -> Linearisation:
    """Fit of the free parameters and initial states alone."""
    first = np.array([p.first for p in twin.parameters]) if parameters is None else parameters
    start = Fit(Candidate(), first, np.zeros(0), twin.first_local(), np.inf, False)
    return fit_fully(twin, whitening, start, nuisance_response, rounds=30)


class Toy(TwinDefaults):
    """x' = (gain u - x)/2 s - leak x - drag x^2 + balance; readings x (+ offset) and gain x^2."""

    channels = ("x", "y")
    states = ("x",)
    state_scales = np.array([1.0])

    def __init__(self, n: int = 1500, windows: int = 10, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        self.time_s = STEP_S * np.arange(n)
        levels = np.repeat(rng.uniform(0.5, 3.0, n // 25 + 1), 25)[:n]
        self.u = np.convolve(levels, np.ones(9) / 9, mode="same")
        self.starts = np.linspace(0, n, windows + 1)[:-1].astype(np.int64)
        self.measured = np.zeros((n, 2))
        self.parameters = (Parameter("gain", 1.0, 0.5, "-", 0.1),)
        self.points = (
            Point("balance", "vessel", False, "1/s", ("x",), 0.1),
            Point("u", "heater", True, "-", ("u",), 1.0, 0.003, ("u",)),
        )
        self.hypotheses = {
            "leak": Hypothesis("leak", "vessel", "k x", "1/s", 0.01, (0.0, 1.0), True, (0.01,)),
            "drag": Hypothesis("drag", "vessel", "k x^2", "1/s", 0.01, (0.0, 1.0), True, (0.01,)),
            "x_offset": Hypothesis("x_offset", "sensor:x", "x + b", "-", 0.02, (-1.0, 1.0), True, (0.02,), "sensor"),
        }
        self.conditions = {"u": self.u}

    def first_local(self) -> np.ndarray:
        rows = [np.nanmean(self.measured[max(a - 3, 0) : a + 4, 0]) for a in self.starts]
        return np.asarray(rows)[:, None]

    def simulate(self, lanes: Lanes) -> np.ndarray:
        size, n = lanes.size, self.time_s.size
        zero = np.zeros(size)
        gain = lanes.parameters[:, 0]
        signals = np.zeros((2, size, n))
        for name, values in lanes.signals.items():
            signals[[p.name for p in self.points].index(name)] += values
        if lanes.lane_points is not None:
            for lane, point in enumerate(lanes.lane_points):
                if point >= 0:
                    signals[point, lane] += lanes.lane_signals[lane]
        amount = {
            name: lanes.magnitudes.get(name, zero)[:, None] * lanes.schedules.get(name, np.ones(n))
            for name in self.hypotheses
        }
        x = np.empty((size, n))
        value = lanes.local[:, :, 0].copy()
        ends = np.append(self.starts[1:], n)
        for k in range(int((ends - self.starts).max())):  # all windows side by side; one that is over stands still
            inside, i = self.starts + k < ends, np.minimum(self.starts + k, ends - 1)
            x[:, i[inside]] = value[:, inside]
            force = gain[:, None] * self.u[i] * (1.0 + signals[1][:, i])
            rate = (force - value) / 2.0 - amount["leak"][:, i] * value - amount["drag"][:, i] * value**2
            value = value + STEP_S * (rate + signals[0][:, i])
        return np.stack([x + amount["x_offset"], gain[:, None] * x**2], axis=2)

    def variables(self, lanes: Lanes) -> dict[str, np.ndarray]:
        return {"x": self.simulate(lanes)[0, :, 0], "u": self.u}

    def record(self, gain: float = 1.1, noise: float = 0.02, seed: int = 1, **effects: object) -> Toy:
        """Fill in readings: one long run from rest, AR(1) noise; an effect is a magnitude or (magnitude, factor)."""
        rng = np.random.default_rng(seed)
        magnitudes = {k: np.array([v[0] if isinstance(v, tuple) else v], dtype=float) for k, v in effects.items()}
        schedules = {k: v[1] for k, v in effects.items() if isinstance(v, tuple)}
        starts, self.starts = self.starts, np.array([0])
        start = np.full((1, 1, 1), gain * self.u[0])
        clean = self.simulate(Lanes(np.array([[gain]]), start, magnitudes, schedules))[0]
        self.starts = starts
        white = rng.normal(size=clean.shape)
        coloured = white.copy()
        for i in range(1, len(white)):
            coloured[i] = 0.3 * coloured[i - 1] + np.sqrt(1 - 0.09) * white[i]
        self.measured = clean + noise * clean.mean(axis=0) * coloured
        return self
