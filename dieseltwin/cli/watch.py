"""`dieseltwin watch`: recordings into the history of their engine, and what it shows."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dieseltwin.atomic import check_folder
from dieseltwin.cli.options import (
    ChannelsFile,
    ParamsFile,
    Profile,
    Sensors,
    counted_progress,
    help_without_command,
    names,
    progress,
    readable,
    say,
)
from dieseltwin.errors import InputError, Refused
from dieseltwin.notes import counted

if TYPE_CHECKING:
    from dieseltwin.api.fleet import Fleet
    from dieseltwin.api.histories import Watched
    from dieseltwin.settings.watch import WatchConfig

watch_app = typer.Typer(help="The history of one engine: add recordings, see what has changed.", add_completion=False)
watch_app.callback(invoke_without_command=True)(help_without_command)

HistoryFolder = Annotated[Path, typer.Option("--history", metavar="DIR", help="Folder of the engine's history.")]
Which = Annotated[str, typer.Argument(metavar="RECORDING", help="Its name, date, hash (8 digits will do) or the file.")]
Out = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Folder for the pages and the table; none without it.")
]
Rate = Annotated[
    float | None,
    typer.Option("--alarms-per-year", metavar="X", help="False alarms an engine and year; 0.02 in params.yaml."),
]


@watch_app.command("add")
def add_command(
    recordings: Annotated[
        list[Path], typer.Argument(metavar="RECORDING...", callback=readable, help="Recordings of the engine.")
    ],
    engine: Annotated[Path, typer.Option("--engine", metavar="FILE", help="File that `dieseltwin learn` wrote.")],
    history: HistoryFolder,
    channels: ChannelsFile = None,
    sensors: Sensors = None,
    alarms_per_year: Rate = None,
    params: ParamsFile = None,
    profile: Profile = "quick",
) -> None:
    """Judge recordings, add each to the history once, and say whether the engine has changed."""
    progress(f"{counted(len(recordings), 'recording')} ...")
    from dieseltwin.api.watch import watch

    settings = _settings(params, profile, alarms_per_year)
    found = watch(
        recordings, engine, history, channels=channels, sensors=names(sensors), settings=settings,
        progress=counted_progress if len(recordings) > 1 else None,
    )  # fmt: skip
    if found.refused and len(recordings) == 1:
        raise Refused(found.refused[0][1])
    say(found.lines())
    if found.refused:
        raise typer.Exit(InputError.exit_code)


@watch_app.command("show")
def show_command(
    history: HistoryFolder,
    out: Out = None,
    alarms_per_year: Rate = None,
    params: ParamsFile = None,
    profile: Profile = "quick",
) -> None:
    """Show the history: whether there is an alarm, and with --out a page with all trends."""
    if out is not None:
        check_folder(out)
    from dieseltwin.api.histories import history as history_of

    found = history_of(history, settings=_settings(params, profile, alarms_per_year))
    _show(found, out)


@watch_app.command("remove")
def remove_command(
    recording: Which,
    history: HistoryFolder,
    reason: Annotated[str, typer.Option("--reason", metavar="TEXT", help="Why; it stands on the page.")],
) -> None:
    """Take out a recording that was added by mistake; the evidence with it is said from then on."""
    from dieseltwin.api.histories import remove

    say(remove(history, recording, reason).lines())


@watch_app.command("restore")
def restore_command(recording: Which, history: HistoryFolder) -> None:
    """Let a recording count again that was taken out."""
    from dieseltwin.api.histories import restore

    say(restore(history, recording).lines())


@watch_app.command("fleet")
def fleet_command(
    histories: Annotated[list[Path], typer.Argument(metavar="HISTORY...", help="Folders of engines' histories.")],
    out: Out = None,
    alarms_per_year: Rate = None,
    params: ParamsFile = None,
    profile: Profile = "quick",
) -> None:
    """Show the histories of many engines: which has an alarm, and with --out a page of all and one of each."""
    if out is not None:
        check_folder(out)
    from dieseltwin.api.fleet import fleet

    found = fleet(histories, settings=_settings(params, profile, alarms_per_year))
    if not found.engines:
        raise Refused(found.refused[0][1])
    _show(found, out)
    if found.refused:
        raise typer.Exit(InputError.exit_code)


def _show(found: Watched | Fleet, out: Path | None) -> None:
    """Say what was found, and write its pages and table into a folder where one is named."""
    say(found.lines())
    if out is not None:
        found.save(out)
        say([f"results: {out}"])


def _settings(params: Path | None, profile: str, alarms_per_year: float | None) -> WatchConfig:
    """Section `watch` of the settings, with another rate of false alarms where one is given."""
    from dieseltwin.settings.params import load_params

    settings = load_params(params, profile).watch
    if alarms_per_year is None:
        return settings
    if not 0.0 < alarms_per_year <= 1.0:  # not so for NaN either
        raise InputError("--alarms-per-year", f"{alarms_per_year:g}", "above 0, up to 1", "choose another")
    return settings.model_copy(update={"alarms_per_year": alarms_per_year})
