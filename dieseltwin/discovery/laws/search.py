"""None of these -> a law: which term at which point, of what variables, explains what the twin left out.

One linearisation gives the response to any signal at any point. Forms of the grammar are ranked by it with an extended
BIC (a form pays for its coefficient and for the number of forms it was picked from), the best are refitted by
simulation together with the twin's parameters and initial states, the linearisation is renewed with the best law
inside, and the ranking done again, as a large effect moves the trajectory that the laws are evaluated along.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from dieseltwin.discovery.laws.curve import Curve, law_curve
from dieseltwin.discovery.laws.features import Structure
from dieseltwin.discovery.laws.final_fit import Tolerances, about_itself, signals_of
from dieseltwin.discovery.laws.grammar import Form
from dieseltwin.discovery.laws.ranking import Ranked, rank, shortlist, simpler
from dieseltwin.discovery.laws.reading_twin import ReadingFault, ReadingTwin
from dieseltwin.discovery.laws.refit import Refit, disagreement, refit_all_laws, spread_over_forms, start_of
from dieseltwin.discovery.laws.responses import Responses
from dieseltwin.discovery.laws.twin import LawTwin, Placed, point_index
from dieseltwin.discovery.likelihood.fit import Candidate, Fit, Linearisation, fit_fully
from dieseltwin.discovery.twins.interface import Array, Twin, WithSignals
from dieseltwin.discovery.twins.onset_times import onset_reaches, times_about

RIVALS = 9.0  # 2 delta log-likelihood within which two laws can't be told apart (docs/discovery.md)
_ALIKE_SHARE = 0.005  # of the gain: what maps that are off a little can add to a form that follows them
_SIMPLER_SHARE = 0.0075  # of the gain: what maps that are off a little add to each further factor or term of a form
_EVEN = 0.5  # of -2 log likelihood, what refits of one law end apart
_FINAL_ROUNDS = 8
_OF_SUMS = 3  # of the best, whose terms are refitted alone
_REFITS = 16  # after each ranking
_RENEWALS = 1  # linearisations with the best law inside
_AMOUNTS = (0.02, 0.05)  # of a quantity's typical size, from which refits of a change by an amount begin, too
RESOLVED = 6.0  # score that a law, or a fault of a sensor, must reach over no law
_LEADING = 0.5  # of the best score: points whose laws reach it are ranked again with the best law inside


@dataclass(frozen=True)
class Rival:
    """A law that the recording can't tell from the one reported: site, score below the best."""

    site: str
    behind: float


@dataclass(frozen=True)
class Law:
    """A law found.

    Attributes:
        site: where it enters.
        text: with coefficient and units.
        std, unit: of the first term's coefficient [unit of the point]; the deviation holds what other forms that
            explain as much say of the size.
        argument: the variable over which `curve` shows it.
        curve: the law and, free of it, what the recording says bin by bin.
        gain: decrease of -2 log likelihood against no law.
        score: gain less what the extended BIC charges.
        rivals: laws within 9 units.
        disagreement: (P,) standard deviation of the twin's parameters over other laws that may be the true one [unit].
        parameters: (P,) of the twin, refitted with the law.
        local: (W, S) initial states.
        placed: all its terms (one or two) with their estimates, for `LawTwin`.
        faults: of sensors, where the law is one of a reading; `placed` is empty then.
    """

    site: str
    text: str
    std: float
    unit: str
    argument: str
    curve: Curve | None
    gain: float
    score: float
    rivals: tuple[Rival, ...]
    parameters: Array
    local: Array
    placed: tuple[Placed, ...]
    faults: tuple[ReadingFault, ...] = ()
    disagreement: Array | None = None

    @property
    def since_s(self) -> float | None:
        """From when on it acts, in the time of the twin [s]; None: always."""
        return self.faults[0].since_s if self.faults else self.placed[0].form.since_s

    def since(self, time_s: float) -> Law:
        """The same law from another time on [s]."""
        placed = (replace(term, form=replace(term.form, since_s=time_s)) for term in self.placed)
        return replace(self, placed=tuple(placed), faults=tuple(replace(one, since_s=time_s) for one in self.faults))

    def on(self, twin: Twin) -> tuple[Twin, Fit]:
        """The twin with the law inside, and the fit of its parameters with the law's."""
        if self.faults:
            other, extra = cast(Twin, ReadingTwin(twin, self.faults)), [fault.size for fault in self.faults]
        else:
            other = cast(Twin, LawTwin(twin, self.placed))
            extra = [p.value for p in other.parameters[len(twin.parameters) :]]
        values = np.append(self.parameters, extra)
        return other, Fit(Candidate(), values, np.zeros(0), self.local, np.inf, True)


