"""Refits of many candidates at once: all advance together, one lane each, with the sensitivities of one linearisation.

A chord method: a refit costs a few simulations, not a few Jacobians.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dieseltwin.discovery.likelihood.fit import (
    Candidate,
    Fit,
    Linearisation,
    prior_precision,
    simulate_fits,
    within_limits,
)
from dieseltwin.discovery.likelihood.metric import covariance_of
from dieseltwin.discovery.likelihood.windows import bounded
from dieseltwin.discovery.twins.interface import Array

_CHORD_ROUNDS = 6


def base_magnitudes(base: Linearisation, candidate: Candidate) -> Array:
    """Where a candidate's magnitudes start: at the base's where it has the same effect, else at 0."""
    known = dict(zip(base.fit.candidate.names, base.fit.magnitudes, strict=True))
    return np.array([known.get(name, 0.0) for name in candidate.names])


def refit_all(
    base: Linearisation, candidates: Sequence[Candidate], responses: Sequence[Array]
) -> list[Fit]:
    """Chord refit of many candidates at once in the metric of `base`.

    Args:
        base: the linearisation that gives metric and parameter sensitivities.
        candidates: what to fit; they contain the effects of the base's own candidate or not.
        responses: responses (m, n, C) of the readings to the candidates' effects [per unit].
    """
    twin = base.twin
    P = len(twin.parameters)
    count = len(candidates)
    columns = [np.concatenate([base.jacobian[:P], np.asarray(r)]) for r in responses]
    ends = np.cumsum([len(r) for r in responses])[:-1]
    own = np.split(base.metric.project(np.concatenate(responses)), ends)  # at once: the metric is read once
    projected = [np.concatenate([base.projected[:P], rows]) for rows in own]
    precision = [prior_precision(twin, len(c.names)) for c in candidates]
    covariance = [covariance_of(a @ a.T + np.diag(b)) for a, b in zip(projected, precision, strict=True)]
    nominal = np.array([p.value for p in twin.parameters])

    best = [
        Fit(c, base.fit.parameters, base_magnitudes(base, c), base.fit.local, base.fit.objective, False)
        for c in candidates
    ]
    residuals = [np.nan_to_num(base.residual) for _ in range(count)]
    vectors = [base.projected_residual for _ in range(count)]
    shrink = np.ones(count)
    active = list(range(count))
    for _round in range(_CHORD_ROUNDS):
        trials, rests, predicted = [], [], []
        for k in active:
            fit = best[k]
            offset = np.zeros(len(precision[k]))
            offset[:P] = nominal - fit.parameters
            gradient = projected[k] @ vectors[k] + precision[k] * offset
            step = covariance[k] @ gradient
            predicted.append(float(gradient @ step))
            start = fit.magnitudes
            change = shrink[k] * step
            parameters, magnitudes = within_limits(
                twin, fit.parameters + change[:P], candidates[k].names, start + change[P:]
            )
            moved = np.concatenate([parameters - fit.parameters, magnitudes - start])
            rests.append(residuals[k] - np.tensordot(moved / shrink[k], columns[k], 1))
            trials.append(replace(fit, parameters=parameters, magnitudes=magnitudes))
        steps = base.metric.local_steps_beside_nuisances(np.stack(rests))
        trials = [
            replace(trial, local=bounded(twin, trial.local + shrink[k] * step))
            for trial, k, step in zip(trials, active, steps, strict=True)
        ]
        simulated = simulate_fits(twin, trials)
        new = np.nan_to_num(twin.measured[None] - simulated)
        new_vectors = base.metric.project(new)
        still = []
        for i, k in enumerate(active):
            objective = base.objective(new_vectors[i], trials[i].parameters)
            gain = best[k].objective - objective
            if np.isfinite(objective) and gain > 0:
                best[k] = replace(trials[i], objective=objective, converged=gain < 1.0)
                residuals[k], vectors[k] = new[i], new_vectors[i]
                shrink[k] = min(1.0, 2.0 * shrink[k])
                if gain > 0.2:
                    still.append(k)
            else:
                best[k] = replace(best[k], converged=predicted[i] < 1.0)
                shrink[k] *= 0.35
                if predicted[i] > 0.2 and shrink[k] > 0.02:
                    still.append(k)
        active = still
        if not active:
            break
    return [replace(fit, covariance=covariance[k]) for k, fit in enumerate(best)]


def nearer(base: Linearisation, fits: Sequence[Fit], before: Sequence[Fit]) -> list[Fit]:
    """For each fit of constant effects the earlier one of the same where that is the better in the metric of `base`."""
    constant = {fit.candidate.names: fit for fit in before if not fit.candidate.schedules}
    earlier = [constant[fit.candidate.names] for fit in fits if fit.candidate.names in constant]
    if not earlier:
        return list(fits)
    projected = base.metric.project(np.nan_to_num(base.twin.measured[None] - simulate_fits(base.twin, earlier)))
    judged = {
        fit.candidate.names: replace(fit, objective=base.objective(vector, fit.parameters))
        for fit, vector in zip(earlier, projected, strict=True)
    }
    return [min(fit, judged.get(fit.candidate.names, fit), key=lambda each: each.objective) for fit in fits]


def widen(at: Linearisation, factor: float) -> None:
    """Intervals for an explanation that is not quite right, by what it leaves over what chance leaves (Birge)."""
    at.covariance = factor * at.covariance
    at.fit = replace(at.fit, covariance=at.covariance)


def scatter(values: Array, about: Array, behind: Array) -> Array:
    """Deviation (P,) over rivals (F, P) from what is reported (P,), each by its likelihood.

    Args:
        behind: (F,) -2 log likelihood of each over the best; in units of their own where chance isn't what decides.
    """
    weights = np.exp(-0.5 * behind)
    return np.asarray(np.sqrt((weights[:, None] * (values - about) ** 2).sum(axis=0) / weights.sum()))
