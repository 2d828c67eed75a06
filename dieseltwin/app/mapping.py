"""The channel map as a form: a row for each of our quantities, and the way back from what a browser sends."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from dieseltwin.api.channels import AMBIENT, STAND_IN_PA, Quantity, channel_map, quantities
from dieseltwin.atomic import write_text
from dieseltwin.errors import InputError
from dieseltwin.settings.strict import read_mapping

DATABASE_KEY = "dbc"
DENSITY_KG_L = 0.835
AS_IT_IS = ""
MOST_CYLINDERS = 32
_MOST_DIGITS = 9

Content = dict[str, Any]
"""A channel map: foreign name -> {column, unit, scale, offset, via, ...}."""


@dataclass(frozen=True)
class Choice:
    """One entry of a list to choose from."""

    value: str
    words: str
    chosen: bool


@dataclass(frozen=True)
class Row:
    """One of our quantities in the form.

    Attributes:
        quantity: which.
        channels, readings: to choose from; a reading is a unit, or a formula with its unit.
        scale, offset: what is done besides.
        state: found, check, missing or unused.
        words: reasons, warnings or what its absence costs.
    """

    quantity: Quantity
    channels: tuple[Choice, ...]
    readings: tuple[Choice, ...]
    scale: str
    offset: str
    state: str
    words: tuple[str, ...]


def read_content(path: Path) -> Content:
    """The channel map of a file with every entry written out; empty where there is none."""
    if not path.is_file():
        return {}
    content = read_mapping(path)
    return {name: {"column": value} if isinstance(value, str) and name != DATABASE_KEY else value
            for name, value in content.items()}  # fmt: skip


def form_rows(found: Mapping[str, Any], content: Content) -> tuple[Row, ...]:
    """The rows of the form.

    Args:
        found: what was found in the file (`api.channels.ChannelsFound.to_json`).
        content: the map as it is.
    """
    by_column = {entry["column"]: (name, entry) for name, entry in content.items() if isinstance(entry, dict)}
    needs_time = bool(found["table"])
    return tuple(_row(quantity, found, by_column.get(quantity.column)) for quantity in quantities()
                 if needs_time or quantity.column != "time_s")  # fmt: skip


def _row(quantity: Quantity, found: Mapping[str, Any], used: tuple[str, Mapping[str, Any]] | None) -> Row:
    names = [channel["channel"] for channel in found["channels"]]
    guess = found["guesses"].get(quantity.column)
    clock = found["clock"] if quantity.column == "time_s" else None
    entry: Mapping[str, Any] = {}
    name = None
    if used is not None:
        name, entry = used
    elif quantity.column in names:  # a column that has our name needs no entry
        name = quantity.column
    channels = [Choice("", "none", name is None)]
    channels += [Choice(str(i), _channel_words(channel), channel["channel"] == name)
                 for i, channel in enumerate(found["channels"])]
    state, words = "unused", [quantity.cost] if quantity.cost else []
    if name is not None:
        state, words = "found", []
        if guess is not None and guess["channel"] == name:
            words = [*guess["warnings"], *guess["reasons"]]
            state = "check" if guess["warnings"] else "found"
        elif clock is not None and name == clock["channel"]:
            words = [*clock["warnings"], "it rises like a clock"]
            state = "check" if clock["warnings"] else "found"
    elif quantity.cost:
        state = "missing"
    return Row(quantity, tuple(channels), tuple(_readings(quantity, entry)), f"{entry.get('scale', 1.0):.10g}",
               f"{entry.get('offset', 0.0):.10g}", state, tuple(words))  # fmt: skip


def _channel_words(channel: Mapping[str, Any]) -> str:
    name = channel["channel"][:80]
    unit = f" [{channel['unit']}]" if channel["unit"] and channel["unit"] not in name else ""
    low, high = channel["low"], channel["high"]
    span = "" if low is None or high is None else f", {low:.4g} to {high:.4g}"
    return f"{name}{unit}{span}"


def _readings(quantity: Quantity, entry: Mapping[str, Any]) -> list[Choice]:
    now = (entry.get("via"), entry.get("unit"))
    choices = [Choice(AS_IT_IS, f"{quantity.unit}, as it is", now == (None, None))]
    choices += [Choice(f"unit:{unit}", unit, now == (None, unit)) for unit in quantity.units]
    for via, (words, units, _, _) in quantity.formulas.items():
        choices += [Choice(f"via:{via}:{unit}", f"{unit}, {words}", now == (via, unit)) for unit in units]
    return choices


def common_values(content: Content, found: Mapping[str, Any]) -> dict[str, str]:
    """What all formulas share: cylinders, density of the fuel, ambient pressure where no channel gives it."""
    entries = [entry for entry in content.values() if isinstance(entry, dict)]

    def first(key: str, default: float) -> str:
        return f"{next((entry[key] for entry in entries if key in entry), default):.10g}"

    return {"cylinders": first("cylinders", found["cylinders"]), "density_kg_l": first("density_kg_l", DENSITY_KG_L),
            "ambient_pa": first("ambient_pa", STAND_IN_PA)}  # fmt: skip


def content_of(form: Mapping[str, str], names: Sequence[str], before: Content) -> Content:
    """The channel map that a form asks for.

    Args:
        form: its fields.
        names: the file's channels in the order of the form: a browser sends their numbers.
        before: the map as it was; what the form doesn't show is kept.

    Raises:
        InputError: a field that says something impossible, or one channel for two quantities.
    """
    shown = {quantity.column: quantity for quantity in quantities()}
    content: Content = {
        name: entry for name, entry in before.items()
        if not isinstance(entry, dict) or entry["column"] not in shown or f"channel-{entry['column']}" not in form
    }  # fmt: skip
    given = {column for column in shown if form.get(f"channel-{column}", "")}
    for column in shown:
        number = form.get(f"channel-{column}", "")
        if not number:
            continue
        place = whole_number(number, 0, len(names) - 1)
        if place is None:
            raise InputError(column, repr(number[:20]), "a channel of this file", "choose one of the list")
        name = names[place]
        if name in content:
            raise InputError(f"channel {name!r}", f"chosen for {content[name]['column']} and {column}",
                             "one quantity for each channel", "choose another one")
        content[name] = _entry(shown[column], form, AMBIENT in given)
    channel_map(content, "channel map")
    return content


def _entry(quantity: Quantity, form: Mapping[str, str], ambient_is_given: bool) -> Content:
    column = quantity.column
    entry: Content = {"column": column}
    kind, _, rest = form.get(f"reading-{column}", "").partition(":")
    if kind == "unit":
        entry["unit"] = rest
    elif kind == "via":
        entry["via"], _, entry["unit"] = rest.partition(":")
        formula = quantity.formulas.get(entry["via"])
        if formula is not None:
            if formula[3]:
                entry["cylinders"] = cylinders_of(form.get("cylinders", "").strip() or "6")
            if AMBIENT in formula[2] and not ambient_is_given:
                entry["ambient_pa"] = _number(form, "ambient_pa", STAND_IN_PA)
            if entry["via"].startswith("fuel_volume"):
                entry["density_kg_l"] = _number(form, "density_kg_l", DENSITY_KG_L)
    for key, usual in (("scale", 1.0), ("offset", 0.0)):
        value = _number(form, f"{key}-{column}", usual)
        if value != usual:
            entry[key] = value
    return entry


def _number(form: Mapping[str, str], key: str, usual: float) -> float:
    text = form.get(key, "").strip().replace(",", ".")
    if not text:
        return usual
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(key, repr(text[:20]), "a number", "mend this field")
    return value


def whole_number(text: str, low: int, high: int) -> int | None:
    """The number that a field says; None for what is no whole number from low to high."""
    digits = text.isdecimal() and len(text) <= _MOST_DIGITS
    return int(text) if digits and low <= int(text) <= high else None


def cylinders_of(text: str) -> int:
    """The number of cylinders that a field says.

    Raises:
        InputError: another text, or no engine's number.
    """
    found = whole_number(text, 1, MOST_CYLINDERS)
    if found is None:
        raise InputError("cylinders", repr(text[:20]), f"1 to {MOST_CYLINDERS}", "mend this field")
    return found


def write_content(content: Content, path: Path) -> None:
    """Write a channel map."""
    text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=10_000)
    write_text(path, f"# Channel map, made with `dieseltwin app`; --channels accepts it.\n{text}")