class LawSearch:
    """The search for a law from the grammar. What was refitted for some points needn't be for more.

    Args:
        twin: without the law; may hold effects already named (`at.fit`).
        at: converged linearisation of that twin, with its tolerance directions.
        tolerances: directions about the law found, for its last fit; None keeps those of `at`.
        since_s: from when on the law acts, nearly; the best one's onset is moved until it fits best. None: always.
        structure: scored features, of which changes by an amount are candidates: between the knots at which laws are
            ranked such a change swings as widely as the quantity, and looks like next to nothing there.
    """

    def __init__(
        self, twin: Twin, at: Linearisation, tolerances: Tolerances | None = None, since_s: float | None = None,
        structure: Sequence[Structure] = (),
    ) -> None:  # fmt: skip
        self.twin, self.at, self.tolerances, self.since_s = twin, at, tolerances, since_s
        self.structure = structure
        lanes = at.fit.lanes()
        self.responses, self.variables = Responses(at, lanes), {**twin.variables(lanes), "time_s": twin.time_s}
        self.refits: list[Refit] = []
        self._renewals: dict[tuple[object, ...], tuple[list[Ranked], Linearisation, dict[str, Array]]] = {}

    def best(self, screened: Sequence[str] | None = None) -> Refit | None:
        """The best law, refitted; None where none is resolved.

        Args:
            screened: names of the points where a term without a name explains enough for a law to (`near_the_best`);
                None for all.
        """
        here, variables = self.at, self.variables
        ranked = rank(self.twin, self.responses, variables, screened=screened, since_s=self.since_s)
        self._amounts(screened)
        self._refit(here, shortlist(ranked, _REFITS), variables)
        for _ in range(_RENEWALS):
            if not self.refits or self.refits[0].score <= 0.0:
                break
            ranked, here, variables = self._renewed()
            self._refit(here, shortlist(ranked, _REFITS), variables)
        simple = _single_terms(self.refits)
        if self.refits:
            simple += simpler(ranked, self.refits[0].ranked)
        self._refit(here, simple, variables)
        if not self.refits or self.refits[0].score <= RESOLVED:
            return None
        if self.since_s is not None:
            self._date(here, variables)
        return _simplest_first(self.refits)[0]

    def law(self) -> Law:
        """The best of the laws refitted, reported; there must be one."""
        return _report(self.twin, self.at, _simplest_first(self.refits), self.tolerances)

    def _amounts(self, screened: Sequence[str] | None) -> None:
        """Refit the changes by an amount among the features, each from several sizes: where nothing is left of the
        quantity they bend (no fuel less than none in overrun), and a fit that starts small stays there."""
        charge = float(np.log(self.at.whitening.present.sum()) + 2.0 * np.log(2.0 * len(self.twin.points)))
        known = {refit.ranked.key for refit in self.refits}
        for item in self.structure:
            feature, form = item.feature, item.feature.form
            if form is None or not form.amount or (screened is not None and form.point not in screened):
                continue
            at_one = float(np.sqrt(np.mean(np.square(form.value(self.variables)))))
            typical = float(np.sqrt(np.mean(np.square(self.variables[form.point]))))
            form, first = replace(form, since_s=self.since_s), item.coefficient / at_one or 1e-12
            items = [Ranked(cast(int, feature.point), feature.site, (Placed(form, size),), item.gain, charge)
                     for size in (first, *(float(np.sign(first)) * share * typical for share in _AMOUNTS))]
            if items[0].key not in known:
                self.refits.append(max(map(self._whole, items), key=lambda refit: refit.gain))
        self.refits.sort(key=lambda refit: -refit.score)

    def _whole(self, item: Ranked) -> Refit:
        """A refit by full steps."""
        try:
            law, reached = _final(self.twin, self.at, item.placed, start_of(self.at, LawTwin(self.twin, item.placed)))
        except np.linalg.LinAlgError:
            return Refit(item, LawTwin(self.twin, item.placed), self.at.fit, -np.inf)
        return Refit(item, law, reached.fit, self.at.fit.objective - reached.fit.objective)

    def _refit(self, here: Linearisation, items: Sequence[Ranked], variables: dict[str, Array]) -> None:
        """Refit those that weren't yet, best first."""
        known = {refit.ranked.key for refit in self.refits}
        fresh = [item for item in items if item.key not in known]
        self.refits += refit_all_laws(self.twin, here, self.at.fit.objective, fresh, variables)
        self.refits.sort(key=lambda refit: -refit.score)

    def _date(self, here: Linearisation, variables: dict[str, Array]) -> None:
        """The best law from other times on."""
        for reach in onset_reaches(self.twin):
            best = _simplest_first(self.refits)[0]
            since = cast(float, best.twin.laws[0].form.since_s)
            estimates = zip(best.twin.laws, best.twin.values(best.fit.parameters), strict=True)
            placed = [replace(law, coefficient=float(coefficient)) for law, (coefficient, _) in estimates]
            self._refit(here, [
                replace(best.ranked, placed=tuple(replace(p, form=replace(p.form, since_s=at)) for p in placed))
                for at in times_about(self.twin, since, reach)
            ], variables)  # fmt: skip

    def _renewed(self) -> tuple[list[Ranked], Linearisation, dict[str, Array]]:
        """Ranking along the trajectory with the best law inside, which is the same where the best is."""
        best = self.refits[0]
        leading = _leading_points(self.twin, self.refits)
        key = (id(best), *leading)
        if key not in self._renewals:
            self._renewals[key] = _renewed(self.twin, self.at, best, leading, self.since_s)
        return self._renewals[key]


