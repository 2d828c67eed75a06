"""`dieseltwin data list | path | fetch`: recordings of other people, with their origin, and checked local copies.

What they do is in `recordings.public_data`, which is slow to load.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import typer

from dieseltwin.cli.options import help_without_command
from dieseltwin.errors import InputError

Name = Annotated[str, typer.Argument(metavar="NAME", help="A set (liu_ice) or one file of it (liu_ice/wltp_NF.csv).")]

data_app = typer.Typer(help="Recordings of other people: origin, terms, and checked local copies.")
data_app.callback(invoke_without_command=True)(help_without_command)


def list_lines() -> Iterator[str]:
    """Every set with its origin and terms, every file with its size and where a good copy lies."""
    from dieseltwin.recordings.public_data import SETS, wanted

    for data_set in SETS.values():
        yield data_set.name
        yield f"  from    {data_set.address}"
        yield f"  terms   {data_set.licence}"
        yield f"  cite    {data_set.citation}"
        for file in wanted(data_set.name):
            yield f"  {file.name:<44}{file.size / 1e6:>7.2f} MB  {file.sha256[:12]}  {_where(file.name)}"


def _where(name: str) -> str:
    from dieseltwin.recordings.public_data import FILES, find

    try:
        found = find(FILES[name])
    except InputError as error:
        return f"WRONG COPY: {error.what}"
    return "not here" if found is None else found[0]


@data_app.command("list")
def data_list() -> None:
    """Sets, files, terms, and which of them lie on this machine."""
    for line in list_lines():
        typer.echo(line)


@data_app.command("path")
def data_path(name: Name) -> None:
    """Print the local path of a file, or of every file of a set, after checking its bytes."""
    from dieseltwin.recordings.public_data import path_of, wanted

    for file in wanted(name):
        typer.echo(path_of(file))


@data_app.command("fetch")
def data_fetch(name: Name) -> None:
    """Make sure that a checked copy is on this machine; prints its path."""
    from dieseltwin.recordings.public_data import fetch, wanted

    for file in wanted(name):
        path, loaded = fetch(file)
        typer.echo(f"{path}{'' if loaded else ' (was here)'}")
