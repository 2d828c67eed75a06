"""Circumstances of a recording as tolerances: ambient, charge temperature, fuel's scale, clocks of the channels.

What no column gives is open in every fit, with its prior. What is right as a rule (clocks, fuel's scale) is taken as
assumed until a recording shows plainly that it isn't (`search.circumstances`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, cast, runtime_checkable

import numpy as np

from dieseltwin.discovery.likelihood.fit import Linearisation
from dieseltwin.discovery.likelihood.nuisance import Nuisance
from dieseltwin.discovery.twins.interface import Array, Lanes, Twin
from dieseltwin.discovery.twins.offers import Offer
from dieseltwin.recordings.circumstances import ROUNDED, TIME_SHIFT, Circumstance
from dieseltwin.settings.search import CircumstanceSettings

_LABEL = "circumstance"
_ROUNDED_BY = 0.1  # of what an input bends by at a row: a straight line halfway between two rows leaves 1/8 of it out
_NEAR = 0.1  # of what is worth a word (0.3 kPa, 0.8 K): up to here linear is as good
_PLAINLY = 4.0  # standard deviations of an estimate: errors of maps are Gaussian in the plant alone
_SAYS_NOTHING = 1e-6  # share of a prior's variance that readings take away, below which they don't answer at all


@runtime_checkable
class WithCircumstances(Offer, Protocol):
    """A twin of a recording that doesn't say all that it was made under.

    Attributes:
        circumstances: what may be off.
        values: what is known of it by now, by name; as assumed where not named.
        opened: names of those that were found to be off.
        beliefs: the settings that say how far anything may be off.
    """

    circumstances: tuple[Circumstance, ...]
    values: Mapping[str, float]
    opened: frozenset[str]
    beliefs: CircumstanceSettings

    def under(self, values: Mapping[str, float], opened: frozenset[str], like: bool = False) -> Twin:
        """The twin of the recording under other circumstances; `like`: with the same windows and holes."""
        ...

    def circumstance_responses(self, lanes: Lanes, simulated: Array, names: Sequence[str]) -> Array:
        """Responses (K, n, C) of the readings per unit, next to one lane with readings (n, C)."""
        ...


@dataclass(frozen=True)
class Estimate:
    """What a recording says of one circumstance: value and standard deviation [unit]."""

    circumstance: Circumstance
    value: float
    std: float

    @property
    def off(self) -> bool:
        """Whether it is plainly another than assumed, by as much as matters."""
        return self.surely_off and abs(self.value - self.circumstance.assumed) > self.circumstance.notable

    @property
    def surely_off(self) -> bool:
        """Whether it is plainly another than assumed, by however little: beside a learned engine that may matter."""
        return abs(self.value - self.circumstance.assumed) > _PLAINLY * self.std


def open_circumstances(twin: Twin) -> tuple[Circumstance, ...]:
    """What is open in every fit: what no column gives and what was found to be off."""
    if not isinstance(twin, WithCircumstances):
        return ()
    return tuple(item for item in twin.circumstances if item.unknown or item.name in twin.opened)


def label_of(item: Circumstance) -> str:
    """Label of its nuisance."""
    return f"{_LABEL} {item.name}"


def nuisance_covariance(at: Linearisation) -> Array:
    """Of the nuisances (K, K) beside parameters, effects and local states, in standard deviations of their priors."""
    known = len(at.jacobian)
    return np.asarray(np.linalg.inv(at.joint()[1])[known:, known:])


def circumstance_nuisances(twin: Twin, lanes: Lanes, simulated: Array, width: int | None = None) -> list[Nuisance]:
    """Directions of what is open, one standard deviation each; `width`: of loadings, for engines that were learned.

    Those of the circumstances are the last. Before them stand the corners of inputs that were moved between their rows:
    a valve that closes never quite does, on a straight line between two rows, and was 0.5 % from its command.
    """
    items = open_circumstances(twin)
    if not items or not isinstance(twin, WithCircumstances):
        return []
    moved = [item.name.replace(TIME_SHIFT, ROUNDED, 1) for item in items if item.drives]
    sizes = [*((f"{_LABEL} {name}", name, _ROUNDED_BY) for name in moved),
             *((label_of(item), item.name, item.std) for item in items)]  # fmt: skip
    responses = twin.circumstance_responses(lanes, simulated, [name for _, name, _ in sizes])
    none = None if width is None else np.zeros(width)
    of_maps = None if width is None else np.zeros_like(simulated)
    return [
        Nuisance(label, response=std * response, loading=none, of_maps=of_maps)
        for (label, _, std), response in zip(sizes, responses, strict=True)
    ]


def at_estimates(twin: Twin, nuisances: Sequence[Nuisance], responses: Array, estimate: Array) -> Twin:
    """The twin simulated in the ambient, with the charge, that an estimate says, as `nuisance.Rebased` does of maps.

    The readings are moved by the linear responses, so that priors stay where they are, and estimates count from where
    the given twin is. Clocks and drifts stay linear.

    Args:
        twin: the twin.
        nuisances, responses, estimate: directions, their linear responses (K, n, C), and (K,) where along them in
            standard deviations.
    """
    if not isinstance(twin, WithCircumstances):
        return twin
    at = {nuisance.label: k for k, nuisance in enumerate(nuisances)}
    far = [
        (item, at[label_of(item)]) for item in open_circumstances(twin)
        if not item.kind and item.std * abs(estimate[at[label_of(item)]]) > _NEAR * item.notable
    ]  # fmt: skip
    if not far:
        return twin
    values = {item.name: twin.values.get(item.name, item.assumed) + item.std * float(estimate[k]) for item, k in far}
    other = twin.under({**twin.values, **values}, twin.opened, like=True)
    cast(WithCircumstances, other).values = twin.values
    other.measured = other.measured + sum(estimate[k] * responses[k] for _, k in far)
    return other


def clock_scatter(twin: Twin, lanes: Lanes) -> Array | None:
    """Variance (n, C) of the readings about one lane where clocks were put right; None where none was.

    What a channel did between two rows isn't known. Where it has kinks, moving it misplaces them by a part of a row.
    """
    if not isinstance(twin, WithCircumstances):
        return None
    names = [item.name for item in open_circumstances(twin) if item.kind == TIME_SHIFT]
    if not names:
        return None
    jitter_s = twin.beliefs.jitter_rows * float(np.median(np.diff(twin.time_s)))
    responses = twin.circumstance_responses(lanes, twin.measured, names)
    return np.asarray(((jitter_s * responses) ** 2).sum(axis=0))


def _middle(values: Array, among: np.ndarray) -> Array:
    """Weights (K,) whose sum of the values is the median of some: one has it all, or two half of it each."""
    index = np.flatnonzero(among)
    ordered = index[np.argsort(values[index])]
    middle = ordered[(index.size - 1) // 2 : index.size // 2 + 1]
    return np.where(np.isin(np.arange(values.size), middle), 1.0 / middle.size, 0.0)


def left_to_clocks(at: Linearisation) -> dict[str, float]:
    """Effects that a twin doesn't try where a clock is open, as they are no others than that (a valve's dead time) ->
    standard deviation of their size beside what is believed of the clock [unit]; infinite where nothing answers.

    Args:
        at: a fit, linearised with the circumstances as its last nuisances.
    """
    items, known = open_circumstances(at.twin), set(at.twin.hypotheses)
    clocks = {k: item for k, item in enumerate(items) if item.kind == TIME_SHIFT and set(item.effects) - known}
    if not clocks or at.nuisance_response is None:
        return {}
    unsaid = np.diag(nuisance_covariance(at))[-len(items) :]  # share of the prior's variance that the readings leave
    found: dict[str, float] = {}
    for k, item in clocks.items():
        said = 1.0 - float(unsaid[k])
        std = item.std / said**0.5 if said > _SAYS_NOTHING else np.inf
        found |= {name: min(std, found.get(name, np.inf)) for name in item.effects if name not in known}
    return found


def from_the_middle(
    twin: WithCircumstances, items: Sequence[Circumstance], values: Array, covariance: Array
) -> tuple[Array, Array]:
    """Values (K,) of open circumstances and their covariance, with the clocks of a recording in which none is trusted
    counted from the middle one: all of them late together shows nowhere."""
    for recording in {item.recording for item in items}:
        clocks = np.array([item.kind == TIME_SHIFT and item.recording == recording for item in items])
        there = sum(item.kind == TIME_SHIFT and item.recording == recording for item in twin.circumstances)
        if clocks.any() and clocks.sum() == there:
            contrast = np.eye(len(items)) - np.outer(clocks, _middle(values, clocks))
            values, covariance = contrast @ values, contrast @ covariance @ contrast.T
    return values, covariance


def away_from_assumed(twin: WithCircumstances, items: Sequence[Circumstance]) -> Array:
    """How far from what was assumed a twin has circumstances (I,), in standard deviations of their priors.

    The directions of a fit have their priors about where the twin is; estimates are drawn back by this times their
    covariance. What a recording says little of would walk away, a part of the way each time that the twin is moved.
    """
    return np.array([(twin.values.get(item.name, item.assumed) - item.assumed) / item.std for item in items])


def estimates(at: Linearisation, residual: Array | None = None) -> tuple[Estimate, ...]:
    """What a fit says of the open circumstances, which are the last of its nuisances; clocks as `from_the_middle`.

    Args:
        at: the fit, linearised with them.
        residual: (n, C) what an explanation leaves that isn't the fit's own; None for its own.
    """
    twin = at.twin
    items = open_circumstances(twin)
    if not items or at.nuisance_response is None or not isinstance(twin, WithCircumstances):
        return ()
    scale = np.array([item.std for item in items])
    own = nuisance_covariance(at)[-len(items) :, -len(items) :]
    covariance = scale[:, None] * own * scale
    left = at.residual if residual is None else residual
    share = at.metric.nuisance_estimate(np.nan_to_num(left))[-len(items) :] - own @ away_from_assumed(twin, items)
    values = np.array([twin.values.get(item.name, item.assumed) for item in items]) + scale * share
    values, covariance = from_the_middle(twin, items, values, covariance)
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return tuple(Estimate(*row) for row in zip(items, values.tolist(), std.tolist(), strict=True))
