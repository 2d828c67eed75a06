"""What several recordings that were judged together say one by one: health of each, sizes of each, and since when."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from dieseltwin.discovery.likelihood.fit import Linearisation
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.interface import Array, OverRecordings, Twin
from dieseltwin.discovery.twins.several import SeveralTwin, ways_to_differ
from dieseltwin.discovery.verdict.document import (
    FoundEffect,
    JudgedRecording,
    Location,
    SizeValue,
)
from dieseltwin.discovery.verdict.health_value import HealthValue, SinceReference
from dieseltwin.discovery.verdict.unseen import health_bias
from dieseltwin.engine import HEALTH
from dieseltwin.recordings.dates import ORDER, Dated

_DIFFERENCE = 0.02  # of a magnitude, for its response
_ALIKE = 9.0  # 2 delta log-likelihood below which two profiles can't be told apart (docs/discovery.md)
_TRACE = 1e-6  # of a magnitude's variance: sizes that no recording tells apart


def health_places(twin: Twin, r: int = -1) -> list[int]:
    """Places of the health parameters among a twin's free parameters; of several recordings those of recording `r`."""
    names = [parameter.name for parameter in twin.parameters]
    if isinstance(twin, SeveralTwin):
        return [names.index(f"{name}:{r % len(twin.parts)}") for name in HEALTH]
    return [names.index(name) for name in HEALTH]


def unseen_bias(found: Search) -> dict[str, dict[str, float]]:
    """What an effect of its smallest visible size, unseen, would move health by; of several recordings the last's."""
    at = found.null.fit.parameters
    places = zip(HEALTH, health_places(found.twin), strict=True)
    return health_bias(found, {name: (place, float(at[place])) for name, place in places})


@dataclass(frozen=True)
class Sizes:
    """Sizes of one effect in every recording, all free beside each other.

    Attributes:
        values: (R,) [unit of the effect].
        covariance: (R, R).
    """

    values: Array
    covariance: Array

    @property
    def std(self) -> Array:
        """(R,) standard deviations."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    def cost(self, factors: Array) -> float:
        """-2 log likelihood of sizes that are proportional to factors (R,), above that of sizes that are free."""
        ridge = _TRACE * np.trace(self.covariance) / len(self.values)
        inverse = np.linalg.inv(self.covariance + ridge * np.eye(len(self.values)))
        push, information = float(factors @ inverse @ self.values), float(factors @ inverse @ factors)
        return float(self.values @ inverse @ self.values) - push**2 / information


def sizes_of_all(at: Linearisation) -> list[Sizes]:
    """Sizes of every effect of a fit, each freed in every recording; none on one recording."""
    if not isinstance(at.twin, OverRecordings):
        return []
    return [sizes_by_recording(at, index) for index in range(len(at.fit.candidate.names))]


def sizes_by_recording(at: Linearisation, index: int) -> Sizes:
    """Sizes of one effect of a fit, freed in every recording: one linear step from the fit, in its metric."""
    twin = cast(SeveralTwin, at.twin)  # or one with fixed signals that stands for it
    name, magnitude = at.fit.candidate.names[index], float(at.fit.magnitudes[index])
    lane, schedule = at.fit.lanes(), at.fit.candidate.schedules.get(name, np.ones(twin.time_s.size))
    more = {**at.fit.candidate.schedules, name: schedule + _DIFFERENCE}
    response = (twin.simulate(replace(lane, schedules=more))[0] - at.simulated) / (_DIFFERENCE * magnitude)
    freed = np.zeros((len(twin.parts), *response.shape))
    for r, rows in enumerate(twin.rows):
        freed[r, rows] = response[rows]
    design = np.vstack([np.delete(at.projected, len(twin.parameters) + index, axis=0), at.metric.project(freed)])
    precision = np.concatenate([np.delete(at.precision, len(twin.parameters) + index), np.full(len(freed), 1e-30)])
    scale = np.sqrt((design**2).sum(axis=1) + precision)
    scaled = (design @ design.T + np.diag(precision)) / np.outer(scale, scale)
    covariance: Array = np.asarray(np.linalg.inv(scaled) / np.outer(scale, scale), dtype=np.float64)
    offset = np.zeros(precision.size)
    offset[: len(twin.parameters)] = [p.value for p in twin.parameters] - at.fit.parameters
    change = covariance @ (design @ at.projected_residual + precision * offset)
    fitted = magnitude * np.array([schedule[rows].mean() for rows in twin.rows])
    kept = slice(-len(freed), None)
    return Sizes(fitted + change[kept], covariance[kept, kept])


def profile_words(profile: str | None, days: Sequence[Dated]) -> str:
    """A profile over recordings in words, to follow "the effect"."""
    if profile is None:
        return "is of one size in all recordings"
    kind, _, number = profile.partition(":")
    if kind == "cold":
        return "comes with cold weather (this size at the coldest)"
    if kind in ("only", "gone"):
        j, k = map(int, number.split(":"))
        span = _on(days[j]) if k == j + 1 else f"from {days[j].day} to {days[k - 1].day}"
        return f"was there {span} alone" if kind == "only" else f"was there, but not {span}"
    k = int(number)
    if kind == "begins":
        return f"began between {days[k - 1].day} and {days[k].day}"
    if kind == "ends":
        return f"was there up to {days[k - 1].day} and isn't {_on(days[k])} any more"
    return f"has grown to this size since {days[k].day}"


def _on(day: Dated) -> str:
    """One recording's day, "on 2026-03-14"; "in recording 2" where there is none."""
    return f"{'in' if day.date_from == ORDER else 'on'} {day.day}"


