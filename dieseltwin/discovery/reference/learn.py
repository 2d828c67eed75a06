"""What recordings of a healthy engine say about its health, its maps and its sensors, all at once.

The unknowns are the coordinates of `learning.belief`. Of each recording the maximum a posteriori is found by
Gauss-Newton with the metric of discovery: initial states of the windows are free, the corrections are simulated with
their own arguments, and all sensitivities are renewed at every step, since errors of 2-5 % bend. What remains of the
recording is the information about that point (Laplace). Information of several recordings adds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dieseltwin.discovery.likelihood.fit import bounded, first_fit, fit_fully, parameter_lanes
from dieseltwin.discovery.likelihood.metric import Metric, Whitening
from dieseltwin.discovery.likelihood.nuisance import signal_responses
from dieseltwin.discovery.likelihood.score import secant_sizes
from dieseltwin.discovery.search.preparation import split_growing
from dieseltwin.discovery.twins.diesel import EngineTwin
from dieseltwin.discovery.twins.interface import Array, Lanes, rows_of, single
from dieseltwin.engine import MEASURED, EngineParameters
from dieseltwin.engine.map_corrections import CORRECTED_POINTS, basis, basis_along
from dieseltwin.engine.quantities import POINTS
from dieseltwin.learning.belief import GAINS_AT, HEALTH_AT, MAPS_AT, OFFSETS_AT, Belief, prior_belief
from dieseltwin.learning.domain import domain_of
from dieseltwin.learning.files import LearnedEngine, distinct
from dieseltwin.recordings.noise import estimate_noise
from dieseltwin.recordings.reader import Recording

_ROUGH_ROUNDS = 5
_ROUNDS = 12
_JOINT_ROUNDS = 5
_CONVERGED = 1.0  # predicted decrease of -2 log posterior over some 160 unknowns
_SHORTER_STEPS = 4
_SHORTER = 0.4
_SETTLING_ROUNDS = 3
_SETTLED = 1e-3  # of a state's scale
_SMALL = 1e-3  # of a coefficient, for its response
_DRAWS = 2
_SUSPICIOUS = 25.0  # gain of an effect beyond all that is believed of a healthy engine: five standard deviations
_LEAST_INFORMATION = 1e-6  # of an effect's own, that is no coordinate's
_CROOKED = 3.0  # squared whitened distance of a window from linear, by one draw of what is believed then
_MOST_CROOKED = 1.0 / 3.0


@dataclass(frozen=True)
class Evidence:
    """What one recording says, as a Gaussian factor over the coordinates of a belief.

    Attributes:
        information: (D, D) in inverse squared units of the coordinates, without any prior.
        vector: (D,) information times the point at which the factor is largest.
        estimate: (D,) the recording's own maximum a posteriori.
        misfit: squared whitened residual a reading at the estimate; 1 for an engine that the maps can describe.
        readings: number of readings used.
        converged: whether the last step promised no further decrease worth naming.
        left_out: share of the windows in which what is believed doesn't act linearly, which were not used.
    """

    information: Array
    vector: Array
    estimate: Array
    misfit: float
    readings: int
    converged: bool
    left_out: float


def combined(prior: Belief, evidence: Sequence[Evidence]) -> Belief:
    """The belief after some recordings; their order doesn't matter, to the last bit if they are sorted."""
    scale = np.sqrt(np.diag(prior.covariance))
    inverse = np.linalg.inv(prior.covariance / np.outer(scale, scale))
    information = inverse.copy()
    vector = inverse @ (prior.mean / scale)
    for item in evidence:
        information += item.information * np.outer(scale, scale)
        vector += item.vector * scale
    covariance = np.linalg.inv(information)
    covariance = 0.5 * (covariance + covariance.T)
    return Belief(scale * (covariance @ vector), covariance * np.outer(scale, scale))


@dataclass(frozen=True)
class Suspicion:
    """An effect that the recordings show although they are believed to be of a healthy engine.

    Attributes:
        name: of the effect; unit: of the magnitude.
        magnitude, std: linear estimate and its standard deviation [unit].
        gain: decrease of -2 log posterior that it gives beyond all that maps, sensors and health can take up.
    """

    name: str
    unit: str
    magnitude: float
    std: float
    gain: float


@dataclass(frozen=True)
class Learned:
    """What some recordings say together.

    Attributes:
        belief: after all of them.
        evidence: of each, linearised about what all say.
        converged: whether all fits did, and linearising anew changed nothing worth naming.
        suspicions: effects by which the reference itself looks faulty, strongest first.
    """

    belief: Belief
    evidence: tuple[Evidence, ...]
    converged: bool
    suspicions: tuple[Suspicion, ...] = ()


