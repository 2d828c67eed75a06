"""The simulator beside what a user would take otherwise: the same equations, the same inputs, the same accuracy.

    python benchmarks/peers.py

One minute of the benchmark driving, field parameters. n_e, u_delta and the actuators' positions run linearly between
the samples. scipy's LSODA calls the equations over numpy scalars; x_r and T_1 are a fixed point there, warm from the
call before. CasADi (extra `bench`) gets them as a system with two algebraic unknowns, compiled, for SUNDIALS'
IDAS. Each peer has the loosest relative tolerance of a list at which no pressure and no turbo speed at a sample is off
by more than 0.01 % of its mean; where none does it the tightest one stands with its error. The reference is this
simulator at steps of 0.5 ms. Seconds are CPU seconds of the thread, warm, the least of the repeats.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from dieseltwin.arrays import Array
from dieseltwin.engine import Actuation, actuate, bind, constants, parameter_batch, simulate_states, we2011
from dieseltwin.engine.array_namespace import with_ambient_pressure, with_charge
from dieseltwin.engine.inputs import half_step_times
from dieseltwin.paper.datasets import benchmark_segments

REFERENCE = Path(__file__).parents[1] / "tests" / "reference" / "field_random_300s.csv"
SEGMENT = 1
WANTED_PCT = 0.01
FINE_STEP_S = 0.0005
STEPS_S = (0.025, 0.02, 0.0125, 0.01, 0.005)
TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
SCALES = np.array([1e5, 1e5, 1e3])  # p_im, p_em [Pa], omega_t [rad/s]
FIRST_GUESS = (0.03, 310.0)  # x_r [-], T_1 [K]


@dataclass(frozen=True)
class Row:
    """One simulator: its name, tolerance or step, largest error [% of the mean], seconds for a minute of driving."""

    name: str
    setting: str
    error_pct: float
    seconds: float

    @property
    def times_real_time(self) -> float:
        """Of one minute."""
        return 60.0 / self.seconds


def linear_actuation(actuation: Actuation) -> Actuation:
    """The same samples, with straight lines between them."""
    half = half_step_times(actuation.time_s, actuation.steps)
    grid = np.stack([np.interp(half, actuation.time_s, row) for row in actuation.at_samples()])
    return Actuation(actuation.time_s, actuation.steps, actuation.inputs, actuation.u_egr1, actuation.u_egr2,
                     actuation.u_vgt, actuation.u_egr, grid)  # fmt: skip


def lsoda(actuation: Actuation, initial: Array, tolerance: float) -> Callable[[], Array]:
    """A run of scipy's LSODA over the numpy equations, (n, 3)."""
    model, c = bind("numpy"), constants(we2011.FIELD)
    time_s, rows = actuation.time_s, actuation.at_samples()
    warm = list(FIRST_GUESS)

    def rates(t: float, y: Array) -> list[float]:
        p_im, p_em, omega_t = y * SCALES
        n_e, u_delta, u_egr, u_vgt = (float(np.interp(t, time_s, row)) for row in rows)
        sweep = model.settle_cylinder(p_im, p_em, n_e, u_delta, warm[0], warm[1], c)
        warm[:] = float(sweep.x_r), float(sweep.T_1)
        q = model.quantities(p_im, p_em, omega_t, warm[0], warm[1], n_e, u_delta, u_egr, u_vgt, c)
        return [float(q.dp_im) / SCALES[0], float(q.dp_em) / SCALES[1], float(q.domega_t) / SCALES[2]]

    def run() -> Array:
        span = (float(time_s[0]), float(time_s[-1]))
        found = solve_ivp(rates, span, initial / SCALES, "LSODA", time_s, rtol=tolerance, atol=tolerance)
        return np.asarray(found.y.T * SCALES)

    return run


def casadi_primitives() -> dict[str, Any]:
    """The engine's primitives over CasADi's symbols."""
    import casadi as ca

    def positive_power(x: Any, exponent: Any) -> Any:
        return ca.if_else(x > 0.0, ca.fmax(x, 1e-300) ** exponent, 0.0)

    return {
        "exp": ca.exp, "root": lambda x: ca.sqrt(ca.fmax(x, 0.0)), "positive_power": positive_power,
        "maximum": ca.fmax, "minimum": ca.fmin, "where": ca.if_else,
        "with_ambient_pressure": with_ambient_pressure, "with_charge": with_charge,
    }  # fmt: skip


