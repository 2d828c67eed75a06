"""What can be seen in the points before anything is fitted: swapped columns, actuators that never move, directions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from dieseltwin.arrays import Array
from dieseltwin.calibration.beside_checks import far_from_reference, refuse_copies
from dieseltwin.engine import EngineParameters, constants
from dieseltwin.engine.cylinder import cylinder_inflow, fuel_flow
from dieseltwin.errors import InputError
from dieseltwin.notes import Note, counted
from dieseltwin.recordings.channels import INPUTS
from dieseltwin.recordings.guess.physics import ranks_agree
from dieseltwin.recordings.ranks import ranks
from dieseltwin.recordings.reader import CRANKING_RPM
from dieseltwin.recordings.steady_points import JUDGED, NEVER_NOUGHT, STATES, SteadyPoints, once_each

FEWEST_POINTS = 20
FEWEST_JUDGED = 10  # beside a reference, which has the coefficients to tell
MANY = 0.2  # of the points, from which a missing reading is said
_SAME_DIGITS = 3  # of rpm, mg and %: points that agree in all of them say the same
SHUT = 0.005  # an EGR fraction below this everywhere is a shut valve [-]
STILL = 1.5  # an actuator whose spread (standard deviation) stays below this does not move [%]
STOICHIOMETRIC = 14.57
FILLING = (0.6, 1.2)  # volumetric efficiency of a four-stroke engine [-], charged at T_im
SURE = 3.0  # a direction is told when its slope has this many standard deviations


@dataclass(frozen=True)
class Actuator:
    """What the points say about one actuator.

    Attributes:
        column: u_egr_pct or u_vgt_pct.
        moves: whether it was varied.
        opens: +1 opens with rising position, -1 closes, 0 can't be told.
        significance: standard deviations of the slope from 0.
        low, high: range met with [%].
    """

    column: str
    moves: bool
    opens: int
    significance: float
    low: float
    high: float

    def sentence(self) -> str:
        """In words."""
        span = f"{self.column} between {self.low:.3g} and {self.high:.3g} %"
        if not self.moves:
            return f"{span}: it doesn't move, so its map can't be told; the base engine's shape is kept"
        if self.opens == 0:
            return f"{span}: which way it opens can't be told; taken as opening with rising position"
        way = "opens" if self.opens > 0 else "closes (turned round by a channel map 100 % - position)"
        return f"{span}: {way} with rising position ({self.significance:.0f} standard deviations)"


def check_points(points: SteadyPoints, where: str, cylinders: int = 6) -> SteadyPoints:
    """Refuse what can't be calibrated from; drop copies, rows that lack more than one reading, and engines at rest.

    Points beside a reference and the reference's own are checked apart: beside the others a swapped column hides.

    Args:
        points: as read; where: name for messages; cylinders: how many the engine has.

    Raises:
        InputError: too few points, a reading that stands still, columns that are swapped.
    """
    points = _running(_read(points))
    if JUDGED in points:
        points = once_each(points)
        well, judged = points.take(points[JUDGED] < 0.5), points.judged
        _check(well, f"{where}: its reference", cylinders)
        if judged.size < FEWEST_JUDGED:
            raise InputError(where, f"{judged.size} usable points", f"at least {FEWEST_JUDGED} beside a reference",
                             "measure more points over speed, load, EGR and VGT")
        _refuse_still(judged, where)
        _swapped(judged, where, cylinders)
        refuse_copies(points, where)
        return replace(points, notes=(*points.notes, *far_from_reference(points)))
    return _check(points, where, cylinders)


def _read(points: SteadyPoints) -> SteadyPoints:
    """Without points that lack more than one reading; a note for these, and for a reading that many lack."""
    known = np.isfinite(points.states())
    kept = known.sum(axis=1) >= len(STATES) - 1
    notes = []
    if not kept.all():
        notes.append(f"{counted(int(np.count_nonzero(~kept)), 'point')} left out: more than one reading is missing")
    for name, there in zip(STATES, known[kept].T, strict=True):
        lacking = int(np.count_nonzero(~there))
        if lacking > MANY * there.size:
            notes.append(f"{name} is missing in {lacking} of {there.size} points, which say nothing of what needs it")
    return replace(points.take(kept), notes=(*points.notes, *notes))


def _refuse_still(points: SteadyPoints, where: str) -> None:
    """Refuse a reading that has one value in every point, while the engine has not."""
    for name in NEVER_NOUGHT:
        values = points[name][np.isfinite(points[name])]
        if values.size >= FEWEST_JUDGED and np.ptp(values) == 0.0:
            raise InputError(f"{where}: column {name}", f"{values[0]:g} in every point",
                             "a reading that follows speed and load", "is the sensor plugged in? Measure it again")


def _check(points: SteadyPoints, where: str, cylinders: int) -> SteadyPoints:
    """`check_points` of those of one engine in one state."""
    different = np.unique(np.round(points.inputs(), _SAME_DIGITS), axis=0)
    if points.size >= FEWEST_POINTS and len(different) < FEWEST_POINTS // 2:
        raise InputError(where, f"{len(different)} different operating points in {points.size} rows",
                         f"at least {FEWEST_POINTS // 2}; 60 or more to tell the maps' coefficients",
                         "measure points over speed, load, EGR and VGT")
    points = once_each(points)
    if points.size < FEWEST_POINTS:
        raise InputError(where, f"{points.size} usable points", f"at least {FEWEST_POINTS}; 60 or more to tell "
                         "the maps' coefficients", "measure more points over speed, load, EGR and VGT")
    _refuse_still(points, where)
    _swapped(points, where, cylinders)
    return points


def _running(points: SteadyPoints) -> SteadyPoints:
    """Without points of an engine that stands, is cranked or pulled along: nothing burns in its cylinders."""
    fired = (points["n_e_rpm"] >= CRANKING_RPM) & (points["u_delta_mg"] > 0.0)
    if fired.all():
        return points
    note = f"{counted(int(np.count_nonzero(~fired)), 'point')} left out: below {CRANKING_RPM:.0f} rpm, or without fuel"
    return replace(points.take(fired), notes=(*points.notes, note))


def _swapped(points: SteadyPoints, where: str, cylinders: int) -> None:
    p_im, p_em, omega, W_c, W_egr, _ = points.states().T
    p_0, T_em = points["p_amb_pa"], points["t_em_k"]
    if np.nanmedian(W_egr) > 0.0 and np.nanmean((p_em < p_im) & (W_egr > 0.05 * W_c)) > 0.5:
        raise InputError(f"{where}: columns p_im_pa and p_em_pa", "p_em below p_im while EGR flows in most points",
                         "p_em above p_im where EGR flows", "are the two columns swapped?")
    W_f = _fuel_flow(points, cylinders)
    if np.nanmedian(W_c / (W_f * STOICHIOMETRIC)) < 0.9 and np.nanmedian(W_egr / W_c) > 1.0:
        raise InputError(f"{where}: columns w_c_kg_s and w_egr_kg_s", "less air than the fuel needs, more EGR than air",
                         "lambda above 1", "are the two columns swapped?")
    if np.nanmedian(T_em) < np.nanmedian(points["t_amb_k"]):
        raise InputError(f"{where}: columns t_em_k and t_amb_k", "exhaust colder than the surroundings",
                         "t_em above t_amb", "are the two columns swapped?")
    if np.nanmedian(p_0) > np.nanmedian(p_im) * 1.05 and np.nanmedian(p_0) > 1.15e5:
        raise InputError(f"{where}: columns p_amb_pa and p_im_pa", "ambient above intake pressure", "p_im above p_amb",
                         "are the two columns swapped?")
    flow, expected = W_c, np.maximum(p_im - p_0, 0.0)
    good = np.isfinite(flow) & np.isfinite(omega) & (expected > 2e3)
    if good.sum() > FEWEST_POINTS // 2 and ranks_agree(omega[good], expected[good]) < 0.0:
        raise InputError(f"{where}: column omega_t_rad_s", "a turbo that runs slower the more it boosts",
                         "speed rising with boost", "is another column under this name?")
    egr, vgt = conductances(points, cylinders)
    own = _explained(egr, points["u_egr_pct"]) + _explained(vgt, points["u_vgt_pct"])
    crossed = _explained(egr, points["u_vgt_pct"]) + _explained(vgt, points["u_egr_pct"])
    if crossed > own + 0.5 and crossed > 1.0:
        raise InputError(f"{where}: columns u_egr_pct and u_vgt_pct",
                         "u_vgt_pct explains the EGR flow and u_egr_pct the turbine flow, far better than the other "
                         "way round", "each its own", "are the two columns swapped?")


def _fuel_flow(points: SteadyPoints, cylinders: int) -> Array:
    """Fuel into all cylinders, (n,) [kg/s]."""
    engine: Any = SimpleNamespace(n_cyl=cylinders)
    return np.asarray(fuel_flow(points["u_delta_mg"], points["n_e_rpm"], engine))


def conductances(points: SteadyPoints, cylinders: int = 6) -> tuple[Array, Array]:
    """Logarithm of the effective areas of the EGR valve and the turbine, up to constants, (n,) each.

    The pressure quotients are taken as those of plain nozzles; that is enough to see which way an actuator opens.
    """
    p_im, p_em, _, W_c, W_egr, T_em = points.states().T
    W_f = _fuel_flow(points, cylinders)
    with np.errstate(invalid="ignore", divide="ignore"):
        drop = np.sqrt(np.clip(1.0 - p_im / p_em, 1e-4, 0.35))
        egr = np.log(np.maximum(W_egr, 1e-6) * np.sqrt(T_em) / (p_em * drop))
        choking = np.sqrt(np.clip(1.0 - (points["p_amb_pa"] / p_em) ** 2.5, 1e-3, 1.0))
        vgt = np.log((W_c + W_f) * np.sqrt(T_em) / (p_em * choking))
    shut = W_egr < SHUT * W_c
    return np.where(shut, np.nan, egr), vgt


def actuators(points: SteadyPoints, cylinders: int = 6) -> tuple[Actuator, Actuator]:
    """EGR valve and VGT: ranges, whether they move, which way they open."""
    egr, vgt = conductances(points, cylinders)
    found = []
    for column, area in (("u_egr_pct", egr), ("u_vgt_pct", vgt)):
        u = points[column]
        moves = bool(np.std(u) > STILL)
        slope = _slope(u, area, points) if moves and np.isfinite(area).sum() > 8 else 0.0
        opens = int(np.sign(slope)) if abs(slope) > SURE else 0
        found.append(Actuator(column, moves, opens, abs(slope), float(u.min()), float(u.max())))
    return found[0], found[1]


def egr_shut(points: SteadyPoints) -> bool:
    """Whether the EGR valve is shut in (nearly) every point."""
    return bool(np.nanmean(points["w_egr_kg_s"] > SHUT * points["w_c_kg_s"]) < 0.1)


def _slope(u: Array, area: Array, points: SteadyPoints) -> float:
    """t-value of the slope of ln area over u, the pressure quotient and the speed carried along.

    All by their ranks: the p_em of one point, read ten times too high, would else hide which way the turbine opens.
    """
    good = np.isfinite(area) & np.isfinite(u)
    if good.sum() <= len(INPUTS) + 2:
        return 0.0
    quotient = points["p_em_pa"] / points["p_amb_pa"]
    area, *columns = (ranks(values[good]) for values in (area, u, quotient, points["n_e_rpm"]))
    A = np.stack([np.ones(area.size), *columns], axis=1)
    solution, _, rank, _ = np.linalg.lstsq(A, area, rcond=None)
    if rank < A.shape[1]:
        return 0.0
    error = area - A @ solution
    variance = np.linalg.inv(A.T @ A)[1, 1] * np.sum(error**2) / (area.size - A.shape[1])
    return float(solution[1] / np.sqrt(max(variance, 1e-30)))


def _explained(area: Array, u: Array) -> float:
    """Share of the variance of ln area that a parabola of u explains [-]."""
    good = np.isfinite(area) & np.isfinite(u)
    if good.sum() < 8 or np.std(u[good]) < STILL or np.std(area[good]) == 0.0:
        return 0.0
    y = area[good]
    fit = np.polyval(np.polyfit(u[good], y, 2), u[good])
    return float(1.0 - np.var(y - fit) / np.var(y))


def filling_notes(points: SteadyPoints, engine: EngineParameters) -> list[Note]:
    """A note where the flows that were measured fill the displacement by what no engine is filled by."""
    warm = points["t_im_k"] if "t_im_k" in points else np.full(points.size, engine.T_im)
    charged: Any = constants(engine)._replace(T_im=warm)
    whole = cylinder_inflow(np.ones(points.size), points["p_im_pa"], points["n_e_rpm"], charged)
    filled = float(np.nanmedian((points["w_c_kg_s"] + points["w_egr_kg_s"]) / whole))
    low, high = FILLING
    if low <= filled <= high:
        return []
    litres = 1e3 * engine.V_d
    return [Note(f"the flows fill {litres:.3g} l of displacement by {filled:.2g}, where {low:g} to {high:g} is usual: "
                 f"an engine of some {litres * filled / 0.9:.2g} l would take them; check the geometry and the units "
                 "of w_c_kg_s and w_egr_kg_s", "wrong_engine", ("w_c_kg_s", "w_egr_kg_s"))]  # fmt: skip
