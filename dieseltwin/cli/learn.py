"""`dieseltwin learn`: recordings of a healthy engine in, a file of that very engine out, which every command takes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dieseltwin.atomic import check_writable
from dieseltwin.cli.options import (
    ChannelsFile,
    EngineFile,
    ParamsFile,
    Profile,
    Sensors,
    check_apart,
    check_ending,
    names,
    progress,
    readable,
    readable_engines,
    say,
)
from dieseltwin.paths import YAML_ENDINGS


def learn_command(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            metavar="HEALTHY...", callback=readable,
            help="Recordings or settled points of the engine when it was known to be well.",
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE", help="Engine file to write, a .yaml; a .learned.parquet beside it.")
    ],
    engine: EngineFile = None,
    channels: ChannelsFile = None,
    sensors: Sensors = None,
    map_error: Annotated[
        float | None,
        typer.Option(
            "--map-error",
            metavar="X",
            help="Believed rms of the maps' errors, 0.001 to 0.1; 0.02 in params.yaml, for an engine of the base's "
            "family.",
        ),
    ] = None,
    siblings: Annotated[
        list[Path] | None,
        typer.Option(
            "--siblings", metavar="FILE", callback=readable_engines, help="Learned engine of the same type; repeatable."
        ),
    ] = None,
    params: ParamsFile = None,
    profile: Profile = "quick",
) -> None:
    """Learn an engine's own maps, health and sensors from driving and settled points; learning more adds to the file.

    A petrol engine (--engine liu_petrol, or a file of its volumes) is learned from all of its recordings at once.
    """
    check_ending(out, YAML_ENDINGS)
    check_apart(out, *recordings, *(siblings or ()), channels)
    check_writable(out)
    progress("learning ...")
    from dieseltwin.api.learning import learn
    from dieseltwin.engine.learned_file import learned_beside
    from dieseltwin.settings.defaults import deciding_by
    from dieseltwin.settings.params import load_params

    with deciding_by(load_params(params, profile)):
        found = learn(recordings, engine, channels=channels, sensors=names(sensors), map_error=map_error,
                      siblings=siblings or ())  # fmt: skip
    found.save(out)
    beside = ", with the file beside it" if learned_beside(out).is_file() else ""
    say([*found.lines(), f"{out}: --engine takes it{beside}"])
