"""The law's last fit: initial states and tolerances linearised about the law itself, not about the fit without it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import cast

import numpy as np

from dieseltwin.discovery.laws.twin import LawTwin
from dieseltwin.discovery.likelihood.fit import Fit, Linearisation, fit_fully, settle_local
from dieseltwin.discovery.twins.interface import Array, Lanes, Twin, WithSignals

Tolerances = Callable[[Linearisation], Array]
"""Tolerance directions (K, n, C) about a linearisation."""

_ROUNDS = 6
_PASSES = 2
_SETTLED = 0.3  # of a standard deviation: change in a pass that counts as none


def signals_of(law: LawTwin, lanes: Lanes) -> dict[str, Array]:
    """Point -> (n,) what the laws add there in total along the trajectory of lane 0."""
    return law.entered(law.signals(lanes))


def about_itself(at: Linearisation, tolerances: Tolerances | None, passes: int = _PASSES) -> Linearisation:
    """A fit of a twin with a law or faults inside, with initial states and tolerances linearised about itself.

    Where the law is large the tolerances of the fit without it are not the law's: its size comes out wrong by up to a
    tenth, with too narrow an interval. The objective is of its own.

    Args:
        at: converged fit of a `LawTwin` or `ReadingTwin`.
        tolerances: directions about a linearisation of the twin; None keeps those of `at`.
        passes: at most, each with tolerances anew.
    """
    if tolerances is None or at.nuisance_response is None:
        return at
    centre = at.fit
    for _ in range(passes):
        own = tolerances(_held(at, centre))
        try:
            last, at = at, settle_local(fit_fully(at.twin, at.whitening, centre, own, _ROUNDS))
        except np.linalg.LinAlgError:  # the machine runs away with some tolerance: what was used so far must do
            break
        # half way: about each other's ends the fits would swing from one side of the estimate to the other
        middle = 0.5 * (last.fit.parameters + at.fit.parameters)
        centre = replace(at.fit, parameters=middle, local=0.5 * (last.fit.local + at.fit.local))
        if at.fit.converged and np.all(np.abs(at.fit.parameters - last.fit.parameters) < _SETTLED * at.fit.std):
            break
    return at


def _held(at: Linearisation, fit: Fit) -> Linearisation:
    """A law's twin at a fit with the law's signal held: maps off by a little hardly move it. Others as they are."""
    law = at.twin
    if not isinstance(law, LawTwin):
        return Linearisation(law, at.whitening, fit, at)
    fixed = cast(Twin, WithSignals(law.base, signals_of(law, fit.lanes())))
    start = replace(fit, parameters=fit.parameters[: len(law.base.parameters)])
    return Linearisation(fixed, at.whitening, start, at)