def learn_engine(
    recordings: Sequence[Recording], base: EngineParameters, map_rms: float, known: LearnedEngine | None = None,
    seed: int = 0,
) -> tuple[LearnedEngine, Learned]:  # fmt: skip
    """What is known of an engine from recordings, and from those that it was learned from before.

    Args:
        recordings: of the engine, known to be well; one that is given twice counts once.
        base: the engine before anything was learned.
        map_rms: size of the maps' smooth relative errors [-].
        known: what was learned before; its own base and size of errors then count, whatever the other two say.
        seed: of the draws by which windows are left out that don't act linearly.

    Raises:
        InputError: no usable sensor, or no stretch with the engine running.
    """
    if known is not None:
        base, map_rms, recordings = known.base, known.map_rms, [*known.recordings, *recordings]
    together = distinct(recordings)
    found = learn(together, base, map_rms, seed)
    misfits = {item.sha256: part.misfit for item, part in zip(together, found.evidence, strict=True)}
    domain = domain_of(found.belief, map_rms)
    return LearnedEngine(base, found.belief, map_rms, together, domain, misfits), found


def learn(recordings: Sequence[Recording], engine: EngineParameters, map_rms: float, seed: int = 0) -> Learned:
    """What recordings of a healthy engine say, the same to the last bit in whatever order they come.

    Args:
        recordings: of the engine, known to be well, no two alike.
        engine: what is believed of it but for its health, maps and sensors; its terms are part of it.
        map_rms: size of the maps' smooth relative errors [-].
        seed: of the draws by which windows are left out that don't act linearly.

    Raises:
        InputError: no usable sensor, or no stretch with the engine running.
    """
    prior = prior_belief(engine, map_rms)
    fits = [_Fit(recording, engine, prior, seed) for recording in sorted(recordings, key=lambda r: r.sha256)]
    evidence = tuple(fit.evidence() for fit in fits)
    converged = all(item.converged for item in evidence)
    belief = combined(prior, evidence)
    settled = len(fits) == 1
    for _ in range(0 if settled else _JOINT_ROUNDS):
        evidence = tuple(fit.evidence_about(belief.mean) for fit in fits)
        before, belief = belief, combined(prior, evidence)
        moved = np.linalg.solve(belief.factor, belief.mean - before.mean)
        settled = float(moved @ moved) < _CONVERGED
        if settled:
            break
    return Learned(belief, evidence, converged and settled, _suspicions(fits, prior, evidence))


def _suspicions(fits: Sequence[_Fit], prior: Belief, evidence: Sequence[Evidence]) -> tuple[Suspicion, ...]:
    """Efficient scores of all effects at what was learned, those above `_SUSPICIOUS`, strongest first."""
    scale = np.sqrt(np.diag(prior.covariance))
    whole = np.eye(scale.size) + sum(item.information for item in evidence) * np.outer(scale, scale)
    parts: dict[tuple[str, float], list[tuple[float, float, Array]]] = {}
    for fit in fits:
        for key, part in fit.scores().items():
            parts.setdefault(key, []).append(part)
    found: dict[str, Suspicion] = {}
    for (name, _), some in parts.items():
        hypothesis = fits[0].twin.hypotheses[name]
        push, own = sum(part[0] for part in some), sum(part[1] for part in some)
        across = np.sum([part[2] for part in some], axis=0)
        information = own - float(across @ np.linalg.solve(whole, across))
        if information <= _LEAST_INFORMATION * own:
            continue
        size = float(np.clip(push / information, *hypothesis.limits))
        gain = information * size * (2.0 * push / information - size)
        if gain > max(_SUSPICIOUS, found[name].gain if name in found else 0.0):
            found[name] = Suspicion(name, hypothesis.unit, size, information**-0.5, gain)
    return tuple(sorted(found.values(), key=lambda item: -item.gain))


@dataclass(frozen=True)
class _Linear:
    """The readings near one point: `columns` (D, n, C) a unit of each coordinate, and the metric there."""

    columns: Array
    metric: Metric
    residual: Array
    projected: Array
    projected_residual: Array


