"""How well channels behave like the quantities they are taken for: relations that the channels of one engine obey.

Every relation gives a support: above zero where the channels agree, below where they contradict each other. None needs
an engine file. Supports are of the size of a correlation, so that their sum can be compared between assignments.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from dieseltwin.recordings.guess.physics import (
    DISPLACEMENT_L,
    SENSORS_DIFFER,
    STEADY_DISPLACEMENT,
    USUAL_LOADED,
    air_to_fuel,
    beside_air,
    displacement,
    egr_area,
    moves,
    ranks_agree,
    turbine_area,
)

STEADY_AMBIENT_PA, STEADY_AMBIENT_K = 1.5e3, 8.0  # weather, altitude and a draught within one recording
FREE_AIR_PA, FREE_AIR_K = (6.0e4, 1.08e5), (253.0, 315.0)
FAST_RAD_S = 2.0e3  # 19000 rpm: no shaft of an engine or a gearbox turns as fast
CHARGE_AIR_K = (285.0, 345.0)  # after a charge air cooler; coolant and oil of a warm engine are hotter
STEADY_CHARGE_K = 2.0  # charge air moves by more with load
HOT_EXHAUST_K = 550.0  # reached before every turbine under load
DRIVEN = 0.93  # rank correlation with engine speed from which a pressure is that of an oil, water or fuel pump
SAME = 0.97  # rank correlation from which two channels are one thing: pedal, load and torque follow the fuel
ONE_RANKING = 0.993  # rank correlation of two readings of one pressure
MANY_POINTS = 40


@dataclass(frozen=True)
class Support:
    """One relation between quantities.

    Attributes:
        columns: ours, that it ties together.
        value: above zero for it, below against it.
        text: what was seen, in words.
    """

    columns: tuple[str, ...]
    value: float
    text: str


Columns = Mapping[str, np.ndarray]


def supports(columns: Columns, cylinders: int) -> Iterator[Support]:
    """All relations that the columns (m,) allow to be looked at [SI, columns' units]."""
    yield from _speeds(columns)
    yield from _balances(columns, cylinders)
    yield from _pressures(columns)
    yield from _temperatures(columns)
    yield from _positions(columns)


def _agree(columns: Columns, one: str, other: str, weight: float, text: str) -> Iterator[Support]:
    if one in columns and other in columns and moves(columns[one]) and moves(columns[other]):
        agrees = ranks_agree(columns[one], columns[other])
        yield Support((one, other), weight * agrees, f"{text} (rank correlation {agrees:.2f})")


def _range(values: np.ndarray) -> tuple[float, float, float]:
    low, median, high = np.nanquantile(values, (0.02, 0.5, 0.98))
    return float(low), float(median), float(high)


def _speeds(columns: Columns) -> Iterator[Support]:
    if "n_e_rpm" in columns:
        low, median, high = _range(columns["n_e_rpm"])
        turns = high - low > 0.05 * median
        yield Support(("n_e_rpm",), 0.5 if turns else -0.5, f"{low:.4g} to {high:.4g} rpm, as an engine turns")
    if "omega_t_rad_s" in columns:
        high = _range(columns["omega_t_rad_s"])[2]
        text = f"up to {high:.4g} rad/s: only a turbocharger turns as fast"
        yield Support(("omega_t_rad_s",), 0.5 if high > FAST_RAD_S else -0.5, text)


def _balances(columns: Columns, cylinders: int) -> Iterator[Support]:
    size = displacement(columns)
    if size is not None:
        litres, spread = 1e3 * float(np.median(size)), float(np.std(size) / np.mean(size))
        in_range = DISPLACEMENT_L[0] <= litres <= DISPLACEMENT_L[1]
        value = float(np.clip(1.0 - spread / (2.0 * STEADY_DISPLACEMENT), -1.0, 1.0)) if in_range else -1.0
        names = tuple(name for name in ("w_c_kg_s", "n_e_rpm", "p_im_pa", "w_egr_kg_s", "t_im_k") if name in columns)
        yield Support(names, 1.5 * value, f"air balance: {litres:.3g} L of displacement, steady to {spread:.1%}")
    ratio = air_to_fuel(columns, cylinders)
    if ratio is not None:
        rich = max(float(np.quantile(ratio, 0.1)), 1e-3)
        off = abs(float(np.log(rich / np.clip(rich, *USUAL_LOADED))))
        yield Support(("w_c_kg_s", "u_delta_mg"), max(0.8 - 2.0 * off, -1.5), f"air to fuel from {rich:.3g}")
    yield from _agree(columns, "w_c_kg_s", "n_e_rpm", 0.4, "air flow rises with speed")
    yield from _agree(columns, "u_delta_mg", "torque_nm", 0.6, "fuel rises with torque")
    if "u_delta_mg" in columns:
        low, _, high = _range(columns["u_delta_mg"])
        yield Support(("u_delta_mg",), 0.2 if low < 0.4 * high else -0.2, f"from {low:.3g} to {high:.3g} mg/cycle")
    if "w_egr_kg_s" in columns:
        low, median, high = _range(columns["w_egr_kg_s"])
        yield Support(("w_egr_kg_s",), 0.3 if low < 0.2 * high else -0.4, "goes down to nothing, as a valve shuts")
        if "w_c_kg_s" in columns:
            share = median / max(_range(columns["w_c_kg_s"])[1], 1e-9)
            yield Support(("w_egr_kg_s", "w_c_kg_s"), 0.1 if share < 0.6 else -1.0, f"{share:.0%} of the air flow")


def _pressures(columns: Columns) -> Iterator[Support]:
    if "p_amb_pa" in columns:
        low, median, high = _range(columns["p_amb_pa"])
        free = FREE_AIR_PA[0] <= median <= FREE_AIR_PA[1] and high - low < STEADY_AMBIENT_PA
        yield Support(("p_amb_pa",), 0.5 if free else -0.5, f"stays at {median / 1e3:.4g} kPa, as free air does")
    if "p_im_pa" in columns:
        low, _, high = _range(columns["p_im_pa"])
        charged = high > 1.15 * low and low > 5e4
        yield Support(("p_im_pa",), 0.1 if charged else -0.6, f"from {low / 1e3:.4g} to {high / 1e3:.4g} kPa")
    if "p_em_pa" in columns:
        low, _, high = _range(columns["p_em_pa"])
        yield Support(("p_em_pa",), 0.1 if high > 1.15 * low and low > 7e4 else -0.6,
                      f"from {low / 1e3:.4g} to {high / 1e3:.4g} kPa")  # fmt: skip
    for name in ("p_im_pa", "p_em_pa"):
        if name in columns and "n_e_rpm" in columns and moves(columns[name]) and moves(columns["n_e_rpm"]):
            driven = ranks_agree(columns[name], columns["n_e_rpm"])
            if driven > DRIVEN:
                yield Support((name, "n_e_rpm"), -2.0, f"follows speed (rank correlation {driven:.2f}), as a pump does")
    yield from _agree(columns, "p_im_pa", "omega_t_rad_s", 0.6, "boost and turbocharger speed rise together")
    yield from _agree(columns, "p_em_pa", "omega_t_rad_s", 0.4, "exhaust pressure and turbocharger speed rise together")
    if {"p_em_pa", "p_im_pa"} <= set(columns):
        above = float(np.nanmean(columns["p_em_pa"] > (1.0 - SENSORS_DIFFER) * columns["p_im_pa"]))
        ratio = float(np.nanmedian(columns["p_em_pa"] / columns["p_im_pa"]))
        value = 0.8 * float(np.clip((above - 0.5) / 0.3, -1.0, 1.0)) if ratio < 2.5 else -0.8
        yield Support(("p_em_pa", "p_im_pa"), value, f"p_em above p_im in {above:.0%} of the rows")
        if ranks_agree(columns["p_em_pa"], columns["p_im_pa"]) > ONE_RANKING:
            yield Support(("p_em_pa", "p_im_pa"), -2.5, "two readings of one pressure, or the wanted one")
        yield from _agree(columns, "p_em_pa", "p_im_pa", 0.3, "pressures before and behind the cylinders go together")


def _temperatures(columns: Columns) -> Iterator[Support]:
    if "t_em_k" in columns:
        low, median, high = _range(columns["t_em_k"])
        hot = 0.4 + (median - HOT_EXHAUST_K) / 1e3 if high > HOT_EXHAUST_K and high - low > 30.0 else -0.6
        yield Support(("t_em_k",), hot, f"as hot as exhaust gas, {median - 273.15:.3g} degC at the median")
        yield from _agree(columns, "t_em_k", "u_delta_mg", 0.3, "exhaust temperature rises with fuel")
    if "t_im_k" in columns:
        low, median, high = _range(columns["t_im_k"])
        fits = CHARGE_AIR_K[0] <= median <= CHARGE_AIR_K[1] and high - low > STEADY_CHARGE_K
        yield Support(("t_im_k",), 0.35 if fits else -0.4, f"{median - 273.15:.3g} degC, as cooled charge air has")
    if "t_amb_k" in columns:
        low, median, high = _range(columns["t_amb_k"])
        fits = FREE_AIR_K[0] <= median <= FREE_AIR_K[1] and high - low < STEADY_AMBIENT_K
        yield Support(("t_amb_k",), 0.4 if fits else -0.4, f"{median - 273.15:.3g} degC, as free air has")
        if "t_im_k" in columns:
            warmer = _range(columns["t_im_k"])[1] - median
            yield Support(("t_im_k", "t_amb_k"), 0.2 if warmer > 1.0 else -0.4, "charge air is warmer than free air")


def _positions(columns: Columns) -> Iterator[Support]:
    for name in ("u_egr_pct", "u_vgt_pct"):
        if not {name, "u_delta_mg"} <= set(columns) or not moves(columns[name]) or not moves(columns["u_delta_mg"]):
            continue
        if ranks_agree(columns[name], columns["u_delta_mg"]) > SAME:
            yield Support((name, "u_delta_mg"), -1.0, "follows the fuel, as pedal and load do")
    if "u_egr_pct" in columns and moves(columns["u_egr_pct"]):
        if "w_egr_kg_s" in columns:
            flow = ranks_agree(columns["u_egr_pct"], columns["w_egr_kg_s"])
            area = _follows(columns["u_egr_pct"], egr_area(columns))
            what, agrees = ("flow", flow) if abs(flow) > abs(area) else ("valve's flow area", area)
            text = f"the EGR {what} follows (rank correlation {agrees:.2f})"
            yield Support(("u_egr_pct", "w_egr_kg_s"), abs(agrees) - 0.1, text)
        elif {"w_c_kg_s", "p_im_pa", "n_e_rpm"} <= set(columns):
            agrees = ranks_agree(columns["u_egr_pct"], beside_air(columns))
            text = f"the cylinders take in more than the air flow with it (rank correlation {agrees:.2f})"
            yield Support(("u_egr_pct", "w_c_kg_s"), abs(agrees) - 0.2, text)
    turbine = turbine_area(columns)
    if turbine is not None and "u_vgt_pct" in columns and moves(columns["u_vgt_pct"]):
        agrees = _follows(columns["u_vgt_pct"], turbine)
        text = f"the turbine's flow area follows (rank correlation {agrees:.2f})"
        yield Support(("u_vgt_pct", "p_em_pa"), abs(agrees) - 0.1, text)


def _follows(position: np.ndarray, area: np.ndarray | None) -> float:
    """Rank correlation of an area with a position where it flows; 0 where too little does."""
    usable = np.isfinite(area) if area is not None else np.zeros(position.size, dtype=bool)
    return ranks_agree(position[usable], area[usable]) if area is not None and usable.sum() > MANY_POINTS else 0.0
