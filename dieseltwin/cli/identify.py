"""`dieseltwin identify`: a recording in, health parameters with their uncertainty out, as files and as a table."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dieseltwin.atomic import check_folder
from dieseltwin.cli.options import (
    ChannelsFile,
    EngineFile,
    ParamsFile,
    Pdf,
    Profile,
    Sensors,
    Strict,
    names,
    progress,
    readable,
    results_in,
    say,
    strictly,
)
from dieseltwin.notes import counted
from dieseltwin.settings import methods
from dieseltwin.settings.names import refuse_options, unknown_name

METHOD = "classical"


def identify_command(
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING", callback=readable, help="Recording of a running engine (CSV, Excel, MDF, CAN, ...)."
        ),
    ],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the results.")],
    method: Annotated[
        str,
        typer.Option("--method", metavar="M", help=f"One of {', '.join(methods.names())}."),
    ] = METHOD,
    runs: Annotated[
        int | None, typer.Option("--runs", metavar="N", help="Independent starts a segment; else those of params.yaml.")
    ] = None,
    engine: EngineFile = None,
    channels: ChannelsFile = None,
    sensors: Sensors = None,
    models: Annotated[
        Path | None,
        typer.Option("--models", metavar="DIR", help="Pretrained networks of `make run`; ./models if none is named."),
    ] = None,
    maps: Annotated[
        str | None,
        typer.Option(
            "--maps",
            metavar="KIND",
            help="Empirical maps: exact formulae, or learned ones, paper or improved. Without it the method's usual "
            "ones: the paper's own methods take paper, the others exact.",
        ),
    ] = None,
    segment: Annotated[
        float | None, typer.Option("--segment", metavar="S", help="Length of a segment [s]; 60 in params.yaml.")
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option("--seed", metavar="N", min=0, help="Seed of everything random; else that of params.yaml."),
    ] = None,
    params: ParamsFile = None,
    profile: Profile = "quick",
    pdf: Pdf = False,
    fit_test: Annotated[
        bool, typer.Option("--fit-test/--no-fit-test", help="Test whether the twin fits the recording at all.")
    ] = True,
    strict: Strict = False,
) -> None:
    """Find A_egrmax, A_vgtmax, eta_sc and h_tot in a recording, with their uncertainty."""
    if method not in methods.names():
        raise unknown_name("--method", method, methods.names())
    from dieseltwin.api.engines import rig_of
    from dieseltwin.api.folders import IDENTIFICATION
    from dieseltwin.api.identification import Setup, ask
    from dieseltwin.api.rigs import identify_rig

    rig = rig_of(engine)
    if rig is not None:
        from dieseltwin.settings.params import DEFAULT_PROFILE

        refuse_options({"--runs": runs, "--channels": channels, "--sensors": sensors, "--models": models,
                        "--maps": maps, "--segment": segment, "--seed": seed, "--params": params,
                        "--method": None if method == METHOD else method,
                        "--profile": None if profile == DEFAULT_PROFILE else profile,
                        "--pdf": pdf or None, "--strict": strict or None,
                        "--no-fit-test": None if fit_test else True}, f"for {rig.name}")  # fmt: skip
        check_folder(out)
        fitted = identify_rig(recording, rig)
        fitted.save(out)
        say([*fitted.lines(), f"results: {out}"])
        return

    setup = Setup(models, maps, params, profile, names(sensors), fit_test)
    question = ask(recording, engine, channels=channels, method=method, runs=runs, segment_s=segment, seed=seed,
                   setup=setup)  # fmt: skip
    with results_in(out, IDENTIFICATION, pdf), question.getting_ready():
        size = f"{counted(len(question.problems), 'segment')}, {counted(question.runs, 'run')} each"
        progress(f"{recording}: {size}, {method} ...")
        found = question.answer()
        found.save(out)
    say([*found.lines(), f"results: {out}"])
    strictly(strict, found.warnings)
