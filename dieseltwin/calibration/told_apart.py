"""Which names and which faults of a sensor settled points can't tell from what was found."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dieseltwin.calibration.discover import PointsDiscovery, Round
from dieseltwin.calibration.steady_model import CHARGE_OFFSET
from dieseltwin.discovery.likelihood.fit import Fit
from dieseltwin.discovery.verdict.document import Discrepancy
from dieseltwin.discovery.verdict.unseen import most_first
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.notes import Note, listing

_APART = {
    "t_c_k": {"compressor_efficiency_loss", "turbine_efficiency_loss"},
    "t_im_k": {"charge_cooler_loss", "egr_heating", "volumetric_efficiency_residual"},
    "p_es_pa": {"back_pressure", "vgt_offset"}, "p_bc_pa": {"air_filter_restriction", "compressor_flow_loss"},
}  # fmt: skip
"""Reading -> names that it tells from one another."""

_UNSEEN = 3.0  # tolerances: what shows below is seen where it matters
_MOVES = 0.005  # of health per tolerance: half of what a health parameter may be off by after a repair


def fits_of(item: Round) -> list[Fit]:
    """Of the single names of a round; of those that begin at a point where its choice does."""
    return item.found.singles if item.onset is None else [item.onset.fit, *item.onset.others]


def alike(item: Round, name: str) -> tuple[str, ...]:
    """Names and faults that the points can't tell from one: what that leaves is the size of what the balances can't
    describe, so closer ones can't be told apart either."""
    found, fits = item.found, fits_of(item)
    left = found.left[0].gain if found.left and item.onset is None else 0.0
    reach = max(found.settings.equivalent_gain, left)
    best = max(found.gain(fit) for fit in fits)
    own = next((found.gain(fit) for fit in fits if fit.candidate.names == (name,)), best)
    return tuple(fit.candidate.names[0] for fit in fits
                 if own - found.gain(fit) < reach and fit.candidate.names[0] not in item.names)


def equivalent(item: Round, name: str) -> tuple[str, ...]:
    """Those of `alike` that have a name of the catalogue."""
    return tuple(other for other in alike(item, name) if other in EFFECTS)


def split_by(name: str, others: Sequence[str], extra: Sequence[str]) -> str | None:
    """The reading that would tell a name from the others; None where none is known."""
    known = (c for c, names in _APART.items() if c not in extra and name in names and not names.isdisjoint(others))
    return next((f"a {column} sensor" for column in known), None)


def sensor_notes(result: PointsDiscovery) -> list[Note]:
    """Sensors of which gain and offset are alike at these points, where that doesn't stand beside the name already."""
    notes = []
    for item in result.rounds:
        for name in (n for n in item.names if item.taken and n in result.effects):
            site = item.found.twin.hypotheses[name].site
            column = site.removeprefix("sensor:")
            others = [n for n in alike(item, name)
                      if item.found.twin.hypotheses[n].site == site and not {name, n} <= set(EFFECTS)]
            if column != site and (others or (name == CHARGE_OFFSET and _charge_may_be_a_gain(result, item))):
                notes.append(Note(f"{column}: at these points a gain and an offset of the reading can't be told apart; "
                                  "points with lower and with higher readings would tell", "not_identifiable",
                                  (column,)))  # fmt: skip
    return notes


def _charge_may_be_a_gain(result: PointsDiscovery, item: Round) -> bool:
    """Whether a gain of the charge's reading as large as its offset in the middle would differ by less than tells names
    apart: nothing else is looked for, as the charge has nearly one temperature."""
    twin, points = item.found.twin, result.points.judged
    read = points["t_im_k"][np.isfinite(points["t_im_k"])]
    row = twin.channels.index("T_im")
    apart = result.effects[CHARGE_OFFSET][0] * (read / read.mean() - 1.0) / read
    deviation = float(result.repaired.estimate.discrepancy[row])
    return bool(np.sum((apart / deviation) ** 2) < item.found.settings.equivalent_gain)


def unseen(found: Discrepancy) -> list[str]:
    """A line of effects that health takes up long before the points show them, with how far it would move until then;
    none beside a reference. An exhaust temperature that reads some per cent too much is a better cycle."""
    named = {effect.name for effect in found.effects}
    told = []
    for name, size in found.minimum_detectable.items():
        effect, bias = EFFECTS[name], most_first(found.health_bias, name)
        slope = abs(bias[0][1]) * effect.tolerance / size if bias and size > _UNSEEN * effect.tolerance else 0.0
        if slope > _MOVES and name not in named:
            moved, change = bias[0]
            seen = f"{size:.2g} {effect.unit}".removesuffix(" -")
            told.append((-slope, f"{name} below {seen} ({moved} {100 * change:+.2g} %)"))
    return [] if found.reference or not told else [
        "not seen in all points alike, as health takes it up (by so much at the size that would show): "
        f"{listing([text for _, text in sorted(told)])}; points from when the engine was well (--reference) tell"
    ]
