"""All that the search for left-out physics finds out."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import logsumexp

from dieseltwin.discovery.laws.features import Structure
from dieseltwin.discovery.laws.search import Law
from dieseltwin.discovery.likelihood.fit import Fit, Linearisation, fit_fully
from dieseltwin.discovery.likelihood.metric import ModelScatter, Whitening
from dieseltwin.discovery.likelihood.nuisance import Nuisance
from dieseltwin.discovery.likelihood.score import Chance, Scored
from dieseltwin.discovery.search.variants import Variant
from dieseltwin.discovery.twins.interface import Twin
from dieseltwin.recordings.noise import Noise
from dieseltwin.settings.search import SearchSettings


@dataclass
class Search:
    """Everything that the search found out.

    Attributes:
        twin, settings: what is searched, and the thresholds.
        noise, whitening, scatter: of the readings, and what they scatter by beside their noise.
        null: health-only fit.
        nuisances: tolerances of maps, sensors and circumstances about it, or
        about: the explanation that they were taken about; None: health alone.
        scored, chance: linear estimates of all effects, and the largest gain of them by chance.
        singles, pairs, variants: refits of one effect, of two, of one that acts at times or in a region, best first.
        scanned: linear estimates of the last.
        second_effect_gain: of the best second effect beside the best single one; None: not looked at.
        spreads: which share of it each second effect keeps without its best window.
        structure, local: terms without a name, and bumps over arguments of maps, at the health-only fit.
        left, left_local: the same beside the explanation.
        best: the explanation, linearised; None where something has no name.
        widening: factor of the variances of `best` beyond its own fit's.
        kind: of the explanation: "healthy", "single", "pair", "variant" or "law".
        probabilities, equivalent: of the names of that kind, and which can't be told apart.
        variant, law: where the kind is that.
        refused: kind of the explanation by name that was refused; "" for none.
        left_out: (W,) windows that don't count.
        hidden: (n, C) readings in those, without what `twin.moved` holds, NaN elsewhere; None: not known.
        onset_range_s, until_range_s: dates in the time of the twin between which an onset and an end can't be told
            [s]; None: there is none, or it wasn't asked.
        seconds: stage -> time that it took [s].
        standing: nearly all is explained by a valve that stands still, found before anything was scored.
        stage, unfinished: what is looked at, and the stages that no time was left for.
        simulated_errors: whether explanations are compared with the maps' errors of each simulated
            (`simulated_errors.verify`).
        unsettled: explanations that led in turns when the likelihood was renewed about the leading one.
        earlier: searches up to single effects under circumstances that were thought of before.
        in_short: only of the single effect that leads is known what it explains (`leader`); all that is compared needs
            the others.
    """

    twin: Twin
    settings: SearchSettings
    noise: Noise
    whitening: Whitening
    null: Linearisation
    scored: list[Scored]
    chance: Chance
    singles: list[Fit] = field(default_factory=list)
    pairs: list[Fit] = field(default_factory=list)
    second_effect_gain: float | None = None
    spreads: dict[str, float] = field(default_factory=dict)
    scanned: list[Variant] = field(default_factory=list)
    variants: list[tuple[Variant, Fit]] = field(default_factory=list)
    structure: list[Structure] = field(default_factory=list)
    local: list[Structure] = field(default_factory=list)
    left: list[Structure] = field(default_factory=list)
    left_local: list[Structure] = field(default_factory=list)
    best: Linearisation | None = None
    widening: float = 1.0
    kind: str = "healthy"
    probabilities: dict[str, float] = field(default_factory=dict)
    equivalent: list[tuple[str, ...]] = field(default_factory=list)
    variant: Variant | None = None
    law: Law | None = None
    refused: str = ""
    nuisances: list[Nuisance] = field(default_factory=list)
    about: Fit | None = None
    scatter: ModelScatter | None = None
    left_out: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    hidden: np.ndarray | None = None
    onset_range_s: tuple[float, float] | None = None
    until_range_s: tuple[float, float] | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    standing: bool = False
    stage: str = ""
    unfinished: tuple[str, ...] = ()
    simulated_errors: bool = False
    unsettled: list[tuple[str, ...]] = field(default_factory=list)
    earlier: list[Search] = field(default_factory=list)
    in_short: bool = False

    def anew(self) -> Search:
        """The same for a search of its own, as long as nothing was looked for here."""
        return replace(self, null=copy(self.null), best=copy(self.best), probabilities={}, seconds=dict(self.seconds))

    @property
    def scored_at(self) -> Linearisation:
        """The fit that `scored` is about: the health-only one, or that beside a valve that stands still."""
        return self.best if self.standing and self.best is not None else self.null

    def gain(self, fit: Fit) -> float:
        """Gain of a fit over the health-only fit."""
        return self.null.fit.objective - fit.objective

    def local_ahead(self, gain: float) -> Structure | None:
        """The strongest bump over an argument of a map that doesn't hang on one window, where it gains more."""
        first = next(iter(self._lasting(self.local)), None)
        return first if first is not None and first.gain > max(gain, self.settings.local_gain) else None

    def everything_unnamed(self) -> list[Structure]:
        """Terms without a name and bumps over arguments of maps, strongest first."""
        return sorted([*self.structure, *self.local], key=lambda item: -item.gain)

    def explained(self) -> float:
        """Gain of the explanation that was chosen over the health-only fit; 0 where there is none."""
        if self.kind == "law":
            return 0.0 if self.law is None else self.law.gain
        return 0.0 if self.best is None else max(self.gain(fit) for fit in self._chosen())

    def refitted(self, fit: Fit, rounds: int, ahead: float = np.inf) -> Fit:
        """A fit carried on with sensitivities of every round, in the metric of the health-only fit; `ahead`: as of
        `fit_fully`."""
        return fit_fully(self.twin, self.whitening, fit, rounds=rounds, frozen=self.null, ahead=ahead).fit

    def fits_of(self, kind: str) -> list[Fit]:
        """Fits of all explanations of a kind."""
        return {"pair": self.pairs, "variant": [fit for _, fit in self.variants]}.get(kind, self.singles)

    def _chosen(self) -> list[Fit]:
        names = () if self.best is None else self.best.fit.candidate.names
        pool = self.fits_of(self.kind)
        return [fit for fit in pool if fit.candidate.names == names] or pool[:1]

    def stood_always(self) -> bool:
        """Whether a valve that stands still does so from the first row to the last."""
        return self.standing and self.variant is not None and bool(self.variant.schedule.all())

    def remaining(self) -> float:
        """What the strongest further term would gain beyond the explanation, without the window it hangs on most."""
        return max((item.held for item in (*self.left, *self.left_local)), default=0.0)

    def share_explained(self) -> float | None:
        """Share of the misfit beyond noise and tolerances that the explanation takes away [-].

        None where healthy, and where no time was left to look at what remains.
        """
        if self.kind == "healthy" or self.unfinished:
            return None
        explained = self.explained()
        if explained <= 0.0:
            return 0.0
        return explained / (explained + max(self.remaining() - self.settings.chance_leaves, 0.0))

    def more_is_missing(self) -> bool:
        """Whether what the explanation leaves is beyond chance and beyond a small share of what it explains."""
        if self.kind == "healthy":
            return False
        share = 0.0 if self.standing else self.settings.missing_share  # it dwarfs whatever else there is
        bar = max(self.settings.left_gain[2], share * self.explained())
        return self.explained() <= 0.0 or self.remaining() > bar

    def lasting(self) -> list[Structure]:
        """Terms without a name that don't hang on one window, strongest first."""
        return self._lasting(self.structure)

    def _lasting(self, items: Sequence[Structure]) -> list[Structure]:
        return [item for item in items if item.held >= self.settings.least_spread * item.gain]

    def known_by_name(self, item: Structure) -> bool:
        """Whether a hypothesis says the same as a term: then the name stands for it, whatever a refit reaches."""
        name = item.feature.effect
        if item.feature.outward and item.coefficient > 0.0:
            return False
        return name is not None and name in self.twin.hypotheses and name not in self.settings.withhold

    def nameless(self, structure: Sequence[Structure] | None = None) -> list[Structure]:
        """The lasting terms that no hypothesis says, of some; None: of those that are there from the first row on."""
        some = self._lasting(self.structure if structure is None else structure)
        return [item for item in some if not self.known_by_name(item)]

    @property
    def since_s(self) -> float | None:
        """From when on the explanation is there, in the time of the twin [s]; None: from the first row on."""
        if self.kind == "law":
            return None if self.law is None else self.law.since_s
        return self.variant.onset_s if self.kind == "variant" and self.variant is not None else None

    @property
    def gain_of_alarm(self) -> float:
        """Gain from which on an effect whose size is of interest is an alarm."""
        return max(self.settings.alarm_gain, self.chance.threshold(self.settings.alarm_level))

    def beyond_chance(self, fit: Fit) -> bool:
        """Whether what a fit explains is an alarm if its sizes are of interest."""
        return bool(self.gain(fit) >= self.gain_of_alarm)

    def names_for_round(self, misfit: float, least_explained: float, refused: bool = False) -> tuple[str, ...]:
        """What a round takes: the choice, or the strongest name where what it leaves is the next round's.

        Args:
            misfit: of the health-only fit; least_explained: share of it that the strongest name must explain [-].
            refused: only a search that refused a choice leaves something to the next round.
        """
        if self.kind == "healthy":
            return ()
        if self.best is not None and self.kind in ("single", "pair"):
            return self.best.fit.candidate.names
        if not self.singles or (refused and not self.refused):
            return ()
        lead = self.singles[0]
        strong = self.gain(lead) > max(self.settings.left_gain[0], least_explained * misfit)
        return lead.candidate.names if strong and self.of_interest(lead) else ()

    def of_interest(self, fit: Fit) -> bool:
        """Whether the largest magnitude is near its tolerance of interest or above, and no other far below."""
        sizes = [
            abs(m) / self.twin.hypotheses[name].tolerance
            for name, m in zip(fit.candidate.names, fit.magnitudes, strict=True)
        ]
        return max(sizes) >= self.settings.alarm_size and min(sizes) >= self.settings.beside_size


