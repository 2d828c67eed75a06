"""A law of what begins in the middle of a rig's recording, where no name explains it.

Terms without a name are let act from several times on, each simulated; from the best time on a law is looked for, and
its own date is moved until it fits best.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import cast

import numpy as np

from dieseltwin.discovery.laws.features import Feature, Structure, generic_features, score_features
from dieseltwin.discovery.laws.search import Law
from dieseltwin.discovery.laws.sensor import best_law
from dieseltwin.discovery.likelihood.fit import Linearisation, fit_fully
from dieseltwin.rigs.fitting import ROUNDS
from dieseltwin.rigs.onsets import allowed_rows, times_tried
from dieseltwin.rigs.twin import RigTwin
from dieseltwin.settings.search import RigSettings

_PASSES = 3  # the misfit that a law leaves says how large gains are, until the law stays
_LESS, _EVEN = 0.99, 1.01  # of the misfit of the law before, that another one, and the same one again, may leave


def writable(law: Law | None) -> Law | None:
    """A law that a rig's file can hold: at one site, as others have no meaning beyond what they were fitted to, of no
    sensor, and without an operator."""
    if law is None or law.faults or any(placed.form.operator for placed in law.placed):
        return None
    return law if all(rival.site == law.site for rival in law.rivals) else None


def later_law(at: Linearisation, settings: RigSettings, most: float) -> Law | None:
    """The law that explains most from some time on; None where there is none that a file can hold.

    Args:
        at: the rig fitted without it.
        settings: of the search.
        most: share of the squared misfit that a term, to first order, may leave for a law to be looked for [-]; from 1
            on any term will do.
    """
    law: Law | None = None
    least = np.inf
    with suppress(np.linalg.LinAlgError):  # the machine runs away with a law: the one before stays
        for turn in range(_PASSES):
            since = _strongest(at, settings)
            if since is None or (turn == 0 and since[1][0].gain < (1.0 - most) * at.fit.objective):
                break
            found = best_law(at.twin, at, since[1], since_s=since[0])
            if found is None:
                break
            at = _about_what_is_left(at, found)
            left = float(np.exp(np.nanmean(np.log(cast(RigTwin, at.twin).misfit))))
            stays = law is not None and _same(found, law)
            if left > least * (_EVEN if stays else _LESS):
                break  # far from the machine as it is, a sum of two comes near to what one term says
            law, least = found, min(left, least)
            if stays:
                break
    return writable(law)


def _same(one: Law, other: Law) -> bool:
    """Whether two laws are one, whenever they begin."""
    forms, others = ([placed.form.key for placed in law.since(0.0).placed] for law in (one, other))
    return one.site == other.site and forms == others


def _strongest(at: Linearisation, settings: RigSettings) -> tuple[float, list[Structure]] | None:
    """Since when the strongest of all terms without a name acts [s], and all of them scored so; None where none says
    anything."""
    twin = cast(RigTwin, at.twin)
    rows, features = allowed_rows(twin, settings), generic_features(twin, at.fit)
    if len(rows) < 2 or not features:
        return None
    scored = ((since_s, _terms_since(at, features, since_s)) for since_s in times_tried(twin, rows))
    return max((item for item in scored if item[1]), key=lambda item: item[1][0].gain, default=None)


def _terms_since(at: Linearisation, features: Sequence[Feature], since_s: float) -> list[Structure]:
    acts = (at.twin.time_s >= since_s).astype(np.float64)
    return score_features(at, [replace(feature, signal=feature.signal * acts) for feature in features])


def _about_what_is_left(at: Linearisation, law: Law) -> Linearisation:
    """The fit without the law, in the size of the misfit that the law leaves."""
    inside, fit = law.on(at.twin)
    left = fit_fully(inside, at.whitening, fit, rounds=ROUNDS)
    twin = cast(RigTwin, at.twin).about(left.residual)
    return fit_fully(twin, twin.whitening(), at.fit, rounds=ROUNDS)
