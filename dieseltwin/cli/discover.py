"""`dieseltwin discover`: recordings in, what the twin leaves out, as a document, a report and a repaired engine."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

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
from dieseltwin.errors import InputError

if TYPE_CHECKING:
    from dieseltwin.api.findings import Question


def discover_command(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the results.")],
    recordings: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="RECORDING...",
            callback=readable,
            help="Recording of a running engine (CSV, MDF, ...), 60 s at least, error rates hold for 10 min; or "
            "settled points, a table without time. Several recordings of a diesel engine are judged together.",
        ),
    ] = None,
    engine: EngineFile = None,
    sensors: Sensors = None,
    channels: ChannelsFile = None,
    withhold: Annotated[
        str | None, typer.Option("--withhold", metavar="NAME,...", help="Effects to keep out of the catalogue.")
    ] = None,
    map_tolerance: Annotated[
        float | None,
        typer.Option(
            "--map-tolerance", metavar="X", help="Smooth error believed of the maps, rms, 0 to 0.05; 0.003 in "
            "params.yaml.",
        ),
    ] = None,
    name: Annotated[
        str | None,
        typer.Option(
            "--explain",
            metavar="NAME",
            help="Say why an effect was or wasn't chosen. Without RECORDING it is answered from the results in DIR.",
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option("--seed", metavar="N", help="Seed of everything random; 0 in params.yaml.")
    ] = None,
    reference: Annotated[
        list[Path] | None,
        typer.Option(
            "--reference",
            metavar="HEALTHY",
            callback=readable,
            help="Recording, or settled points, of the engine when it was well; repeatable.",
        ),
    ] = None,
    time_s: Annotated[
        float | None,
        typer.Option("--time", metavar="S", help="Seconds for the best answer so far; no limit without it."),
    ] = None,
    params: ParamsFile = None,
    profile: Profile = "quick",
    pdf: Pdf = False,
    strict: Strict = False,
) -> None:
    """Find what physics the twin leaves out: where, what, how large, since when."""
    from dieseltwin.api.discovery import ask, catalogue_of
    from dieseltwin.api.findings import Asked
    from dieseltwin.discovery.verdict.explain import explain
    from dieseltwin.settings.defaults import deciding_by
    from dieseltwin.settings.params import load_params

    if not recordings:
        if name is None:
            raise InputError("RECORDING", "nothing", "a recording", "name the recording")
        say(explain(name, out, catalogue_of(out)))
        return
    settings = load_params(params, profile)
    asked = Asked(names(sensors), names(withhold), map_tolerance, seed, tuple(reference or ()), settings.discover,
                  time_s, name)  # fmt: skip
    with deciding_by(settings):
        question = ask(tuple(recordings), engine, channels, asked)
        answered = name is not None and question.answered_in(out)
        warnings = [] if answered else _answer(question, out, pdf)
    if name is not None:
        say([*([] if answered else [""]), *explain(name, out, question.catalogue)])
    strictly(strict, warnings)


def _answer(question: Question, out: Path, pdf: bool) -> list[dict[str, Any]]:
    """Search, say and save; the answer's warnings."""
    from dieseltwin.api.folders import DISCREPANCY

    with results_in(out, DISCREPANCY, pdf), question.getting_ready():
        progress(question.about)
        say(question.preview())
        progress("fitting ...")
        found = question.answer()
        say(found.lines())  # who waits reads it while the files are written
        found.save(out)
    say([f"results: {out}"])
    return found.warnings
