"""Made-up discoveries for the report's tests. Nothing here was discovered: every number is drawn or invented."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from dieseltwin.discovery.verdict.curves import Candidate, Curves, Discovery, LawCurve
from dieseltwin.discovery.verdict.document import Discrepancy
from dieseltwin.engine import we2011

CHANNELS = ("p_im_pa", "p_em_pa", "omega_t_rad_s", "w_egr_kg_s", "t_em_k")
MEANS = np.array([1.9e5, 2.1e5, 6200.0, 0.03, 640.0])
SIGMA = np.array([5.7e3, 6.3e3, 62.0, 0.0015, 19.0])
MINIMUM = {
    "boost_leak": 2.6e-6, "exhaust_leak": 6.0e-6, "back_pressure": 1.4e4, "bearing_friction": 4.0e-7,
    "compressor_efficiency_loss": 0.008, "thermocouple_lag": 0.12, "egr_valve_leak": 0.004, "vgt_offset": 0.9,
    "injector_drift": 0.03, "p_im_offset": 420.0, "egr_clogging": 2e-5, "vgt_dead_time": 0.4,
}  # fmt: skip
TOLERANCE = {
    "boost_leak": 4e-6, "exhaust_leak": 5e-6, "back_pressure": 2e4, "bearing_friction": 1.6e-6,
    "compressor_efficiency_loss": 0.01, "thermocouple_lag": 0.2, "egr_valve_leak": 0.01, "vgt_offset": 0.5,
    "injector_drift": 0.01, "p_im_offset": 1000.0, "egr_clogging": 5e-5, "vgt_dead_time": 0.05,
}  # fmt: skip
UNITS = {
    "boost_leak": "m2", "exhaust_leak": "m2", "back_pressure": "Pa/(kg/s)^2", "bearing_friction": "N m s",
    "compressor_efficiency_loss": "-", "thermocouple_lag": "s", "egr_valve_leak": "-", "vgt_offset": "%",
    "injector_drift": "-", "p_im_offset": "Pa", "egr_clogging": "1/s", "vgt_dead_time": "s",
}  # fmt: skip
LEAK = {
    "name": "boost_leak", "probability": 0.96, "equivalent_names": ["compressor_efficiency_loss"],
    "law": "W_leak = A p_im/sqrt(R_a T_im) Psi(p_amb/p_im)", "magnitude": 4.1e-5, "std": 2e-6, "unit": "m2",
    "valid_for": "p_im/p_amb 1.0 to 2.9", "split_by": "a w_c_kg_s sensor",
}  # fmt: skip
FRICTION = {
    "name": "bearing_friction", "probability": 0.9, "equivalent_names": [], "law": "P_f = c omega_t^2",
    "magnitude": 3.1e-6, "std": 2e-7, "unit": "N m s", "valid_for": None, "split_by": None,
}  # fmt: skip
UNNAMED = {
    "name": "none_of_these", "probability": 0.99, "equivalent_names": [], "law": "W = 0.01004 kg/s p_im/p_amb",
    "magnitude": None, "std": None, "unit": "kg/s", "valid_for": "p_im/p_amb 1.0 to 2.9", "split_by": None,
}  # fmt: skip
LOCATION = {
    "site": "intake_mass_balance", "probability": 0.97,
    "alternatives": [{"site": "compressor_power", "probability": 0.03}],
    "regions": [], "onset_s": None,
}  # fmt: skip
REGION = {"n_e_rpm": [1200, 1500], "u_delta_mg": [120, 200], "u_egr_pct": [0, 100], "u_vgt_pct": [20, 100],
          "share_of_evidence": 0.8}  # fmt: skip


def content(**changes: Any) -> dict[str, Any]:
    """`discrepancy.json` of a boost leak as a mapping; the named top-level keys are replaced."""
    return {
        "schema": 1,
        "recording": {"path": "drive.csv", "sha256": "0" * 64, "duration_s": 599.8, "channels": list(CHANNELS)},
        "mismatch": True,
        "p_value": 1e-12,
        "location": LOCATION,
        "effects": [LEAK],
        "health": {
            "A_egrmax": {"value": 3.0e-4, "std": 4e-6, "before": 3.01e-4},
            "A_vgtmax": {"value": 7.25e-4, "std": 3e-6, "before": 6.47e-4},
            "eta_sc": {"value": 1.2, "std": 0.006, "before": 0.96},
            "h_tot": {"value": 96.0, "std": 3.0, "before": 141.0},
        },
        "fit": {
            "held_out_nll_before": 2.815, "held_out_nll_after": 2.502,
            "chi2_per_sample_before": 1.63, "chi2_per_sample_after": 1.004,
            "rmse_before": dict(zip(CHANNELS, (1.2 * SIGMA).tolist(), strict=True)),
            "rmse_after": dict(zip(CHANNELS, SIGMA.tolist(), strict=True)),
        },
        "minimum_detectable": MINIMUM,
        "provenance": {"code_version": "0.1.0", "params_sha256": "1" * 64},
        **changes,
    }  # fmt: skip


def healthy_content() -> dict[str, Any]:
    """`discrepancy.json` of a healthy recording."""
    health = {name: {**entry, "before": entry["value"]} for name, entry in content()["health"].items()}
    fit = {**content()["fit"], "held_out_nll_before": 2.5, "chi2_per_sample_before": 1.0}
    surely = {name: 1.5 * size for name, size in MINIMUM.items()} | {"boost_leak": 4.1e-6, "back_pressure": 2.11e4}
    return content(mismatch=False, p_value=0.42, location=None, effects=[], health=health, fit=fit,
                   surely_detectable=surely)  # fmt: skip


def document(**changes: Any) -> Discrepancy:
    """The same as a document."""
    return Discrepancy.model_validate(content(**changes))


def _conditions(n: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    def walk(low: float, high: float, period: int) -> np.ndarray:
        knots = rng.uniform(low, high, n // period + 2)
        return np.interp(np.arange(n), np.arange(knots.size) * period, knots)

    return {"n_e_rpm": walk(600, 1900, 60), "u_delta_mg": walk(10, 230, 35),
            "u_egr_pct": walk(0, 80, 80), "u_vgt_pct": walk(25, 95, 50)}  # fmt: skip


def candidates() -> list[Candidate]:
    """Six effects as weighed for the leak."""
    rows = [
        ("boost_leak", "intake_mass_balance", 512.0, 4.1e-5, 2e-6, 0.96, "chosen: largest gain"),
        ("compressor_efficiency_loss", "compressor_power", 508.5, 0.061, 0.003, 0.03,
         "equivalent: 3.5 log-likelihood units behind boost_leak, less than 4.5"),
        ("exhaust_leak", "exhaust_mass_balance", 301.0, 7e-5, 4e-6, 1e-9, "gains 211 less than boost_leak"),
        ("bearing_friction", "shaft_power", 44.0, 5e-6, 1e-6, 0.0, "gains 468 less than boost_leak"),
        ("vgt_offset", "vgt_actuator", 2.0, 0.3, 0.2, 0.0, "beneath its tolerance of 0.5 %"),
        ("p_im_offset", "sensor:p_im_pa", None, None, None, None, "its linear score is too small for a refit"),
    ]  # fmt: skip
    return [
        Candidate(name=name, site=site, log_likelihood_gain=gain, magnitude=size, std=std,
                  tolerance=TOLERANCE[name], probability=probability, reason=reason)
        for name, site, gain, size, std, probability, reason in rows
    ]  # fmt: skip


def law(rng: np.random.Generator) -> LawCurve:
    """A leak flow over the pressure ratio, with a band and scattered points."""
    x = np.linspace(1.0, 2.8, 40)
    curve = 0.0102 * np.sqrt(np.clip(x - 1.0, 0.0, None)) * x**0.5
    points_x = np.linspace(1.05, 2.7, 12)
    points_y = np.interp(points_x, x, curve) + 6e-4 * rng.standard_normal(12)
    return LawCurve(name="boost_leak", x_name="p_im/p_amb", x=x, curve=curve, low=0.95 * curve, high=1.05 * curve,
                    points_x=points_x, points_y=points_y, unit="kg/s")  # fmt: skip


def discovery(given: Discrepancy | None = None, n: int = 3000, seed: int = 3) -> Discovery:
    """A whole result: n rows at 5 Hz, the residual before structured over speed and load, after white."""
    found = document() if given is None else given
    rng = np.random.default_rng(seed)
    time_s = 0.2 * np.arange(n)
    conditions = _conditions(n, rng)
    shape = (conditions["n_e_rpm"] - 1250.0) / 650.0 * (conditions["u_delta_mg"] - 120.0) / 110.0
    clean = MEANS * (1.0 + 0.25 * np.sin(time_s / 17.0)[:, None])
    noise = SIGMA * rng.standard_normal((n, len(CHANNELS)))
    size = 0.6 if found.mismatch else 0.0
    onset = found.location.onset_s if found.location is not None else None
    active = 1.0 if onset is None else (time_s >= onset).astype(float)
    before = clean - size * (active * shape)[:, None] * SIGMA * np.array([1.0, -0.8, 0.5, 0.3, -0.4])
    measured = clean + noise
    evidence = 0.5 * (((measured - before) / SIGMA) ** 2 - (noise / SIGMA) ** 2).sum(axis=1)
    edges = np.arange(0, n + 1, 50)
    windows = np.array([evidence[a:b].sum() for a, b in pairwise(edges)])
    middles = np.array([time_s[a:b].mean() for a, b in pairwise(edges)])
    before_engine = we2011.PARAMETERS.replace(**{k: v.before for k, v in found.health.items()})
    after_engine = we2011.PARAMETERS.replace(**{k: v.value for k, v in found.health.items()})
    curves = Curves(
        time_s=time_s, channels=CHANNELS, measured=measured, before=before, after=clean, sigma=SIGMA,
        evidence_over_time=(middles, windows), evidence_map=conditions, evidence=evidence,
        candidates=candidates() if found.mismatch else [], laws=[law(rng)] if found.mismatch else [],
        tolerance=TOLERANCE, units=UNITS, held_out=time_s > 0.8 * time_s[-1],
    )  # fmt: skip
    runtime = {"detect_s": 1.2, "name_s": 7.5, "total_s": 9.1}
    details = {"seed": 0, "equivalent_gain": 12.0, "noise_rho": dict.fromkeys(CHANNELS, 0.2)}
    return Discovery(found, after_engine, before_engine, curves, runtime, details)
