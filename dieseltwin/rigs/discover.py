"""What a rig's file leaves out, round by round: the search of recordings, a refit, and runs that no fit has seen.

Every round runs `discovery.search.run` about the present machine. What it names (or, where no name fits, the law that
it finds) enters the machine, all parameters are fitted again together with the sizes, and free runs over the last part
of the recording judge whether that foretells them no worse; then the search looks at what is left.

Where an effect that begins in the middle explains more, the first round is of what began then, and that course of
rounds stands if it leaves clearly less than one without an onset. So does one whose first round is a law of what began
then, where all that has a name leaves more than noise.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np

from dieseltwin.discovery.laws.search import Law
from dieseltwin.discovery.laws.sensor import best_law
from dieseltwin.discovery.likelihood.fit import Fit, Linearisation, fit_fully
from dieseltwin.discovery.options import SearchOptions
from dieseltwin.discovery.search import run as search
from dieseltwin.discovery.search.preparation import recentred
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.interface import Array
from dieseltwin.errors import InputError
from dieseltwin.rigs.fitting import (
    ROUNDS,
    checked_rows,
    fitted,
    fitted_otherwise,
    fitted_surely,
    foretold,
    rms_left,
    times_noise,
)
from dieseltwin.rigs.later_laws import later_law, writable
from dieseltwin.rigs.onsets import dated, first_course
from dieseltwin.rigs.parameters import RigParameters, RigTerm
from dieseltwin.rigs.recording import RigRecording
from dieseltwin.rigs.repaired import explanation, machine_with
from dieseltwin.rigs.twin import RigTwin, When
from dieseltwin.settings.defaults import default_search
from dieseltwin.settings.search import RigSettings

_PASSES = 4  # of a round: the misfit of an explanation says how large gains are, until the explanation stays
LOUD = 3.0
"""Times the noise, by which a repaired machine may miss a reading without a word."""
_FAR_BEHIND = 4.0  # what leaves so many times the squared misfit of another explanation isn't gone after
_DATINGS = 3  # of what a round names: with its own onset other names may be ahead


@dataclass(frozen=True, kw_only=True)
class Options(SearchOptions):
    """What a user may choose.

    Attributes:
        law_search: look for a law where no name fits.
    """

    law_search: bool = True
    search: RigSettings = field(default_factory=lambda: default_search().rigs)


@dataclass(frozen=True)
class Round:
    """One round of the search.

    Attributes:
        found: the search.
        names: what it would add.
        law: or the law.
        before, after: rms error of free runs over the last part of the recording, by machines that were fitted to the
            first part, (C,) [units of the readings]; NaN for a reading that is absent there.
        taken: whether they are good enough.
        early: the machine of `after`; None where it runs away, and where there was nothing to try.
        when: it is so [time stamps, s]; None: from the first row on.
    """

    found: Search
    names: tuple[str, ...]
    law: Law | None
    before: Array
    after: Array
    taken: bool
    early: RigParameters | None = None
    when: When | None = None


@dataclass(frozen=True)
class _Course:
    """Rounds one after another: the machine that they lead to, its fit, and that of before fitted to the first part."""

    rounds: tuple[Round, ...]
    machine: RigParameters
    fit: Linearisation
    early: RigParameters | None = None

    @property
    def finds(self) -> bool:
        """Whether anything was taken."""
        return any(item.taken for item in self.rounds)

    @property
    def is_loud(self) -> bool:
        """Whether a reading is missed by more than noise, in the fit or in free runs that none has seen."""
        left = [rms_left(self.fit), *(item.after for item in self.rounds if item.taken)][::-1][:2]
        return any((times_noise(self.fit, errors) > LOUD).any() for errors in left)

    @property
    def silent(self) -> bool:
        """Whether nothing is missing."""
        return not self.finds and self.rounds[-1].found.kind == "healthy"


@dataclass(frozen=True)
class RigDiscovery:
    """What a rig's file leaves out.

    Attributes:
        recording, options: as asked.
        before, repaired: the machine fitted to the recording, without and with what was found.
        fit_before, fit_after: of their windows.
        fit_otherwise: as `fit_before`, with the inputs taken the other way between rows; None where that runs away.
        rounds: of the search; the last one took nothing, or most were named.
        seconds: wall time.
        early: the machine without what was found, fitted to the first part; None where it runs away, and where there
            was nothing to try.
    """

    recording: RigRecording
    options: Options
    before: RigParameters
    repaired: RigParameters
    fit_before: Linearisation
    fit_after: Linearisation
    fit_otherwise: Linearisation | None
    rounds: tuple[Round, ...]
    seconds: float
    early: RigParameters | None = None

    @property
    def taken(self) -> tuple[Round, ...]:
        """Rounds whose finding is part of the repaired machine."""
        return tuple(item for item in self.rounds if item.taken)

    @property
    def when(self) -> When | None:
        """When the first finding is so [time stamps, s]; None: from the first row on, and where there is none."""
        return self.rounds[0].when if self.taken else None

    @property
    def begun(self) -> tuple[str, ...]:
        """Names of what is so then only; none where all is so from the first row on."""
        return () if self.when is None else self.rounds[0].names

    @property
    def checked(self) -> slice:
        """The rows that judged what was found."""
        return checked_rows(self.recording, self.options.search.checked_share, _onset(self.when))

    @property
    def more_is_missing(self) -> bool:
        """Whether the last round saw something that has no name and no law that foretells."""
        last = self.rounds[-1]
        return not last.taken and last.found.kind != "healthy"


def discover_rig(recording: RigRecording, rig: RigParameters, options: Options | None = None) -> RigDiscovery:
    """Name one after another what a rig's file leaves out, and a law for the rest.

    Raises:
        InputError: no fit of the rig stays finite on this recording; no effect in its file, or all of them withheld.
    """
    options, began = options or Options(), time.perf_counter()
    settings = options.search
    if not _left(rig, options):
        raise InputError(f"{rig.name}: effects", "none to look for", "one or more that may be missing",
                         "name them in the file, or withhold fewer")  # fmt: skip
    before, fit = fitted_surely(rig, recording)
    found, midway = _searched(before, fit.residual, recording, options), first_course(fit, settings, options.withhold)
    course = _best_course(before, fit, recording, options, found, midway)
    otherwise = fitted_otherwise(before, recording)
    seconds = time.perf_counter() - began
    return RigDiscovery(recording, options, before, course.machine, fit, course.fit, otherwise, course.rounds, seconds,
                        course.early)  # fmt: skip


def _best_course(
    before: RigParameters, fit: Linearisation, recording: RigRecording, options: Options, found: Search,
    midway: Linearisation | None,
) -> _Course:  # fmt: skip
    """The course of rounds with an onset where it leaves clearly less, else the one without; with a law of what begins
    in the middle where names leave more than noise, and it clearly less.

    Args:
        before, fit: the machine without what is missing, and its fit.
        recording, options: as asked.
        found: the first search of what is so from the first row on.
        midway: what explains most where it begins in the middle.
    """
    course = _course_of_names(before, fit, recording, options, found, midway)
    if not options.law_search or not course.is_loud:
        return course
    law = later_law(fit, options.search, _FAR_BEHIND * _left_by(course.fit, fit) / _left_by(fit, fit))
    if law is None or law.since_s is None:
        return course
    with suppress(np.linalg.LinAlgError):  # it runs away with the law
        begun = _course(before, fit, recording, options, found, When(law.since_s), law)
        if begun.finds and _ahead(begun.fit, course, begun.fit, options.search):
            return begun
    return course


def _course_of_names(
    before: RigParameters, fit: Linearisation, recording: RigRecording, options: Options, found: Search,
    midway: Linearisation | None,
) -> _Course:  # fmt: skip
    """As `_best_course`, without laws of what begins in the middle."""
    settings = options.search

    def begun(midway: Linearisation) -> _Course | None:
        """The course with an onset; None where it finds nothing, or runs away with it."""
        try:
            course = _course(before, fit, recording, options, *_then(midway, options))
        except np.linalg.LinAlgError:
            return None
        return course if course.finds else None

    if midway is not None and _left_by(_explained(found), midway) > _FAR_BEHIND * _left_by(midway, midway):
        dated_course = begun(midway)
        if dated_course is not None:
            return dated_course
        midway = None
    course = _course(before, fit, recording, options, found)
    if midway is not None and _ahead(midway, course, midway, settings):
        dated_course = begun(midway)
        if dated_course is not None and _ahead(dated_course.fit, course, dated_course.fit, settings):
            return dated_course
    return course


def _explained(found: Search) -> Linearisation:
    """What the strongest explanation of a search leaves."""
    best = found.best.fit if found.best is not None else found.singles[0] if found.singles else found.null.fit
    return fit_fully(found.twin, found.whitening, best, rounds=ROUNDS)


def _left_by(fit: Linearisation, measure: Linearisation) -> float:
    """Sum of squares of a fit's residual in the size of what another one leaves."""
    size = cast(RigTwin, measure.twin).about(measure.residual).misfit
    return float(np.nansum((fit.residual / size) ** 2))


