"""`dieseltwin calibrate` and `dieseltwin imply`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from dieseltwin.atomic import check_writable
from dieseltwin.cli.options import Strict, check_apart, check_ending, readable, say, strictly
from dieseltwin.paths import YAML_ENDINGS

Points = Annotated[
    Path, typer.Argument(metavar="POINTS", callback=readable, help="Steady points, or a recording, in any format.")
]
Channels = Annotated[Path | None, typer.Option("--channels", metavar="MAP", help="YAML mapping foreign columns.")]


def calibrate_command(
    points: Points,
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="Engine file to write (.yaml).")],
    base: Annotated[
        str,
        typer.Option(
            "--base",
            metavar="NAME",
            help="we2011, liu_petrol (POINTS is driving without a fault then) or an engine file.",
        ),
    ] = "we2011",
    geometry: Annotated[
        Path | None,
        typer.Option(
            "--geometry",
            metavar="FILE",
            help="YAML of the data sheet: bore_mm and stroke_mm, or displacement_l; n_cyl, r_c, any engine parameter.",
        ),
    ] = None,
    channels: Channels = None,
    noise: Annotated[
        float | None,
        typer.Option(
            "--noise", metavar="PCT", help="Standard deviation of every sensor [%]; else each has its usual one."
        ),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Seed of the held-out third.")] = 0,
    strict: Strict = False,
) -> None:
    """Calibrate another engine of the same kind from steady points."""
    from dieseltwin.api.calibration import calibrate

    began = time.perf_counter()
    check_ending(out, YAML_ENDINGS)
    check_apart(out, points, base, geometry, channels)
    check_writable(out)  # better known before the work
    found = calibrate(points, base, geometry=geometry, channels=channels, noise_pct=noise, seed=seed)
    found.save(out)
    names = ", ".join([str(out), *found.beside(out)])
    say([*found.lines(), f"{names} ({time.perf_counter() - began:.0f} s)"])
    strictly(strict, found.warnings)


def imply_command(
    points: Points,
    engine: Annotated[Path, typer.Option("--engine", metavar="FILE", help="repaired.yaml of `discover POINTS`.")],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help=".csv or .parquet to write.")],
    channels: Channels = None,
    strict: Strict = False,
) -> None:
    """Say, for each point, every quantity that nobody measured, with its standard deviation."""
    from dieseltwin.api.points import imply
    from dieseltwin.recordings.reader import CSV_SUFFIXES, PARQUET_SUFFIXES

    check_ending(out, (*CSV_SUFFIXES, *PARQUET_SUFFIXES))
    check_apart(out, points, engine, channels)
    check_writable(out)
    found = imply(points, engine, channels=channels)
    found.save(out)
    first, *notes = found.lines()
    say([f"{out}: {first}", *notes])
    strictly(strict, found.warnings)
