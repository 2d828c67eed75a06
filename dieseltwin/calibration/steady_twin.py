"""The diesel engine at settled points as a twin for discovery: balances of every point, whitened by what is known.

One sample is a point, one channel a submodel's balance (`SteadyModel`), read with measured flows and temperatures in
their places. So no state at rest has to be found, and an error of one submodel stays there. Every reading is noisy and
every submodel only nearly right: the balances of a point have a covariance J N J' + S, and the twin hands on
L^-1 (ln measured/predicted) with L L' that covariance, so that a valve with a small pressure difference counts as
little as it knows. Smooth errors of maps are directions that the search takes out, and so are coefficients.

A sensor's gain and offset don't move the balances in proportion: EGR flow goes with the root of a small difference of
pressures. So they are parameters of the twin, estimated and simulated in every fit, believed about nought. Beside a
reference, which tells them whatever is missing now, they are directions like the other coefficients. What is simulated
there is the wear since: a fault can move it by as much as is believed of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dieseltwin.arrays import MAD_TO_STD
from dieseltwin.calibration.calibrate import Calibration
from dieseltwin.calibration.coefficients import FLAP_COEFFICIENTS, WEAR
from dieseltwin.calibration.lasting_errors import BESIDE_REFERENCE, SUBMODEL_OF, TOLERANCE_OVER, sensor_errors
from dieseltwin.calibration.likelihood import reading_covariance, reading_noise
from dieseltwin.calibration.steady_model import CHARGE_OFFSET, MAP_MODE, SteadyModel, law_variables
from dieseltwin.discovery.likelihood.metric import Whitening
from dieseltwin.discovery.likelihood.nuisance import Nuisance, map_nuisances, nuisance_responses
from dieseltwin.discovery.twins.diesel_points import POINT_FACTS
from dieseltwin.discovery.twins.diesel_points import hypotheses_of as shown
from dieseltwin.discovery.twins.interface import (
    Array,
    Hypothesis,
    Lanes,
    LawScope,
    Parameter,
    Point,
    TwinDefaults,
    joined,
    single,
)
from dieseltwin.engine.effects import ACTUATION_EFFECTS, EFFECTS, GAS_LAG
from dieseltwin.engine.parameters import HEALTH
from dieseltwin.engine.quantities import ADDED_AT
from dieseltwin.engine.terms import LAW_VARIABLES, SENSOR_SLOTS, SENSOR_UNITS
from dieseltwin.recordings.channels import OPTIONAL_INPUTS
from dieseltwin.recordings.noise import Noise
from dieseltwin.recordings.steady_points import JUDGED, SINCE, STATES, SteadyPoints
from dieseltwin.settings.search import PointSettings
from dieseltwin.symbols import INPUT_COLUMNS

MOVING_ONLY = (
    *ACTUATION_EFFECTS, GAS_LAG, *(n for n, e in EFFECTS.items() if e.drifts or e.enters.operator == "lag"),
)  # fmt: skip
"""Effects that a settled point can't show: they need time."""

CHARGE = "charge, by the weather"
_WITHOUT_SIGNAL = ("T_e",)
_TYPICAL = 0.3  # prior standard deviations of a health parameter or its wear, for differences and step limits
_COEFFICIENT_STEP = 0.02  # of a prior standard deviation, for linear responses
_LIMIT = 30.0  # whitened balances beyond are cut: a trial state far off
_OUTLIER = 6.0
_SCATTER_ROUNDS = 4
_BELIEVED_AS = 10.0  # readings: what the belief of a balance's scatter weighs beside those of the reference
_CHARGE_TOLERANCE, _CHARGE_LIMIT = 3.0, 60.0  # K, of interest and most, of the charge's reading
_SENSOR_TOLERANCES = {"gain": 0.01, "offset": 0.01}  # of interest, of faults that the catalogue has no name for