def _ahead(fit: Linearisation, course: _Course, measure: Linearisation, settings: RigSettings) -> bool:
    """Whether a fit leaves clearly less than a course of rounds without an onset."""
    its = _left_by(course.fit, measure)
    gained = its - _left_by(fit, measure)
    if course.silent:
        return gained > settings.hidden_gain
    # What is missing in a machine from its first row on takes any shape in time: little is better everywhere.
    return gained > max(settings.variant_gain, settings.least_explained * its)


def _course(
    here: RigParameters, fit: Linearisation, recording: RigRecording, options: Options, found: Search,
    when: When | None = None, first: Law | None = None,
) -> _Course:  # fmt: skip
    """Rounds until nothing is left that a search can tell, after a first search of what is so at a time, or a law."""
    settings, early = options.search, None
    rounds: list[Round] = []
    none = np.zeros(0)
    errors, checked = none, checked_rows(recording, settings.checked_share, _onset(when))
    while len(rounds) < settings.most_effects and _left(here, options):
        then = when if not rounds else None
        if rounds:
            found = _searched(here, fit.residual, recording, options)
        law = None if rounds else first
        names = () if law is not None else found.names_for_round(found.null.fit.objective, settings.least_explained)
        if law is None and not names and found.kind != "healthy" and options.law_search and then is None:
            law = _law(found)
        if not names and law is None:
            rounds.append(Round(found, (), None, none, none, False))
            break
        if not rounds:
            errors, early = foretold(here, recording, checked)
        candidate = machine_with(here, found, names, law, then)
        bar = settings.gain_of_law if law is not None else settings.loss_of_name
        later, by = foretold(candidate, recording, checked)
        taken = _foretells(later, errors, bar)
        repaired, refit = fitted(candidate, recording) if taken else (here, fit)
        sure = all(_sure(term, settings) for term in repaired.terms if term.effect in names)
        if not sure and (rounds or not _foretells(later, errors, settings.gain_of_law)):
            if not rounds:
                rounds.append(Round(replace(found, kind="healthy", best=None), (), None, none, none, False))
            break  # what is left is nothing that has a size
        rounds.append(Round(found, names, law, errors, later, taken, by, then))
        if not taken:
            break
        here, fit, errors = repaired, refit, later
    return _Course(tuple(rounds), here, fit, early)


