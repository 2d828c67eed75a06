"""`dieseltwin effects`, and the option `--effect NAME=VALUE`."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import Annotated

import typer

from dieseltwin.errors import InputError

EffectOption = Annotated[
    list[str] | None,
    typer.Option(
        "--effect", metavar="NAME=VALUE", help="Add an effect that the engine file leaves out; repeatable. See "
        "`dieseltwin effects`.",
    ),
]  # fmt: skip

HEADINGS = ("name", "law", "unit", "range", "tolerance", "site", "confused with")


def show_effects(
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="Print the table of the documentation.")] = False,
) -> None:
    """List the effects that `simulate --effect` and `discover` know."""
    for line in json_lines() if as_json else markdown_lines() if markdown else table_lines():
        typer.echo(line)


def json_lines() -> Iterator[str]:
    """The catalogue as strict JSON: a list of objects, the attributes of `engine.effect.Effect`."""
    from dieseltwin.engine.effects import EFFECTS

    yield json.dumps([effect.document() for effect in EFFECTS.values()], indent=2, ensure_ascii=False, allow_nan=False)


def table_lines() -> Iterator[str]:
    """The catalogue as a table, columns of `HEADINGS`."""
    from dieseltwin.engine.effects import EFFECTS
    from dieseltwin.report.circumstance_words import NEARLY_HEALTH

    rows = [HEADINGS] + [
        (e.name, e.law, e.unit, f"{e.limits[0]:g} to {e.limits[1]:g}", f"{e.tolerance:g}", e.site,
         ", ".join([*e.confused_with, *(NEARLY_HEALTH[n][0] for n in (e.name,) if n in NEARLY_HEALTH)]) or "-")
        for e in EFFECTS.values()
    ]  # fmt: skip
    widths = [max(len(row[i]) for row in rows) for i in range(len(HEADINGS))]
    for row in rows:
        yield "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()


def markdown_lines() -> Iterator[str]:
    """The effects as the table of docs/effects.md: name, law, unit, limits, source."""
    from dieseltwin.engine.effects import EFFECTS

    yield "| effect | law | unit | limits | source |"
    yield "|---|---|---|---|---|"
    for e in EFFECTS.values():
        yield f"| `{e.name}` | {e.law} | {e.unit} | {e.limits[0]:g} to {e.limits[1]:g} | {e.source} |"


def named_values(options: Sequence[str]) -> dict[str, float | str]:
    """Name -> text of its value, from NAME=VALUE.

    Raises:
        InputError: no '=', or a name given twice.
    """
    values: dict[str, float | str] = {}
    for option in options:
        name, separator, text = option.partition("=")
        name = name.strip()
        if not separator:
            raise InputError(f"--effect {option}", "no '='", "NAME=VALUE", "write for instance boost_leak=3e-5")
        if name in values:
            raise InputError(f"--effect {name}", "two values", "one", "give each effect once")
        values[name] = text
    return values
