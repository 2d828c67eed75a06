"""The commands `dieseltwin calibrate` and `dieseltwin imply`. What they do is in `cli.calibrate`, slow to load."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dieseltwin.cli.early import check_there

Points = Annotated[Path, typer.Argument(metavar="POINTS", help="CSV or Parquet: steady points, or a recording.")]
Channels = Annotated[Path | None, typer.Option("--channels", metavar="MAP", help="YAML mapping foreign columns.")]


def calibrate_command(
    points: Points,
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="Engine file to write (.yaml).")],
    base: Annotated[str, typer.Option("--base", metavar="NAME", help="we2011 or an engine file.")] = "we2011",
    geometry: Annotated[
        Path | None,
        typer.Option("--geometry", metavar="FILE", help="YAML: bore_mm, stroke_mm or displacement_l, n_cyl, r_c, ..."),
    ] = None,
    channels: Channels = None,
    noise: Annotated[
        float | None, typer.Option("--noise", metavar="PCT", help="Standard deviation of every sensor [%].")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Seed of the held-out third.")] = 0,
) -> None:
    """Calibrate another engine of the same kind from steady points."""
    check_there(points)
    from dieseltwin.cli.calibrate import run_calibrate

    for line in run_calibrate(points, out, base=base, geometry=geometry, channels=channels, noise_pct=noise, seed=seed):
        typer.echo(line)


def imply_command(
    points: Points,
    engine: Annotated[Path, typer.Option("--engine", metavar="FILE", help="repaired.yaml of `discover POINTS`.")],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help=".csv or .parquet to write.")],
    channels: Channels = None,
) -> None:
    """Say, for each point, every quantity that nobody measured, with its standard deviation."""
    check_there(points)
    from dieseltwin.cli.calibrate import run_imply

    for line in run_imply(points, engine, out, channels=channels):
        typer.echo(line)
