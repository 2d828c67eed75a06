"""All recordings of a healthy engine as one likelihood over the coordinates of `learning.belief`, and its maximum."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import copy

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from dieseltwin.discovery.reference.conditions import Weather, clocks_of_all, exponents_together
from dieseltwin.discovery.reference.evidence import Evidence
from dieseltwin.discovery.reference.part import Linear, Part
from dieseltwin.discovery.reference.standing_part import StandingPart, tell_noise
from dieseltwin.discovery.reference.suspicion import Suspicion
from dieseltwin.discovery.twins.interface import Array, Hypothesis
from dieseltwin.learning.belief import HEALTH_AT, Belief
from dieseltwin.learning.weather import Exponent

ROUNDS = 12
"""Sets of sensitivities that a fit takes at most."""

_BESIDE = 5e-5  # of -2 log posterior that a step promises, below which a fit beside a fault is there
_SLIDES, _ROUNDS_BESIDE = 6, 4
_CONVERGED = 0.05  # predicted decrease of -2 log posterior: a twentieth of a standard deviation squared, of any mix
_LEFT_TO_NEXT = 0.2  # of that, below which steps with old sensitivities promise nothing
_STALLED = 0.5  # of the decrease predicted before, above which old sensitivities mislead
_STUCK = 0.05  # promised decrease an unknown that counts as none where no step leads down: the posterior has kinks
_SHRINKS = (1.0, 0.4, 0.16, 0.064)
_DAMPINGS = (0.01, 0.1, 1.0)  # of an unknown's own information
_LEAST_FREEDOM = 1.0  # readings; the fit follows fewer
_LEAST_INFORMATION = 1e-6  # of an effect's information, that must be left when all coordinates are taken out


class Joint:
    """The maximum a posteriori of all recordings at once, and the linearisations of all about it.

    Steps are Gauss-Newton with the last sensitivities while these promise enough, and convergence is judged by new
    ones: a set of them costs as much as twenty simulations.
    """

    def __init__(self, parts: Sequence[Part], prior: Belief) -> None:
        self.parts = parts
        self.begin(prior)

    def begin(self, prior: Belief) -> None:
        """Judge by a prior, from the fits of health alone on."""
        self.prior = prior
        self.scale = np.sqrt(np.diag(prior.covariance))
        self.precision = np.linalg.inv(prior.covariance / np.outer(self.scale, self.scale))
        self.unknowns = int(np.count_nonzero(prior.open))
        self.x = np.zeros(prior.mean.size)
        if self.parts:
            health = np.mean([part.health for part in self.parts], axis=0)
            self.x[HEALTH_AT] = (health - prior.health) / self.scale[HEALTH_AT]
        for part in self.parts:
            part.begin(prior)
        self._simulate()
        self.at: list[Linear] = []
        self._linearise()

    def of_all_functions(self) -> tuple[Array, Array]:
        """Information (D, D) of the readings about all coordinates, those included that aren't open, and the vector
        (D,) to which it takes the coordinates' distance from the prior's mean [inverse units]."""
        information, vector = np.zeros_like(self.precision), np.zeros_like(self.x)
        for part, at, rest in zip(self.parts, self.at, self.projected, strict=True):
            rows = at.projected / self.scale[:, None] + part.further(at, self.x)
            information += rows @ rows.T
            vector += rows @ (rest + at.projected.T @ self.x)
        return information, vector

    def fit(self, rounds: int, near: float = 0.0) -> bool:
        """Damped Gauss-Newton with at most so many sets of sensitivities; whether it converged.

        Args:
            near: share of -2 log posterior below which what a step promises is enough as well.
        """
        for _ in range(rounds):
            factor = cho_factor(self._information())
            step, predicted = self._step(factor)
            if predicted < max(_CONVERGED, near * self.cost()):
                return True
            if not self._advance(step) and not self._creep():
                return predicted < _STUCK * self.unknowns
            while True:
                before = predicted
                step, predicted = self._step(factor)
                if predicted < _LEFT_TO_NEXT * _CONVERGED or predicted > _STALLED * before or not self._advance(step):
                    break
            self._put_right()
            self._linearise()
        return self._step(cho_factor(self._information()))[1] < _STUCK * self.unknowns

    def beside(self, effect: str, size: float, anew: bool) -> Joint:
        """All recordings fitted from here on with an effect of a size in the engine; this fit stays as it is.

        Args:
            anew: take new sensitivities there; else those of here have to do.
        """
        other = copy(self)
        other.parts = [part.beside(effect, size) for part in self.parts]
        other._simulate()
        other._project()
        factor, before = cho_factor(other._information()), np.inf
        for _ in range(_SLIDES):
            step, predicted = other._step(factor)
            if predicted < _BESIDE * other.cost() or predicted > _STALLED * before or not other._advance(step):
                break
            before = predicted
        if anew:
            other._linearise()
            other.fit(_ROUNDS_BESIDE, _BESIDE)
        return other

    def _put_right(self) -> None:
        """Simulate in the clocks and the weather that the readings show beside the maps as corrected by now. They are
        open all the time, but linear only near where the simulation is."""
        there = [part.put_right(at, self.x, rest) for part, at, rest in self._left()]
        if any(there):
            self.at = [new or at for new, at in zip(there, self.at, strict=True)]
            self._simulate()

    def clocks(self) -> Mapping[str, float]:
        """Column -> how late all recordings together show it to be [s]."""
        return clocks_of_all([part.clocks(at, rest) for part, at, rest in self._left()])

    def exponents(self, believed: Mapping[str, Exponent]) -> Mapping[str, Exponent]:
        """What all recordings together show of the compressor's exponents, by name, beside what was believed of each;
        none in one weather."""
        found = [part.exponents(at, rest) for part, at, rest in self._left()]
        return exponents_together(found, self._covariance(), believed)

    def strange(self) -> tuple[Weather, ...]:
        """Weather and charge in which next to nobody drives."""
        found = [part.conditions.strange(at.conditions_at(rest)) for part, at, rest in self._left()]
        return tuple(item for some in found for item in some)

    def _left(self) -> Iterator[tuple[Part, Linear, Array]]:
        return zip(self.parts, self.at, self.residuals, strict=True)

    def whiten_anew(self) -> None:
        """Estimate the noise of every recording from what the maps as corrected by now leave."""
        self._tell_noise()
        for part, at, rest in self._left():
            part.whiten_anew(at, self.x, rest)
        self._rewhiten()

    def leave_crooked_out(self, rng: np.random.Generator) -> bool:
        """Leave windows out in which what is believed now doesn't act linearly; whether there are any."""
        covariance = self._covariance()
        found = [part.crooked(at, self.x, covariance, rng) for part, at in zip(self.parts, self.at, strict=True)]
        if any_out := any(windows.any() for windows in found):
            for part, windows in zip(self.parts, found, strict=True):
                if windows.any():
                    part.leave_out(windows)
            self._tell_noise()
            for part, at, rest, windows in zip(self.parts, self.at, self.residuals, found, strict=True):
                if windows.any() or isinstance(part, StandingPart):
                    part.whiten_anew(at, self.x, rest)
            self._simulate()
            self._rewhiten()
        return any_out

    def evidence(self) -> tuple[Evidence, ...]:
        """What each recording says, linearised about what all say."""
        mean, across = self.prior.mean + self.scale * self.x, np.outer(self.scale, self.scale)
        covariance = self._covariance()
        found = []
        for part, at, rest in zip(self.parts, self.at, self.projected, strict=True):
            own = at.projected @ at.projected.T
            freedom = max(part.readings - float(np.sum(covariance * own)), _LEAST_FREEDOM)
            information = 0.5 * (own + own.T) / across
            vector = information @ mean + (at.projected @ rest) / self.scale
            misfit = float(rest @ rest) / freedom
            found.append(Evidence(information, vector, misfit, freedom, part.noise_freedom))
        return tuple(found)

    def suspicions(self, least_gain: float) -> tuple[Suspicion, ...]:
        """Efficient scores of all effects at what was learned, in all recordings and in each alone, those above a gain,
        strongest first. One recording of several must show an effect by what the choice among them costs more.

        What is left of the gradient of what was learned is taken out as well: next to nothing there is much beside an
        effect of which maps take up all but a thousandth.
        """
        parts: dict[tuple[str, float, int | None], list[tuple[float, float, Array]]] = {}
        for k, (part, at, rest) in enumerate(zip(self.parts, self.at, self.projected, strict=True)):
            for (name, size), values in part.scores(at, self.x, rest).items():
                parts.setdefault((name, size, None), []).append(values)
                if len(self.parts) > 1:
                    parts[name, size, k] = [values]
        choice = 2.0 * float(np.log(len(self.parts)))
        whole, gradient = self._information(), self._gradient()
        hypotheses = self.hypotheses()
        found: dict[str, Suspicion] = {}
        for (name, _, number), some in parts.items():
            hypothesis = hypotheses[name]
            own = sum(values[1] for values in some)
            across = np.sum([values[2] for values in some], axis=0)
            taken_up = np.linalg.solve(whole, across)
            push = sum(values[0] for values in some) - float(gradient @ taken_up)
            information = own - float(across @ taken_up)
            if information <= _LEAST_INFORMATION * own:
                continue
            size = float(np.clip(push / information, *hypothesis.limits))
            gain = information * size * (2.0 * push / information - size)
            alone = None if number is None else self.parts[number].sha256
            gain -= 0.0 if alone is None else choice
            if gain > max(least_gain, found[name].gain if name in found else 0.0):
                found[name] = Suspicion(name, hypothesis.unit, size, information**-0.5, gain, alone,
                                        abs(size) / hypothesis.tolerance)  # fmt: skip
        return tuple(sorted(found.values(), key=lambda item: -item.gain))

    def hypotheses(self) -> dict[str, Hypothesis]:
        """The effects that any of the recordings can show."""
        return {name: item for part in self.parts for name, item in part.twin.hypotheses.items()}

    def by_an_effect(self) -> tuple[float, float]:
        """Log likelihood that the strongest effect gains beside what is believed of the maps, and the strongest that
        one recording shows alone."""
        found = self.suspicions(0.0)
        alone = (item for item in found if item.alone is not None)
        return max((0.5 * s.gain for s in found), default=0.0), max((0.5 * s.gain for s in alone), default=0.0)

    def _simulate(self) -> None:
        """Readings less simulation of all recordings at x."""
        self.residuals = [part.residual(self.x, part.local) for part in self.parts]

    def _linearise(self) -> None:
        """Sensitivities of all recordings at x."""
        self.at = [part.linearised(self.x) for part in self.parts]
        self._project()

    def _rewhiten(self) -> None:
        """The same sensitivities in the metrics of new noise or of fewer windows."""
        self.at = [part.rewhitened(at) for part, at in zip(self.parts, self.at, strict=True)]
        self._project()

    def _project(self) -> None:
        self.projected = [at.rest(rest) for at, rest in zip(self.at, self.residuals, strict=True)]

    def _tell_noise(self) -> None:
        """Of settled points, which have none of their own."""
        if any(isinstance(part, StandingPart) for part in self.parts):  # or nobody needs the covariance
            tell_noise(self.parts, self.at, self.residuals, self._covariance())

    def _covariance(self) -> Array:
        """Of what is believed now (D, D), in standard deviations of the prior."""
        return np.asarray(np.linalg.inv(self._information()), dtype=np.float64)

    def _information(self) -> Array:
        return np.asarray(self.precision + np.sum([at.projected @ at.projected.T for at in self.at], axis=0))

    def _gradient(self) -> Array:
        """Half the slope of -2 log posterior at x, downwards."""
        pushes = [at.projected @ rest for at, rest in zip(self.at, self.projected, strict=True)]
        return np.asarray(np.sum(pushes, axis=0) - self.precision @ self.x)

    def _step(self, factor: tuple[Array, bool]) -> tuple[Array, float]:
        """Gauss-Newton step, and the decrease of -2 log posterior that it promises."""
        gradient = self._gradient()
        step = np.asarray(cho_solve(factor, gradient))
        return step, float(gradient @ step)

    def cost(self) -> float:
        """-2 log posterior, up to a constant."""
        return float(self.x @ self.precision @ self.x + sum(rest @ rest for rest in self.projected))

    def _creep(self) -> bool:
        """Go along a step that avoids what the readings say least of, where Gauss-Newton's own leads nowhere down."""
        whole, gradient = self._information(), self._gradient()
        damped = (whole + damping * np.diag(np.diag(whole)) for damping in _DAMPINGS)
        return any(self._advance(np.asarray(np.linalg.solve(to, gradient)), _SHRINKS[:1]) for to in damped)

    @np.errstate(over="ignore")  # too long a step may run away to 1e200: its cost is infinite, and it isn't taken
    def _advance(self, step: Array, shrinks: Sequence[float] = _SHRINKS) -> bool:
        """Go along a step as far as the posterior rises; False where it nowhere does."""
        before, cost = (self.x, [part.local for part in self.parts], self.residuals), self.cost()
        for shrink in shrinks:
            x, change = before[0], shrink * step
            for part, local in zip(self.parts, before[1], strict=True):
                part.local = local
            found = [
                part.moved(at, x, rest, change)
                for part, at, rest in zip(self.parts, self.at, before[2], strict=True)
            ]
            self.x, self.residuals = x + change, [rest for _, rest in found]
            for part, (local, _) in zip(self.parts, found, strict=True):
                part.local = local
            self._project()
            if self.cost() < cost:
                return True
        self.x, self.residuals = before[0], before[2]
        for part, local in zip(self.parts, before[1], strict=True):
            part.local = local
        self._project()
        return False
