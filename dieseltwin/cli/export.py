"""`dieseltwin export`: an engine for programs that know nothing of this package."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from dieseltwin.cli.options import check_apart
from dieseltwin.errors import InputError
from dieseltwin.paths import refuse_unreadable


def export_command(
    context: typer.Context,
    engine: Annotated[str, typer.Argument(metavar="[ENGINE]", help="Engine file, or a name.")] = "we2011",
    c: Annotated[
        Path | None, typer.Option("--c", metavar="FILE.c", help="One file of C: a simulator without dependencies.")
    ] = None,
    fmu: Annotated[
        Path | None, typer.Option("--fmu", metavar="FILE.fmu", help="A functional mock-up unit for co-simulation.")
    ] = None,
    table: Annotated[
        Path | None, typer.Option("--table", metavar="DIR", help="The maps: a CSV each, and C with look-up functions.")
    ] = None,
    onnx: Annotated[
        Path | None, typer.Option("--onnx", metavar="DIR", help="The networks of --models, each as ONNX.")
    ] = None,
    models: Annotated[
        Path, typer.Option("--models", metavar="DIR", help="Folder of pretrained networks, for --onnx.")
    ] = Path("models"),
    fmi: Annotated[int, typer.Option("--fmi", metavar="N", help="Version of FMI: 2 (2.0) or 3 (3.0).")] = 2,
    sources_only: Annotated[
        bool, typer.Option("--sources-only", help="No binary in the FMU: its C sources are compiled where it runs.")
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace files that are there.")] = False,
) -> None:
    """Write an engine with its effects and learned maps as C, as an FMU or as tables, and networks as ONNX."""
    if os.path.exists(engine) or Path(engine).suffix:
        refuse_unreadable(Path(engine), "an engine file")
    for out in (c, fmu):
        if out is not None:
            check_apart(out, engine)
    of_engine = onnx is None or not (c is fmu is table is None)
    _refuse_unused(context, {
        "--fmi": ("--fmu", fmu), "--sources-only": ("--fmu", fmu), "--models": ("--onnx", onnx),
        "ENGINE": ("--c, --fmu or --table", of_engine),
    })  # fmt: skip
    from dieseltwin.api.export import export, export_networks

    written = []
    if of_engine:
        written += export(engine, c=c, fmu=fmu, table=table, fmi=fmi, sources_only=sources_only, overwrite=overwrite)
    if onnx is not None:
        written += export_networks(models, onnx, overwrite=overwrite)
    for path in written:
        typer.echo(f"{path}: {path.stat().st_size / 1000:.0f} kB")


def _refuse_unused(context: typer.Context, used_by: Mapping[str, tuple[str, object]]) -> None:
    """Refuse what was given and changes nothing; `used_by`: its name -> what it belongs to, and that where it is given.

    Raises:
        InputError: the first such.
    """
    for name, (owner, given) in used_by.items():
        source = context.get_parameter_source(name.lstrip("-").replace("-", "_").lower())
        if not given and source is not None and source.name == "COMMANDLINE":
            raise InputError(f"export {name}", f"no {owner}", f"{name} beside {owner}", f"add {owner}, or leave it out")
