"""What a rig's file leaves out, round by round: the search of recordings, a refit, and runs that no fit has seen.

Every round runs `discovery.search.run` about the present machine. What it names (or, where no name fits, the law that
it finds) enters the machine, all parameters are fitted again together with the sizes, and free runs over the last part
of the recording judge whether that foretells them no worse; then the search looks at what is left.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from dieseltwin.discovery.laws.search import Law
from dieseltwin.discovery.laws.sensor import best_law
from dieseltwin.discovery.likelihood.fit import Fit, Linearisation, first_fit, fit_fully
from dieseltwin.discovery.search import run as search
from dieseltwin.discovery.search.preparation import recentred
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.interface import Array
from dieseltwin.errors import InputError
from dieseltwin.rigs.parameters import LawFactor, RigLaw, RigParameters, RigTerm
from dieseltwin.rigs.recording import RigRecording
from dieseltwin.rigs.simulate import first_states, run_error
from dieseltwin.rigs.twin import RigTwin
from dieseltwin.settings.params import default_search
from dieseltwin.settings.search import RigSettings

_ROUNDS = 20  # of a fit
_PASSES = 4  # of a round: the misfit of an explanation says how large gains are, until the explanation stays


@dataclass(frozen=True)
class Options:
    """What a user may choose.

    Attributes:
        withhold: effects to keep out of the catalogue.
        seed: of everything random.
        law_search: look for a law where no name fits.
        search: what is decided by.
    """

    withhold: tuple[str, ...] = ()
    seed: int = 0
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
            first part, (C,) [units of the readings].
        taken: whether they are good enough.
        early: the machine of `after`; None where it runs away, and where there was nothing to try.
    """

    found: Search
    names: tuple[str, ...]
    law: Law | None
    before: Array
    after: Array
    taken: bool
    early: RigParameters | None = None


@dataclass(frozen=True)
class RigDiscovery:
    """What a rig's file leaves out.

    Attributes:
        recording, options: as asked.
        before, repaired: the machine fitted to the recording, without and with what was found.
        fit_before, fit_after: of their windows.
        rounds: of the search; the last one took nothing, or most were named.
        seconds: wall time.
        early: the machine without what was found, fitted to the first part; None where it runs away.
    """

    recording: RigRecording
    options: Options
    before: RigParameters
    repaired: RigParameters
    fit_before: Linearisation
    fit_after: Linearisation
    rounds: tuple[Round, ...]
    seconds: float
    early: RigParameters | None = None

    @property
    def taken(self) -> tuple[Round, ...]:
        """Rounds whose finding is part of the repaired machine."""
        return tuple(item for item in self.rounds if item.taken)

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
    try:
        here, fit = before, fit_before = fitted(rig, recording)
    except np.linalg.LinAlgError:
        raise InputError(recording.path, f"no fit of {rig.name} that stays finite", "a recording of this machine",
                         "check the columns' units, or shorten the file's window_s") from None
    errors, early = _foretold(here, recording, settings.checked_share)
    rounds: list[Round] = []
    while len(rounds) < settings.most_effects and _left(here, options):
        found = _searched(here, fit.residual, recording, options)
        names = _named(found, settings.least_explained)
        law = None
        if not names and found.kind != "healthy" and options.law_search:
            law = _law(found)
        if not names and law is None:
            rounds.append(Round(found, (), None, np.zeros(0), np.zeros(0), False))
            break
        candidate = _with(here, found, names, law)
        bar = settings.gain_of_law if law is not None else settings.loss_of_name
        later, by = _foretold(candidate, recording, settings.checked_share)
        taken = bool(np.isfinite(later).all() and np.mean(later / errors) <= bar)
        rounds.append(Round(found, names, law, errors, later, taken, by))
        if not taken:
            break
        (here, fit), errors = fitted(candidate, recording), later
    seconds = time.perf_counter() - began
    return RigDiscovery(recording, options, before, here, fit_before, fit, tuple(rounds), seconds, early)


def _left(rig: RigParameters, options: Options) -> set[str]:
    """Names that a search can still give."""
    return set(rig.effects) - {term.effect for term in rig.terms} - set(options.withhold)


def _fit(rig: RigParameters, recording: RigRecording) -> Linearisation:
    """Parameters, sizes of terms and first states, in the metric of the misfit that they leave."""
    twin = RigTwin(rig, recording, rig.window_s)
    start = first_fit(twin)
    start = replace(start, local=first_states(twin, start.parameters))
    rough = fit_fully(twin, twin.whitening(), start, rounds=_ROUNDS)
    twin = twin.about(rough.residual)
    return fit_fully(twin, twin.whitening(), rough.fit, rounds=_ROUNDS)


