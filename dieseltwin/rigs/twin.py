"""A rig's file bound to a recording: a twin for the shared search, which knows how large its own misfit is.

No twin of a real machine explains a recording down to the noise of its sensors, and gains counted in that noise are
huge for every name. So the size of the misfit that an explanation leaves counts as the noise, and as many readings as
are independent in it: the likelihood of an unknown variance about that explanation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from dieseltwin.discovery.likelihood.metric import Whitening
from dieseltwin.discovery.likelihood.nuisance import Nuisance
from dieseltwin.discovery.twins.interface import Array, Hypothesis, Lanes, Parameter, Point
from dieseltwin.discovery.twins.simple import LawTerm, Model, SimpleTwin
from dieseltwin.engine.courses import course
from dieseltwin.recordings.noise import Noise
from dieseltwin.rigs.expressions import moment
from dieseltwin.rigs.parameters import RigParameters, RigTerm
from dieseltwin.rigs.recording import RigRecording

WIDE = 3.0  # tolerances of an effect that was found: what is believed of its size when it is fitted again


@dataclass(frozen=True)
class When:
    """When an effect acts: since its onset, before its end if it has one; it may grow evenly from nothing to the end of
    the recording [s]."""

    onset_s: float
    until_s: float | None = None
    grown_s: float | None = None

    def share(self, time_s: Array) -> Array:
        """(n,) share of its size at some times (n,) [s]."""
        return course(time_s, self.onset_s, self.until_s, self.grown_s)


def model_of(rig: RigParameters) -> Model:
    """The rig's formulae as a `Model`; sizes of effects that were found are free parameters of it."""
    found = {term.effect: term for term in rig.terms}
    always = [name for name, term in found.items() if term.onset_s is None]  # others differ from sample to sample
    held = {**dict.fromkeys(rig.effects, "e"), **dict.fromkeys((*rig.parameters, *always), "p"),
            **dict.fromkeys(rig.states, "x"), **dict.fromkeys(rig.inputs, "u")}  # fmt: skip
    formulae = {name: q.formula for name, q in rig.quantities.items()}
    changes = [rig.rates[name] for name in rig.states]

    @cache
    def rates_without(effects: frozenset[str]) -> Callable[..., tuple[Any, ...]]:
        return moment(held, formulae, changes, effects, noted=False)

    shown = moment(held, formulae, list(rig.readings.values()))
    return Model(
        states={name: state.scale for name, state in rig.states.items()},
        parameters=(
            *(Parameter(n, p.value, p.prior_std, p.unit, p.scale, bounded=p.value > 0.0)
              for n, p in rig.parameters.items()),
            *(_found(rig, name, term.magnitude) for name, term in found.items()),
        ),
        inputs=tuple(rig.inputs), channels=tuple(rig.readings), rates=moment(held, formulae, changes), readings=shown,
        rates_without=rates_without,
        points=tuple(Point(n, q.site, q.relative, "-" if q.relative else q.unit, q.ports, q.scale)
                     for n, q in rig.quantities.items() if q.site is not None),
        hypotheses=tuple(
            Hypothesis(n, e.site, e.law, e.unit, e.tolerance, e.limits, not e.sizes, e.sizes or (e.tolerance,),
                       "sensor" if e.sensor else "physics")
            for n, e in rig.effects.items() if n not in found
        ),
        units={**{n: s.unit for n, s in rig.states.items()}, **rig.inputs,
               **{n: q.unit for n, q in rig.quantities.items()}},
        sub_steps=rig.sub_steps, hold=rig.hold,
        nearest={s.nearest: n for n, s in rig.states.items() if s.nearest is not None},
        first={n: s.first for n, s in rig.states.items()},
    )  # fmt: skip


def _found(rig: RigParameters, name: str, magnitude: float) -> Parameter:
    effect = rig.effects[name]
    size = WIDE * max(effect.tolerance, abs(magnitude))
    return Parameter(name, magnitude, size, effect.unit, effect.tolerance)


TIMES = 24
"""At which every effect and every term is let begin; between them the best one's date is moved."""


