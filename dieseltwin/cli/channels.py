"""`dieseltwin channels FILE`: what a file holds, which of our quantities each channel could be, and a map to edit."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from dieseltwin.atomic import check_writable
from dieseltwin.cli.options import check_apart, check_ending
from dieseltwin.paths import YAML_ENDINGS


def channels_command(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="CSV, Parquet, Excel, MATLAB, MDF, or a CAN trace (J1939, or a DBC).")
    ],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="MAP", help="Channel map to write (.yaml), for --channels.")
    ] = None,
    dbc: Annotated[Path | None, typer.Option("--dbc", metavar="FILE", help="DBC of a CAN trace.")] = None,
    cylinders: Annotated[
        int | None, typer.Option("--cylinders", metavar="N", min=1, max=32, help="Of the engine; 6 is assumed.")
    ] = None,
    engine: Annotated[
        Path | None,
        typer.Option("--engine", metavar="FILE", help="Whose columns: liu_petrol or a file; without it a diesel's."),
    ] = None,
) -> None:
    """Say what is in a file, guess which channel is which quantity, and write a channel map to edit."""
    for line in run_channels(file, out, dbc=dbc, cylinders=cylinders, engine=engine):
        typer.echo(line)


def run_channels(
    file: Path, out: Path | None = None, *, dbc: Path | None = None, cylinders: int | None = None,
    engine: Path | None = None,
) -> Iterator[str]:
    """Lines to print; the map is written last.

    Args:
        file: to look into.
        out: channel map to write, None only prints.
        dbc: database of a CAN trace.
        cylinders: of the engine, for fuel and air per stroke; None assumes six.
        engine: whose quantities are looked for; None is a diesel engine.

    Raises:
        InputError: a file that cannot be read, or a map that cannot be written.
    """
    if out is not None:
        check_ending(out, YAML_ENDINGS)
        check_apart(out, file, dbc)
        check_writable(out)
    from dieseltwin.api.channels import channels

    found = channels(file, dbc, cylinders, engine)
    yield from found.lines()
    if out is not None:
        found.save(out)
        yield ""
        yield f"channel map: {out} (check every line)"
