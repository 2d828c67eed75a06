"""Every found law as a card: its formula, its size with unit, what it means in words, and how sure it is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from dieseltwin.discovery.verdict.document import Discrepancy, FoundEffect
from dieseltwin.discovery.verdict.when import only_in_words
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.report import quantities
from dieseltwin.report.discovery_words import effect_words, magnitude_words, site_of, site_words
from dieseltwin.report.mathml import laws_markup, name_markup, symbols_in

SURE = ((0.99, "practically certain"), (0.9, "very likely"), (0.7, "likely"), (0.5, "more likely than not"))
UNSURE = "one possibility among several"


@dataclass(frozen=True)
class Told:
    """What a machine's catalogue says of an effect that was found.

    Attributes:
        title: what it is and how large ("a boost leak of 41.0 ± 2.0 mm²").
        about: what it means, a sentence; "" for none.
        site: where it enters; "" where that isn't known.
        laws: formulae.
        symbol: of the magnitude; "" for none.
        size: with unit.
        symbols: of the formulae, with meanings and units.
    """

    title: str
    about: str
    site: str
    laws: tuple[str, ...]
    symbol: str
    size: str
    symbols: tuple[tuple[str, str], ...] = ()


Teller = Callable[[FoundEffect], Told | None]
"""What a machine says of an effect; None for one that its catalogue doesn't hold."""


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
        text: the law as documents have it.
    """

    title: str
    meaning: str
    formula: Markup
    size: Markup
    symbols: tuple[tuple[Markup, str], ...]
    sure: str
    holds: str
    text: str = ""


def diesel(effect: FoundEffect) -> Told | None:
    """What the catalogue of the diesel engine says."""
    entry = EFFECTS.get(effect.name)
    if entry is None or effect.magnitude is None:
        return None
    size = magnitude_words(effect.name, effect.magnitude, effect.std, effect.unit)
    return Told(effect_words(effect), entry.about, entry.site, (effect.law or entry.law,), entry.symbol, size)


def law_cards(document: Discrepancy, tell: Teller = diesel, judged: str = "This recording") -> list[LawCard]:
    """A card for each effect that was found, strongest first.

    Args:
        document: the verdict.
        tell: what the machine's catalogue says.
        judged: what it was found in.
    """
    return [_card(effect, document, tell(effect), judged) for effect in document.effects]


def _card(effect: FoundEffect, document: Discrepancy, told: Told | None, judged: str) -> LawCard:
    law = effect.law or ""
    location = document.location
    if told is None:
        site = site_of(effect.name) or (location.site if location is not None else "")
        title = effect_words(effect) if effect.named else "what no effect of the catalogue explains"
        told = Told(title, "", site, (law,) if law else (), "", "")
    where = f"It enters in {site_words(told.site)}." if told.site else ""
    if location is not None and location.only_in:
        where += f" It acts {only_in_words(location)}."
    if effect.since_row is not None:
        where += f" It is there since data row {effect.since_row}."
    size = f"{name_markup(told.symbol)} = {told.size}" if told.symbol else ""
    known = ((s.name, s.meaning + ("" if s.unit == "-" else f" [{s.unit}]")) for s in symbols_in(" ".join(told.laws)))
    symbols = tuple((Markup(name_markup(name)), words) for name, words in told.symbols or known)
    about, valid_for = map(quantities.with_symbols, (f"{told.about} {where}".strip(), (effect.valid_for or "").strip()))
    return LawCard(told.title[:1].upper() + told.title[1:], about, _typeset(told.laws), Markup(size), symbols,
                   _sure(effect, judged), valid_for, law if law in told.laws else "")  # fmt: skip


def _typeset(laws: Sequence[str]) -> Markup:
    return Markup("").join(Markup(laws_markup(law)) for law in laws)


def _sure(effect: FoundEffect, judged: str) -> str:
    if not effect.equivalent_names:
        words = next((words for least, words in SURE if effect.probability >= least), UNSURE)
        return f"{words.capitalize()} ({quantities.probability(effect.probability)})."
    # a probability beside names that are as good would read as if it were settled
    text = f"The likeliest name. {judged} can't tell it from {' or '.join(effect.equivalent_names)}."
    return f"{text} {effect.split_by.capitalize()} would settle it." if effect.split_by else text