class SteadyTwin(TwinDefaults):
    """`Twin` and `KnownErrors` of settled points; every point is a sample and a window of its own.

    Args:
        calibration: engine, points and coefficients; the engine's terms are part of the twin.
        settings: what is believed of sensors and submodels.
        sensors: columns to use, None for all.
    """

    law_scope = LawScope(
        ("power", "ratio", "difference", "head", "above_one", "share", "orifice"), LAW_VARIABLES,
        channel_units=SENSOR_UNITS,
    )  # fmt: skip

    def __init__(
        self, calibration: Calibration, settings: PointSettings, sensors: Sequence[str] | None = None, seed: int = 0
    ) -> None:
        self.calibration, self.settings = calibration, settings
        order = np.random.default_rng(seed).permutation(calibration.points.size)  # the last ones are held out
        self.order = order
        self.data: SteadyPoints = calibration.points.take(order)
        self.engine = calibration.model.engine
        self.model: SteadyModel = calibration.model
        self.used = tuple(c for c in STATES if sensors is None or c in sensors)
        self.channels = self.model.rows
        self.states: tuple[str, ...] = ()
        self.state_scales: Array = np.zeros(0)
        self._coefficients = calibration.estimate.coefficients
        self._fixed = {**calibration.start, **calibration.estimate.values()}
        self.hypotheses: Mapping[str, Hypothesis] = {
            name: h for name, h in hypotheses_of(self.data, self.used).items() if name not in self._fixed
        }  # fmt: skip
        errors = settings.submodels
        judged = self.data.columns.get(JUDGED)
        self._acts: Array = np.ones(self.data.size) if judged is None else np.asarray(judged)
        in_file = np.cumsum(self._acts[np.argsort(order)] > 0.5) - 1  # judged points are in the order of their file
        self.file_rank: NDArray[np.int64] = np.where(self._acts > 0.5, in_file[order], -1)
        told = any(c.name.startswith(MAP_MODE) for c in self._coefficients)
        if told:
            self.parameters: tuple[Parameter, ...] = tuple(
                Parameter(c.name, c.mean, c.std, c.unit, _TYPICAL * c.std, start=self._fixed[c.name])
                for c in self._coefficients if c.name in WEAR.values()
            )
        else:
            self.parameters = tuple(
                Parameter(c.name, self._fixed[c.name], c.std, c.unit, _TYPICAL * c.std)
                for c in self._coefficients if c.name in HEALTH
            )
            self.parameters += tuple(
                Parameter(c.name, 0.0, c.std, c.unit, c.std, start=self._fixed.get(c.name))
                for c in sensor_errors(self.data, settings)
            )
        if "exhaust_flap" in self.hypotheses:
            nominal = EFFECTS["exhaust_flap"].coefficients
            spread = settings.flap_spread
            self.parameters += tuple(
                Parameter(name, nominal[key], spread, "-", spread) for name, key in FLAP_COEFFICIENTS.items()
            )
        lasting, over = {name: errors.smooth_error(row) for name, row in SUBMODEL_OF.items()}, TOLERANCE_OVER
        if told:
            lasting, over = dict.fromkeys(BESIDE_REFERENCE, settings.map_beside_reference), BESIDE_REFERENCE
        flap = ("u_flap",) if "u_flap_pct" in self.data else ()
        self.points: tuple[Point, ...] = tuple(
            Point(
                name, facts.site, name not in ADDED_AT, ADDED_AT.get(name, "-"),
                (*facts.ports, *(flap if name == "p_es" else ())), facts.scale,
                lasting.get(name, 0.0),
                *over.get(name, (facts.over, facts.also)),
            )
            for name, facts in POINT_FACTS.items() if name not in _WITHOUT_SIGNAL
        )  # fmt: skip
        self.time_s: Array = np.arange(self.data.size, dtype=np.float64)
        self.starts = np.arange(self.data.size, dtype=np.int64)
        self.conditions: Mapping[str, Array] = {name: self.data[name] for name in INPUT_COLUMNS}
        readings = self.data.states()
        known = np.isfinite(readings) & np.array([c in self.used for c in STATES])
        self._x = np.where(known, readings, calibration.estimate.x[order])
        self._whiten = np.zeros((self.data.size, len(self.channels), len(self.channels)))
        start = self.values(np.array([p.first for p in self.parameters]))
        scatter = np.array([errors.scatter(row) for row in self.channels])
        sigma = reading_noise(self._x)
        covariance = reading_covariance(self.model, self.data, self._x, start, np.where(known, sigma, 1.0))
        covariance = covariance + np.diag(scatter**2)
        self._whiten = np.linalg.inv(np.linalg.cholesky(covariance))
        self.measured: Array = np.where(self._outlying(), np.nan, 0.0)
        if told:
            self._whiten /= self._scatter_at_reference()[:, None]
            self.measured = np.where(self._outlying(), np.nan, 0.0)

    def _outlying(self) -> np.ndarray:
        """(n, C) balances far off all others of their channel.

        Next to a kink (EGR flow at p_em = p_im) noise makes a balance nonsense; one such point would outweigh all.
        """
        off = self.simulate(self.plain_lane())[0]
        off = np.abs(off - np.median(off, axis=0))
        return np.asarray(off > np.maximum(_OUTLIER, _OUTLIER * MAD_TO_STD * np.median(off, axis=0)))

    def _scatter_at_reference(self) -> Array:
        """(C,) scatter of the balances about the fitted engine where it is known to be well, over what is believed.

        Variance components by redundancy numbers (Foerstner, Ein Verfahren zur Schaetzung von Varianz- und
        Kovarianzkomponenten, 1979): a reading that the fit follows has less than its whole scatter left.
        """
        lane = self.plain_lane()
        present, well = np.isfinite(self.measured), self._acts < 0.5
        left = np.where(present, self.simulate(lane)[0], 0.0)
        directions = (n.response for n in self.nuisances(lane) if n.response is not None)
        along = np.stack([np.where(present, direction, 0.0) for direction in directions], axis=-1)
        counted = present & well[:, None]
        scale = np.ones(len(self.channels))
        for _ in range(_SCATTER_ROUNDS):
            A = (along / scale[:, None]).reshape(-1, along.shape[-1])
            followed = np.einsum("ik,ik->i", A, np.linalg.solve(A.T @ A + np.eye(A.shape[1]), A.T).T)
            redundancy = np.sum(counted * (1.0 - followed.reshape(left.shape)), axis=0)
            scale = np.sqrt((_BELIEVED_AS + np.sum(counted * left**2, axis=0)) / (_BELIEVED_AS + redundancy))
        return np.asarray(scale)

    def first_local(self) -> Array:
        """No state starts anew: (n, 0)."""
        return np.zeros((self.data.size, 0))

    def noise(self) -> Noise:
        """As `KnownErrors.noise`: the balances come whitened."""
        size = len(self.channels)
        return Noise(np.ones(size), np.zeros(size))

    def whitening(self) -> Whitening:
        """As `KnownErrors.whitening`."""
        return Whitening.of(self.measured, self.noise(), self.starts)

    def nuisances(self, lanes: Lanes) -> list[Nuisance]:
        """As `KnownErrors.nuisances`: coefficients and smooth errors of the maps."""
        maps = map_nuisances(self, self.variables(lanes))
        simulated = self.simulate(lanes)[0]
        lasting = copy(self)  # errors of maps were there before
        lasting._acts = np.ones(self.data.size)
        found = [
            Nuisance(nuisance.label, response=response)
            for nuisance, response in zip(maps, nuisance_responses(lasting, lanes, simulated, maps), strict=True)
        ]
        if (warmer := self._warmer_weather()).any():
            warm = joined(lanes.signals, {"T_im": warmer / self.engine.T_im})
            found.append(Nuisance(CHARGE, response=self.simulate(replace(lanes, signals=warm))[0] - simulated))
        free = {p.name for p in self.parameters}
        for c in self._coefficients:
            if c.name not in free:
                step = _COEFFICIENT_STEP * c.std
                step = -step if self._fixed[c.name] + step > c.high else step
                moved = self._balances(lanes, {c.name: self._fixed[c.name] + step})
                found.append(Nuisance(c.name, response=(moved[0] - simulated) * c.std / step))
        return found

    def _warmer_weather(self) -> Array:
        """How far the charge of each judged point may be from the usual one, as far as the weather is [K], (n,).

        The model's charge is one temperature, and a cooler's outlet follows the weather: without this a reference of a
        warm day and points of a cold one are a meter that reads some per cent of air too much, and so are two days in
        one file, since the second. Nought where the charge is read.
        """
        if "t_im_k" in self.model.extra:
            return np.zeros(self.data.size)
        ambient, well = self.data["t_amb_k"], self._acts < 0.5
        return np.asarray(ambient - np.median(ambient[well] if well.any() else ambient))

    def simulate(self, lanes: Lanes) -> Array:
        """Balances that the lanes explain, whitened, (B, n, C)."""
        return self._balances(lanes)

    def _balances(self, lanes: Lanes, changed: Mapping[str, float] | None = None) -> Array:
        """`simulate` with changed coefficients."""
        residual = self._relations(lanes, changed).residual
        bounded = np.clip(np.nan_to_num(residual), -_LIMIT, _LIMIT)
        return -np.asarray(np.clip(np.einsum("nij,bnj->bni", self._whiten, bounded), -_LIMIT, _LIMIT))

    def _relations(self, lanes: Lanes, changed: Mapping[str, float] | None = None) -> Any:
        own = {p.name: lanes.parameters[:, i] for i, p in enumerate(self.parameters)}
        values: dict[str, Any] = {**self._fixed, **own}
        values.update(changed or {})
        for name, magnitude in lanes.magnitudes.items():
            values[name] = self._fixed.get(name, 0.0) + magnitude
        values = {name: np.broadcast_to(value, (lanes.size,)) for name, value in values.items()}
        since = {f"{SINCE}{name}": self._acts * schedule for name, schedule in lanes.schedules.items()}
        data = self.data.with_columns(**since) if since else self.data
        return replace(self.model, signals=self._signals(lanes)).relations(data, self._x, values)

    def _signals(self, lanes: Lanes) -> dict[str, Array]:
        shape = (lanes.size, self.data.size)
        entered = {name: np.broadcast_to(self._acts * signal, shape) for name, signal in lanes.signals.items()}
        if lanes.lane_points is not None and lanes.lane_signals is not None:
            for index in np.unique(lanes.lane_points[lanes.lane_points >= 0]):
                name = self.points[int(index)].name
                own = np.where((lanes.lane_points == index)[:, None], self._acts * lanes.lane_signals, 0.0)
                entered[name] = entered.get(name, 0.0) + own
        return entered

    def variables(self, lanes: Lanes) -> dict[str, Array]:
        """Every variable that ports and tolerances name, at the points as measured, lane 0, (n,) each."""
        q = {k: np.asarray(v[0]) for k, v in self._relations(lanes).quantities.items()}
        return law_variables(self.data, q)

    def values(self, parameters: Array) -> dict[str, float]:
        """Every number of the balances at parameters (P,), effects aside."""
        return {**self._fixed, **{p.name: float(v) for p, v in zip(self.parameters, parameters, strict=True)}}

    def plain_lane(self) -> Lanes:
        """The lane at which fits start."""
        return single(np.array([p.first for p in self.parameters]), self.first_local())


