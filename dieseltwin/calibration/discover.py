"""What settled points say that the mean-value model lacks: the search of recordings, round by round.

Every round runs `discovery.search.run` on the balances (`SteadyTwin`) about the present engine; beside a reference
about the engine that the reference tells (`reference_engine`). What it names enters the engine, all coefficients are
fitted again together with its magnitude, and a held-out third of the points judges whether that foretells better; then
the search looks at what is left. So a second effect is sought with maps that the first no longer bends.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import cast

import numpy as np
from numpy.typing import NDArray

from dieseltwin.calibration.believable import unbelievable
from dieseltwin.calibration.calibrate import Calibration, Fit, counted_rows, submodel_fits
from dieseltwin.calibration.coefficients import (
    FLAP_COEFFICIENTS,
    Coefficient,
    effect_coefficients,
    with_scalars,
    worn,
)
from dieseltwin.calibration.formulations import formulations
from dieseltwin.calibration.held_out import Foretold, foretold
from dieseltwin.calibration.lasting_errors import corrections_left, map_corrections
from dieseltwin.calibration.likelihood import FULL_ITERATIONS, Estimate, estimate
from dieseltwin.calibration.matched_turbine import beside_best_ratio
from dieseltwin.calibration.onsets import Onset, onset_of
from dieseltwin.calibration.own_pipes import BACK_PRESSURE, beside_own_pipes
from dieseltwin.calibration.reference_engine import about_reference, told_by_reference
from dieseltwin.calibration.rough_maps import Rough, wider
from dieseltwin.calibration.scatter import Scatter, scatter_of
from dieseltwin.calibration.steady_model import (
    CHARGE_OFFSET,
    SteadyModel,
    term_values,
)
from dieseltwin.calibration.steady_twin import SteadyTwin, hypotheses_of
from dieseltwin.discovery.laws.search import Law
from dieseltwin.discovery.laws.sensor import best_law
from dieseltwin.discovery.laws.terms import law_terms_of
from dieseltwin.discovery.likelihood.fit import Fit as Fitted
from dieseltwin.discovery.options import SearchOptions
from dieseltwin.discovery.search import run as search
from dieseltwin.discovery.search.preparation import tolerance_responses
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.interface import Hypothesis
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.engine.parameters import EngineParameters
from dieseltwin.engine.terms import OneTerm, SensorTerm, Term, corrections_in, law_terms, with_corrections
from dieseltwin.recordings.steady_points import SINCE, STATES, SteadyPoints
from dieseltwin.settings.defaults import default_search
from dieseltwin.settings.search import PointSettings

_SIGNIFICANT = 2.0  # standard deviations


@dataclass(frozen=True, kw_only=True)
class Options(SearchOptions):
    """What a user may choose.

    Attributes:
        sensors: columns to use, None for all.
        law_search: look for a law where no name fits.
        search: what is decided by, and believed of the submodels.
    """

    sensors: tuple[str, ...] | None = None
    law_search: bool = True
    search: PointSettings = field(default_factory=lambda: default_search().points)


@dataclass(frozen=True)
class Round:
    """One round of the search.

    Attributes:
        found: the search.
        names: what it would add.
        nll: negative log-likelihood per held-out point with it.
        taken: whether the held-out points like it.
        onset: where what it would add begins at a point.
    """

    found: Search
    names: tuple[str, ...]
    nll: float
    taken: bool
    onset: Onset | None = None

    def tried(self, count: int) -> list[tuple[str, str, Fitted, bool]]:
        """Name, since when, fit, and whether it was taken: what begins at a point, and of the others so many that
        lead."""
        rest = [(name, "", fit, self.onset is None and self.taken and name in self.names)
                for fit in self.found.singles[:count] for name in fit.candidate.names]  # fmt: skip
        if self.onset is None:
            return rest
        return [(self.onset.name, f" since data row {self.onset.row}", self.onset.fit, self.taken), *rest]


@dataclass(frozen=True)
class PointsDiscovery:
    """What the points say.

    Attributes:
        calibration: of the engine as it was given.
        repaired: the same with what was found, `start` and `estimate` holding the magnitudes under the effects' names.
        rounds: of the search, the last one took nothing (or none was left).
        effects: name (or fault of a sensor) -> magnitude and standard deviation [its unit], in the order of finding.
        nll_before, nll_after: negative log-likelihood per held-out point.
        fits_before, fits_after: per submodel, of coefficients that never saw the held-out third.
        law: of the last round, where no name explains what it sees and a law foretells held-out points better.
        law_terms: the same as terms, with which all coefficients of `repaired` were fitted.
        scatter: where the points differ by what nobody recorded, if more is missing.
        options: as asked.
        formulations: competing models of the unmeasured places, with their estimates, for `imply`.
        seconds: wall time.
        before_law: `repaired` as it was before the law, where there is one.
        beside_pipes: back pressure where the engine has usual pipes of its own [Pa/(kg/s)^2], where that was found.
        rough: what has no name by wider beliefs of the maps, where there is something and no reference.
        rough_named: likewise of the first name that acts in all points, by that name.
    """

    calibration: Calibration
    repaired: Calibration
    rounds: tuple[Round, ...]
    effects: Mapping[str, tuple[float, float]]
    nll_before: float
    nll_after: float
    fits_before: Mapping[str, Fit]
    fits_after: Mapping[str, Fit]
    law: Law | None
    law_terms: tuple[OneTerm, ...]
    scatter: Scatter | None
    options: Options
    formulations: Mapping[str, tuple[SteadyModel, Estimate]]
    seconds: float
    before_law: Calibration | None = None
    beside_pipes: float | None = None
    rough: Rough | None = None
    rough_named: Mapping[str, Rough] = field(default_factory=dict)

    @property
    def mismatch(self) -> bool:
        """Whether something is missing, with a name or without."""
        return bool(self.effects) or self.more_is_missing

    @property
    def more_is_missing(self) -> bool:
        """Whether the last round still sees something that no name explains."""
        return bool(self.rounds) and self.rounds[-1].found.kind != "healthy" and not self.rounds[-1].taken

    @property
    def points(self) -> SteadyPoints:
        """Of the calibration, with where each effect that begins at a point acts."""
        return self.repaired.points

    @property
    def onsets(self) -> Mapping[str, Onset]:
        """Effects that begin at a point, by name."""
        return {item.onset.name: item.onset for item in self.rounds
                if item.taken and item.onset is not None and item.onset.name in self.effects}

    @property
    def first(self) -> Round:
        """The first round that gave a name that is left; the very first one where none did."""
        named = (item for item in self.rounds if item.taken and not self.effects.keys().isdisjoint(item.names))
        return next(named, self.rounds[0])

    def terms(self) -> tuple[OneTerm, ...]:
        """What was found, by name or as a law, as terms of an engine file."""
        values = self.repaired.start
        named = (_term(name, magnitude, std, values) for name, (magnitude, std) in self.effects.items()
                 if name != CHARGE_OFFSET)
        return (*named, *self.law_terms)

    @cached_property
    def corrections(self) -> NDArray[np.float64]:
        """Corrections of the maps (K,) beside those that the engine had: as a reference told them, else what is left at
        the points [-]."""
        here, believed = self.repaired, self.options.search
        told = map_corrections(here.points, here.model, here.start, believed)
        if told is not None:
            return told
        counted = counted_rows(here.model, here.estimate.coefficients)
        errors = zip(here.model.rows, here.estimate.discrepancy.tolist(), strict=True)
        left = {row: error for row, error in errors if row in counted}
        return corrections_left(here.points, here.model, here.start, believed, left)

    def engine(self) -> EngineParameters:
        """The repaired machine: fitted coefficients, the found terms beside those that the engine had, and the
        corrections of its maps."""
        terms = (*self.calibration.engine.terms, *self.terms())
        known = corrections_in(terms)
        terms = with_corrections(terms, self.corrections if known is None else known + self.corrections)
        return worn(self.repaired.engine, self.repaired.start).replace(terms=terms)


def _term(name: str, magnitude: float, std: float, values: Mapping[str, float]) -> OneTerm:
    if name not in EFFECTS:
        column, _, fault = name.partition(":")
        return SensorTerm(sensor=column, fault="gain" if fault == "gain" else "offset", magnitude=magnitude, std=std)
    own = {key: values[column] for column, key in FLAP_COEFFICIENTS.items()} if name == "exhaust_flap" else {}
    return Term(effect=name, magnitude=float(np.clip(magnitude, *EFFECTS[name].limits)), std=std, shape=own)


def discover_points(calibration: Calibration, options: Options | None = None) -> PointsDiscovery:
    """Detect, locate, name, model, prove; on settled points.

    Args:
        calibration: of the engine as it is believed.
        options: None for the defaults.
    """
    options = options or Options()
    clock = time.perf_counter()
    points, mask = calibration.points, calibration.held_out
    hypotheses = hypotheses_of(points, STATES)
    free = list(calibration.estimate.coefficients)
    here = calibration
    first = best = foretold(here, free)
    rounds: list[Round] = []
    names: list[str] = []
    faded: set[str] = set()
    told = told_by_reference(calibration)
    while True:
        there = about_reference(here, told)
        twin = SteadyTwin(there, options.search, options.sensors, options.seed)
        settings = options.settings()
        found = search.run(twin, settings.asked(tuple(faded), options.seed), laws=False)
        misfit = max(found.null.fit.objective - found.twin.measured.size, 1.0)
        onset = onset_of(found, twin, options.search.onset_share)
        added = (onset.name,) if onset is not None else \
            found.names_for_round(misfit, options.search.least_explained, refused=True)
        if not added or len(names) + len(added) > options.search.most_effects:
            rounds.append(Round(found, (), best.nll, False))
            break
        more = [c for name in added for c in effect_coefficients(name, hypotheses[name], options.search.flap_spread)]
        if onset is not None:
            there = replace(there, points=_acting(there.points, onset, hypotheses[onset.name]))
        candidate = _refitted(there, [*free, *more], _start_of(found, added, more, onset))
        vanished = _vanished(candidate, added, hypotheses, found)
        if vanished:  # the maps bend so that nothing is left of it: the search looks again without that name
            faded |= vanished
            continue
        with_it = foretold(candidate, [*free, *more])
        taken = with_it.better_than(best)
        rounds.append(Round(found, added, with_it.nll, taken, onset))
        if not taken:
            break
        here, best = candidate, with_it
        free += more
        names += added
        superseded = _vanished(here, names, hypotheses, found)
        if superseded:  # what came later explains what an earlier name had stood for
            names = [name for name in names if name not in superseded]
            free = [c for c in free if c.name not in superseded]
            here = _refitted(here, free, dict.fromkeys(superseded, 0.0))
            best = foretold(here, free)
    last = rounds[-1]
    more_is_missing = last.found.kind != "healthy" and not last.taken
    law: Law | None = None
    terms: tuple[OneTerm, ...] = ()
    scatter, before_law = None, None
    if more_is_missing and options.law_search:
        proved = _proved_law(last.found, here, free, best)
        if proved is not None:
            before_law = here
            law, terms, here, best = proved
    if more_is_missing:
        scatter = scatter_of(here.model, here.points, here.start, options.search.submodels)
    std = here.estimate.std()
    values = here.estimate.values()
    beside_pipes = beside_own_pipes(here, free)
    if beside_pipes is not None:
        std[BACK_PRESSURE] = float(np.hypot(std[BACK_PRESSURE], values[BACK_PRESSURE] - beside_pipes))
    for name, other in beside_best_ratio(here, free, names).items():
        std[name] = float(np.hypot(std[name], values[name] - other))
    return PointsDiscovery(
        calibration, here, tuple(rounds), {name: (values[name], std[name]) for name in names}, first.nll,
        best.nll, submodel_fits(calibration.model, points, mask, first.trained, calibration.estimate.discrepancy),
        submodel_fits(here.model, here.points, mask, best.trained, here.estimate.discrepancy),
        law, terms, scatter, options, formulations(here, free, options.search.submodels), time.perf_counter() - clock,
        before_law, beside_pipes,
        wider(last.found, twin) if more_is_missing and not told else None,
        {} if told else _named_by_wider(rounds, names),
    )  # fmt: skip


def _named_by_wider(rounds: Sequence[Round], names: Sequence[str]) -> dict[str, Rough]:
    """The first name that is left and acts in all points, by wider beliefs of the maps; what begins in the middle of
    the points is no error of a map."""
    for item in rounds:
        kept = [name for name in item.names if name in names]
        if item.taken and item.onset is None and kept:
            return {kept[0]: wider(item.found, cast(SteadyTwin, item.found.twin))}
    return {}


def _acting(points: SteadyPoints, onset: Onset, effect: Hypothesis) -> SteadyPoints:
    """The points with where an effect acts. What moves the charge or its reading bends what is usual of it: the points
    before tell that."""
    acting = points.with_columns(**{f"{SINCE}{onset.name}": onset.acts})
    moved = "t_im_k" in points and effect.site in ("intake_temperature", "sensor:t_im_k")
    return acting.with_usual_charge(onset.acts < 0.5) if moved else acting


def _vanished(
    candidate: Calibration, names: Sequence[str], hypotheses: Mapping[str, Hypothesis], found: Search
) -> set[str]:
    """Names that the joint fit makes smaller than what is of interest, or than twice their deviation."""
    values, std = candidate.estimate.values(), candidate.estimate.std()
    least = {name: found.settings.alarm_size * hypotheses[name].tolerance for name in names}
    return {name for name in names if abs(values[name]) < max(least[name], _SIGNIFICANT * std[name])}


def _start_of(
    found: Search, names: tuple[str, ...], more: list[Coefficient], onset: Onset | None
) -> dict[str, float]:
    """Where the joint fit starts: the magnitudes of the search."""
    at = onset.fit if onset is not None else None
    if at is None and found.best is not None and found.best.fit.candidate.names == names:
        at = found.best.fit
    fit = at or next(f for f in [*found.singles, *found.pairs] if f.candidate.names == names)
    start = {c.name: c.mean for c in more}
    start |= dict(zip(names, (float(m) for m in fit.magnitudes), strict=True))
    own = {p.name: float(v) for p, v in zip(found.twin.parameters, fit.parameters, strict=True)}
    return start | {name: value for name, value in own.items() if name in start}


def _refitted(here: Calibration, free: list[Coefficient], start: Mapping[str, float]) -> Calibration:
    """All coefficients again, with further ones."""
    begin = {**here.start, **start}
    found = estimate(here.model, here.points, free, begin, iterations=FULL_ITERATIONS,
                     rows=counted_rows(here.model, free), inflate=True)
    values = {**begin, **found.values()}
    return replace(here, estimate=found, start=values, covariance=found.covariance,
                   engine=with_scalars(here.engine, found.values()))


_Proved = tuple[Law, tuple[OneTerm, ...], Calibration, Foretold]


def _proved_law(found: Search, here: Calibration, free: list[Coefficient], best: Foretold) -> _Proved | None:
    """A law for what no name explains, if the held-out third is foretold better with it and all coefficients fitted.

    Among some thousand forms the best one always fits better; a law that doesn't foretell is none. Nor is one that
    takes an unmeasured place beyond what is believed of it: the next best at another place is looked for.

    Returns:
        The law, its terms, the calibration with it, and what that foretells.
    """
    refused: frozenset[str] = frozenset()
    while True:
        points = found.twin.points
        unnamed = [item for item in found.everything_unnamed()
                   if item.feature.point is None or points[item.feature.point].name not in refused]
        law = best_law(found.twin, found.null, unnamed,
                       lambda there: tolerance_responses(there.twin, there, found.settings))
        terms = law_terms_of(law, points) if law is not None else ()
        if law is None or not terms:
            return None
        candidate = _with_law(here, free, terms)
        places = frozenset(term.point for term in law_terms(terms))
        told = candidate.model.relations(here.points, here.points.states(), candidate.start).quantities
        wrong = unbelievable(places, here.points, {name: value[0] for name, value in told.items()})
        if not wrong:
            break
        refused |= wrong
    with_it = foretold(candidate, free)
    return (law, terms, candidate, with_it) if with_it.better_than(best) else None


def _with_law(here: Calibration, free: list[Coefficient], terms: tuple[OneTerm, ...]) -> Calibration:
    """All coefficients again, with a law among the terms."""
    engine = here.model.engine
    model = replace(here.model, engine=engine.replace(terms=(*engine.terms, *terms)), added=len(terms))
    own = term_values(terms)
    start = {name: here.start.get(name, 0.0) + value for name, value in own.items()}
    return _refitted(replace(here, model=model), free, start)
