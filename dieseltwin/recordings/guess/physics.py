"""Do the guesses agree with each other as the channels of one engine must? And which unit does, where several could.

Balances need no engine file: the displacement that speed, intake state and flows imply must be one number, more
pressure must stand before the EGR valve than behind it, a turbocharger turns faster the higher the pressure ratio.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dieseltwin.recordings.guess.facts import Facts
from dieseltwin.recordings.guess.reading import Reading
from dieseltwin.recordings.importers.signals import Signal
from dieseltwin.recordings.ranks import ranks

R_AIR = 287.0  # J/(kg K)
VOLUMETRIC_EFFICIENCY = 0.9  # +-0.1 for every charged diesel
POINTS = 2000  # on which the channels meet
DISPLACEMENT_L = (0.6, 30.0)
TOO_GOOD = 0.014  # two flow meters and the true eta_vol together scatter more
COMPUTED = ("it may be computed from boost and speed in the control unit, and can't show an intake leak then")
STEADY_DISPLACEMENT = 0.15  # standard deviation over mean: eta_vol itself moves by about 0.05
SMOKE_LIMIT, LEANEST = 15.0, 250.0  # air to fuel: below, a diesel smokes black; above, it does not fire
USUAL_LOADED = (15.0, 42.0)  # air to fuel in the richest tenth of driving
NOMINAL_AIR_K, NOMINAL_AMBIENT_PA, NOMINAL_AMBIENT_K = 320.0, 1.0e5, 295.0
EGR_FLOWS = 0.05  # of the air flow
MOSTLY_ABOVE = 0.3  # of the rows, of a pressure behind a throttle that is above the one before it
SENSORS_DIFFER = 0.05  # of a pressure: noise of 3 % in both readings makes 4 %; gauge against absolute makes tens
BACKWARDS = 0.2  # share of rows with EGR in which p_em may lie below p_im: sensors of 1 to 2 %
LOWEST_RATIO = (0.9, 1.4)  # lowest exhaust over lowest intake pressure: at idle both are near the ambient
MOVES = 0.06  # relative standard deviation from which a channel says something
TURBO_AGREES = 0.4  # rank correlation with the pressure ratio
HEAT = (4.6, 16.0)  # K per mg/cycle and litre of a cylinder, real engines (see `plausibility`)
SHARES_SPREAD, LINE_HOLDS = 1.5, 0.8  # of fuel in the gas, 95 over 5 %; correlation of temperature with it
COLD_LINE, HOT_LINE = 260.0, 480.0
"""K without fuel: 268 to 400 of engines; 90 to 260 of degC and degF taken as K, 530 and 670 of degF and K as degC."""
ALIKE_ROWS = 3.0  # that tell as much of that line as one: the exhaust follows slowly, and the line bends
HOT_PER_SHARE, IMPOSSIBLE_PER_SHARE = 1.85e4, 2.8e4
"""K per fuel share in the gas, where it is above its median: 11,000 to 15,000 of engines, and all heat makes 37,000."""
LEAST_LOADED_MG, FULL_LOAD_MG_L = 20.0, 60.0  # below, no load at all; a diesel's full load per litre of cylinder
WHEEL_RADIUS_M = (0.018, 0.075)  # of turbine wheels, for the tip speed that a pressure ratio takes
CLEAR_SIGN = 0.3  # rank correlation from which a direction is told
STIRRED_PCT = 2.0  # standard deviation of a position that says something
DRIVEN_BELOW = 0.97  # p_im over p_em, for the EGR valve
FLOWS_BELOW = 0.9  # p_amb over p_em: nearer to 1 the area is all noise


class Meeting:
    """The guessed channels in SI at the same times, under the current choice of units."""

    def __init__(self, signals: Mapping[str, Signal], facts: Mapping[str, Facts], cylinders: int) -> None:
        self.signals, self.facts, self.cylinders = signals, facts, cylinders
        self._times = _common_times(signals)
        self._met: dict[str, np.ndarray] = {}

    def columns(self, chosen: Mapping[str, tuple[str, Reading]], nominal: bool = True) -> dict[str, np.ndarray]:
        """Our column -> values on the common times, formulas applied where what they need is there.

        Args:
            chosen: our column -> (channel, unit and formula).
            nominal: stand in for an ambient pressure that nobody gives.
        """
        raw = {column: (reading.entry, reading.entry.converted(self._at(name)))
               for column, (name, reading) in chosen.items()}  # fmt: skip
        found = {column: values for column, (entry, values) in raw.items() if entry.via is None}
        if nominal:
            found.setdefault("p_amb_pa", np.full(self._size, NOMINAL_AMBIENT_PA))
        for _ in raw:
            for column, (entry, values) in raw.items():
                if column not in found and all(need in found for need in entry.needs):
                    found[column] = entry.derived(values, found)
        return found

    @property
    def _size(self) -> int:
        return POINTS if self._times is None else self._times.size

    def _at(self, name: str) -> np.ndarray:
        if name not in self._met:
            signal = self.signals[name]
            if self._times is None or signal.time_s is None:
                self._met[name] = np.resize(signal.values, self._size)
            else:
                there = np.isfinite(signal.values)
                self._met[name] = np.interp(self._times, signal.time_s[there], signal.values[there])
        return self._met[name]


def _common_times(signals: Mapping[str, Signal]) -> np.ndarray | None:
    spans = [(s.time_s[0], s.time_s[-1]) for s in signals.values() if s.time_s is not None and s.time_s.size > 1]
    if not spans:
        return None
    start, end = max(a for a, _ in spans), min(b for _, b in spans)
    if end <= start:
        start, end = min(a for a, _ in spans), max(b for _, b in spans)
    return np.linspace(start, end, POINTS)


def misfit(columns: Mapping[str, np.ndarray], cylinders: int) -> float:
    """How badly the columns disagree, for the choice between units; 0 where nothing disagrees."""
    total = 0.0
    ratio = air_to_fuel(columns, cylinders)
    if ratio is not None:
        rich = float(np.quantile(ratio, 0.1))
        total += abs(np.log(rich / np.clip(rich, *USUAL_LOADED)))
    size = displacement(columns)
    if size is not None:
        litres = float(np.median(size)) * 1e3
        total += abs(np.log(litres / np.clip(litres, *DISPLACEMENT_L)))
        total += max(0.0, float(np.std(size) / np.mean(size)) - STEADY_DISPLACEMENT)
    heat = heat_per_fuel(columns, cylinders)
    if heat is not None:
        total += abs(np.log(max(heat, 0.1) / np.clip(max(heat, 0.1), *HEAT)))
    if {"p_em_pa", "p_im_pa", "w_egr_kg_s"} <= set(columns):
        total += backwards(columns)
    if {"p_em_pa", "p_im_pa"} <= set(columns):
        lowest = max(float(np.divide(*(np.nanquantile(columns[name], 0.05) for name in ("p_em_pa", "p_im_pa")))), 0.1)
        total += abs(np.log(lowest / np.clip(lowest, *LOWEST_RATIO)))
    speed, ratio_p = columns.get("omega_t_rad_s"), _pressure_ratio(columns)
    if speed is not None and ratio_p is not None:
        radius = wheel_radius(speed, ratio_p)
        total += abs(np.log(radius / np.clip(radius, *WHEEL_RADIUS_M)))
    return total


def wheel_radius(speed: np.ndarray, ratio: np.ndarray) -> float:
    """Radius of the compressor's wheel [m] by its speed [rad/s] and pressure ratio [-], (m,) each.

    The work of a pressure ratio is about 0.65 of the squared tip speed.
    """
    tip = np.sqrt(np.maximum(2.0 * 1005.0 * 300.0 * (np.maximum(ratio, 1.02) ** 0.2857 - 1.0) / 0.65, 1.0))
    return float(np.median(tip / np.maximum(speed, 1.0)))


def air_to_fuel(columns: Mapping[str, np.ndarray], cylinders: int) -> np.ndarray | None:
    """Air to fuel by mass where fuel is injected, (m,); None without both flows or fuel."""
    if not {"w_c_kg_s", "u_delta_mg", "n_e_rpm"} <= set(columns):
        return None
    fuel = 1e-6 * columns["u_delta_mg"] * cylinders * columns["n_e_rpm"] / 120.0
    usable = np.isfinite(fuel) & (columns["u_delta_mg"] > 5.0) & (columns["w_c_kg_s"] > 0.0)
    return columns["w_c_kg_s"][usable] / fuel[usable] if np.count_nonzero(usable) > 20 else None


def displacement(columns: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """Displacement that the flows imply at a volumetric efficiency of 0.9, (m,) [m3]: 120 R T (W_c+W_egr)/(0.9 p n)."""
    if not {"w_c_kg_s", "n_e_rpm", "p_im_pa"} <= set(columns):
        return None
    flow = columns["w_c_kg_s"] + columns.get("w_egr_kg_s", 0.0)
    temperature = columns.get("t_im_k", np.full(flow.size, NOMINAL_AIR_K))
    pressure, speed = columns["p_im_pa"], columns["n_e_rpm"]
    usable = (speed > 400.0) & (pressure > 2e4) & np.isfinite(flow) & (flow > 0.0)
    if np.count_nonzero(usable) < 20:
        return None
    size = 120.0 * R_AIR * temperature[usable] * flow[usable]
    return size / (VOLUMETRIC_EFFICIENCY * pressure[usable] * speed[usable])


def petrol_agreements(columns: Mapping[str, np.ndarray]) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
    """As `agreements`, of a petrol engine: the displacement that its air flow implies, and pressures in each other's
    place."""
    reasons, warnings = {}, {}
    if {"p_im_pa", "p_ic_pa"} <= set(columns):
        above = float(np.mean(columns["p_im_pa"] > (1.0 + SENSORS_DIFFER) * columns["p_ic_pa"]))
        if above > MOSTLY_ABOVE:
            warnings["p_im_pa"] = [f"above the pressure before the throttle in {above:.0%} of the rows: are the two "
                                   "swapped?"]  # fmt: skip
    if "omega_e_rad_s" in columns:
        ours = {"w_af_kg_s": "w_c_kg_s", "t_ic_k": "t_im_k"}
        size = displacement({**{ours.get(name, name): values for name, values in columns.items()},
                             "n_e_rpm": columns["omega_e_rad_s"] * 30.0 / np.pi})  # fmt: skip
        if size is not None:
            reasons["w_af_kg_s"] = [f"air balance: {1e3 * float(np.median(size)):.3g} L of displacement"]
    return reasons, warnings


def heat_per_fuel(columns: Mapping[str, np.ndarray], cylinders: int) -> float | None:
    """Exhaust temperature over ambient per fuel at medium load [K per mg/cycle and litre of a cylinder], see `HEAT`.

    Without flows that say the displacement, the richest driving is taken for 60 mg per litre.
    """
    if not {"t_em_k", "u_delta_mg"} <= set(columns):
        return None
    fuel, size = columns["u_delta_mg"], displacement(columns)
    most = float(np.nanquantile(fuel, 0.98))
    medium = (fuel > 0.3 * most) & (fuel < 0.8 * most) & np.isfinite(columns["t_em_k"])
    if most < LEAST_LOADED_MG or np.count_nonzero(medium) < 20:
        return None
    litres = most / FULL_LOAD_MG_L if size is None else 1e3 * float(np.median(size)) / cylinders
    return float(np.median((columns["t_em_k"][medium] - NOMINAL_AMBIENT_K) / fuel[medium])) * litres


def exhaust_line(columns: Mapping[str, np.ndarray], cylinders: int) -> tuple[float, float, float] | None:
    """Exhaust temperature without fuel [K], by a line over fuel per gas, heating per fuel share at load [K], and the
    standard deviation of the first [K].

    The first doesn't depend on units of the flows or on the number of cylinders; by a temperature in K it lies near
    the intake's. None where fuel, air and temperature don't say it.
    """
    if not {"w_c_kg_s", "u_delta_mg", "n_e_rpm", "t_em_k"} <= set(columns):
        return None
    fuel = 1e-6 * columns["u_delta_mg"] * cylinders * columns["n_e_rpm"] / 120.0
    gas = columns["w_c_kg_s"] + fuel
    usable = (columns["u_delta_mg"] > 0.0) & (columns["w_c_kg_s"] > 0.0) & np.isfinite(gas + columns["t_em_k"])
    if np.count_nonzero(usable) < 20:
        return None
    share, hot = fuel[usable] / gas[usable], columns["t_em_k"][usable]
    low, middle, high = np.quantile(share, (0.05, 0.5, 0.95))
    if high < SHARES_SPREAD * low or float(np.corrcoef(share, hot)[0, 1]) < LINE_HOLDS:
        return None
    (_, cold), covariance = np.polyfit(share, hot, 1, cov=True)
    rich = share > middle
    per_share = float(np.median((hot[rich] - NOMINAL_AMBIENT_K) / share[rich]))
    return float(cold), per_share, float(np.sqrt(ALIKE_ROWS * covariance[1, 1]))


def exhaust_in_doubt(columns: Mapping[str, np.ndarray], cylinders: int) -> str:
    """What is odd about the exhaust temperature over fuel and air, "" where nothing is."""
    line = exhaust_line(columns, cylinders)
    if line is None:
        return ""
    cold, per_share, std = line
    if cold + std < COLD_LINE:
        return (f"lies on a line over the fuel's share of the gas that meets {cold:.0f} K at no fuel, far below the "
                "intake's: degF or degC taken as K?")
    if per_share > IMPOSSIBLE_PER_SHARE:
        return (f"rises by {per_share:.3g} K per share of fuel in the gas, which no fuel can heat: check the units of "
                "fuel, air flow and temperature, and the number of cylinders")  # fmt: skip
    if cold > HOT_LINE and per_share > HOT_PER_SHARE:
        return (f"lies on a line over the fuel's share of the gas that meets {cold:.0f} K at no fuel, far above the "
                "intake's: K or degF taken as degC?")
    return ""


def backwards(columns: Mapping[str, np.ndarray]) -> float:
    """Share of the rows with EGR in which the pressure behind the valve is the higher one, by more than noise makes."""
    flows = columns["w_egr_kg_s"] > EGR_FLOWS * columns.get("w_c_kg_s", np.full(columns["w_egr_kg_s"].size, 0.1))
    if np.count_nonzero(flows) < 20:
        return 0.0
    return float(np.mean(columns["p_em_pa"][flows] < (1.0 - SENSORS_DIFFER) * columns["p_im_pa"][flows]))


def _pressure_ratio(columns: Mapping[str, np.ndarray]) -> np.ndarray | None:
    if "p_im_pa" not in columns:
        return None
    with np.errstate(invalid="ignore", divide="ignore"):  # a row of zeros
        return np.asarray(columns["p_im_pa"] / columns["p_amb_pa"])


def ranks_agree(a: np.ndarray, b: np.ndarray) -> float:
    """Rank correlation of two columns (m,) [-]; rows of one value share a rank, and none is said by a column of one."""
    there = np.isfinite(a) & np.isfinite(b)
    if not there.any() or np.ptp(a[there]) == 0.0 or np.ptp(b[there]) == 0.0:
        return 0.0
    return float(np.corrcoef(ranks(a[there]), ranks(b[there]))[0, 1])


def moves(values: np.ndarray) -> bool:
    """Whether a column (m,) changes enough to say something."""
    mean = float(np.nanmean(np.abs(values)))
    return mean > 0.0 and float(np.nanstd(values)) > MOVES * mean


def agreements(columns: Mapping[str, np.ndarray], cylinders: int) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
    """Reasons and warnings by column, from the balances."""
    reasons: dict[str, list[str]] = {}
    warnings: dict[str, list[str]] = {}

    def note(where: dict[str, list[str]], names: tuple[str, ...], text: str) -> None:
        for name in names:
            if name in columns and text:
                where.setdefault(name, []).append(text)

    size = displacement(columns)
    if size is not None:
        litres, spread = float(np.median(size)) * 1e3, float(np.std(size) / np.mean(size))
        flows = ("w_c_kg_s", "w_egr_kg_s", "p_im_pa", "n_e_rpm")
        if DISPLACEMENT_L[0] <= litres <= DISPLACEMENT_L[1] and spread <= 2.0 * STEADY_DISPLACEMENT:
            text = f"air balance: {litres:.3g} L of displacement at eta_vol 0.9, steady to {spread:.1%}"
            note(reasons, flows, text)
            if spread < TOO_GOOD and moves(columns["w_c_kg_s"]) and "w_egr_kg_s" in columns:
                note(warnings, ("w_c_kg_s",), f"the air balance closes to {spread:.1%}, better than meters: {COMPUTED}")
        else:
            text = "one of the flows, the pressure or their units is not what it seems"
            note(warnings, flows, f"air balance: {litres:.3g} L of displacement, unsteady by {spread:.0%}: {text}")
    ratio = air_to_fuel(columns, cylinders)
    if ratio is not None:
        rich = float(np.quantile(ratio, 0.1))
        good = SMOKE_LIMIT * 0.8 <= rich <= LEANEST
        note(reasons if good else warnings, ("u_delta_mg", "w_c_kg_s"), f"air to fuel from {rich:.3g}"
             + ("" if good else ": a diesel lies above 15; check units and the number of cylinders"))
    if {"p_em_pa", "p_im_pa", "w_egr_kg_s"} <= set(columns):
        share = backwards(columns)
        if share > BACKWARDS:
            text = f"EGR flows although p_em lies below p_im in {share:.0%} of its rows: gauge against absolute?"
            note(warnings, ("p_em_pa", "p_im_pa"), text)
        else:
            note(reasons, ("p_em_pa",), "above p_im where EGR flows")
    elif {"p_em_pa", "p_im_pa"} <= set(columns):
        share = float(np.mean(columns["p_em_pa"] < (1.0 - SENSORS_DIFFER) * columns["p_im_pa"]))
        if share > BACKWARDS:
            text = f"p_em lies below p_im in {share:.0%} of the rows: behind the turbine, or gauge against absolute?"
            note(warnings, ("p_em_pa",), text)
    ratio_p = _pressure_ratio(columns)
    if "omega_t_rad_s" in columns and ratio_p is not None and moves(ratio_p) and moves(columns["omega_t_rad_s"]):
        agrees = ranks_agree(columns["omega_t_rad_s"], ratio_p)
        note(reasons if agrees >= TURBO_AGREES else warnings, ("omega_t_rad_s",),
             f"rises with the pressure ratio (rank correlation {agrees:.2f})" if agrees >= TURBO_AGREES
             else f"doesn't rise with the pressure ratio (rank correlation {agrees:.2f})")
    if "t_em_k" in columns and "u_delta_mg" in columns and moves(columns["u_delta_mg"]):
        agrees = ranks_agree(columns["t_em_k"], np.nan_to_num(columns["u_delta_mg"]))
        if agrees > TURBO_AGREES / 2.0:
            note(reasons, ("t_em_k",), f"rises with fuel (rank correlation {agrees:.2f})")
    note(warnings, ("t_em_k",), exhaust_in_doubt(columns, cylinders))
    return reasons, warnings


def reversed_positions(columns: Mapping[str, np.ndarray]) -> dict[str, str]:
    """Positions that seem to count the other way (0 open), with the reason."""
    found = {}
    if {"u_egr_pct", "w_egr_kg_s"} <= set(columns) and moves(columns["u_egr_pct"]):
        agrees = ranks_agree(columns["u_egr_pct"], columns["w_egr_kg_s"])
        if agrees < -CLEAR_SIGN:
            found["u_egr_pct"] = f"EGR flow falls while it rises (rank correlation {agrees:.2f}): 0 seems to be open"
    elif {"u_egr_pct", "w_c_kg_s", "p_im_pa", "n_e_rpm"} <= set(columns) and moves(columns["u_egr_pct"]):
        agrees = ranks_agree(columns["u_egr_pct"], beside_air(columns))
        if agrees < -CLEAR_SIGN:
            found["u_egr_pct"] = ("the cylinders take in less beside the air flow while it rises "
                                  f"(rank correlation {agrees:.2f}): 0 seems to be open")  # fmt: skip
    area = turbine_area(columns)
    if area is not None and "u_vgt_pct" in columns and float(np.nanstd(columns["u_vgt_pct"])) > STIRRED_PCT:
        usable = np.isfinite(area)
        agrees = ranks_agree(columns["u_vgt_pct"][usable], area[usable]) if np.count_nonzero(usable) > 50 else 0.0
        if agrees < -CLEAR_SIGN:
            found["u_vgt_pct"] = (f"the turbine's flow area falls while it rises (rank correlation {agrees:.2f}): "
                                  "100 seems shut")  # fmt: skip
    return found


def reversed_where_read(columns: Mapping[str, np.ndarray], more_than: int = 0) -> dict[str, str]:
    """`reversed_positions` by the rows in which every column has a number; nothing by no more than so many rows."""
    met = np.isfinite(np.stack(list(columns.values()))).all(axis=0)
    if np.count_nonzero(met) <= more_than:
        return {}
    return reversed_positions({name: values[met] for name, values in columns.items()})


def unchecked_positions(columns: Mapping[str, np.ndarray]) -> dict[str, str]:
    """Positions that move and whose direction no other channel could tell, with what to check."""
    tells = {"u_egr_pct": ({"w_egr_kg_s"}, {"w_c_kg_s", "p_im_pa", "n_e_rpm"}), "u_vgt_pct": ({"p_em_pa", "w_c_kg_s"},)}
    missing = {"u_egr_pct": "EGR flow, or air flow with boost", "u_vgt_pct": "exhaust pressure and air flow"}
    return {
        name: f"its direction couldn't be checked without {missing[name]}: 0 must be shut, 100 open"
        for name, ways in tells.items() if name in columns and not any(way <= set(columns) for way in ways)
        and float(np.nanstd(columns[name])) > STIRRED_PCT
    }  # fmt: skip


def beside_air(columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """What the cylinders take in over the air flow, up to a factor: p_im n_e/W_c, which rises with EGR."""
    filled: np.ndarray = columns["p_im_pa"] * columns["n_e_rpm"] / np.maximum(columns["w_c_kg_s"], 1e-6)
    return filled


def turbine_area(columns: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """Area of the turbine as a nozzle up to a factor, W sqrt(T)/(p_em sqrt(1 - Pi^2)); NaN where it hardly flows."""
    return _area(columns, "w_c_kg_s", "p_amb_pa", FLOWS_BELOW)


def egr_area(columns: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """Area of the EGR valve as a nozzle up to a factor, as `turbine_area`; NaN where hardly anything drives it."""
    return _area(columns, "w_egr_kg_s", "p_im_pa", DRIVEN_BELOW)


def _area(columns: Mapping[str, np.ndarray], flow: str, behind: str, below: float) -> np.ndarray | None:
    """Area that a flow out of the exhaust manifold passes, NaN where the pressure ratio over it isn't below `below`."""
    if not {"p_em_pa", flow, behind} <= set(columns):
        return None
    ratio = columns[behind] / np.maximum(columns["p_em_pa"], 1.0)
    temperature = columns.get("t_em_k", np.full(ratio.size, 700.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        area = columns[flow] * np.sqrt(temperature) / (columns["p_em_pa"] * np.sqrt(1.0 - ratio**2))
    return np.where(ratio < below, area, np.nan)
