"""Does `calibrate` recover the coefficients of a simulated engine of another size, within the intervals it states?

    python benchmarks/calibration.py [--seed N] [--engines N] [--points 150] [--noise 1.0]

Engines are drawn: displacement 9 to 16 l, every map coefficient moved by half a prior standard deviation (normal). The
simulator holds each operating point until it is settled; readings get white noise. Printed per engine: how many
coefficients lie inside their 90 % intervals, and the fit on the held-out third; at the end the coverage of all.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from dieseltwin.calibration.calibrate import Calibration, calibrate
from dieseltwin.calibration.coefficients import engine_coefficients, scalar, with_scalars
from dieseltwin.engine import we2011
from dieseltwin.engine.inputs import Inputs
from dieseltwin.engine.parameters import EngineParameters
from dieseltwin.engine.simulate import simulate
from dieseltwin.recordings.noise import SETTLED_NOISE
from dieseltwin.recordings.steady_points import STATES, SteadyPoints, points

HOLD_S = 40.0
SETTLED = 0.001  # relative change of the turbo speed over the last tenth of the hold
LARGEST_SPEED = 15_000.0  # rad/s; the simulator stops at 20,944
INTERVAL_90 = 1.645
MOVE = 0.4  # of a prior standard deviation, by which the drawn engine's coefficients differ


def drawn_engine(generator: np.random.Generator) -> tuple[EngineParameters, EngineParameters]:
    """A simulated engine and its geometry (what a user knows): displacement, compression ratio, wheel radii."""
    base = we2011.PARAMETERS
    ratio = float(generator.uniform(0.75, 1.25))
    size = np.sqrt(ratio)
    geometry = base.replace(V_d=base.V_d * ratio, r_c=float(generator.uniform(16.0, 19.0)), R_c=base.R_c * size,
                            R_t=base.R_t * size)
    values = {}
    for c in engine_coefficients(base, geometry):
        shift = MOVE * c.std * generator.standard_normal()
        if c.name in ("c_vol1", "c_vol2", "c_vgt2", "c_omega_psi1", "c_omega_psi2", "c_omega_phi2", "c_egr3"):
            shift *= 0.1  # their priors are wide beside what keeps an engine an engine
        if c.name in ("c_vol3", "c_f2", "c_vgt1", "c_omega_psi3", "c_omega_phi3", "a_1", "a_2", "a_3"):
            shift *= 0.25
        values[c.name] = float(np.clip(c.mean + shift, c.low + 1e-3 * (c.high - c.low), c.high))
    values["x_cv"] = abs(values["x_cv"])
    for i, power in ((1, 2), (2, 1)):  # a larger wheel turns slower
        for name in (f"c_omega_psi{i}", f"c_omega_phi{i}"):
            values[name] *= size**power
    return with_scalars(geometry, values), geometry


def settled_points(engine: EngineParameters, count: int, noise: float, generator: np.random.Generator) -> SteadyPoints:
    """Settled points by the simulator (each held for `HOLD_S`), with relative white noise on every reading."""
    n = 2 * count
    u = generator.uniform([800.0, 40.0, 5.0, 22.0], [2000.0, 230.0, 85.0, 65.0], (n, 4))
    u[:, 1] *= engine.V_d / we2011.PARAMETERS.V_d
    start = np.arange(n) * HOLD_S
    time_s = np.stack([start, start + 0.9 * HOLD_S, start + HOLD_S - 1e-3], axis=1).ravel()
    table = simulate(Inputs(time_s, *np.repeat(u, 3, axis=0).T), engine, oxygen=False)
    late, last = table.iloc[1::3].reset_index(drop=True), table.iloc[2::3].reset_index(drop=True)
    still = np.abs(late["omega_t_rad_s"] / last["omega_t_rad_s"] - 1.0) < SETTLED
    good = still & (last["lambda"] > 1.15) & (last["p_im_pa"] > 1.03 * engine.p_amb) & (last["t_em_k"] < 1200.0)
    good &= last["omega_t_rad_s"] < LARGEST_SPEED  # at its limiter the simulator's turbo is not in balance
    chosen = last[good].iloc[:count]
    columns = {name: chosen[name].to_numpy() for name in ("n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct", *STATES)}
    for name in STATES:
        columns[name] = columns[name] * (1.0 + noise * generator.standard_normal(len(chosen)))
    columns["w_egr_kg_s"] = np.maximum(columns["w_egr_kg_s"], 0.0)
    return points(columns, engine, where="simulated")


def recovered(found: Calibration, truth: EngineParameters) -> dict[str, float]:
    """Coefficient -> error over its standard deviation [-]."""
    return {c.name: (c.value - scalar(truth, c.name)) / c.std for c in found.coefficients}


def main() -> int:
    """Run the benchmark; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--engines", type=int, default=3)
    parser.add_argument("--points", type=int, default=150)
    parser.add_argument("--noise", type=float, default=1.0, help="standard deviation of the readings [%%]")
    given = parser.parse_args()
    inside: list[bool] = []
    for number in range(given.engines):
        generator = np.random.default_rng([given.seed, number])
        truth, geometry = drawn_engine(generator)
        data = settled_points(truth, given.points, given.noise / 100.0, generator)
        began = time.perf_counter()
        found = calibrate(data, we2011.PARAMETERS, geometry, noise={k: given.noise / 100.0 for k in SETTLED_NOISE})
        z = recovered(found, truth)
        hits = [abs(v) <= INTERVAL_90 for v in z.values()]
        inside += hits
        worst = max(z, key=lambda name: abs(z[name]))
        fits = ", ".join(f"{name} {fit.held_out:.1f}" for name, fit in found.fits.items())
        print(f"engine {number + 1}: {truth.V_d * 1e3:.2f} l, {data.size} points, {sum(hits)} of {len(hits)} "
              f"coefficients inside their 90 % intervals, worst {worst} {z[worst]:+.1f} std; held out [%]: {fits}; "
              f"{time.perf_counter() - began:.0f} s, information / {found.estimate.inflation:.1f}")
        for c in found.coefficients:
            print(f"    {c.name:13s} true {scalar(truth, c.name):11.4g}  found {c.value:11.4g} +- {c.std:8.2g}"
                  f"  {z[c.name]:+5.1f}  {c.verdict}")
    print(f"coverage of 90 % intervals: {100 * np.mean(inside):.1f} % of {len(inside)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
