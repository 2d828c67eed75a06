"""`dieseltwin simulate`: inputs from a file, every quantity of the engine into another."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dieseltwin.atomic import check_writable
from dieseltwin.cli.effects import EffectOption, named_values
from dieseltwin.cli.options import ChannelsFile, EngineFile, check_apart, check_ending, readable, say
from dieseltwin.notes import of_reading

SUFFIXES = (".csv", ".parquet")


def simulate_command(
    inputs: Annotated[
        Path,
        typer.Argument(
            metavar="INPUTS",
            callback=readable,
            help="Any recording with time_s, n_e_rpm, u_delta_mg, u_egr_pct, u_vgt_pct. The states start at the first "
            "row's p_im_pa, p_em_pa, omega_t_rad_s where it has them, else at rest at the first inputs.",
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE", help=".parquet or .csv: every quantity at the times of INPUTS.")
    ],
    engine: EngineFile = None,
    channels: ChannelsFile = None,
    effect: EffectOption = None,
) -> None:
    """Simulate the engine over recorded or made-up inputs."""
    from dieseltwin.api.simulation import simulate

    check_ending(out, SUFFIXES)
    check_apart(out, inputs, engine, channels)
    check_writable(out)  # a place that cannot be written to is better known before the work
    found = simulate(inputs, engine, channels=channels, effects=named_values(effect or ()))
    found.save(out)
    say([f"{out}: {len(found.frame)} rows", *map(of_reading, found.notes)])