class _Fit:
    """The maximum a posteriori of one recording; coordinates are in standard deviations of the prior about its mean."""

    def __init__(self, recording: Recording, engine: EngineParameters, prior: Belief, seed: int) -> None:
        self.prior, self.seed = prior, seed
        self.scale = np.sqrt(np.diag(prior.covariance))
        self.twin = EngineTwin(recording, engine)
        self.at = [MEASURED.index(name) for name in self.twin.channels]
        twin = self.twin
        whitening = Whitening.of(twin.measured, estimate_noise(twin.measured), twin.starts)
        rough = fit_fully(twin, whitening, first_fit(twin), rounds=_ROUGH_ROUNDS)
        start = split_growing(rough) or rough.fit
        self.local = start.local
        self.x = np.zeros(prior.mean.size)
        self.x[HEALTH_AT] = (rough.fit.parameters - prior.health) / self.scale[HEALTH_AT]
        self.whitening = Whitening.of(twin.measured, estimate_noise(twin.measured), twin.starts)
        self.left_out = np.zeros(twin.starts.size, dtype=bool)

    def evidence(self) -> Evidence:
        """Fit, leave windows out that don't act linearly, fit again, and take what is known there."""
        self._fit(2)
        explained = self._shown(self.x, self.local)
        self.whitening = self._whitened(explained)
        here, _ = self._fit(_ROUNDS)
        self.left_out = self._crooked(here)
        if self.left_out.any():
            self.twin.measured[rows_of(self.twin, self.left_out)] = np.nan
            self.whitening = self._whitened(explained)
        here, converged = self._fit(_ROUNDS)
        return self._evidence(here, converged)

    def evidence_about(self, mean: Array) -> Evidence:
        """What the recording says when it is linearised about another point than its own estimate."""
        self.x = (mean - self.prior.mean) / self.scale
        here = self._linearised()
        self.local, _ = self._settled(here.metric, self.x, self.local)
        return self._evidence(self._linearised(), True)

    def scores(self) -> dict[tuple[str, float], tuple[float, float, Array]]:
        """Of every effect at the sizes at which it is tried: half the gradient, its own information, that which it
        shares with the coordinates (D,)."""
        here, values = self._linearised(), self._values(self.x)
        twin = self.twin.with_coefficients(values[MAPS_AT])
        fit = replace(first_fit(twin), parameters=values[HEALTH_AT], local=self.local)
        wanted = secant_sizes(twin, list(twin.hypotheses))
        base = fit.lanes()
        magnitudes = {name: np.zeros(len(wanted)) for name, _ in wanted}
        for k, (name, size) in enumerate(wanted):
            magnitudes[name][k] = size
        lanes = Lanes(
            np.repeat(base.parameters, len(wanted), axis=0), np.repeat(base.local, len(wanted), axis=0), magnitudes
        )
        sizes = np.array([size for _, size in wanted])
        factor = 1.0 + values[GAINS_AT][self.at]
        responses = (twin.simulate(lanes) - twin.simulate(base)) * factor / sizes[:, None, None]
        projected = here.metric.without_local(responses)
        return {
            key: (float(row @ here.projected_residual), float(row @ row), here.projected @ row)
            for key, row in zip(wanted, projected, strict=True)
        }

    def _evidence(self, here: _Linear, converged: bool) -> Evidence:
        information = here.projected @ here.projected.T
        gradient = here.projected @ here.projected_residual
        mean = self.prior.mean + self.scale * self.x
        information = 0.5 * (information + information.T) / np.outer(self.scale, self.scale)
        present = np.isfinite(self.twin.measured)
        squared = float(here.projected_residual @ here.projected_residual)
        return Evidence(
            information, information @ mean + gradient / self.scale, mean, squared / max(int(present.sum()), 1),
            int(present.sum()), converged, float(self.left_out.mean()),
        )  # fmt: skip

    def _whitened(self, explained: Array) -> Whitening:
        measured = self.twin.measured
        return Whitening.of(measured, estimate_noise(measured, explained=explained), self.twin.starts)

    def _values(self, x: Array) -> Array:
        return self.prior.mean + self.scale * x

    def _shown(self, x: Array, local: Array) -> Array:
        """Readings (n, C) at a point, errors of the sensors included."""
        values = self._values(x)
        twin = self.twin.with_coefficients(values[MAPS_AT])
        clean = twin.simulate(single(values[HEALTH_AT], local))[0]
        return clean * (1.0 + values[GAINS_AT][self.at]) + values[OFFSETS_AT][self.at]

    def _linearised(self) -> _Linear:
        values = self._values(self.x)
        twin = self.twin.with_coefficients(values[MAPS_AT])
        fit = replace(first_fit(twin), parameters=values[HEALTH_AT], local=self.local)
        lanes, steps = parameter_lanes(twin, fit)
        simulated = twin.simulate(lanes)
        clean, factor = simulated[0], 1.0 + values[GAINS_AT][self.at]
        differences = (simulated[1:] - clean) / steps[:, None, None]
        points = [POINTS.index(CORRECTED_POINTS[m]) for m in basis().maps]
        signals = _SMALL * basis_along(twin.variables(fit.lanes()))
        columns = np.zeros((self.x.size, *clean.shape))
        columns[HEALTH_AT] = differences[: len(twin.parameters)] * factor
        columns[MAPS_AT] = signal_responses(twin, fit.lanes(), clean, points, signals) * (factor / _SMALL)
        for j, channel in enumerate(self.at):
            columns[GAINS_AT.start + channel, :, j] = clean[:, j]
            columns[OFFSETS_AT.start + channel, :, j] = 1.0
        columns *= self.scale[:, None, None]
        local = differences[len(twin.parameters) :] * factor
        metric = Metric(self.whitening, twin.starts, local, twin.state_scales)
        residual = np.nan_to_num(self.twin.measured - clean * factor - values[OFFSETS_AT][self.at])
        return _Linear(
            columns, metric, residual, metric.without_local(columns), metric.without_local(residual[None])[0]
        )

    def _fit(self, rounds: int) -> tuple[_Linear, bool]:
        """Damped Gauss-Newton, and whether it converged."""
        here = self._linearised()
        for _ in range(rounds):
            gradient = here.projected @ here.projected_residual - self.x
            information = here.projected @ here.projected.T + np.eye(self.x.size)
            step: Array = np.linalg.solve(information, gradient).astype(np.float64)
            predicted = float(gradient @ step)
            if predicted < _CONVERGED:
                return here, True
            if not self._advance(here, step):
                return here, predicted < 20.0 * _CONVERGED
            here = self._linearised()
        return here, False

    def _advance(self, here: _Linear, step: Array) -> bool:
        """Go along a step as far as the posterior rises; False where it nowhere does."""
        cost = float(self.x @ self.x + here.projected_residual @ here.projected_residual)
        shrink = 1.0
        for _ in range(_SHORTER_STEPS):
            change = shrink * step
            rest = here.residual - np.tensordot(change, here.columns, 1)
            local = bounded(self.twin, self.local + here.metric.local_step(rest))
            x = self.x + change
            local, residual = self._settled(here.metric, x, local)
            projected = here.metric.without_local(residual[None])[0]
            if float(x @ x + projected @ projected) < cost:
                self.x, self.local = x, local
                return True
            shrink *= _SHORTER
        return False

    def _residual(self, x: Array, local: Array) -> Array:
        return np.nan_to_num(self.twin.measured - self._shown(x, local))

    def _settled(self, metric: Metric, x: Array, local: Array) -> tuple[Array, Array]:
        """Initial states at their minimum, each window by itself, and the residual there."""
        residual = self._residual(x, local)
        cost, shrink = metric.window_costs(residual), np.ones(len(local))
        for _ in range(_SETTLING_ROUNDS):
            step = metric.local_step(residual)
            if not np.any(np.abs(step) > _SETTLED * self.twin.state_scales):
                break
            trial = bounded(self.twin, local + shrink[:, None] * step)
            moved = self._residual(x, trial)
            costs = metric.window_costs(moved)
            better = costs < cost
            local = np.where(better[:, None], trial, local)
            residual = np.where(rows_of(self.twin, better)[:, None], moved, residual)
            cost, shrink = np.where(better, costs, cost), np.where(better, 1.0, _SHORTER * shrink)
        return local, residual

    def _crooked(self, here: _Linear) -> np.ndarray:
        """(W,) windows in which draws of what is believed now don't act linearly."""
        rng = np.random.default_rng(self.seed)
        information = here.projected @ here.projected.T + np.eye(self.x.size)
        values, vectors = np.linalg.eigh(information)
        shown = self._shown(self.x, self.local)
        worst = np.zeros(self.twin.starts.size)
        for _ in range(_DRAWS):
            change = vectors @ (rng.standard_normal(self.x.size) / np.sqrt(values))
            bend = self._shown(self.x + change, self.local) - shown - np.tensordot(change, here.columns, 1)
            projected = here.metric.without_local(bend[None])[0][: bend.size].reshape(bend.shape)
            worst = np.maximum(worst, np.add.reduceat((projected**2).sum(axis=1), self.twin.starts))
        return worst > max(_CROOKED, float(np.quantile(worst, 1.0 - _MOST_CROOKED)))
