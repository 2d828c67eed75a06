"""What engines of one type say of the next one: their maps' errors are the type's and each engine's own.

The error of engine i over the basis of `engine.map_corrections` is t + o_i, with t common to the type and o_i its own,
both Gaussian and smooth alike; t has a declared share of the variance. What engine i was learned from is a
Gaussian factor over t + o_i (its posterior divided by its prior, with health and sensors integrated out). Integrating
o_i out leaves a factor over t; the factors multiply, so that the order of the engines doesn't matter (Gelman et al.,
Bayesian Data Analysis, 3rd edition, section 5.4, with vectors in place of scalars).

How far the compressor's maps go by corrected flow and speed is the type's alone: a maker's map goes with the wheel. An
engine that was learned in other weather has the same map at another flow and speed, and so another correction of the
published one. How much another depends on the exponents, which are unknowns beside t: nothing at 0, and at 1 what the
published map changes by from the flow and speed of one weather to those of the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from dieseltwin.engine import EngineParameters, constants
from dieseltwin.engine.binding import numpy_model
from dieseltwin.engine.map_corrections import ARGUMENTS, CORRECTED_POINTS, NODES, RANGES, basis
from dieseltwin.learning.belief import MAPS_AT, NOTHING_FURTHER, Array, Belief, Further, prior_belief
from dieseltwin.learning.domain import KNOWN_SHARE, functions_on_maps, uncertainty_along
from dieseltwin.learning.weather import EXPONENTS, Exponent, OfType
from dieseltwin.least_squares import without_negative
from dieseltwin.settings.search import CircumstanceSettings

_LEAST_SHARE = 1e-12  # where nothing is the type's
_SAID = 1e-6  # deviation of an exponent that the base's file says [-]
_SAME = 1e-3  # of a deviation, by which an engine knows an exponent better than it was told, to have learned any of it
_MOST_ALIKE = 0.999  # of the siblings' exponents, so that they can be weighed
_LEAST_LIFT = 0.02  # of efficiency and flow coefficient, at or below which the compressor lifts nothing [-]
_ROUND = 1e-3  # of a function's mean square, that a change's share of it has to be ahead of [-]


@dataclass(frozen=True)
class Sibling:
    """An engine of the type that was learned.

    Attributes:
        before, after: what was believed before anything was learned of it, and what is believed now.
        engine: with the weather that its maps are of.
        exponents: of its compressor, as it was learned with; of_type: those that were believed before.
        errors: size of its maps' errors [-].
    """

    before: Belief
    after: Belief
    engine: EngineParameters
    errors: float
    exponents: Mapping[str, Exponent] = field(default_factory=dict)
    of_type: Mapping[str, Exponent] = field(default_factory=dict)


def belief_from_siblings(
    siblings: Sequence[Sibling], engine: EngineParameters, map_rms: float, type_share: float,
    beliefs: CircumstanceSettings, further: Further = NOTHING_FURTHER,
) -> tuple[Belief, OfType]:  # fmt: skip
    """What is believed of a new engine of a type of which some engines were learned: of its maps, and of its compressor
    in other weather.

    Args:
        siblings: at least one.
        engine: base of the new one, with the same published maps, in the weather that its own are to be of.
        map_rms: size of the maps' smooth relative errors [-].
        type_share: of their variance that is the type's, 0-1 [-].
        beliefs: what is believed of exponents that nobody said.
        further: errors of the maps of the type beyond the usual ones.
    """
    prior = prior_belief(engine, map_rms, further)
    believed = prior.covariance[MAPS_AT, MAPS_AT]
    own = (1.0 - type_share) * believed
    count = len(believed)
    usual = {
        name: Exponent(value, getattr(beliefs, name) if value not in (0.0, 1.0) else _SAID)
        for name, value in ((name, float(getattr(engine, name))) for name in EXPONENTS)
    }
    information = np.zeros((count + len(EXPONENTS), count + len(EXPONENTS)))
    information[:count, :count] = np.linalg.inv(believed) / max(type_share, _LEAST_SHARE)
    vector = np.zeros(len(information))
    _add(usual, information, vector)
    _add(_heard(siblings, usual, min(type_share, _MOST_ALIKE)), information, vector)
    for one in siblings:
        seen, pushed = _factor(one.before, one.after)
        kept = np.linalg.inv(np.eye(count) + seen @ own)
        some = kept @ seen
        of_all = np.concatenate([np.eye(count), _elsewhere(one, engine).T], axis=1)
        information += of_all.T @ (0.5 * (some + some.T)) @ of_all
        vector += of_all.T @ kept @ pushed
    together = np.linalg.inv(information)
    values, std = together @ vector, np.sqrt(np.diag(together))
    mean, covariance = prior.mean.copy(), prior.covariance.copy()
    mean[MAPS_AT] = values[:count]
    of_type = together[:count, :count]
    covariance[MAPS_AT, MAPS_AT] = 0.5 * (of_type + of_type.T) + own
    told = {
        name: Exponent(float(value), float(sd)) for name, value, sd in
        zip(EXPONENTS, values[count:], std[count:], strict=True) if _SAID < sd < KNOWN_SHARE * usual[name].std
    }  # fmt: skip
    return Belief(mean, covariance), OfType(told, engine.p_cmap, engine.T_cmap)


def _heard(siblings: Sequence[Sibling], usual: Mapping[str, Exponent], alike: float) -> dict[str, Exponent]:
    """What the siblings say of the exponents beyond what was believed before.

    What a sibling leaves open of an exponent is what its maps leave open, and their errors are the type's for the most
    part: two siblings that drove cold in town and warm in the hills had 1.15 and 1.22 ± 0.16, where 1 was true.

    Args:
        usual: what is believed of exponents that nobody said; alike: correlation of the siblings' errors, 0-1 [-].
    """
    found = {}
    for name in EXPONENTS:
        said = [(one.exponents[name], one.of_type.get(name, usual[name])) for one in siblings if name in one.exponents]
        own = [(now, before) for now, before in said if now.std < (1.0 - _SAME) * before.std]
        if not own:
            continue
        weights = np.array([now.std**-2 - before.std**-2 for now, before in own])
        pushes = np.array([now.value * now.std**-2 - before.value * before.std**-2 for now, before in own])
        std = weights**-0.5
        precision = np.linalg.inv(np.outer(std, std) * (alike + (1.0 - alike) * np.eye(std.size)))
        among = precision.sum(axis=0)
        found[name] = Exponent(float(among @ (pushes / weights) / among.sum()), float(among.sum() ** -0.5))
    return found


def _add(exponents: Mapping[str, Exponent], information: Array, vector: Array) -> None:
    """Add what is said of exponents to the information, whose last rows they are."""
    for name, item in exponents.items():
        at = len(vector) - len(EXPONENTS) + EXPONENTS.index(name)
        information[at, at] += item.std**-2
        vector[at] += item.value * item.std**-2


def _elsewhere(one: Sibling, here: EngineParameters) -> Array:
    """(2, K) what is added to the corrections of a map per unit of its exponent, where it is told in a sibling's
    weather in place of another's; of the compressor's efficiency and flow, as they are where the sibling knows them."""
    there, functions, model = one.engine, basis(), numpy_model()
    c = constants(here.replace(k_cflow=0.0, k_cspeed=0.0))
    uncertain = uncertainty_along(one.after, functions_on_maps(there))
    warmer = (there.T_cmap / here.T_cmap) ** 0.5

    def efficiency(flow: Array, Pi_c: Array) -> Array:
        return np.asarray(model.eta_c(flow, Pi_c, c))

    def flow(omega_t: Array, Psi_c: Array) -> Array:
        psi = Psi_c - c.c_psi2
        rest = 1.0 - model.ellipse_coefficient_psi(omega_t, c) * psi * psi
        return np.asarray(np.sqrt(np.maximum(rest / model.ellipse_coefficient_phi(omega_t, c), 0.0)) + c.c_phi2)

    out = np.zeros((len(EXPONENTS), functions.maps.size))
    maps = (("eta_c", ("W_c", "Pi_c"), efficiency, warmer * here.p_cmap / there.p_cmap),
            ("W_c", ("omega_t", "Psi_c"), flow, 1.0 / warmer))  # fmt: skip
    for row, (point, names, published, times) in enumerate(maps):
        m = CORRECTED_POINTS.index(point)
        nodes = (np.linspace(*RANGES[name], NODES) for name in ARGUMENTS[point])
        at = dict(zip(ARGUMENTS[point], (some.ravel() for some in np.meshgrid(*nodes, indexing="ij")), strict=True))
        before, after = published(at[names[0]], at[names[1]]), published(times * at[names[0]], at[names[1]])
        known = (uncertain[m] < KNOWN_SHARE * one.errors) & (before > _LEAST_LIFT) & (after > _LEAST_LIFT)
        if times == 1.0 or not known.any():
            continue
        which = np.flatnonzero((functions.maps == m) & functions.usual)
        some, weights = functions.tables[which].reshape(which.size, -1)[:, known], uncertain[m][known] ** -2.0
        square = (weights * some) @ some.T + _ROUND * weights.sum() * np.eye(which.size)
        out[row, which] = np.linalg.solve(square, some @ (weights * (after[known] / before[known] - 1.0)))
    return out


def _factor(before: Belief, after: Belief) -> tuple[Array, Array]:
    """Information (K, K) and its vector (K,) of what was learned about the maps, health and sensors integrated out."""
    precisions = [np.linalg.inv(belief.covariance[MAPS_AT, MAPS_AT]) for belief in (before, after)]
    seen = without_negative(precisions[1] - precisions[0])
    return seen, precisions[1] @ after.coefficients - precisions[0] @ before.coefficients
