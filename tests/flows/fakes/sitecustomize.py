"""Puts fakes in the place of the dear parts of discovery, in every process that has this folder on its path."""

from __future__ import annotations

import sys
import types
from pathlib import Path
from typing import Any

CALLS = "FAKE_DISCOVERY_CALLS"


def _discover(
    recording: Any, engine: Any, options: Any = None, known: Any = None, prepared: Any = None, time_s: Any = None,
    shown: Any = None,
) -> Any:
    """Says "boost leak" of every recording whose mean intake pressure is odd."""
    import hashlib
    import os

    import numpy as np

    from dieseltwin.discovery.verdict.curves import Curves, Discovery
    from dieseltwin.discovery.verdict.document import Discrepancy

    if os.environ.get(CALLS):
        with Path(os.environ[CALLS]).open("a") as file:
            file.write(f"{os.getcwd()} {sorted(os.listdir())}\n")
    if os.environ.get("FAKE_DISCOVERY_FAILS"):
        raise RuntimeError("no convergence")
    p_im = np.asarray(recording.columns["p_im_pa"])
    leaks = bool(int(p_im.mean()) % 2)
    channels = tuple(name for name in recording.columns if name == "p_im_pa")
    effects = [
        {
            "name": "boost_leak", "probability": 0.9, "equivalent_names": ["compressor_efficiency_loss"],
            "law": "A p", "magnitude": 4e-5, "std": 2e-6, "unit": "m2", "valid_for": None, "split_by": None,
        }
    ]  # fmt: skip
    document = Discrepancy.model_validate(
        {
            "schema": 1,
            "recording": {
                "path": "recording.csv", "sha256": hashlib.sha256(p_im.tobytes()).hexdigest(),
                "duration_s": float(recording.duration_s), "channels": channels,
            },
            "mismatch": leaks,
            "p_value": 1e-9 if leaks else 0.4,
            "location": {"site": "intake_mass_balance", "probability": 0.97} if leaks else None,
            "effects": effects if leaks else [],
            "health": {
                name: {"value": getattr(engine, name), "std": 0.01, "before": 1.1 * getattr(engine, name)}
                for name in ("A_egrmax", "A_vgtmax", "eta_sc", "h_tot")
            },
            "fit": {
                "held_out_nll_before": 3.0, "held_out_nll_after": 2.5, "chi2_per_sample_before": 2.0,
                "chi2_per_sample_after": 1.0, "rmse_before": {"p_im_pa": 4000.0}, "rmse_after": {"p_im_pa": 3000.0},
            },
            "minimum_detectable": {"boost_leak": 3e-6},
            "provenance": {"code_version": "0", "params_sha256": ""},
        }
    )  # fmt: skip
    time_s = np.asarray(recording.time_s)
    readings = p_im[:, None]
    zeros = np.zeros_like(time_s)
    names = ("n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct")
    conditions = {name: np.asarray(recording.columns[name]) for name in names}
    sigma, evidence = np.array([1000.0]), (time_s[:2], zeros[:2])
    curves = Curves(time_s, ("p_im_pa",), readings, readings, readings, sigma, evidence, conditions, zeros)
    return Discovery(document, engine, engine, curves, {"fit": 0.1}, {"seed": getattr(options, "seed", None)})


def _held_out_nll(engine: Any, recording: Any) -> float:
    return 2.0


def _fit_oracle(recording: Any, engine: Any, terms: Any, map_tolerance: float = 0.003) -> Any:
    return engine.model_copy(update={"terms": tuple(terms)})


def _separability(recording: Any, engine: Any, term: Any, map_tolerance: float = 0.003) -> dict[str, float]:
    return {"blow_by": 12.0}


def _module(name: str, **content: Any) -> None:
    module = types.ModuleType(name)
    for key, value in content.items():
        setattr(module, key, value)
    sys.modules[name] = module


def _prepare(recording: Any, engine: Any, options: Any = None, known: Any = None) -> Any:
    from dieseltwin.engine.effects import EFFECTS

    smallest = {name: 0.5 * effect.tolerance for name, effect in EFFECTS.items()}
    return types.SimpleNamespace(minimum_detectable=smallest, health_bias={})


class Options:
    """Takes what it is given."""

    def __init__(self, **given: Any) -> None:
        self.__dict__.update(given)


def install() -> None:
    """Replace the two modules."""
    _module("dieseltwin.discovery.discover", discover=_discover, prepare=_prepare, Options=Options)
    _module(
        "dieseltwin.challenge.oracle",
        held_out_nll=_held_out_nll,
        fit_oracle=_fit_oracle,
        separability=_separability,
    )


install()