def _single_terms(refits: Sequence[Refit]) -> list[Ranked]:
    """Each term alone of the best sums of two: a second term that a refit shrinks to nothing isn't worth its charge."""
    known = {r.ranked.key for r in refits}
    out: dict[object, Ranked] = {}
    for refit in [r for r in refits if len(r.ranked.placed) > 1 and r.score > 0.0][:_OF_SUMS]:
        charge = 0.5 * (refit.ranked.charge + 2.0 * np.log(2.0))
        for law, (coefficient, _) in zip(refit.twin.laws, refit.twin.values(refit.fit.parameters), strict=True):
            placed = replace(law, coefficient=float(coefficient))
            item = replace(refit.ranked, placed=(placed,), charge=charge)
            if item.key not in known:
                out.setdefault(item.key, item)
    return list(out.values())


def _simplest_first(refits: list[Refit]) -> list[Refit]:
    """Of the laws that the recording can't tell from the best one, the simplest goes first, wherever it sits.

    A form that follows this recording's chance, or the errors of its maps, is no better here and worse on other
    driving.
    """
    gain = refits[0].gain
    behind = np.array([_SIMPLER_SHARE * gain * _complexity(r) - r.score for r in refits])
    reach = behind.min() + max(RIVALS, _ALIKE_SHARE * gain)
    alike = [r for r, far in zip(refits, behind, strict=True) if far < reach]
    fewest = min(map(_complexity, alike))
    simple = [r for r in alike if _complexity(r) == fewest]
    # one law in two spellings (T_c - T_amb, T_c/T_amb where T_amb stands still) has one score but for rounding
    even = [r for r in simple if max(other.score for other in simple) - r.score < _EVEN]
    simplest = min(even, key=lambda r: (len(_spelt(r)), _spelt(r)))
    return [simplest, *(r for r in refits if r is not simplest)]


