"""The command line: `dieseltwin simulate | identify | discover | engine show | params show`.

A problem that the user can mend is one line on stderr and exit code 2; nothing is written then. Any other exception
keeps its traceback: it is a defect, and the report of it needs the place.
"""

from __future__ import annotations

import os
import sys
import warnings
from pathlib import Path
from typing import Annotated

import typer

from dieseltwin import __version__
from dieseltwin.cli.challenge import challenge_app
from dieseltwin.cli.channels import channels_command
from dieseltwin.cli.data import data_app
from dieseltwin.cli.early import check_there
from dieseltwin.cli.effects import EffectOption, show_effects
from dieseltwin.cli.points import calibrate_command, imply_command
from dieseltwin.errors import DieselTwinError, InputError
from dieseltwin.settings import methods
from dieseltwin.settings.names import unknown_name

# typer carries its own copy of click and exports few of its exceptions; these are the bases of one it does export
_UsageError: type[Exception] = typer.BadParameter.__bases__[0]
_ClickError: type[Exception] = _UsageError.__bases__[0]

app = typer.Typer(
    name="dieseltwin",
    help="Digital twin of a diesel engine's gas path: simulate it, identify its health parameters from a recording.",
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode=None,
)
engine_app = typer.Typer(help="Engine parameters.")
params_app = typer.Typer(help="Settings of a run (params.yaml).")
app.add_typer(engine_app, name="engine")
app.add_typer(params_app, name="params")
app.add_typer(challenge_app, name="challenge")
app.add_typer(data_app, name="data")
app.command("channels")(channels_command)
app.command("effects")(show_effects)
app.command("calibrate")(calibrate_command)
app.command("imply")(imply_command)

EngineFile = Annotated[
    Path | None, typer.Option("--engine", metavar="FILE", help="YAML that overrides engine parameters by name.")
]
ChannelsFile = Annotated[
    Path | None, typer.Option("--channels", metavar="MAP", help="YAML mapping foreign column names and units to ours.")
]
ParamsFile = Annotated[Path | None, typer.Option("--params", metavar="FILE", help="Settings instead of params.yaml.")]
Profile = Annotated[str, typer.Option("--profile", metavar="NAME", help="Profile of the settings: quick or paper.")]


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"dieseltwin {__version__}")
        raise typer.Exit


def _help_without_command(context: typer.Context) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


engine_app.callback(invoke_without_command=True)(_help_without_command)
params_app.callback(invoke_without_command=True)(_help_without_command)


@app.callback(invoke_without_command=True)
def _options(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and end.")
    ] = False,
) -> None:
    """Digital twin of a diesel engine's gas path: simulate it, identify its health parameters from a recording."""
    _help_without_command(context)


