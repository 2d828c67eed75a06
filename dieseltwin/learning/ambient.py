"""How well the weather and the charge of a reference are known themselves.

A case's ambient and charge temperature are told by an engine that was learned under those of its reference. Where a
column of the reference is off, all that is told later is off by as much. Without a column, of the charge's temperature
and the level of eta_vol only the product shows. As for health (`learning.levels`), the shape of a map isn't believed to
say anything of its mean. An ambient that no column gave was open when the engine was learned, and its deviation is in
what is known of the engine.
"""

from __future__ import annotations

import numpy as np

from dieseltwin.engine.map_corrections import CORRECTED_POINTS, basis
from dieseltwin.learning.belief import MAPS_AT
from dieseltwin.learning.domain import KNOWN_SHARE, functions_on_maps, uncertainty_along
from dieseltwin.learning.files import LearnedEngine
from dieseltwin.settings.search import CircumstanceSettings


def reference_std(learned: LearnedEngine, beliefs: CircumstanceSettings) -> dict[str, float]:
    """Standard deviation of a reference's own weather and charge that isn't part of its belief, by column [unit].

    Args:
        learned: with the recordings of its reference.
        beliefs: how far a reading may be off, and how far what no column gives. Several recordings are no surer than
            one: they have the same sensors.
    """
    read = {"p_amb_pa": beliefs.p_amb_read_pa, "t_amb_k": beliefs.t_amb_read_k, "t_im_k": beliefs.t_im_read_k}
    stds = {
        column: std for column, std in read.items()
        if any(column in item.columns and np.isfinite(item.columns[column]).any() for item in learned.recordings)
    }  # fmt: skip
    unread = min(learned.base.T_im * level_std(learned, "eta_vol"), beliefs.t_im_k)
    return {"t_im_k": unread, **stds}


def level_std(learned: LearnedEngine, point: str) -> float:
    """Standard deviation that is believed of a map's error in the mean of where the reference knows it [-]."""
    m, tables, believed = CORRECTED_POINTS.index(point), functions_on_maps(learned.base), learned.believed
    known = uncertainty_along(learned.belief, tables)[m] < KNOWN_SHARE * learned.errors
    at = np.flatnonzero(basis().maps == m)
    mean = tables[at][:, known if known.any() else np.ones_like(known)].mean(axis=1)
    own = believed.covariance[np.ix_(at + MAPS_AT.start, at + MAPS_AT.start)]
    return float(np.sqrt(mean @ own @ mean))
