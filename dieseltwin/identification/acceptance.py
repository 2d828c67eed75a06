"""What learned networks owe to physics before anybody uses them: six tests, each a figure against a limit.

Errors on held-out labels say how near a map is on average. They don't say whether an opened valve lets more through, or
whether the engine with these maps comes to rest. Every limit stands with its reason in `promotion` of params.yaml.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import pandas as pd

from dieseltwin.arrays import Array
from dieseltwin.engine import HEALTH, EngineParameters, actuate, bind, constants, parameter_batch, settle
from dieseltwin.errors import InputError
from dieseltwin.identification.identify import identify_segments
from dieseltwin.identification.problem import PAPER_CHANNELS, problems_from_recording
from dieseltwin.recordings.reader import recording
from dieseltwin.settings.discovery import AcceptanceConfig
from dieseltwin.settings.params import IdentifyConfig
from dieseltwin.surrogates.empirical import EmpiricalMaps, map_arguments
from dieseltwin.surrogates.map_simulator import MapFunctions, Point, numpy_simulator, rest

POINTS: tuple[Point, ...] = tuple(
    (n_e, *load)
    for n_e in (1000.0, 1300.0, 1700.0)
    for load in ((60.0, 20.0, 50.0), (120.0, 10.0, 60.0), (180.0, 0.0, 70.0))
)
"""Settled points: light, half and high load at three speeds."""

RANGES: Mapping[str, tuple[float, float]] = {
    "eta_vol": (0.3, 1.2), "f_egr": (0.0, 1.0), "F_vgt_Pi_t": (0.0, 1.2), "eta_tm": (0.0, 1.0), "eta_c": (0.0, 1.0),
    "Phi_c": (0.0, 1.0),
}  # fmt: skip
"""What each map may be [-]: no efficiency above one, no negative area or flow."""

STEP_S = 0.025  # of the simulation: below the stability limit of 0.04 s, errors below 1e-4
SEGMENT_S = 60.0
SEGMENTS = 3  # minutes in which a known engine must be found
MOVE = 0.01  # of an argument's usual range (5-95 %): the step of a slope
LEAST_STD_REL = 0.005  # of a value: maps learned from labels with 3 % noise aren't held to what is stated below it
_SIMULATED = {"p_im": "p_im_pa", "p_em": "p_em_pa", "omega_t": "omega_t_rad_s"}


@dataclass(frozen=True)
class AcceptanceTest:
    """One physical test of a set of networks.

    Attributes:
        name: of the test, "balances"; with more than one kind of maps "balances/improved".
        figure: what was found; infinite where nothing could be computed.
        limit: the figure up to which the test is passed.
        sentence: what the figure is, with the limit.
    """

    name: str
    figure: float
    limit: float
    sentence: str

    @property
    def passed(self) -> bool:
        """Whether the figure is a number up to the limit."""
        return bool(np.isfinite(self.figure) and self.figure <= self.limit)

    def to_json(self) -> dict[str, Any]:
        """As JSON types; a figure that is no number is null."""
        return {**asdict(self), "figure": self.figure if np.isfinite(self.figure) else None, "passed": self.passed}


@dataclass(frozen=True)
class HeldOutDriving:
    """A clean simulated recording that nothing was trained on.

    Attributes:
        frame: inputs, actuator states, states and sensors as `engine.simulate` gives them, with the ambient columns.
        engine: the engine that drove, its own health values included.
    """

    frame: pd.DataFrame
    engine: EngineParameters


def acceptance_tests(
    maps: Mapping[str, EmpiricalMaps], networks: Mapping[str, Any], driving: HeldOutDriving, limits: AcceptanceConfig,
    identify: IdentifyConfig,
) -> list[AcceptanceTest]:  # fmt: skip
    """All tests that have a limit, in the order of the limits.

    Args:
        maps: kind -> learned maps, each tested by itself.
        networks: "maps", "bodies" and "operators" as `few-shot-newton` takes them, for the known engine.
        driving: held-out driving, three minutes or more.
        limits: a test without a limit is left out.
        identify: settings of the identification.

    Raises:
        InputError: the engine of the maps has no stable rest at a settled point.
    """
    tests = []
    for kind, one in maps.items():
        for test in map_tests(one.replacements("numpy"), one.parameters, driving, limits.of_maps(kind)):
            tests.append(replace(test, name=f"{test.name}/{kind}", sentence=f"{kind} maps: {test.sentence}"))
    if limits.known_engine is not None:
        laboratory = networks["maps"].parameters
        tests.append(known_engine(networks, laboratory, driving, identify, limits.known_engine))
    return tests


def map_tests(
    functions: MapFunctions, engine: EngineParameters, driving: HeldOutDriving, limits: AcceptanceConfig
) -> list[AcceptanceTest]:
    """The tests of six maps that have a limit.

    Args:
        functions: the maps over numpy.
        engine: the engine whose maps they are, from which settled points are taken.
        driving: see `acceptance_tests`; limits: likewise.
    """
    tests = []
    if limits.balances is not None:
        tests.append(balances(functions, engine, limits.balances))
    if limits.rest is not None:
        tests.append(place_of_rest(functions, engine, limits.rest))
    if limits.ranges is not None:
        tests.append(ranges(functions, driving, limits.ranges))
    if limits.monotony is not None:
        tests.append(monotony(functions, driving, limits.monotony))
    if limits.driving is not None:
        tests.append(driving_errors(functions, driving, limits.driving))
    return tests


def balances(functions: MapFunctions, engine: EngineParameters, limit: float) -> AcceptanceTest:
    """Mass in both manifolds and power of the shaft with these maps, where the engine itself is at rest.

    The figure is the largest imbalance over what flows in, over nine loads [-]: (W_c + W_egr - W_ei) / W_ei,
    (W_eo - W_t - W_egr) / W_eo and (P_t eta_m - P_c) / P_c (A.1, A.2, A.24).
    """
    model, c = bind("numpy", functions), constants(engine)
    found: dict[str, float] = {}
    for point in POINTS:
        with np.errstate(all="ignore"):
            q = model.quantities(*_settled(engine, point), *point, c)
            open_by = {
                "mass in the intake manifold": (q.W_c + q.W_egr - q.W_ei) / q.W_ei,
                "mass in the exhaust manifold": (q.W_eo - q.W_t - q.W_egr) / q.W_eo,
                "power of the turbo shaft": (q.P_t_eta_m - q.P_c) / q.P_c,
            }
        found |= {f"{name} at {_words(point)}": abs(float(value)) for name, value in open_by.items()}
    worst, figure = _largest(found)
    return AcceptanceTest("balances", figure, limit, f"the {worst} is open by {_percent(figure)} where the engine "
                          f"is at rest; {_percent(limit)} is allowed")  # fmt: skip


def place_of_rest(functions: MapFunctions, engine: EngineParameters, limit: float) -> AcceptanceTest:
    """Whether the engine with these maps comes to a stable rest, where the engine itself does.

    The figure is the largest relative difference of p_im, p_em and omega_t over nine loads [-]; infinite where there is
    no stable rest.
    """
    found: dict[str, float] = {}
    for point in POINTS:
        true = _settled(engine, point)
        with_maps = rest(functions, point, engine, true[:3])
        if with_maps is None:
            return AcceptanceTest("rest", np.inf, limit, f"the engine comes to no stable rest at {_words(point)}")
        difference = np.abs(with_maps[:3] / true[:3] - 1.0)
        found |= {f"{name} at {_words(point)}": float(d) for name, d in zip(_SIMULATED, difference, strict=True)}
    worst, figure = _largest(found)
    return AcceptanceTest("rest", figure, limit, f"{worst} comes to rest {_percent(figure)} from where it does; "
                          f"{_percent(limit)} is allowed")  # fmt: skip


def ranges(functions: MapFunctions, driving: HeldOutDriving, limit: float) -> AcceptanceTest:
    """Whether the maps stay in what is physically possible (`RANGES`); the figure is the largest share of rows of the
    driving that lie outside [-]."""
    c, arguments = constants(driving.engine), map_arguments(driving.frame, driving.engine)
    outside = {}
    for name, (low, high) in RANGES.items():
        with np.errstate(all="ignore"):
            value = np.asarray(functions[name](*arguments[name], c))
        outside[name] = float(np.mean(~((value >= low) & (value <= high))))
    worst, figure = _largest(outside)
    low, high = RANGES[worst]
    return AcceptanceTest("ranges", figure, limit, f"{worst} is outside {low:g} to {high:g} in {_percent(figure)} of "
                          f"the rows; {_percent(limit)} is allowed")  # fmt: skip


def monotony(functions: MapFunctions, driving: HeldOutDriving, limit: float) -> AcceptanceTest:
    """Whether flows answer valves, pressures and speeds in the direction that physics gives.

    Each argument is moved by a hundredth of its usual range at every row of the driving. The figure is the share of the
    moves of a flow, by their size, that go the wrong way [-], the worst of seven slopes.
    """
    c, arguments = constants(driving.engine), map_arguments(driving.frame, driving.engine)

    def inflow(p_im: Array, n_e: Array, c: Any) -> Array:
        return np.asarray(functions["eta_vol"](p_im, n_e, c) * p_im * n_e)

    (u_egr,) = arguments["f_egr"]
    opening = u_egr[(u_egr > 0.0) & (u_egr < min(c.u_egr_vertex, 100.0))]  # flat beyond
    slopes: dict[str, tuple[Callable[..., Any], tuple[Array, ...], int, float]] = {
        "flow into the cylinders over p_im": (inflow, arguments["eta_vol"], 0, 1.0),
        "flow into the cylinders over n_e": (inflow, arguments["eta_vol"], 1, 1.0),
        "f_egr over the EGR valve's position": (functions["f_egr"], (opening,), 0, 1.0),
        "F_vgt,Pi_t over the VGT's position": (functions["F_vgt_Pi_t"], arguments["F_vgt_Pi_t"], 0, 1.0),
        "F_vgt,Pi_t over Pi_t": (functions["F_vgt_Pi_t"], arguments["F_vgt_Pi_t"], 1, -1.0),
        "Phi_c over Pi_c": (functions["Phi_c"], arguments["Phi_c"], 1, -1.0),
        "Phi_c over omega_t": (functions["Phi_c"], arguments["Phi_c"], 2, 1.0),
    }
    wrong = {}
    for name, (function, at, which, sign) in slopes.items():
        low, middle, high = np.quantile(at[which], [0.05, 0.5, 0.95])
        step = np.where(at[which] < middle, 1.0, -1.0) * MOVE * (high - low)  # never out of what was driven
        moved = [x + step if k == which else x for k, x in enumerate(at)]
        with np.errstate(all="ignore"):
            moves = np.sign(sign * step) * (np.asarray(function(*moved, c)) - np.asarray(function(*at, c)))
        total = float(np.abs(moves).sum())
        wrong[name] = float(np.maximum(-moves, 0.0).sum()) / total if total > 0.0 else np.inf
    worst, figure = _largest(wrong)
    return AcceptanceTest("monotony", figure, limit, f"{worst} goes the wrong way in {_percent(figure)} of its moves; "
                          f"{_percent(limit)} is allowed")  # fmt: skip


def driving_errors(functions: MapFunctions, driving: HeldOutDriving, limit: float) -> AcceptanceTest:
    """The engine with these maps over held-out driving, minute by minute from its true states.

    The figure is the largest root mean square error of p_im, p_em and omega_t over their mean [-].
    """
    truth, frame = driving.engine, driving.frame
    segments = recording(frame, truth).segments(SEGMENT_S)
    lanes = [actuate(segment.inputs, truth, STEP_S) for segment in segments]
    true = frame[list(_SIMULATED.values())].to_numpy()
    first = np.searchsorted(frame["time_s"].to_numpy(), [lane.time_s[0] for lane in lanes])
    batch = parameter_batch(truth, size=len(lanes))
    states = numpy_simulator(functions)(lanes, batch, true[first]).states[..., :3]
    expected = np.stack([true[row : row + states.shape[1]] for row in first])
    errors = np.sqrt(np.mean((states - expected) ** 2, axis=(0, 1))) / expected.mean(axis=(0, 1))
    worst, figure = _largest(dict(zip(_SIMULATED, errors.tolist(), strict=True)))
    return AcceptanceTest("driving", figure, limit, f"{worst} is off by {_percent(figure)} (rms over its mean) in "
                          f"{len(lanes)} minutes of held-out driving; {_percent(limit)} is allowed")  # fmt: skip


def known_engine(
    networks: Mapping[str, Any], laboratory: EngineParameters, driving: HeldOutDriving, identify: IdentifyConfig,
    limit: float,
) -> AcceptanceTest:  # fmt: skip
    """Whether `few-shot-newton` with these networks finds the health of an engine that is known, and says how sure.

    The last three minutes of the driving get the paper's noise. The figure is the largest error of a health parameter
    over its stated standard deviation [-]; infinite where none can be told.

    Args:
        networks: "maps", "bodies" and "operators"; what isn't given is exact.
        laboratory: what is known of the engine, with the laboratory's health values.
        driving: see `acceptance_tests`.
        identify: settings of the identification; limit: of the figure.
    """
    made = recording(driving.frame, driving.engine)
    problems = problems_from_recording(made, laboratory, duration_s=SEGMENT_S, channels=PAPER_CHANNELS)[-SEGMENTS:]
    rng = np.random.default_rng(0)
    noisy = [problem.with_noise_draws(1, rng) for problem in problems]
    found = identify_segments(noisy, "few-shot-newton", 1, 0, config=identify, **networks).pooled()
    errors = {}
    for name in HEALTH:
        value, true = found[name], float(getattr(driving.engine, name))
        if value.mean is not None and value.std is not None:
            errors[name] = abs(value.mean - true) / max(value.std, LEAST_STD_REL * true)
    if not errors:
        return AcceptanceTest("known_engine", np.inf, limit, "no health parameter of a known engine can be told")
    worst, figure = _largest(errors)
    return AcceptanceTest("known_engine", figure, limit, f"{worst} of a known engine is found {figure:.1f} stated "
                          f"standard deviations from its value; {limit:g} are allowed")  # fmt: skip


@lru_cache(maxsize=32)
def _settled(engine: EngineParameters, point: Point) -> Array:
    """Where the engine itself rests; raises `InputError` for one that has no stable rest there."""
    found = rest({}, point, engine, settle(*point, engine))
    if found is None:
        raise InputError(
            "engine of the maps", f"no stable rest at {_words(point)}", "an engine that comes to rest",
            "set balances and rest to null in promotion.acceptance of params.yaml",
        )  # fmt: skip
    return found


def _largest(values: Mapping[str, float]) -> tuple[str, float]:
    """Name and value of the largest; what is no number counts as infinite."""
    found = {name: value if np.isfinite(value) else np.inf for name, value in values.items()}
    worst = max(found, key=lambda name: found[name])
    return worst, found[worst]


def _percent(share: float) -> str:
    return f"{100.0 * share:.2f} %" if np.isfinite(share) else "what is no number"


def _words(point: Point) -> str:
    return f"{point[0]:g} rpm and {point[1]:g} mg"
