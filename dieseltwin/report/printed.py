"""Numbers that the paper prints, kept beside our own in figures and tables. Nothing here enters a computation.

Source: Nath, Kumar, Smith, Karniadakis, "A Digital Twin for Diesel Engines" (the paper of this project).
"""

from __future__ import annotations

from collections.abc import Mapping

# Table "Computational time comparison", noisy data, 301 points, one CPU core; mean over segments.
PRINTED_SECONDS: Mapping[str, float] = {
    "few-shot transfer": 137.6,
    "multi-stage transfer": 229.9,
    "baseline PINN": 586.0,
}

# Table "Training of multi-head networks": relative L2 training error [%], (mean, std).
PRINTED_BODIES: Mapping[str, tuple[float, float]] = {
    "p_im": (1.476, 0.078),
    "p_em": (1.478, 0.135),
    "x_r": (5.512, 0.136),
    "T_1": (0.913, 0.008),
    "omega_t": (1.035, 0.028),
}

# Table "DeepONet results for independent variables", clean data: relative L2 error [%], (mean, std).
PRINTED_OPERATORS_TRAINING: Mapping[str, tuple[float, float]] = {
    "u_egr1": (0.64, 0.04),
    "u_egr2": (0.65, 0.04),
    "u_vgt": (0.86, 0.10),
}
PRINTED_OPERATORS_TEST: Mapping[str, tuple[float, float]] = {
    "u_egr1": (2.69, 0.49),
    "u_egr2": (3.64, 0.18),
    "u_vgt": (2.52, 0.08),
}

# Table "Predicted unknown parameters, Few-shot learning", noisy data, 301 points: (mean, std) in units of the truth,
# per minute, in the order A_egrmax, A_vgtmax, eta_sc, h_tot.
PRINTED_FEW_SHOT_NOISY: Mapping[str, tuple[tuple[float, float], ...]] = {
    "0–1": ((0.9699, 0.0653), (1.0190, 0.0056), (0.9913, 0.0094), (0.9568, 0.0379)),
    "1–2": ((1.0255, 0.0748), (0.9992, 0.0092), (0.9888, 0.0230), (0.9445, 0.1749)),
    "2–3": ((0.5800, 0.0568), (0.9520, 0.0165), (0.9524, 0.0429), (0.9087, 0.2365)),
    "3–4": ((0.9972, 0.0246), (1.0139, 0.0081), (0.9554, 0.0276), (0.9114, 0.0721)),
    "4–5": ((0.9525, 0.0998), (0.9942, 0.0093), (0.9849, 0.0122), (0.9519, 0.0390)),
}
