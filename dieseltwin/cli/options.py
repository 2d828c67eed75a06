"""Options that several commands take, what one who waits is told, and checks before anything slow is imported."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, TypeVar

import typer

from dieseltwin.atomic import check_folder
from dieseltwin.errors import InputError
from dieseltwin.notes import STRICT_CODE
from dieseltwin.paths import refuse_unreadable, same_file

EngineFile = Annotated[
    Path | None,
    typer.Option(
        "--engine",
        metavar="FILE",
        help="Engine file: parameters that differ from the published ones, or what a command wrote; or a name. Without "
        "it we2011, the published diesel engine.",
    ),
]
ChannelsFile = Annotated[
    Path | None, typer.Option("--channels", metavar="MAP", help="YAML mapping foreign column names and units to ours.")
]
Sensors = Annotated[
    str | None,
    typer.Option(
        "--sensors",
        metavar="A,B,...",
        help="Sensor columns to use; without it all that there are, and the paper's five must be among them.",
    ),
]
ParamsFile = Annotated[Path | None, typer.Option("--params", metavar="FILE", help="Settings instead of params.yaml.")]
Profile = Annotated[str, typer.Option("--profile", metavar="NAME", help="Profile: quick, paper or tiny.")]

Pdf = Annotated[bool, typer.Option("--pdf", help="Print the report to report.pdf as well (with Chromium or Chrome).")]

Strict = Annotated[bool, typer.Option("--strict", help="Exit code 3 when the answer carries a warning.")]

Named = TypeVar("Named", Path, list[Path], None)


def readable(named: Named) -> Named:
    """One file, or several, of an argument or an option (its callback): refused before anything slow is imported.

    Raises:
        InputError: what can't be read, as `refuse_unreadable`.
    """
    _refuse_unreadable_among(named, "a recording")
    return named


def readable_engines(named: list[Path] | None) -> list[Path] | None:
    """The same of engine files."""
    _refuse_unreadable_among(named, "a learned engine")
    return named


def _refuse_unreadable_among(named: Path | list[Path] | None, allowed: str) -> None:
    for path in named if isinstance(named, list) else (named,):
        refuse_unreadable(path, allowed)


def progress(text: str) -> None:
    """For a person who waits; a log file needs no promise."""
    if sys.stderr.isatty():
        print(text, file=sys.stderr)


def counted_progress(done: int, total: int, note: str = "") -> None:
    """One of many is through: a line that is written over on a terminal, one after the other in a log file."""
    end = "\n" if not sys.stderr.isatty() or done == total else "\r"
    print(f"{done}/{total} {note}".rstrip(), end=end, file=sys.stderr, flush=True)


def say(lines: Iterable[str]) -> None:
    """Print lines as they come."""
    for line in lines:
        typer.echo(line)


def names(text: str | None) -> tuple[str, ...] | None:
    """Names of a comma list, each once; None where the option isn't given."""
    if text is None:
        return None
    return tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))


def check_apart(out: Path, *inputs: Path | str | None) -> None:
    """Refuse to write over what is read.

    Raises:
        InputError: `out` is one of the inputs, by whatever name.
    """
    for path in inputs:
        if path is not None and same_file(out, path):
            raise InputError(f"--out {out}", f"the file that is read ({path})", "another file", "choose another name")


def check_ending(out: Path, allowed: Sequence[str]) -> None:
    """Refuse a file that couldn't be written by its name, before the work.

    Raises:
        InputError: another ending than those.
    """
    if out.suffix.lower() not in allowed:
        raise InputError(f"--out {out}", f"ending {out.suffix or 'nothing'}", ", ".join(allowed), "choose one of them")


@contextmanager
def results_in(out: Path, document: str, pdf: bool) -> Iterator[None]:
    """A folder that results of this document can be written to, and a browser to print with: known before the work."""
    from dieseltwin.api.folders import keep_apart
    from dieseltwin.report.pdf import browser, print_report

    if pdf:
        browser()
    keep_apart(out, document)
    check_folder(out)
    yield
    if pdf:
        print_report(out)


def strictly(strict: bool, warnings: Sequence[object]) -> None:
    """End with `STRICT_CODE` where that was asked for and there is a warning."""
    if strict and warnings:
        raise typer.Exit(STRICT_CODE)


def help_without_command(context: typer.Context) -> None:
    """A group of commands without one prints its help."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
