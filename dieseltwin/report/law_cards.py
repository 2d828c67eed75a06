"""Every found law as a card: its formula, its size with unit, what it means in words, and how sure it is."""

from __future__ import annotations

import importlib
from dataclasses import dataclass

from markupsafe import Markup

from dieseltwin.discovery.verdict.curves import Discovery
from dieseltwin.discovery.verdict.document import Discrepancy, FoundEffect
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.report import quantities
from dieseltwin.report.discovery_words import effect_words, magnitude_words, site_of, site_words
from dieseltwin.report.mathml import law_markup, name_markup, symbols_in

SURE = ((0.99, "practically certain"), (0.9, "very likely"), (0.7, "likely"), (0.5, "more likely than not"))
UNSURE = "one possibility among several"


@dataclass(frozen=True)
class LawCard:
    """A law for people.

    Attributes:
        title: what it is and how large ("A boost leak of 41.0 ± 2.0 mm²").
        meaning: in a sentence or two.
        formula: HTML.
        size: the magnitude's symbol and value as HTML; "" for a law whose numbers stand in it.
        symbols: of the formula, as HTML, with meanings and units.
        sure: how sure, in words.
        holds: where it holds; "" everywhere.
    """

    title: str
    meaning: str
    formula: Markup
    size: Markup
    symbols: tuple[tuple[Markup, str], ...]
    sure: str
    holds: str


def law_cards(found: Discovery) -> list[LawCard]:
    """A card for each effect that was found, strongest first."""
    return [_card(effect, found.document) for effect in found.document.effects]


def _card(effect: FoundEffect, document: Discrepancy) -> LawCard:
    entry = EFFECTS.get(effect.name)
    law = effect.law or ""
    words = effect_words(effect) if effect.named else "a law that no effect of the catalogue explains"
    location = document.location
    site = site_of(effect.name) or (location.site if location is not None else "")
    meaning = f"It enters in {site_words(site)}." if site else ""
    if entry is not None:
        meaning = f"{_about(effect.name)} {meaning}".strip()
    size = ""
    if entry is not None and effect.magnitude is not None:
        shown = magnitude_words(effect.name, effect.magnitude, effect.std, effect.unit)
        size = f"{name_markup(entry.symbol)} = {shown}"
    symbols = tuple((Markup(name_markup(s.name)), s.meaning + ("" if s.unit == "-" else f" [{s.unit}]"))
                    for s in symbols_in(law))  # fmt: skip
    return LawCard(words[:1].upper() + words[1:], meaning, Markup(law_markup(law)) if law else Markup(""),
                   Markup(size), symbols, _sure(effect), effect.valid_for or "")  # fmt: skip


def _about(name: str) -> str:
    """The first sentence about an effect: that of the file that it stands in."""
    text = importlib.import_module(f"dieseltwin.engine.effects.{name}").__doc__ or ""
    return text.split("\n\n")[0].replace("\n", " ").strip()


def _sure(effect: FoundEffect) -> str:
    words = next((words for least, words in SURE if effect.probability >= least), UNSURE)
    shown = "more than 99.9 %" if effect.probability > 0.999 else quantities.percent(effect.probability)
    text = f"{words.capitalize()} ({shown})."
    if effect.equivalent_names:
        text += f" This recording can't tell it from {' or '.join(effect.equivalent_names)}."
        if effect.split_by:
            text += f" {effect.split_by.capitalize()} would settle it."
    return text