def idas(actuation: Actuation, initial: Array, tolerance: float) -> Callable[[], Array]:
    """A run of CasADi's IDAS on compiled equations, (n, 3)."""
    import casadi as ca

    model, c = bind(casadi_primitives()), constants(we2011.FIELD)
    time_s, rows = actuation.time_s - actuation.time_s[0], actuation.at_samples()
    y, z, u = ca.SX.sym("y", 3), ca.SX.sym("z", 2), ca.SX.sym("u", 4)
    scaled = [y[k] * SCALES[k] for k in range(3)]
    q = model.quantities(*scaled, z[0], z[1] * FIRST_GUESS[1], u[0], u[1], u[2], u[3], c)
    slopes = ca.vertcat(q.dp_im / SCALES[0], q.dp_em / SCALES[1], q.domega_t / SCALES[2])
    rest = ca.vertcat(q.x_r_next - z[0], q.T_1_next / FIRST_GUESS[1] - z[1])
    equations = ca.Function("equations", [y, z, u], [slopes, rest])
    driven = ca.interpolant("driven", "linear", [time_s], np.ascontiguousarray(rows.T).ravel())
    t, state, inner = ca.MX.sym("t"), ca.MX.sym("state", 3), ca.MX.sym("inner", 2)
    ode, alg = equations(state, inner, driven(t))
    options = {"reltol": tolerance, "abstol": tolerance, "max_num_steps": 200_000, "jit": True, "compiler": "shell",
               "jit_options": {"flags": ["-O2"], "verbose": False}}  # fmt: skip
    system = {"t": t, "x": state, "z": inner, "ode": ode, "alg": alg}
    solver = ca.integrator("solver", "idas", system, 0.0, time_s[1:], options)

    def run() -> Array:
        found = solver(x0=initial / SCALES, z0=[FIRST_GUESS[0], 1.0])["xf"].full().T * SCALES
        return np.concatenate([initial[None], found])

    return run


def timed(run: Callable[[], Array], repeats: int) -> tuple[Array, float]:
    """States, and the least CPU seconds of some warm runs."""
    states, least = run(), np.inf
    for _ in range(repeats):
        begin = time.thread_time()
        run()
        least = min(least, time.thread_time() - begin)
    return states, least


def error_pct(states: Array, reference: Array) -> float:
    """Largest deviation behind the start, in % of the column's mean."""
    return float((np.abs(states - reference).max(axis=0) / reference.mean(axis=0)).max() * 100.0)


def measure(repeats: int, tolerances: tuple[float, ...] = TOLERANCES) -> Iterator[Row]:
    """Rows of the table: this simulator, then the peers that are installed."""
    _, segments = benchmark_segments(REFERENCE, we2011.FIELD)
    inputs, initial = segments[SEGMENT].inputs, np.asarray(segments[SEGMENT].measured[0, :3], dtype=np.float64)
    batch = parameter_batch(we2011.FIELD)

    def ours(step_s: float) -> Callable[[], Array]:
        actuation = linear_actuation(actuate(inputs, we2011.FIELD, step_s))
        return lambda: simulate_states(actuation, batch, initial, threads=1).states[0, :, :3]

    reference = ours(FINE_STEP_S)()
    samples = linear_actuation(actuate(inputs, we2011.FIELD, STEPS_S[0]))
    simulators: dict[str, Callable[[float], Callable[[], Array]]] = {
        "this simulator": ours,
        "scipy LSODA, numpy": lambda tolerance: lsoda(samples, initial, tolerance),
    }
    try:
        import casadi  # noqa: F401

        simulators["CasADi IDAS, compiled"] = lambda tolerance: idas(samples, initial, tolerance)
    except ImportError:
        pass
    for name, make in simulators.items():
        mine = name == "this simulator"
        row = None
        for setting in STEPS_S if mine else tolerances:
            states, seconds = timed(make(setting), 20 * repeats if mine else repeats)
            text = f"steps of {1e3 * setting:g} ms" if mine else f"tolerance {setting:g}"
            row = Row(name, text, error_pct(states, reference), seconds)
            if row.error_pct <= WANTED_PCT:
                break
        if row is not None:
            yield row


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=2)
    for row in measure(parser.parse_args().repeats):
        print(f"{row.name:<24} {row.setting:<18} error {row.error_pct:.4f} %  {1e3 * row.seconds:9.2f} ms"
              f"  {row.times_real_time:10,.0f} x real time", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
