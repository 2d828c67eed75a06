"""Words for what a recording could show, and what goes unseen would move."""

from __future__ import annotations

from collections.abc import Mapping

from dieseltwin.discovery.verdict.unseen import HealthBias, most_first
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.report.discovery_words import magnitude_words, these


def bias_words(bias: HealthBias, effect: str) -> list[str]:
    """Health that an effect, unseen, would move, most first ("eta_sc −1.9 %")."""
    return [f"{name} {100 * change:+.2g} %".replace("-", "−") for name, change in most_first(bias, effect)]


def visible_table(smallest: Mapping[str, float], bias: HealthBias, recordings: int = 1) -> list[str]:
    """What so many recordings could show, as lines of text: smallest visible size, tolerance, the health parameter that
    an effect of that size, unseen, would move most, place."""
    rows = []
    for name, size in smallest.items():
        effect = EFFECTS[name]
        mark = "" if size <= effect.tolerance else f"  {size / effect.tolerance:.2g} x tolerance"
        shown = magnitude_words(name, size, None, effect.unit, extra=False, digits=2)
        least = magnitude_words(name, effect.tolerance, None, effect.unit, extra=False, digits=2)
        moved = "".join(bias_words(bias, name)[:1])
        line = f"{name:<31}{shown:>18}{least:>18}   {moved:<17} {effect.site}{mark}"
        rows.append((size / effect.tolerance, line))
    head = f"{these(recordings) + ' could show':<31}{'from':>18}{'of interest from':>18}   {'unseen, it moves':<17} in"
    return [head, *(line for _, line in sorted(rows))]