def fitted(rig: RigParameters, recording: RigRecording) -> tuple[RigParameters, Linearisation]:
    """The rig with its parameters and the sizes of its terms fitted to a recording, and the fit.

    Standard deviations are those in the size of the misfit that is left.
    """
    at = _fit(rig, recording)
    fit = at.fit
    values = dict(zip(rig.parameters, zip(fit.parameters, fit.std, strict=True), strict=False))
    sizes = fit.parameters[len(rig.parameters) :], fit.std[len(rig.parameters) :]
    parameters = {name: p.model_copy(update={"value": float(values[name][0]), "std": float(values[name][1])})
                  for name, p in rig.parameters.items()}
    terms = tuple(RigTerm(effect=t.effect, magnitude=float(np.clip(m, *rig.effects[t.effect].limits)), std=float(s))
                  for t, m, s in zip(rig.terms, *sizes, strict=True))
    return rig.model_copy(update={"parameters": parameters, "terms": terms}), at


def _searched(rig: RigParameters, left: Array, recording: RigRecording, options: Options) -> Search:
    """The search, with gains counted in the misfit that its own explanation leaves."""
    settings = options.search.asked(options.withhold, options.seed)
    twin = RigTwin(rig, recording, rig.window_s).about(left)
    lead: tuple[str, ...] = ()
    for _ in range(_PASSES):
        found = search.run(twin, settings, laws=False)
        best = found.best.fit if found.best is not None else found.singles[0] if found.singles else None
        if best is None or best.candidate.names == lead or (found.kind == "healthy" and lead):
            break
        lead = best.candidate.names
        explained = fit_fully(found.twin, found.whitening, best, rounds=_ROUNDS)
        twin = RigTwin(rig, recording, rig.window_s).about(explained.residual)
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


def _named(found: Search, least_explained: float) -> tuple[str, ...]:
    """What a round takes: the search's choice, or the strongest name where what it leaves is the next round's."""
    if found.kind == "healthy":
        return ()
    if found.best is not None and found.kind in ("single", "pair"):
        return found.best.fit.candidate.names
    if not found.singles:
        return ()
    lead = found.singles[0]
    strong = found.gain(lead) > max(found.settings.left_gain[0], least_explained * found.null.fit.objective)
    return lead.candidate.names if strong and found.of_interest(lead) else ()


def _law(found: Search) -> Law | None:
    law = best_law(found.twin, found.null, found.everything_unnamed())
    sites = set() if law is None else {law.site, *(rival.site for rival in law.rivals)}
    if law is None or law.faults or len(sites) > 1 or any(p.form.operator for p in law.placed):
        return None  # laws at several sites have no meaning beyond what they were fitted to; a file holds no operators
    return law


def _with(rig: RigParameters, found: Search, names: tuple[str, ...], law: Law | None) -> RigParameters:
    """The machine with what a round found, parameters as the search left them."""
    if law is not None:
        more = tuple(_written(placed.form.point, placed.coefficient, placed.form.factors, law.text)
                     for placed in law.placed)
        return rig.model_copy(update={"laws": (*rig.laws, *more)})
    at = found.best.fit if found.best is not None and found.best.fit.candidate.names == names else found.singles[0]
    sizes: Mapping[str, float] = dict(zip(at.candidate.names, map(float, at.magnitudes), strict=True))
    parameters = {name: p.model_copy(update={"value": float(value)})
                  for (name, p), value in zip(rig.parameters.items(), at.parameters, strict=False)}
    terms = (*rig.terms, *(RigTerm(effect=name, magnitude=sizes[name]) for name in names))
    return rig.model_copy(update={"parameters": parameters, "terms": terms})


def _written(point: str, coefficient: float, factors: tuple, text: str) -> RigLaw:  # type: ignore[type-arg]
    plain = tuple(LawFactor(kind=f.kind, variables=f.variables, references=f.references, shape=float(f.shape),
                            units=f.units) for f in factors)  # fmt: skip
    return RigLaw(at=point, coefficient=float(coefficient), factors=plain, text=text)


def checked_rows(recording: RigRecording, share: float) -> slice:
    """The last share of a recording, which judges what was found."""
    return slice(round((1.0 - share) * len(recording.time_s)), None)


def _foretold(rig: RigParameters, recording: RigRecording, share: float) -> tuple[Array, RigParameters | None]:
    """Errors of free runs over the last share of the recording, fitted to what comes before, and the machine so
    fitted; (C,), infinite where it runs away."""
    last = checked_rows(recording, share)
    try:
        early, _ = fitted(rig, recording.part(slice(0, last.start)))
        return run_error(early, recording.part(last)), early
    except np.linalg.LinAlgError:
        return np.full(len(rig.readings), np.inf), None