def _spelt(refit: Refit) -> str:
    return "; ".join(law.form.text() for law in refit.twin.laws)


def _complexity(refit: Refit) -> int:
    return sum(1 + law.form.complexity for law in refit.twin.laws)


def law_text(twin: Twin, form: Form, coefficient: float, std: float | None = None) -> str:
    """"point: +1.2e-3 kg/s (p_im/p_amb)^0.5"; `std` is the coefficient's, or the shape's where that alone is free."""
    point = twin.points[point_index(twin.points, form.point)]
    if form.fixed is not None:
        factor = form.factors[0]
        return f"{point.name} becomes {factor.operated(std)}"
    spread = "" if std is None else f" ± {std:.2g}"
    if form.amount:
        return f"added to {point.name}: {coefficient:.4g}{spread} {form.factors[0].units[0]}"
    unit = "" if point.unit == "-" else f" {point.unit}"
    kind = "relative change of" if point.relative else "added to"
    return f"{kind} {point.name}: {coefficient:.4g}{spread}{unit} {form.text()}".rstrip()


def _leading_points(twin: Twin, refits: Sequence[Refit]) -> tuple[str, ...]:
    """Names of the points whose laws come near to the best, which is the first."""
    names = (twin.points[r.ranked.index].name for r in refits if r.score > _LEADING * refits[0].score)
    return tuple(dict.fromkeys(names))


def _renewed(
    twin: Twin, at: Linearisation, best: Refit, leading: Sequence[str], since_s: float | None
) -> tuple[list[Ranked], Linearisation, dict[str, Array]]:
    """Ranking along the trajectory with the best law inside: all forms compete to explain what it explains."""
    signals = signals_of(best.twin, best.fit.lanes())
    responses = _free_of(twin, at, signals, best.fit, tuple(signals))
    variables = {**best.twin.variables(best.fit.lanes()), "time_s": twin.time_s}
    return rank(twin, responses, variables, leading, since_s=since_s), responses.at, variables


def _free_of(
    twin: Twin, at: Linearisation, signals: Mapping[str, Array], fit: Fit, points: Sequence[str]
) -> Responses:
    """Responses with a law's signals held, about its fit; those at some points have to be explained anew."""
    fixed = cast(Twin, WithSignals(twin, signals))
    start = replace(fit, parameters=fit.parameters[: len(twin.parameters)])
    responses = Responses(Linearisation(fixed, at.whitening, start, None, at.nuisance_response), start.lanes())
    for name in points:
        responses.add_to_residual(responses.signals(point_index(twin.points, name), signals[name][None])[0])
    return responses


