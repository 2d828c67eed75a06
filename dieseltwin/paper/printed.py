"""What the paper prints, by table and row: the one place that figures and tables take printed values from.

Source: Nath, Kumar, Smith, Karniadakis, "A Digital Twin for Diesel Engines". Table ids are the LaTeX labels of the
paper; a row id is the case and the minute, or the output. Nothing here enters a computation of ours.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import pandas as pd

from dieseltwin.symbols import HEALTH_NAMES

PARAMETERS = HEALTH_NAMES
MINUTES = ("0-1", "1-2", "2-3", "3-4", "4-5")
RUNS = 30
"""Independent runs behind every cell (paper)."""

MULTI_STAGE = "Table: Predicted unknown, transfer_learning"
FEW_SHOT = "Table:Param estimates, few shot learning"

Cell = tuple[float, float]

_MULTI_STAGE: Mapping[str, tuple[tuple[Cell, ...], ...]] = {
    "clean-151": (
        ((1.009, 0.0017), (1.022, 0.0003), (1.004, 0.0008), (1.003, 0.0035)),
        ((0.922, 0.0487), (1.0185, 0.0036), (0.977, 0.0183), (0.850, 0.0967)),
        ((0.955, 0.0117), (0.991, 0.0036), (1.012, 0.0017), (1.013, 0.0041)),
        ((1.007, 0.0017), (1.019, 0.0004), (1.003, 0.0025), (0.992, 0.0072)),
        ((0.944, 0.0980), (0.999, 0.0073), (1.001, 0.0025), (0.988, 0.0103)),
    ),
    "clean-301": (
        ((1.004, 0.0010), (1.024, 0.0003), (1.007, 0.000), (1.005, 0.0012)),
        ((0.971, 0.0470), (1.012, 0.0046), (1.000, 0.0833), (0.980, 0.0561)),
        ((0.964, 0.0123), (0.992, 0.0011), (1.008, 0.0025), (1.007, 0.0056)),
        ((1.004, 0.0013), (1.019, 0.0003), (1.003, 0.0017), (0.992, 0.0054)),
        ((0.900, 0.1033), (1.006, 0.0022), (0.998, 0.0042), (0.984, 0.0137)),
    ),
    "noisy-301": (
        ((0.997, 0.1103), (1.021, 0.0061), (0.999, 0.0125), (0.999, 0.0452)),
        ((0.952, 0.0693), (1.011, 0.0072), (1.007, 0.0108), (1.021, 0.0675)),
        ((0.803, 0.1047), (0.974, 0.0148), (0.998, 0.0125), (0.984, 0.0734)),
        ((1.004, 0.0353), (1.019, 0.0051), (0.993, 0.0117), (0.978, 0.0271)),
        ((0.793, 0.1333), (1.002, 0.0103), (0.997, 0.0117), (0.985, 0.0328)),
    ),
}

_FEW_SHOT: Mapping[str, tuple[tuple[Cell, ...], ...]] = {
    "clean-151": (
        ((1.0073, 0.0046), (1.0201, 0.0008), (0.9929, 0.0086), (0.9592, 0.0296)),
        ((0.9531, 0.0026), (1.0115, 0.0007), (0.9980, 0.0162), (1.0559, 0.1541)),
        ((0.9512, 0.0238), (0.9925, 0.0022), (0.9281, 0.0357), (0.7854, 0.1144)),
        ((1.0057, 0.0013), (1.0186, 0.0006), (0.9755, 0.0091), (0.9589, 0.0173)),
        ((0.9238, 0.0032), (0.9993, 0.0018), (0.9965, 0.0043), (0.9951, 0.0163)),
    ),
    "clean-301": (
        ((1.0038, 0.0044), (1.0198, 0.0007), (0.9922, 0.0056), (0.9599, 0.0207)),
        ((1.0312, 0.0042), (1.0043, 0.0008), (0.9958, 0.0111), (1.0084, 0.0883)),
        ((0.9551, 0.0263), (0.9922, 0.0014), (0.9385, 0.0315), (0.8205, 0.1001)),
        ((1.0057, 0.0013), (1.0190, 0.0006), (0.9688, 0.0098), (0.9532, 0.0162)),
        ((0.9385, 0.0041), (1.0024, 0.0006), (0.9893, 0.0047), (0.9646, 0.0156)),
    ),
    "noisy-301": (
        ((0.9699, 0.0653), (1.0190, 0.0056), (0.9913, 0.0094), (0.9568, 0.0379)),
        ((1.0255, 0.0748), (0.9992, 0.0092), (0.9888, 0.0230), (0.9445, 0.1749)),
        ((0.5800, 0.0568), (0.9520, 0.0165), (0.9524, 0.0429), (0.9087, 0.2365)),
        ((0.9972, 0.0246), (1.0139, 0.0081), (0.9554, 0.0276), (0.9114, 0.0721)),
        ((0.9525, 0.0998), (0.9942, 0.0093), (0.9849, 0.0122), (0.9519, 0.0390)),
    ),
}

PARAMETER_TABLES: Mapping[str, Mapping[str, tuple[tuple[Cell, ...], ...]]] = {
    MULTI_STAGE: _MULTI_STAGE,
    FEW_SHOT: _FEW_SHOT,
}
"""Table id -> case -> minute -> parameter: mean and standard deviation of estimate over truth, 30 runs."""

_OWN_TABLE = {"multi-stage": (MULTI_STAGE,), "few-shot-adam": (FEW_SHOT,)}


def counterpart(method: str) -> tuple[str, ...]:
    """Ids of the tables that a method is held against: its own for a method of the paper, both for any other."""
    return _OWN_TABLE.get(method, (FEW_SHOT, MULTI_STAGE))


@dataclass(frozen=True)
class PrintedTime:
    """One row of the paper's table of run times: seconds (mean, std) on one core of a cluster."""

    epochs: int
    clean_151: Cell
    noisy_301: Cell


