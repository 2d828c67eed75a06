"""A petrol engine's verdict in one sentence."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from dieseltwin.discovery.verdict.document import Discrepancy
from dieseltwin.discovery.verdict.when import when_words
from dieseltwin.petrol.effects import sized, smallest

TOLD_LEVEL = 0.01  # shift of a level that the sentence tells [-]
_SENSOR = "sensor:"  # begin of the site of a reading
_LEVELS = {"eta_vol_level": "the level of the volumetric efficiency",
           "throttle_area_level": "the level of the throttle's area"}  # fmt: skip
IN_THE_SENTENCE = ("p_im_gain", "p_ic_gain", "w_af_gain", "intake_leak")


def sentence(d: Discrepancy, hidden: Sequence[Mapping[str, float]]) -> str:
    """The verdict in words.

    Args:
        d: the verdict.
        hidden: where nothing is found, the smallest sizes at the end that an effect shows which grows evenly to them,
            and those that one shows which was there from the first row on.
    """
    if not d.mismatch or d.location is None:
        shown = (smallest(name, size, [kind.get(name, math.inf) for kind in hidden])
                 for name in IN_THE_SENTENCE if (size := d.minimum_detectable.get(name)) is not None)  # fmt: skip
        return ("No mismatch beyond what healthy recordings differ by. Visible if begun after a tenth of it (if grown "
                f"slowly from there to the end; if there from the first row on): {', '.join(shown)}.")  # fmt: skip
    found = found_words(d)
    return f"{found[0].upper()}{found[1:]}.{_consequence(d) if d.effects[0].named else ''}"


def found_words(d: Discrepancy) -> str:
    """Where, what, how large and since when, of a mismatch."""
    if d.location is None:
        return ""
    since = when_words(d.location)
    told = []
    for e in d.effects:
        if e.magnitude is None:
            when = "" if d.location.onset_s is None else f", {since}"  # whether it was there all along isn't looked for
            return f"{_place(d.location.site)}{when}: none of the known effects explains it"
        same = f", not told from {', '.join(e.equivalent_names)}" if e.equivalent_names else ""
        told.append(f"{sized(e.name, e.magnitude, e.std)} ({e.name}){same}")
    return f"{_place(d.location.site)}: {'; and '.join(told)}; {since}"


def _place(site: str) -> str:
    reading = site.removeprefix(_SENSOR)
    return f"in the {site.replace('_', ' ')}" if reading == site else f"in the reading {reading}"


def _consequence(d: Discrepancy) -> str:
    """What the effect did to the levels, if it moved one, and to the held-out score."""
    text = ""
    names = [name for name in _LEVELS if name in d.health]
    worst = max(names, key=lambda name: abs(d.health[name].before - d.health[name].value), default=None)
    if worst is not None:
        level = d.health[worst]
        if abs(level.before - level.value) > TOLD_LEVEL:
            before, after = (f"{round(100 * v, 1) + 0.0:+.1f} %" for v in (level.before, level.value))  # no -0.0
            text = f" Unrepaired, {_LEVELS[worst]} ({worst}) would read {before} instead of {after}."
    first, second = d.fit.held_out_nll_before, d.fit.held_out_nll_after
    if first is not None and second is not None:
        text += f" Held-out negative log-likelihood {first:.2f} before, {second:.2f} after."
    return text