def _foretells(later: Array, errors: Array, bar: float) -> bool:
    """Whether errors of free runs (C,) are at most `bar` times those before; NaN is an absent reading."""
    there = ~np.isnan(errors)
    return bool(there.any() and np.isfinite(later[there]).all() and np.mean(later[there] / errors[there]) <= bar)


def _sure(term: RigTerm, settings: RigSettings) -> bool:
    """Whether a further effect's size is away from nought, with all that is believed only."""
    return term.std is None or abs(term.magnitude) > settings.second_size_std * term.std


def _onset(when: When | None) -> float | None:
    return None if when is None else when.onset_s


def _then(midway: Linearisation, options: Options) -> tuple[Search, When]:
    """The search of what acts when an effect does, and that time, moved until it is that of what is named."""
    settings, twin = options.search, cast(RigTwin, midway.twin).about(midway.residual)
    near = [midway.fit]
    for _ in range(_DATINGS):
        found = _passes(twin, options, near)
        names = found.names_for_round(found.null.fit.objective, settings.least_explained)
        if not names:
            break
        moved = dated(cast(RigTwin, found.twin), found.whitening, explanation(found, names), settings)
        if cast(RigTwin, moved.twin).when == twin.when:
            break
        twin = cast(RigTwin, moved.twin).about(moved.residual)
        near.append(moved.fit)
    return found, cast(When, cast(RigTwin, found.twin).when)


def _left(rig: RigParameters, options: Options) -> set[str]:
    """Names that a search can still give."""
    return set(rig.effects) - {term.effect for term in rig.terms} - set(options.withhold)


def _searched(rig: RigParameters, left: Array, recording: RigRecording, options: Options) -> Search:
    """The search about a rig whose fit leaves a residual (n, C)."""
    return _passes(RigTwin(rig, recording, rig.window_s).about(left), options)


def _passes(twin: RigTwin, options: Options, starts: Sequence[Fit] = ()) -> Search:
    """The search, with gains counted in the misfit that its own explanation leaves; `starts`: as of `search.run`."""
    settings = options.settings()
    lead: tuple[str, ...] = ()
    for _ in range(_PASSES):
        found = search.run(twin, settings, laws=False, starts=starts)
        best = found.best.fit if found.best is not None else found.singles[0] if found.singles else None
        if best is None or best.candidate.names == lead or (found.kind == "healthy" and lead):
            break
        lead = best.candidate.names
        explained = fit_fully(found.twin, found.whitening, best, rounds=ROUNDS)
        twin = twin.about(explained.residual)
    _strongest_first(found)
    return found


def _strongest_first(found: Search) -> None:
    """Of pairs that can't be told apart those that hold the strongest single name, where any does; the smallest first.

    A sum of effects can be written in several ways (dry friction and a constant force are two one-sided forces): said
    is what explains most by itself, with sizes that add up to the fewest tolerances.
    """
    if found.kind != "pair" or found.best is None:
        return
    lead = found.singles[0].candidate.names[0]
    kept = [names for names in found.equivalent if lead in names]
    if not kept:
        return
    found.equivalent = kept
    weights = {key: p for key, p in found.probabilities.items() if lead in key.split(" + ")}
    found.probabilities = {key: p / sum(weights.values()) for key, p in weights.items()}
    fits = [fit for fit in found.pairs if fit.candidate.names in kept]
    least = min(fits, key=lambda fit: _tolerances(found, fit))
    if least.candidate.names != found.best.fit.candidate.names:
        found.best = recentred(found, least)


def _tolerances(found: Search, fit: Fit) -> float:
    names = fit.candidate.names
    return sum(abs(m) / found.twin.hypotheses[n].tolerance for n, m in zip(names, fit.magnitudes, strict=True))


def _law(found: Search) -> Law | None:
    return writable(best_law(found.twin, found.null, found.everything_unnamed()))