def _report(
    twin: Twin, at: Linearisation, refits: list[Refit], tolerances: Tolerances | None
) -> Law:
    """Full fit of the best law, its intervals, rivals and curve."""
    best = refits[0]
    form = best.twin.laws[0].form
    coefficient = float(best.twin.values(best.fit.parameters)[0][0])
    free = len(best.twin.laws) == 1 and bool(form.factors) and form.factors[0].has_free_shape and not form.amount
    estimates = best.twin.values(best.fit.parameters)
    placed = [replace(law, coefficient=float(c)) for law, (c, _) in zip(best.twin.laws, estimates, strict=True)]
    final = _final(twin, at, placed, best.fit)
    loose = LawTwin(twin, [Placed(form, coefficient, free_shape=True)]) if free else None
    # an operator's only number is its time or width: it is free already, and there is nothing more to loosen
    if loose is not None and len(loose.parameters) == final[1].fit.parameters.size + 1:
        start = start_of(at, loose)
        begun = np.concatenate([final[1].fit.parameters, [form.factors[0].shape]])
        start = replace(start, parameters=begun, local=final[1].fit.local)
        gained = at.fit.objective - final[1].fit.objective
        price = max(float(np.log(at.whitening.present.sum())), _ALIKE_SHARE * gained)
        enough = final[1].fit.objective - price
        freed = fit_fully(
            cast(Twin, loose), at.whitening, start, at.nuisance_response, _FINAL_ROUNDS, ahead=enough
        )
        at_shape = len(loose.parameters) - 1
        shape = float(freed.fit.parameters[at_shape])
        if freed.fit.objective < enough:
            form = form.with_shape(float(f"{shape:.3g}"))
            placed = [Placed(form, float(np.sign(coefficient) * freed.fit.parameters[at_shape - 1]))]
            final = _final(twin, at, placed, replace(best.fit, local=freed.fit.local))
    law, reached = final
    lin = about_itself(reached, tolerances)
    at_coefficient = len(twin.parameters)
    coefficient = float(law.values(lin.fit.parameters)[0][0])
    std = float(lin.fit.std[at_coefficient])
    lanes = lin.fit.lanes()
    variables = {**law.variables(lanes), "time_s": twin.time_s}
    forms = _probable(best, refits[1:])
    std = float(np.hypot(std, coefficient * spread_over_forms(law, lin.fit, forms, variables)))
    point = twin.points[point_index(twin.points, form.point)]
    rivals = tuple(
        Rival(r.ranked.site, abs(best.score - r.score))
        for r in refits[1:]
        if best.score - r.score < RIVALS
    )
    argument = form.factors[0].variables[0] if form.factors else point.ports[0]
    last = tuple(
        _as_found(q, float(c), s) for q, (c, s) in zip(law.laws, law.values(lin.fit.parameters), strict=True)
    )
    others = [
        abs(size if placed.form.fixed is None else shape)
        for placed, (size, shape) in zip(law.laws[1:], law.values(lin.fit.std)[1:], strict=True)
    ]
    text = "; ".join(
        law_text(twin, placed.form, placed.coefficient, std=deviation)
        for placed, deviation in zip(last, [std, *others], strict=True)
    )
    curve = _curve(twin, at, law, lin, variables, argument, std / max(abs(coefficient), 1e-300))
    return Law(
        point.site, text, std, point.unit, argument, curve, at.fit.objective - reached.fit.objective, best.score,
        rivals, lin.fit.parameters[:at_coefficient], lin.fit.local, last, (),
        disagreement(best, refits, at_coefficient),
    )  # fmt: skip


def _probable(best: Refit, others: Sequence[Refit]) -> list[tuple[float, Refit]]:
    """Refits with their probabilities over the best one's; what maps off a little can put behind counts in full."""
    behind = [max(0.0, best.score - r.score - _ALIKE_SHARE * best.gain) for r in others]
    return [(float(np.exp(-0.5 * b)), r) for b, r in zip(behind, others, strict=True) if b < RIVALS]


def _as_found(placed: Placed, coefficient: float, shape: float | None) -> Placed:
    """A term with its estimates, none of them free any more."""
    form = placed.form if shape is None else placed.form.with_shape(float(shape))
    return replace(placed, form=form, coefficient=coefficient, free_shape=False)


def _final(
    twin: Twin, at: Linearisation, placed: Sequence[Placed], start: Fit
) -> tuple[LawTwin, Linearisation]:
    law = LawTwin(twin, placed)
    extra = [p.value for p in law.parameters[len(twin.parameters) :]]
    start = replace(start, parameters=np.append(start.parameters[: len(twin.parameters)], extra))
    return law, fit_fully(cast(Twin, law), at.whitening, start, at.nuisance_response, _FINAL_ROUNDS)


def _curve(
    twin: Twin, at: Linearisation, law: LawTwin, lin: Linearisation,
    variables: dict[str, Array], argument: str, spread: float,
) -> Curve | None:  # fmt: skip
    """The law over its argument beside what the recording says bin by bin, free of it; None where the machine runs away
    with what the law adds held as it is."""
    name = law.laws[0].form.point
    signals = signals_of(law, lin.fit.lanes())
    try:
        responses = _free_of(twin, at, signals, lin.fit, (name,))
    except np.linalg.LinAlgError:
        return None
    return law_curve(variables[argument], signals[name], spread, responses.point(point_index(twin.points, name)))


__all__ = ["Law", "LawSearch", "Rival", "law_text"]