def told_apart(found: Search, days: Sequence[Dated]) -> str:
    """How sizes of the explanation differ between the recordings, in words; what can't be told from it is said."""
    at, twin = found.best, found.twin
    if at is None or found.kind == "law" or not isinstance(twin, SeveralTwin):
        return ""
    chosen = found.variant.profile if found.kind == "variant" and found.variant is not None else None
    if found.kind == "variant" and chosen is None:
        return ""
    sizes = sizes_by_recording(at, 0)
    profiles: dict[str | None, Array] = {None: np.ones(len(twin.parts))}
    profiles.update(ways_to_differ(twin.occasions))
    costs = {name: sizes.cost(factors) for name, factors in profiles.items()}
    others = [name for name, cost in costs.items() if name != chosen and cost < costs[chosen] + _ALIKE]
    others.sort(key=lambda name: costs[name])
    words = profile_words(chosen, days)
    if others:
        words += "; not to be told from: it " + ", or ".join(profile_words(name, days) for name in others[:3])
    return words


def onset_of(location: Location, found: Search, days: Sequence[Dated]) -> Location:
    """The location with the onset as a date, where the effect wasn't there from the first recording on."""
    twin, variant = found.twin, found.variant if found.kind == "variant" else None
    if not isinstance(twin, SeveralTwin):
        return location
    if found.since_s is not None:
        row = int(np.searchsorted(twin.time_s, found.since_s))
        r = twin.recording_at(row)
        here = twin.since_start(row)
        return location.model_copy(update={"onset_s": here, "onset_date": days[r].day})
    kind, _, number = ("" if variant is None else variant.profile or "").partition(":")
    if kind in ("begins", "only"):
        k = int(number.split(":")[0])
        return location.model_copy(update={"onset_date": days[k].day, "onset_after": days[k - 1].day})
    if kind == "grows":
        k = int(number)
        return location.model_copy(update={"onset_date": days[k].day, "onset_after": days[k - 1].day if k else None})
    return location


def with_words(effects: Sequence[FoundEffect], words: str) -> tuple[FoundEffect, ...]:
    """Effects with how they differ between recordings, in words."""
    return tuple(effect.model_copy(update={"over_recordings": words or None}) for effect in effects)


def judged(
    found: Search, days: Sequence[Dated], after: tuple[Array, Array | None], since: tuple[Array, Array] | None,
    sizes: Sequence[Sizes],
) -> tuple[JudgedRecording, ...]:  # fmt: skip
    """Every recording by itself.

    Args:
        found: the search over all; days: the recordings, in time order.
        after: free parameters of the explanation and their covariance; since: what became of them since the reference.
        sizes: of every effect that was found, by the fit that gives the verdict's own size.
    """
    twin = found.twin
    if not isinstance(twin, SeveralTwin):
        return ()
    names = found.best.fit.candidate.names if found.best is not None and sizes else ()
    out = []
    for r, day in enumerate(days):
        recording = day.recording
        out.append(
            JudgedRecording(
                path=str(recording.path.name if recording.path else f"recording {r + 1}"), sha256=recording.sha256,
                duration_s=recording.duration_s, date=day.day if day.date_from == ORDER else day.date.isoformat(),
                date_from=day.date_from, p_amb_pa=recording.p_amb_pa, t_amb_k=recording.t_amb_k,
                health=health_values(found, after, since, r),
                magnitudes={
                    name: SizeValue(value=float(size.values[r]), std=float(size.std[r]))
                    for name, size in zip(names, sizes, strict=True)
                },
            )
        )  # fmt: skip
    return tuple(out)


def health_values(
    found: Search, after: tuple[Array, Array | None], since: tuple[Array, Array] | None, r: int = -1
) -> dict[str, HealthValue]:
    """Health parameters of a search's explanation; of several recordings those of recording `r`."""
    parameters, covariance = after
    values = {}
    for name, j in zip(HEALTH, health_places(found.twin, r), strict=True):
        variance = None if covariance is None else float(covariance[j, j])
        values[name] = HealthValue(
            value=float(parameters[j]), before=float(found.null.fit.parameters[j]),
            std=float(np.sqrt(variance)) if variance is not None and np.isfinite(variance) and variance >= 0 else None,
            since_reference=None if since is None else SinceReference(value=float(since[0][j]), std=float(since[1][j])),
        )  # fmt: skip
    return values
