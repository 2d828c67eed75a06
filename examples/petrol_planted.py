"""How small a fault does the petrol twin name? Planted in pieces of the fault-free recording that no map saw.

    python examples/petrol_planted.py [wltp_NF.csv]

Ten-minute pieces, fault from 200 s on. A leak is planted as it looks under control: the throttle closes by what the
leak lets in. The sensors' faults reach no controller here, which is easier than on the engine.
"""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from dieseltwin.petrol.calibrate import fit_maps
from dieseltwin.petrol.components import nozzle_flow, signed_leak
from dieseltwin.petrol.discover import discover_petrol
from dieseltwin.petrol.maps import spline_basis
from dieseltwin.petrol.model import ALPHA_SHIFT
from dieseltwin.petrol.parameters import PetrolParameters
from dieseltwin.petrol.recording import PetrolRecording, Signals, read_petrol

ONSET_S, PIECE_S = 200.0, 600.0
CASES = [
    ("p_im_gain", 0.05), ("p_im_gain", -0.05), ("p_ic_gain", 0.05), ("p_ic_gain", -0.03), ("w_af_gain", 0.05),
    ("w_af_gain", -0.05), ("w_af_gain", -0.10), ("intake_leak", 5e-7), ("intake_leak", 1e-6), ("intake_leak", 2e-6),
    ("boost_leak", 1e-5), ("throttle_offset", 0.5),
]  # fmt: skip
LARGEST_SHARE = 0.8  # of the air flow that may come through the leak: the throttle has to stay open


def area_table(engine: PetrolParameters) -> tuple[np.ndarray, np.ndarray]:
    """Throttle position [%] and log of its area, rising."""
    alpha = np.linspace(0.05, 100.0, 4000)
    knots = np.array(engine.throttle.knots_x)
    basis = spline_basis(np.log(alpha + ALPHA_SHIFT), knots)
    log_area = basis @ np.array(engine.throttle.coefficients[: basis.shape[1]])
    return alpha, np.maximum.accumulate(log_area)


def plant(s: Signals, name: str, size: float, engine: PetrolParameters) -> Signals:
    """The signals with the fault from ONSET_S on."""
    m = size * (s.time_s >= ONSET_S)
    if name == "p_im_gain":
        return replace(s, p_im=s.p_im * (1 + m))
    if name == "p_ic_gain":
        return replace(s, p_ic=s.p_ic * (1 + m))
    if name == "w_af_gain":
        return replace(s, W_af=s.W_af * (1 + m))
    if name == "throttle_offset":
        return replace(s, alpha=s.alpha + m)
    if name == "boost_leak":
        return replace(s, W_af=s.W_af + nozzle_flow(m, s.p_ic, s.T_ic, s.p_amb))
    alpha, log_area = area_table(engine)
    leak = np.minimum(signed_leak(m, s.p_im, s.T_ic, s.p_amb, s.T_amb), LARGEST_SHARE * s.W_af)
    closed = np.interp(np.interp(s.alpha, alpha, log_area) + np.log1p(-leak / s.W_af), log_area, alpha)
    return replace(s, W_af=s.W_af - leak, alpha=np.where(leak == 0.0, s.alpha, closed))


def main() -> None:
    root = Path(os.environ.get("DIESELTWIN_DATA") or Path(__file__).parents[2] / "shared" / "data")
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else root / "liu_ice" / "wltp_NF.csv"
    if not path.is_file():
        sys.exit(f"no recording {path}: set DIESELTWIN_DATA to the folder that holds it, or pass the file")
    signals = read_petrol(path).signals
    whole, _ = fit_maps(signals, PetrolParameters())
    spans = [(a, a + PIECE_S) for a in np.arange(0.0, signals.time_s[-1] - 0.9 * PIECE_S, PIECE_S)]
    engines = [fit_maps(signals, PetrolParameters(), without=span)[0] for span in spans]
    for case in [None, *CASES]:
        cells = []
        for span, engine in zip(spans, engines, strict=True):
            piece = signals.part(*span)
            if case is not None:
                piece = plant(piece, *case, whole)
            found = discover_petrol(PetrolRecording(piece, 0.0, str(path), "", ()), engine)
            best = found.document.effects[0] if found.document.effects else None
            onset = found.document.location.onset_s if found.document.location else None
            cells.append("nothing" if best is None else f"{best.name} {best.magnitude or float('nan'):.3g} at {onset}")
        print(f"{'no fault' if case is None else f'{case[0]} {case[1]:g}':<24}" + " | ".join(cells), flush=True)


if __name__ == "__main__":
    main()
