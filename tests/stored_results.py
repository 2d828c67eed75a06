"""Made-up result documents for the report's tests. Nothing here was identified: every number is drawn or invented."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

PARAMETERS = ("A_egrmax", "A_vgtmax", "eta_sc", "h_tot")
UNITS = {"A_egrmax": "m2", "A_vgtmax": "m2", "eta_sc": "-", "h_tot": "W/(m2 K)"}
TRUTH = {
    "A_egrmax": 4.0e-4 / 1.333,
    "A_vgtmax": 8.455767e-4 / 1.1663,
    "eta_sc": 1.101529 / 0.9179,
    "h_tot": 96.27546,
}
NOMINAL = {"A_egrmax": 4.0e-4, "A_vgtmax": 8.455767e-4, "eta_sc": 1.101529, "h_tot": 96.27546}
RELATIVE_BOUND = {"A_egrmax": 0.0049, "A_vgtmax": 0.0015, "eta_sc": 0.0021, "h_tot": 0.025}
SIGMA = {
    "p_im_pa": 4800.0,
    "p_em_pa": 6000.0,
    "omega_t_rad_s": 55.0,
    "w_egr_kg_s": 0.002,
    "t_em_k": 20.0,
    "w_c_kg_s": 0.006,
}
SHUT = 2  # the segment at idle with the valve shut
# method: (spread of runs over bound, stated std over bound, bias in bounds, runs, seconds per run)
METHODS = {
    "classical": (0.02, 1.0, 0.6, 30, 0.071),
    "few-shot-newton": (0.4, 1.2, 0.8, 30, 0.17),
    "few-shot-adam": (2.5, 2.5, 2.0, 2, 21.0),
}


def _summary(
    name: str, mean: float | None, std: float | None, bound: float | None, identifiable: bool
) -> dict[str, Any]:
    interval = None if mean is None or std is None else [mean - 1.645 * std, mean + 1.645 * std]
    return {
        "mean": mean,
        "std": std,
        "interval_90": interval,
        "unit": UNITS[name],
        "bound": bound,
        "identifiable": identifiable,
    }


def document(
    method: str, segments: int = 5, seed: int = 1, *, diverged: bool = False, nothing: bool = False
) -> dict[str, Any]:
    """One identification.json document; ``diverged`` breaks a third of the runs, ``nothing`` flags every segment."""
    rng = np.random.default_rng([seed, sum(method.encode())])
    spread, stated, bias, runs, _ = METHODS[method]
    table = np.empty((segments, runs, len(PARAMETERS)))
    entries, weights = [], np.zeros((segments, len(PARAMETERS)))
    converged = np.ones((segments, runs), dtype=bool)
    if diverged:
        converged[:, ::3] = False
    bounds = np.empty((segments, len(PARAMETERS)))
    for s in range(segments):
        parameters = {}
        for i, name in enumerate(PARAMETERS):
            relative = (
                RELATIVE_BOUND[name] * rng.uniform(0.7, 1.6) * (90 if name == "A_egrmax" and s == SHUT else 1)
            )
            relative *= 9 if name == "h_tot" and s == SHUT else 1
            bounds[s, i] = relative * TRUTH[name]
            identifiable = relative <= 0.25 and not nothing
            centre = TRUTH[name] * np.exp(relative * bias * rng.standard_normal())
            table[s, :, i] = centre * np.exp(relative * spread * rng.standard_normal(runs))
            table[s, ~converged[s], i] *= rng.uniform(0.3, 3.0, (~converged[s]).sum())
            values = table[s, converged[s], i]
            parameters[name] = _summary(
                name, float(values.mean()), float(stated * bounds[s, i]), float(bounds[s, i]), identifiable
            )
            weights[s, i] = relative**-2.0 if identifiable else 0.0
        entries.append({"t0_s": 60.0 * s, "t1_s": 60.0 * (s + 1), "parameters": parameters})
    pooled = {}
    for i, name in enumerate(PARAMETERS):
        total = weights[:, i].sum()
        if total == 0:
            pooled[name] = _summary(name, None, None, None, False)
            continue
        mean = float(
            sum(w * e["parameters"][name]["mean"] for w, e in zip(weights[:, i], entries, strict=True))
            / total
        )
        pooled[name] = _summary(
            name, mean, float(stated * mean * total**-0.5), float(mean * total**-0.5), True
        )
    run_list = [
        {
            "run": r,
            "converged": bool(converged[:, r].all()),
            "parameters": {name: float(table[:, r, i].mean()) for i, name in enumerate(PARAMETERS)},
            "segments": [
                {
                    "t0_s": 60.0 * s,
                    "converged": bool(converged[s, r]),
                    "chi2_per_sample": 1.0,
                    "parameters": {
                        name: {"value": float(table[s, r, i]), "std": float(stated * bounds[s, i])}
                        for i, name in enumerate(PARAMETERS)
                    },
                }
                for s in range(segments)
            ],
        }
        for r in range(runs)
    ]
    return {"schema": 1, "method": method, "parameters": pooled, "segments": entries, "runs": run_list}


def runtime(method: str, segments: int = 5) -> dict[str, Any]:
    """One runtime.json document."""
    runs, seconds = METHODS[method][3:]
    return {
        "schema": 1,
        "method": method,
        "seconds": seconds * runs * segments,
        "runs": runs,
        "segments": segments,
        "seconds_per_run": seconds,
        "host": "synthetic",
        "platform": "synthetic",
        "cpus": 2,
        "versions": {"dieseltwin": "0.0", "numpy": "2"},
    }


def truth_states(segments: int = 5, seed: int = 3) -> pd.DataFrame:
    """A smooth made-up trace with the columns of the reference traces, 5 Hz."""
    time = np.arange(0.0, 60.0 * segments + 0.1, 0.2)
    rng = np.random.default_rng(seed)
    kernel = np.hanning(41) / np.hanning(41).sum()

    def wander(low: float, high: float) -> np.ndarray:
        steps = np.repeat(rng.uniform(0, 1, len(time) // 25 + 3), 25)[: len(time) + 40]
        return low + (high - low) * np.convolve(steps, kernel, mode="valid")[: len(time)]

    columns = {
        "n_e_rpm": (600, 1850),
        "u_delta_mg": (5, 180),
        "u_egr_pct": (0, 60),
        "u_vgt_pct": (25, 75),
        "p_im_pa": (1.0e5, 2.4e5),
        "p_em_pa": (1.1e5, 3.2e5),
        "omega_t_rad_s": (1500, 9500),
        "x_r": (0.025, 0.06),
        "t_1_k": (303, 325),
        "w_egr_kg_s": (0.0, 0.09),
        "w_c_kg_s": (0.04, 0.33),
        "w_t_kg_s": (0.05, 0.35),
        "w_ei_kg_s": (0.06, 0.36),
        "t_em_k": (400, 900),
        "t_e_k": (420, 950),
        "eta_vol": (0.95, 1.0),
        "f_egr": (0, 0.7),
        "f_vgt_pi_t": (0.3, 0.9),
        "eta_tm": (0.6, 0.82),
        "eta_c": (0.4, 0.73),
        "phi_c": (0.05, 0.16),
    }
    return pd.DataFrame({"time_s": time, **{name: wander(*limits) for name, limits in columns.items()}})


def measured(states: pd.DataFrame, seed: int = 4) -> pd.DataFrame:
    """The trace with noise on the measured columns and a masked gap."""
    rng = np.random.default_rng(seed)
    columns = ["time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct", *SIGMA]
    table = states[columns].copy()
    for column, sigma in SIGMA.items():
        table[column] += sigma * rng.standard_normal(len(table))
    table.loc[100:140, "p_em_pa"] = np.nan
    return table


def predicted(method: str, states: pd.DataFrame, seed: int = 5) -> pd.DataFrame:
    """A method's states: the truth with a slow error, and a band."""
    rng = np.random.default_rng([seed, sum(method.encode())])
    size = 0.002 * METHODS[method][1]
    segment = np.minimum((states["time_s"] // 60).astype(int), int(states["time_s"].max() // 60) - 1)
    table = pd.DataFrame({"time_s": states["time_s"], "segment": segment})
    for column in states.columns:
        if column in ("time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct"):
            continue
        mean = states[column].mean()
        wave = np.sin(states["time_s"] / rng.uniform(3, 9) + rng.uniform(0, 6))
        table[column] = states[column] + size * mean * wave
        table[f"{column}_lo"] = table[column] - 1.3 * size * mean
        table[f"{column}_hi"] = table[column] + 1.3 * size * mean
    return table


def curves(segments: int = 5, runs: int = 2, seed: int = 6) -> pd.DataFrame:
    """Convergence of a made-up Adam run, long form."""
    rng = np.random.default_rng(seed)
    epochs = np.unique(np.geomspace(1, 30000, 120).astype(int))
    rows = []
    for s in range(segments):
        for r in range(runs):
            for name in ("loss_total", "loss_p_im_ode", "loss_p_em_ode", "loss_w_egr_data", "loss_t_em_data"):
                value = rng.uniform(1, 30) * np.exp(-epochs / 4000) + rng.uniform(1e-3, 1e-2)
                rows.append(
                    pd.DataFrame({"epoch": epochs, "segment": s, "run": r, "quantity": name, "value": value})
                )
            for name in PARAMETERS:
                value = TRUTH[name] * (
                    1
                    + (NOMINAL[name] / TRUTH[name] - 1 + 0.1 * rng.standard_normal()) * np.exp(-epochs / 5000)
                )
                rows.append(
                    pd.DataFrame({"epoch": epochs, "segment": s, "run": r, "quantity": name, "value": value})
                )
    return pd.concat(rows, ignore_index=True)


PRETRAINING = {
    "operators": {
        "u_egr1": {"train": 0.5, "test": 1.9},
        "u_egr2": {"train": 0.5, "test": 2.2},
        "u_vgt": {"train": 0.6, "test": 1.8},
    },
    "bodies": {
        "paper": {
            k: {"train": t, "held_out": 2 * t, "pod_floor": 0.9 * t}
            for k, t in {"p_im": 0.9, "p_em": 1.1, "x_r": 3.9, "T_1": 0.5, "omega_t": 0.7}.items()
        },
        "conditioned": {
            k: {"train": t, "held_out": 1.2 * t, "pod_floor": 0.95 * t}
            for k, t in {"p_im": 0.07, "p_em": 0.12, "x_r": 1.6, "T_1": 0.21, "omega_t": 0.32}.items()
        },
    },
    "maps": {
        "paper": {"eta_vol": 0.6, "f_egr": 1.5, "F_vgt_Pi_t": 0.9, "eta_tm": 1.2, "eta_c": 1.4, "Phi_c": 9.5},
        "improved": {
            "eta_vol": 0.02,
            "f_egr": 0.1,
            "F_vgt_Pi_t": 0.06,
            "eta_tm": 0.2,
            "eta_c": 0.21,
            "Phi_c": 0.3,
        },
    },
}


def write_results(
    root: Path,
    methods: tuple[str, ...] = tuple(METHODS),
    *,
    segments: int = 5,
    truth: bool = True,
    states: bool = True,
    pretraining: bool = True,
    **kinds: bool,
) -> Path:
    """Write a folder as the pipeline does."""
    root.mkdir(parents=True, exist_ok=True)
    clean = truth_states(segments)
    for method in methods:
        folder = root / method
        folder.mkdir()
        (folder / "identification.json").write_text(json.dumps(document(method, segments, **kinds)))
        (folder / "runtime.json").write_text(json.dumps(runtime(method, segments)))
        if states:
            predicted(method, clean).to_parquet(folder / "states.parquet")
        if method == "few-shot-adam":
            curves(segments).to_parquet(folder / "curves.parquet")
    if truth:
        (root / "truth.json").write_text(json.dumps(TRUTH))
        clean.to_parquet(root / "truth.parquet")
    if states:
        measured(clean).to_parquet(root / "measured.parquet")
        (root / "measured.json").write_text(json.dumps({"sigma": SIGMA}))
    if pretraining:
        (root / "pretraining.json").write_text(json.dumps(PRETRAINING))
    (root / "report.json").write_text(
        json.dumps(
            {
                "title": "SYNTHETIC results for tests",
                "recording": "synthetic_case_v.parquet",
                "seed": 7,
                "profile": "quick",
                "params_sha256": "0" * 64,
                "code_version": "0.0.synthetic",
                "nominal": NOMINAL,
            }
        )
    )
    return root