@app.command()
def simulate(
    inputs: Annotated[
        Path,
        typer.Argument(
            metavar="INPUTS",
            help="CSV or Parquet with time_s, n_e_rpm, u_delta_mg, u_egr_pct, u_vgt_pct. The states start at the first "
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
    check_there(inputs)
    from dieseltwin.cli.simulate import run_simulate

    rows = run_simulate(inputs, out, engine=engine, channels=channels, effects=effect)
    typer.echo(f"{out}: {rows} rows")


@app.command()
def identify(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="CSV or Parquet recording of a running engine.")
    ],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the results.")],
    method: Annotated[
        str,
        typer.Option("--method", metavar="M", help=f"One of {', '.join(methods.names())}."),
    ] = "classical",
    runs: Annotated[int | None, typer.Option("--runs", metavar="N", help="Independent starts a segment.")] = None,
    engine: EngineFile = None,
    channels: ChannelsFile = None,
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
    seed: Annotated[int | None, typer.Option("--seed", metavar="N", min=0, help="Seed of everything random.")] = None,
    params: ParamsFile = None,
    profile: Profile = "quick",
) -> None:
    """Find A_egrmax, A_vgtmax, eta_sc and h_tot in a recording, with their uncertainty."""
    if method not in methods.names():
        raise unknown_name("--method", method, methods.names())
    check_there(recording)
    from dieseltwin.cli.identify import run_identify

    lines = run_identify(
        recording,
        out,
        method=method,
        runs=runs,
        engine=engine,
        channels=channels,
        models=models,
        maps=maps,
        segment_s=segment,
        seed=seed,
        params=params,
        profile=profile,
    )
    for line in lines:
        typer.echo(line)


@app.command()
def discover(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the results.")],
    recording: Annotated[
        Path | None,
        typer.Argument(metavar="RECORDING", help="CSV or Parquet recording of a running engine, 10 min or more."),
    ] = None,
    engine: EngineFile = None,
    sensors: Annotated[
        str | None, typer.Option("--sensors", metavar="A,B,...", help="Sensor columns to use; all without it.")
    ] = None,
    channels: ChannelsFile = None,
    withhold: Annotated[
        str | None, typer.Option("--withhold", metavar="NAME,...", help="Effects to keep out of the catalogue.")
    ] = None,
    map_tolerance: Annotated[
        float | None,
        typer.Option("--map-tolerance", metavar="X", help="Smooth relative error believed of the maps; 0.003."),
    ] = None,
    name: Annotated[
        str | None,
        typer.Option(
            "--explain", metavar="NAME", help="Say why an effect was or wasn't chosen; reads DIR where it can."
        ),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", metavar="N", help="Seed of everything random.")] = 0,
) -> None:
    """Find what physics the twin leaves out: where, what, how large, since when."""
    check_there(recording)
    from dieseltwin.cli.discover import run_discover

    lines = run_discover(
        recording,
        out,
        engine=engine,
        sensors=sensors,
        channels=channels,
        withhold=withhold,
        map_tolerance=map_tolerance,
        seed=seed,
        name=name,
    )
    for line in lines:
        typer.echo(line)


@engine_app.command("show")
def engine_show(engine: EngineFile = None) -> None:
    """Print the engine's parameters as YAML that --engine accepts."""
    from dieseltwin.cli.show import engine_lines

    for line in engine_lines(engine):
        typer.echo(line)


@params_app.command("show")
def params_show(params: ParamsFile = None, profile: Profile = "quick") -> None:
    """Print the settings of one profile as YAML, and their hash."""
    from dieseltwin.cli.show import params_lines

    for line in params_lines(params, profile):
        typer.echo(line)


def _fail(message: str, code: int) -> int:
    print("dieseltwin: " + " ".join(message.split()), file=sys.stderr)
    return code


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code (0 done, 2 the input cannot be used, 130 interrupted)."""
    if not sys.warnoptions:  # numerical warnings are for developers: `python -W default -m dieseltwin`
        warnings.simplefilter("ignore", RuntimeWarning)
    # Numpy reads it when first imported, which is after this. Its matrices are small here: on two busy cores a second
    # spinning thread doubles a discovery's processor time and up to quadruples the wait. Simulations have own threads.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    try:
        result = app(args=arguments, prog_name="dieseltwin", standalone_mode=False)
    except DieselTwinError as error:
        return _fail(str(error), error.exit_code)
    except _ClickError as error:  # a wrong option or argument
        message = error.format_message().rstrip(".")  # type: ignore[attr-defined]
        return _fail(f"{message}; see `dieseltwin --help`", InputError.exit_code)
    except PermissionError as error:  # an input; outputs are checked where they are written
        closed = InputError(str(error.filename), "permission denied", "a file you may read", "change its permissions")
        return _fail(str(closed), closed.exit_code)
    except (typer.Abort, KeyboardInterrupt):
        return _fail("interrupted; no file is half-written, and what was finished before is kept", 130)
    except BrokenPipeError:  # `dieseltwin engine show | head`: the flush at the end must not complain either
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    return result if isinstance(result, int) else 0


if __name__ == "__main__":
    sys.exit(main())
