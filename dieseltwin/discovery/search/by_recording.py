"""Effects that differ between recordings, begun from what each recording says by itself.

A fault that is there in some recordings only bends the health-only fit of all of them together to where no response is
what it is near the truth: nothing on the way from there is linear. Each recording alone bends less, since maps and
sensors give way to it. So the explanations of all recordings together start from the health, and from the sizes, that
the recordings find one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dieseltwin.discovery.likelihood.fit import Candidate, Fit, Linearisation, simulate_fits
from dieseltwin.discovery.likelihood.refit import refit_all
from dieseltwin.discovery.search.alone import refits_alone, with_own_readings
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.search.variant_fits import in_order
from dieseltwin.discovery.search.variants import Variant
from dieseltwin.discovery.twins.interface import Array, OverRecordings, Twin
from dieseltwin.settings.search import SearchSettings

_TRIED = 5  # names, the best by the sum of what they gain in each recording
_LEAST_GAIN = 9.0  # of that sum: by chance the best of some thirty names has as much in one recording
_ROUNDS = 8
_LEADING = 3  # are refitted again where what is open of the maps is linearised anew


@dataclass(frozen=True)
class Start:
    """Where a refit of all recordings together begins.

    Attributes:
        name: of the effect.
        profile: way in which its size differs between recordings, None for one size.
        schedule: (n,) factor of its size.
        magnitude: its size [unit].
        parameters: (P,) free parameters of all recordings.
        local: (W, S) initial states, None for those of the health-only fit.
    """

    name: str
    profile: str | None
    schedule: Array
    magnitude: float
    parameters: Array
    local: Array | None = None


def starts_by_recording(found: Search) -> list[Start]:
    """First guesses from every recording by itself; none for a twin of one recording."""
    twin = found.twin
    if not isinstance(twin, OverRecordings):
        return []
    fits = [_singles(part, found.settings) for part in twin.parts]
    total: dict[str, float] = {}
    for own in fits:
        for name, (gain, _) in own.items():
            total[name] = total.get(name, 0.0) + gain
    names = [name for name in twin.hypotheses if total.get(name, 0.0) > _LEAST_GAIN]
    names = sorted(names, key=lambda name: -total[name])[:_TRIED]
    return [_start(twin, name, fits) for name in names]


def refitted(found: Search, starts: Sequence[Start]) -> tuple[Search, list[Start]]:
    """The search with the refits of such guesses among its single effects and its variants; the leading ones from where
    they ended, for the next time."""
    ended = []
    for start in starts:
        schedules = {} if start.profile is None else {start.name: start.schedule}
        first = replace(
            found.null.fit, candidate=Candidate((start.name,), schedules), parameters=start.parameters,
            magnitudes=np.array([start.magnitude]), local=found.null.fit.local if start.local is None else start.local,
        )  # fmt: skip
        base = Linearisation(found.twin, found.whitening, first, found.null)
        ended.append((start, refit_all(base, [first.candidate], [base.jacobian[-1:]])[0]))
    ended.sort(key=lambda pair: pair[1].objective)
    if ended:
        start, fit = ended[0]
        ended[0] = start, found.refitted(fit, _ROUNDS)
    for start, fit in ended:
        if start.profile is None:
            others = [other for other in found.singles if other.candidate.names != (start.name,)]
            same = [other for other in found.singles if other.candidate.names == (start.name,)]
            found.singles = sorted([*others, min([fit, *same], key=lambda f: f.objective)], key=lambda f: f.objective)
            continue
        response = start.schedule[:, None] * next(s for s in found.scored if s.name == start.name).response
        variant = Variant(
            start.name, None, None, start.schedule, response, found.gain(fit), profile=start.profile
        )
        found.variants = in_order(found, [*found.variants, (variant, fit)])
    return found, [
        replace(start, parameters=fit.parameters, magnitude=float(fit.magnitudes[0]), local=fit.local)
        for start, fit in ended[:_LEADING]
    ]


def gained_elsewhere(null: Linearisation, fit: Fit) -> float:
    """Share of what a fit gains over the health-only fit that is left without the window that gains most, 0-1.

    As `score.spread`, of a fit that is simulated: far from the health-only fit its linear estimate says nothing.
    """
    n, channels = null.residual.shape
    explained = np.nan_to_num(null.twin.measured - simulate_fits(null.twin, [fit])[0])
    rest = null.metric.project(explained[None])[0][: n * channels]
    gains = null.projected_residual[: n * channels] ** 2 - rest**2
    windows = np.add.reduceat(gains, null.twin.starts * channels)
    return float(np.clip(1.0 - windows.max() / gains.sum(), 0.0, 1.0)) if gains.sum() > 0.0 else 0.0


def _singles(part: Twin, settings: SearchSettings) -> dict[str, tuple[float, Fit]]:
    """Gain and refit of the leading effects in one recording, the health-only fit under the name ''."""
    own, fits = refits_alone(with_own_readings(part), settings)
    out = {fit.candidate.names[0]: (max(own.gain(fit), 0.0), fit) for fit in fits}
    return {**out, "": (0.0, own.null.fit)}


def _start(twin: OverRecordings, name: str, fits: Sequence[dict[str, tuple[float, Fit]]]) -> Start:
    """The profile that the sizes found in each recording fit best, least squares by their own precision."""
    sizes, weights = np.zeros(len(fits)), np.full(len(fits), np.nan)
    for r, own in enumerate(fits):
        if name in own:
            fit = own[name][1]
            sizes[r], weights[r] = float(fit.magnitudes[0]), 1.0 / float(fit.std[-1]) ** 2
    # too weak there to be looked at: nothing, as precisely as where it is seen best
    weights = np.nan_to_num(weights, nan=np.nanmax(weights))
    profiles: dict[str | None, Array] = {None: np.ones(len(fits))}
    profiles.update(twin.factors)
    costs = {}
    for key, factors in profiles.items():
        told = float((weights * factors**2).sum())  # nothing where a profile has it only where it doesn't show
        size = float((weights * factors * sizes).sum()) / told if told > 0.0 else 0.0
        costs[key] = (float((weights * (sizes - size * factors) ** 2).sum()), size)
    best = min(costs, key=lambda key: costs[key][0])
    own_fits = [own.get(name, own[""])[1] for own in fits]
    low, high = twin.hypotheses[name].limits
    return Start(
        name, best, twin.profiles[best] if best is not None else np.ones(twin.time_s.size),
        float(np.clip(costs[best][1], low, high)), np.concatenate([fit.parameters for fit in own_fits]),
    )  # fmt: skip
