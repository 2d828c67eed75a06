"""One recording of a healthy engine as a likelihood over the coordinates of `learning.belief`."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from dieseltwin.discovery.likelihood.between_rows import scatter_about
from dieseltwin.discovery.likelihood.fit import first_fit, fit_fully, parameter_lanes
from dieseltwin.discovery.likelihood.learned import map_columns, running_away
from dieseltwin.discovery.likelihood.metric import Metric, ModelScatter, WhitenedNuisances, Whitening
from dieseltwin.discovery.likelihood.noise import noise_of
from dieseltwin.discovery.likelihood.score import effects_beside, secant_sizes
from dieseltwin.discovery.likelihood.windows import bounded, settled_windows
from dieseltwin.discovery.reference.conditions import Clock, Conditions, Exponents, recorded_twin
from dieseltwin.discovery.search.preparation import split_growing
from dieseltwin.discovery.twins.diesel_circumstances import LoggedTwin
from dieseltwin.discovery.twins.interface import Array, Lanes, rows_of, single
from dieseltwin.engine import HEALTH, MEASURED, EngineParameters
from dieseltwin.engine.terms import Term
from dieseltwin.errors import InputError
from dieseltwin.learning.belief import GAINS_AT, HEALTH_AT, MAPS_AT, OFFSETS_AT, Belief
from dieseltwin.least_squares import symmetric_root
from dieseltwin.recordings.reader import Recording
from dieseltwin.settings.search import CircumstanceSettings

_ROUGH_ROUNDS = 5
_SETTLING_ROUNDS = 3
_DRAWS = 2
_CROOKED = 3.0  # squared whitened distance of a window from linear, by one draw of what is believed then
_MOST_CROOKED = 1.0 / 3.0


@dataclass(frozen=True)
class Linear:
    """The readings near one point.

    Attributes:
        columns: (D, n, C) responses to one prior standard deviation of every coordinate.
        local: (S, n, C) responses to the initial states.
        conditions: (K, n, C) responses to the circumstances that are open.
        applied: (K,) where the simulation has those, in standard deviations of their priors.
        metric: of the readings, initial states and circumstances taken out.
        projected: (D, rows) the columns in it.
    """

    columns: Array
    local: Array
    conditions: Array
    applied: Array
    metric: Metric
    projected: Array

    def rest(self, residual: Array) -> Array:
        """What readings less simulation (n, C) are in the metric, (rows,): priors of circumstances count from what is
        assumed of them."""
        return self.metric.project(self._as_assumed(residual)[None])[0]

    def conditions_at(self, residual: Array) -> Array:
        """(K,) where readings less simulation (n, C) have the circumstances, in standard deviations of their priors."""
        return self.metric.nuisance_estimate(self._as_assumed(residual))

    def elsewhere(self, residual: Array) -> Array:
        """(n, C) what the circumstances add to the simulation where the readings have them."""
        return np.asarray(np.tensordot(self.conditions_at(residual) - self.applied, self.conditions, 1))

    def _as_assumed(self, residual: Array) -> Array:
        return np.asarray(residual + np.tensordot(self.applied, self.conditions, 1))


class Part:
    """A recording, bound to the base engine; points `x` (D,) are in prior standard deviations about the prior's mean.

    Attributes:
        name: file of the recording, for people.
        health: (4,) of a fit of health alone, where learning starts.
        local: (W, 1) initial states.
        noise_freedom: degrees of freedom from which its noise is known; so many where rows tell it that it is certain.
    """

    noise_freedom = float("inf")

    def __init__(
        self, recording: Recording, engine: EngineParameters, prior: Belief, map_rms: float,
        beliefs: CircumstanceSettings | None = None, between_rows: bool | None = None,
    ) -> None:  # fmt: skip
        self.sha256, self.name = recording.sha256, str(recording.path or "recording")
        self.twin = self._bound(recording, engine, map_rms, beliefs, between_rows)
        self.conditions = Conditions(self.twin)
        self.at = [MEASURED.index(name) for name in self.twin.channels]
        self._scatter = ModelScatter()
        rough = fit_fully(self.twin, self._whitening(), first_fit(self.twin), rounds=_ROUGH_ROUNDS)
        start = split_growing(rough) or rough.fit
        self._first = start.local
        self.begin(prior)
        self.health = rough.fit.parameters
        self._scatter = self._scatter_about(self.twin, start.lanes())
        self.whitening = self._whitening()

    def _bound(
        self, recording: Recording, engine: EngineParameters, map_rms: float, beliefs: CircumstanceSettings | None,
        between_rows: bool | None,
    ) -> LoggedTwin:  # fmt: skip
        return recorded_twin(recording, engine, map_rms, beliefs, between_rows)

    def _scatter_about(self, twin: LoggedTwin, lanes: Lanes) -> ModelScatter:
        return scatter_about(twin, lanes)

    def _whitening(self, explained: Array | None = None) -> Whitening:
        """By the noise beside what the readings scatter by; explained: a model's readings (n, C), or None."""
        noise = noise_of(self.twin, explained, self._scatter.windows)
        return Whitening.of(self.twin.measured, noise, self.twin.starts, self._scatter)

    def begin(self, prior: Belief) -> None:
        """Take points to be about a prior, and the initial states as the fit of health alone has them."""
        self.prior, self.local = prior, self._first
        self.scale = np.sqrt(np.diag(prior.covariance))

    def beside(self, effect: str, size: float) -> Part:
        """The recording of an engine with an effect of a size in it, noise, initial states and windows as they are."""
        other = copy(self)
        if size != 0.0:
            other.twin = self.twin.with_term(Term(effect=effect, magnitude=size))
        return other

    @property
    def readings(self) -> int:
        """Number of readings used."""
        return int(np.isfinite(self.twin.measured).sum())

    def whiten_anew(self, here: Linear, x: Array, residual: Array) -> None:
        """Estimate the noise from what the simulation at a point leaves, in the circumstances that readings show."""
        explained = self.shown(x, self.local) + here.elsewhere(residual)
        self.whitening = self._whitening(explained)

    def leave_out(self, windows: np.ndarray) -> None:
        """Use some windows (W,) no longer."""
        self.twin.measured[rows_of(self.twin, windows)] = np.nan

    def shown(self, x: Array, local: Array) -> Array:
        """Readings (n, C) at a point, errors of the sensors included."""
        values = self._values(x)
        twin = self.twin.with_coefficients(values[MAPS_AT])
        clean = twin.simulate(single(values[HEALTH_AT], local))[0]
        return clean * (1.0 + values[GAINS_AT][self.at]) + values[OFFSETS_AT][self.at]

    def put_right(self, here: Linear, x: Array, residual: Array) -> Linear | None:
        """Simulate in the circumstances that readings less simulation (n, C) at x show; the same responses with the
        simulation there, None where it was there."""
        other = self.conditions.moved(self.twin, here.conditions_at(residual))
        if other is None:
            return None
        self.twin = other
        values = self._values(x)
        twin = other.with_coefficients(values[MAPS_AT])
        self._scatter = self._scatter_about(twin, single(values[HEALTH_AT], self.local))
        return replace(here, applied=self.conditions.applied(other))

    def clocks(self, here: Linear, residual: Array) -> tuple[Clock, ...]:
        """Clocks that are open, as readings less simulation (n, C) say them."""
        return self.conditions.clocks(self.twin, here.metric, here.conditions_at(residual))

    def exponents(self, here: Linear, residual: Array) -> Exponents:
        """Exponents of the compressor, where they are open, as readings less simulation (n, C) say them."""
        return self.conditions.exponents(here.metric, here.conditions_at(residual), here.columns)

    def residual(self, x: Array, local: Array) -> Array:
        """Readings less simulation (n, C), 0 where there is no reading."""
        return np.nan_to_num(self.twin.measured - self.shown(x, local))

    def linearised(self, x: Array) -> Linear:
        """Responses to every coordinate about a point and the initial states as they are.

        Nought in a window in which they run away. On the way from maps that are 5 % off, idling surged in a quarter of
        the windows: there every difference grows manyfold from row to row, to 1e43 of a reading.

        Raises:
            InputError: a health parameter at or below nought, which no engine has.
        """
        values = self._values(x)
        self._check_health(values[HEALTH_AT])
        twin = self.twin.with_coefficients(values[MAPS_AT])
        fit = replace(first_fit(twin), parameters=values[HEALTH_AT], local=self.local)
        lanes, steps = parameter_lanes(twin, fit)
        simulated = twin.simulate(lanes)
        clean, factor = simulated[0], 1.0 + values[GAINS_AT][self.at]
        differences = (simulated[1:] - clean) / steps[:, None, None]
        free = self.prior.free
        columns = np.zeros((x.size, *clean.shape))
        columns[HEALTH_AT] = differences[: len(twin.parameters)] * factor
        of_maps = map_columns(twin, fit.lanes(), clean, free)
        columns[MAPS_AT][free] = of_maps * factor
        for j, channel in enumerate(self.at):
            columns[GAINS_AT.start + channel, :, j] = clean[:, j]
            columns[OFFSETS_AT.start + channel, :, j] = 1.0
        columns *= self.scale[:, None, None]
        local = differences[len(twin.parameters) :] * factor
        conditions = self.conditions.responses(twin, fit.lanes()) * factor
        far = running_away(self.twin, clean, of_maps, local * self.twin.state_scales[:, None, None])
        for responses in (columns, local, conditions):
            responses[:, far] = 0.0
        return self._whitened(columns, local, conditions)

    def rewhitened(self, here: Linear) -> Linear:
        """The same responses behind another whitening."""
        return self._whitened(here.columns, here.local, here.conditions)

    def _whitened(self, columns: Array, local: Array, conditions: Array) -> Linear:
        taken_out = WhitenedNuisances.of(self.whitening, conditions)
        metric = Metric(self.whitening, self.twin.starts, local, self.twin.state_scales, taken_out)
        return Linear(columns, local, conditions, self.conditions.applied(self.twin), metric, metric.project(columns))

    def further(self, here: Linear, x: Array) -> Array:
        """Responses (D, rows), in the metric of `here` about x, to a coefficient of one of the functions that aren't
        free; those of all other coordinates are nought.

        In a window in which the linear response runs away it is nought as well: at idle, next to where the compressor
        lifts nothing, it grew to 1e51 of a reading, and no likelihood could be told of it.
        """
        values = self._values(x)
        twin = self.twin.with_coefficients(values[MAPS_AT])
        lanes = single(values[HEALTH_AT], self.local)
        held = ~self.prior.free
        simulated = twin.simulate(lanes)[0]
        columns = map_columns(twin, lanes, simulated, held) * (1.0 + values[GAINS_AT][self.at])
        columns[:, running_away(twin, simulated, columns)] = 0.0
        rows = np.zeros_like(here.projected)
        rows[MAPS_AT][held] = here.metric.project(columns)
        return rows

    def moved(self, here: Linear, x: Array, residual: Array, change: Array) -> tuple[Array, Array]:
        """Initial states that go with a change (D,) of x, each window's at its minimum, and the residual there."""
        rest = residual - np.tensordot(change, here.columns, 1)
        step = here.metric.local_step(rest - here.elsewhere(rest))
        return self.settled(here, x + change, bounded(self.twin, self.local + step))

    def settled(self, here: Linear, x: Array, local: Array) -> tuple[Array, Array]:
        """Initial states at their minimum, each window by itself, and the residual there."""
        residual = self.residual(x, local)
        return settled_windows(self.twin, here.metric, local, residual, here.elsewhere(residual),
                               lambda there: self.residual(x, there), _SETTLING_ROUNDS)  # fmt: skip

    def crooked(self, here: Linear, x: Array, covariance: Array, rng: np.random.Generator) -> np.ndarray:
        """(W,) windows in which draws of what is believed now, (D, D) about x, don't act linearly."""
        which = self.prior.open
        root = symmetric_root(covariance[np.ix_(which, which)])
        shown = self.shown(x, self.local)
        worst, change = np.zeros(self.twin.starts.size), np.zeros(x.size)
        for _ in range(_DRAWS):
            change[which] = root @ rng.standard_normal(len(root))
            bend = self.shown(x + change, self.local) - shown - np.tensordot(change, here.columns, 1)
            projected = here.metric.project(bend[None])[0][: bend.size].reshape(bend.shape)
            worst = np.maximum(worst, np.add.reduceat((projected**2).sum(axis=1), self.twin.starts))
        return worst > max(_CROOKED, float(np.quantile(worst, 1.0 - _MOST_CROOKED)))

    def scores(self, here: Linear, x: Array, projected: Array) -> dict[tuple[str, float], tuple[float, float, Array]]:
        """Of every effect at the sizes at which it is tried: half the gradient, its own information, that which it
        shares with the coordinates (D,).

        Args:
            here: about x; projected: (rows,) the residual there, in the metric.
        """
        values = self._values(x)
        twin = self.twin.with_coefficients(values[MAPS_AT])
        base = replace(first_fit(twin), parameters=values[HEALTH_AT], local=self.local).lanes()
        wanted = secant_sizes(twin, list(twin.hypotheses))
        factor = 1.0 + values[GAINS_AT][self.at]
        rows = here.metric.project(factor * effects_beside(twin, base, twin.simulate(base)[0], wanted))
        return {
            key: (float(row @ projected), float(row @ row), here.projected @ row)
            for key, row in zip(wanted, rows, strict=True)
        }

    def _values(self, x: Array) -> Array:
        return self.prior.mean + self.scale * x

    def _check_health(self, health: Array) -> None:
        """Refuse to go on where the readings ask for what no engine has, as idling alone does."""
        for name, value in zip(HEALTH, health, strict=True):
            if value <= 0.0:
                raise InputError(
                    self.name, f"readings that ask for {name} = {value:.3g}",
                    "driving that tells health: it is above 0",
                    "record load and speed, not idling alone, and check that columns and units are right",
                )  # fmt: skip