TIMES: Mapping[tuple[str, str], PrintedTime] = {
    ("baseline", "0-1"): PrintedTime(80000, (487.12, 54.35), (585.99, 79.87)),
    ("multi-stage", "1-2"): PrintedTime(35000, (245.50, 25.82), (235.08, 42.45)),
    ("multi-stage", "2-3"): PrintedTime(35000, (257.16, 18.49), (222.45, 51.76)),
    ("multi-stage", "3-4"): PrintedTime(35000, (219.47, 34.63), (242.05, 31.99)),
    ("multi-stage", "4-5"): PrintedTime(35000, (237.10, 26.26), (219.97, 45.19)),
    ("few-shot-adam", "0-1"): PrintedTime(30000, (124.35, 11.00), (140.28, 16.95)),
    ("few-shot-adam", "1-2"): PrintedTime(30000, (129.21, 18.20), (137.13, 11.72)),
    ("few-shot-adam", "2-3"): PrintedTime(30000, (128.48, 14.63), (133.41, 16.87)),
    ("few-shot-adam", "3-4"): PrintedTime(30000, (122.82, 12.28), (141.81, 13.31)),
    ("few-shot-adam", "4-5"): PrintedTime(30000, (125.71, 11.74), (135.28, 19.45)),
}
"""Table "tab:trnflear_vs_fewshot": (our name of the method, minute) -> printed seconds."""


def mean_seconds() -> dict[str, float]:
    """Method, as the paper calls it -> seconds a run, noisy data, mean over the minutes."""
    names = {"few-shot-adam": "few-shot transfer", "multi-stage": "multi-stage transfer", "baseline": "baseline PINN"}
    found: dict[str, list[float]] = {name: [] for name in names.values()}
    for (method, _), time in TIMES.items():
        found[names[method]].append(time.noisy_301[0])
    return {name: sum(seconds) / len(seconds) for name, seconds in found.items()}


OPERATOR_ERRORS: Mapping[tuple[str, str, str], Cell] = {
    ("clean", "u_egr1", "train"): (0.64, 0.04),
    ("clean", "u_egr1", "test"): (2.69, 0.49),
    ("clean", "u_egr2", "train"): (0.65, 0.04),
    ("clean", "u_egr2", "test"): (3.64, 0.18),
    ("clean", "u_vgt", "train"): (0.86, 0.10),
    ("clean", "u_vgt", "test"): (2.52, 0.08),
    ("noisy", "u_egr1", "train"): (0.95, 0.08),
    ("noisy", "u_egr1", "test"): (3.11, 0.75),
    ("noisy", "u_egr2", "train"): (0.97, 0.02),
    ("noisy", "u_egr2", "test"): (3.48, 0.17),
    ("noisy", "u_vgt", "train"): (1.14, 0.11),
    ("noisy", "u_vgt", "test"): (2.62, 0.13),
}
"""Table "Table:DeepONet results": (labels, output, recording) -> relative L2 error [%], mean and std of six trainings.
"""


def operator_errors(recording: str) -> dict[str, Cell]:
    """Output -> error [%] of operators trained on clean labels; `recording` is "train" or "test"."""
    return {
        output: cell for (labels, output, on), cell in OPERATOR_ERRORS.items() if (labels, on) == ("clean", recording)
    }


BODY_ERRORS: Mapping[str, Cell] = {
    "p_em": (1.478, 0.135),
    "p_im": (1.476, 0.078),
    "x_r": (5.512, 0.136),
    "T_1": (0.913, 0.008),
    "omega_t": (1.035, 0.028),
}
"""Table "Table:Multihead_training": relative L2 training error [%], mean and std."""


def parameter_cells() -> pd.DataFrame:
    """Both parameter tables in long form: table, case, minute, parameter, mean, std, rmse (all over the truth)."""
    rows = [
        {"table": table, "case": case, "minute": minute, "parameter": name, "mean": mean, "std": std,
         "rmse": ((mean - 1.0) ** 2 + std**2) ** 0.5}
        for table, cases in PARAMETER_TABLES.items()
        for case, minutes in cases.items()
        for minute, cells in zip(MINUTES, minutes, strict=True)
        for name, (mean, std) in zip(PARAMETERS, cells, strict=True)
    ]  # fmt: skip
    return pd.DataFrame(rows)