class RigTwin(SimpleTwin):
    """A rig bound to a recording; satisfies `Twin` and `KnownErrors`.

    Args:
        rig: its laws are part of the twin, its terms free parameters.
        recording: what was recorded; a reading that is absent counts as missing.
        window_s: of a fit [s]; None for one run.

    Attributes:
        misfit: (C,) size that counts as noise [units of the readings]; see `about`.
        when: all effects that are looked for act then; None: always. See `acting`.
    """

    exact_responses = True  # integrated with steps far below what any force changes in
    strained = True  # without its friction an axis is fitted with twice its mass

    def __init__(self, rig: RigParameters, recording: RigRecording, window_s: float | None = None) -> None:
        none = np.full(len(recording.time_s), np.nan)
        measured = np.stack([recording.readings.get(name, none) for name in rig.readings], axis=1)
        self._laws: dict[str, list[LawTerm]] = {}
        super().__init__(model_of(rig), recording.time_s, recording.inputs, measured, window_s)
        self.rig, self.recording, self.window_s = rig, recording, window_s
        self.when: When | None = None
        self._begun = {len(rig.parameters) + k: term for k, term in enumerate(rig.terms) if term.onset_s is not None}
        self.floors = np.array([rig.floors.get(name, 0.0) for name in rig.readings])
        steps = np.diff(measured, axis=0)
        there = np.isfinite(steps).any(axis=0)  # a sensor that is absent has no noise
        self.misfit = self.floors.copy()
        self.misfit[there] = np.maximum(np.nanstd(steps[:, there], axis=0), self.floors[there])
        for law in rig.laws:
            placed = law.placed_in(recording.sha256)
            self._laws.setdefault(law.at, []).append(
                lambda at, placed=placed: placed.coefficient * placed.form.value(at)  # type: ignore[misc]
            )

    def about(self, residual: Array) -> RigTwin:
        """The same twin with the size of its misfit as a fit left it: residual (n, C) [units of the readings]."""
        twin = copy(self)
        twin._begins = None  # its runs are no continuation of this one's
        share = np.isfinite(residual).sum() / _independent(residual, self.starts, len(self.states))
        size = np.sqrt(np.nanmean(residual**2, axis=0) * max(share, 1.0))
        twin.misfit = np.maximum(size, self.floors)
        return twin

    @property
    def onset_reaches_s(self) -> tuple[float, ...]:
        """As `WithOnsetReaches`: from what lies between the times that are tried first down to a row."""
        rows, reaches = len(self.time_s) / TIMES, []
        while rows > 1.0:
            reaches.append(rows * float(np.median(np.diff(self.time_s))))
            rows /= 2.0  # five times about the best lie half a reach apart
        return tuple(reaches)

    def acting(self, when: When) -> RigTwin:
        """The same twin, in which all effects that are looked for act then."""
        twin = copy(self)
        twin.when = when
        return twin

    def noise(self) -> Noise:
        """As `KnownErrors.noise`: the size of the misfit, white."""
        return Noise(self.misfit, np.zeros(len(self.channels)))

    def whitening(self) -> Whitening:
        """As `KnownErrors.whitening`."""
        return Whitening.of(self.measured, self.noise(), self.starts)

    def nuisances(self, lanes: Lanes) -> list[Nuisance]:
        """As `KnownErrors.nuisances`: none; a rig has no maps of known tolerance."""
        del lanes
        return []

    def simulate_with_laws(self, lanes: Lanes, laws: Mapping[str, list[LawTerm]]) -> Array:
        """As `SimpleTwin.simulate_with_laws`, with the rig's own laws."""
        return super().simulate_with_laws(self._entering(lanes), self._with_own(laws))

    def variables(self, lanes: Lanes, laws: Mapping[str, list[LawTerm]] | None = None) -> dict[str, Array]:
        """As `SimpleTwin.variables`, with the rig's own laws."""
        return super().variables(self._entering(lanes), self._with_own(laws or {}))

    def _entering(self, lanes: Lanes) -> Lanes:
        """Lanes with the times at which effects act."""
        if self.when is None and not self._begun:
            return lanes
        magnitudes, schedules = dict(lanes.magnitudes), dict(lanes.schedules)
        if self.when is not None:
            acts = self.when.share(self.time_s)
            schedules = {name: acts * schedules.get(name, 1.0) for name in magnitudes}
        for column, term in self._begun.items():
            magnitudes[term.effect] = lanes.parameters[:, column]
            schedules[term.effect] = self._acts(term)
        return replace(lanes, magnitudes=magnitudes, schedules=schedules)

    def _acts(self, term: RigTerm) -> Array:
        """Share of its size that a term has at the samples (n,)."""
        if term.onset_s is not None and term.found_in == self.recording.sha256:
            return When(term.onset_s, term.until_s, term.grown_s).share(self.time_s)
        return np.full(len(self.time_s), float(term.until_s is None))

    def _with_own(self, laws: Mapping[str, list[LawTerm]]) -> dict[str, list[LawTerm]]:
        return {name: [*self._laws.get(name, ()), *laws.get(name, ())] for name in {**self._laws, **laws}}


def _independent(residual: Array, starts: np.ndarray, states: int) -> float:
    """Number of independent readings in a misfit (n, C): half of all pairs of neighbours change sign in white noise."""
    crossings = 0
    for column in np.asarray(residual).T:
        kept = column[np.isfinite(column)]
        crossings += int(np.sum(np.signbit(kept[1:]) != np.signbit(kept[:-1])))
    return float(np.clip(2 * crossings, len(starts) * (states + 1), np.isfinite(residual).sum()))