def occam(found: Search, fit: Fit) -> float:
    """Log evidence of a fit up to a constant: half its gain less what the precision of its magnitudes costs.

    Magnitudes are believed log-uniform between their tolerance and `believed_range` times it.
    """
    value = 0.5 * found.gain(fit)
    stds, spread = fit.std[len(found.twin.parameters) :], np.log(found.settings.believed_range)
    for magnitude, std in zip(np.abs(fit.magnitudes), stds, strict=True):
        if std > 0 and magnitude > 0:
            value += float(np.log(np.sqrt(2 * np.pi) * min(std, magnitude) / (magnitude * spread)))
    return value


def set_probabilities(found: Search, kind: str) -> None:
    """Probabilities of the names of the chosen kind, and who can't be told apart."""
    pool = found.fits_of(kind)
    if not pool:
        return
    keys = [" + ".join(fit.candidate.names) for fit in pool]
    evidence = np.array([occam(found, fit) for fit in pool])
    share = found.settings.equivalent_share * found.gain(pool[0])
    evidence /= max(1.0, share / found.settings.equivalent_gain)
    weights = np.exp(evidence - logsumexp(evidence))
    found.probabilities = {}
    for key, weight in zip(keys, weights, strict=True):
        found.probabilities[key] = found.probabilities.get(key, 0.0) + float(weight)
    best = min(fit.objective for fit in pool)
    # what an explanation leaves is the size of what the twin can't describe: closer names can't be told apart
    reach = max(found.settings.equivalent_gain, share, found.left[0].gain if found.left else 0.0)
    if found.variant is not None and found.variant.region is not None:  # nor can those whose regions' edges decide
        reach = max(reach, found.settings.edges_share * found.gain(pool[0]))
    seen: list[tuple[str, ...]] = []
    for fit in pool:
        if fit.objective - best < reach and fit.candidate.names not in seen:
            seen.append(fit.candidate.names)
    found.equivalent = [*seen, *(names for names in found.unsettled if names not in seen)]
