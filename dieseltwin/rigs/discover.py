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
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, cast

import numpy as np

from dieseltwin.discovery.laws.search import Law
from dieseltwin.discovery.laws.sensor import best_law
from dieseltwin.discovery.laws.twin import Placed
from dieseltwin.discovery.likelihood.fit import Fit, Linearisation, fit_fully
from dieseltwin.discovery.search import run as search
from dieseltwin.discovery.search.preparation import recentred
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.interface import Array
from dieseltwin.errors import InputError
from dieseltwin.rigs.fitting import ROUNDS, checked_rows, fitted, fitted_otherwise, fitted_surely, foretold
from dieseltwin.rigs.later_laws import later_law, writable
from dieseltwin.rigs.onsets import dated, first_course
from dieseltwin.rigs.parameters import LawFactor, RigLaw, RigParameters, RigTerm
from dieseltwin.rigs.recording import RigRecording
from dieseltwin.rigs.rounds import Course, Options, RigDiscovery, Round, onset_of
from dieseltwin.rigs.twin import RigTwin, When
from dieseltwin.settings.search import RigSettings

_PASSES = 4  # of a round: the misfit of an explanation says how large gains are, until the explanation stays
_FAR_BEHIND = 4.0  # what leaves so many times the squared misfit of another explanation isn't gone after
_DATINGS = 3  # of what a round names: with its own onset other names may be ahead


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
) -> Course:  # fmt: skip
    """The course of rounds with an onset where it leaves clearly less, else the one without; the one with a law of what
    begins in the middle where that one leaves more than noise, and this one clearly less.

    Args:
        before, fit: the machine without what is missing, and its fit.
        recording, options: as asked.
        found: the first search of what is so from the first row on.
        midway: what explains most where it begins in the middle.
    """
    course = _course_without_later_laws(before, fit, recording, options, found, midway)
    if not options.law_search or not course.is_loud:
        return course
    law = later_law(fit, options.search, _FAR_BEHIND * _left_by(course.fit, fit) / _left_by(fit, fit))
    if law is None or law.since_s is None:
        return course
    with suppress(np.linalg.LinAlgError):  # it runs away with the law
        begun = _course(before, fit, recording, options, found, When(law.since_s), law)
        if begun.finds and _ahead(begun.fit, course, begun.fit, options.search):
            return _beside_law(begun, law, before, recording, options)
    return course


def _beside_law(
    course: Course, law: Law, before: RigParameters, recording: RigRecording, options: Options
) -> Course:
    """A course whose first round is a law of what begins in the middle, with the search that says what else could have
    been seen then: in the size of the misfit that the course leaves."""
    first = course.rounds[0]
    twin = RigTwin(before, recording, before.window_s).about(course.fit.residual).acting(cast(When, first.when))
    with suppress(np.linalg.LinAlgError):  # an effect that the machine runs away with: the search of before stays
        found = search.run(twin, options.settings(), laws=False)
        found.kind, found.best, found.law = "law", None, law
        return replace(course, rounds=(replace(first, found=found), *course.rounds[1:]))
    return course


def _course_without_later_laws(
    before: RigParameters, fit: Linearisation, recording: RigRecording, options: Options, found: Search,
    midway: Linearisation | None,
) -> Course:  # fmt: skip
    """As `_best_course`, without a law of what begins in the middle."""
    settings = options.search

    def begun(midway: Linearisation) -> Course | None:
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


def _ahead(fit: Linearisation, course: Course, measure: Linearisation, settings: RigSettings) -> bool:
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
) -> Course:  # fmt: skip
    """Rounds until nothing is left that a search can tell, after a first search of what is so at a time, or a law."""
    settings, early = options.search, None
    rounds: list[Round] = []
    none = np.zeros(0)
    errors, checked = none, checked_rows(recording, settings.checked_share, onset_of(when))
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
        candidate = _machine_with(here, found, names, law, then)
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
    return Course(tuple(rounds), here, fit, early)


def _foretells(later: Array, errors: Array, bar: float) -> bool:
    """Whether errors of free runs (C,) are at most `bar` times those before; NaN is an absent reading."""
    there = ~np.isnan(errors)
    return bool(there.any() and np.isfinite(later[there]).all() and np.mean(later[there] / errors[there]) <= bar)


def _sure(term: RigTerm, settings: RigSettings) -> bool:
    """Whether a further effect's size is away from nought, with all that is believed only."""
    return term.std is None or abs(term.magnitude) > settings.second_size_std * term.std


def _then(midway: Linearisation, options: Options) -> tuple[Search, When]:
    """The search of what acts when an effect does, and that time, moved until it is that of what is named."""
    settings, twin = options.search, cast(RigTwin, midway.twin).about(midway.residual)
    near = [midway.fit]
    for _ in range(_DATINGS):
        found = _passes(twin, options, near)
        names = found.names_for_round(found.null.fit.objective, settings.least_explained)
        if not names:
            break
        moved = dated(cast(RigTwin, found.twin), found.whitening, _explanation(found, names), settings)
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


def _machine_with(
    rig: RigParameters, found: Search, names: tuple[str, ...], law: Law | None, then: When | None = None
) -> RigParameters:
    """The machine with what a round found, parameters as the search left them."""
    recording = cast(RigTwin, found.twin).recording
    if law is not None:
        more = tuple(_written(placed, law.text, recording.sha256) for placed in law.placed)
        return rig.model_copy(update={"laws": (*rig.laws, *more)})
    at = _explanation(found, names)
    sizes: Mapping[str, float] = dict(zip(at.candidate.names, map(float, at.magnitudes), strict=True))
    parameters = {name: p.model_copy(update={"value": float(value)})
                  for (name, p), value in zip(rig.parameters.items(), at.parameters, strict=False)}
    when: dict[str, Any] = {} if then is None else {**vars(then), "found_in": recording.sha256}
    terms = (*rig.terms, *(RigTerm(effect=name, magnitude=sizes[name], **when) for name in names))
    return rig.model_copy(update={"parameters": parameters, "terms": terms})


def _explanation(found: Search, names: tuple[str, ...]) -> Fit:
    """The fit of what a round takes."""
    return found.best.fit if found.best is not None and found.best.fit.candidate.names == names else found.singles[0]


def _written(placed: Placed, text: str, sha256: str) -> RigLaw:
    form = placed.form
    factors = tuple(LawFactor(kind=f.kind, variables=f.variables, references=f.references, shape=float(f.shape),
                              units=f.units) for f in form.factors)  # fmt: skip
    begun = {} if form.since_s is None else {"onset_s": form.since_s, "found_in": sha256}
    return RigLaw(at=form.point, coefficient=float(placed.coefficient), factors=factors, text=text, **begun)