def hypotheses_of(points: SteadyPoints, used: Sequence[str]) -> dict[str, Hypothesis]:
    """Effects that settled points can show with these sensors, and faults of sensors beyond the catalogue."""
    moved = [name for name in OPTIONAL_INPUTS if name in points and np.nanstd(points[name]) > 1.0]
    found = {
        name: hypothesis
        for name, hypothesis in shown(used, moved).items()
        if name not in MOVING_ONLY
    }  # fmt: skip
    for slot in SENSOR_SLOTS:
        column, _, fault = slot.partition(":")
        if fault in _SENSOR_TOLERANCES and column in used:
            level = 1.0 if fault == "gain" else float(np.nanmedian(points[column]))
            size = _SENSOR_TOLERANCES[fault] * level
            law = "reading (1 + g)" if fault == "gain" else "reading + b"
            found[slot] = Hypothesis(slot, f"sensor:{column}", law, "-" if fault == "gain" else SENSOR_UNITS[column],
                                     size, (-0.3 * level, 0.3 * level), True, (size,), "sensor")
    if "t_im_k" in points and np.isfinite(points["t_im_k"]).any():
        found[CHARGE_OFFSET] = Hypothesis(CHARGE_OFFSET, "sensor:t_im_k", "reading + b", "K", _CHARGE_TOLERANCE,
                                          (-_CHARGE_LIMIT, _CHARGE_LIMIT), True, (_CHARGE_TOLERANCE,), "sensor")
    return found
