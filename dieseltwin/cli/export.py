"""`dieseltwin export`: an engine for programs that know nothing of this package."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from dieseltwin.cli.early import check_apart, check_there


def export_command(
    engine: Annotated[str, typer.Argument(metavar="ENGINE", help="Engine file, or the name we2011.")],
    c: Annotated[
        Path | None, typer.Option("--c", metavar="FILE.c", help="One file of C: a simulator without dependencies.")
    ] = None,
    fmu: Annotated[
        Path | None, typer.Option("--fmu", metavar="FILE.fmu", help="A functional mock-up unit for co-simulation.")
    ] = None,
    fmi: Annotated[int, typer.Option("--fmi", metavar="N", help="Version of FMI: 2 (2.0) or 3 (3.0).")] = 2,
    sources_only: Annotated[
        bool, typer.Option("--sources-only", help="No binary in the FMU: its C sources are compiled where it runs.")
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace files that are there.")] = False,
) -> None:
    """Write an engine with its effects and learned maps as C or as an FMU; the equations are those of `simulate`."""
    if os.path.exists(engine) or Path(engine).suffix:
        check_there(Path(engine), "an engine file")
    for out in (c, fmu):
        if out is not None:
            check_apart(out, engine)
    from dieseltwin.api.export import export

    for path in export(engine, c=c, fmu=fmu, fmi=fmi, sources_only=sources_only, overwrite=overwrite):
        typer.echo(f"{path}: {path.stat().st_size / 1000:.0f} kB")
