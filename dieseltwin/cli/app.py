"""The command line: `dieseltwin simulate | identify | discover | calibrate | imply | ...`, a file for each command.

A problem that the user can mend is one line on stderr and exit code 2; nothing is written then. Any other exception
keeps its traceback: it is a defect, and the report of it needs the place.
"""

from __future__ import annotations

import errno
import gc
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from functools import cache
from typing import Annotated

import typer

from dieseltwin.cli.challenge import challenge_app
from dieseltwin.cli.channels import channels_command
from dieseltwin.cli.data import data_app
from dieseltwin.cli.discover import discover_command
from dieseltwin.cli.effects import show_effects
from dieseltwin.cli.export import export_command
from dieseltwin.cli.identify import identify_command
from dieseltwin.cli.learn import learn_command
from dieseltwin.cli.options import help_without_command
from dieseltwin.cli.page import app_command
from dieseltwin.cli.points import calibrate_command, imply_command
from dieseltwin.cli.show import engine_app, params_app
from dieseltwin.cli.simulate import simulate_command
from dieseltwin.cli.watch import watch_app
from dieseltwin.errors import LONGEST_LINE, DieselTwinError, InputError, one_line, shortened
from dieseltwin.version import __version__

# typer carries its own copy of click and exports few of its exceptions; these are the bases of one it does export
_UsageError: type[Exception] = typer.BadParameter.__bases__[0]
_ClickError: type[Exception] = _UsageError.__bases__[0]

_OF_A_PATH = {
    errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.ENAMETOOLONG, errno.ELOOP, errno.EACCES, errno.EPERM,
}  # fmt: skip

app = typer.Typer(
    name="dieseltwin",
    help="Digital twin of a diesel engine's gas path: simulate it, identify its health, find what it leaves out.",
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.command("simulate")(simulate_command)
app.command("identify")(identify_command)
app.command("learn")(learn_command)
app.command("discover")(discover_command)
app.add_typer(watch_app, name="watch")
app.add_typer(engine_app, name="engine")
app.add_typer(params_app, name="params")
app.add_typer(challenge_app, name="challenge")
app.add_typer(data_app, name="data")
app.command("channels")(channels_command)
app.command("app")(app_command)
app.command("effects")(show_effects)
app.command("calibrate")(calibrate_command)
app.command("imply")(imply_command)
app.command("export")(export_command)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"dieseltwin {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _options(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and end.")
    ] = False,
) -> None:
    """Digital twin of a diesel engine's gas path: simulate it, identify its health, find what it leaves out."""
    help_without_command(context)


@cache
def _commands() -> Callable[..., object]:
    """All of them, made once: typer would read every signature anew for each call of `app`."""
    return typer.main.get_command(app)


_NAME = "dieseltwin: "
_INTERRUPTED = 130


_OUT_OF_MEMORY = "out of memory; no file is half-written: cut the recording, or run it where there is more"
_NO_ROOM = "no space left on the device; no file is half-written: make room, or write elsewhere"


def _short_of_memory(error: BaseException | None) -> bool:
    """Whether a library couldn't be loaded for want of memory, by the linker's words at the root of the error."""
    while error is not None:
        if any(words in str(error) for words in ("failed to map segment", "annot allocate memory")):
            return True
        error = error.__cause__ or error.__context__
    return False


def _fail(error: Exception | str, code: int) -> int:
    room = LONGEST_LINE - len(_NAME)
    line = error.line(room) if isinstance(error, InputError) else shortened(one_line(str(error)), room)
    print(_NAME + line, file=sys.stderr)
    return code


def _refuse_empty(arguments: Sequence[str]) -> None:
    """Refuse a word without letters: as a path it is the current folder, where nobody asked for results.

    Raises:
        InputError: `--out ""`, `--out=`, or an argument that is empty.
    """
    for before, word in zip(["", *arguments], arguments, strict=False):
        option, _, value = word.partition("=")
        if value.strip() or (word.strip() and not (option.startswith("--") and word != option)):
            continue
        name = option if option.strip() else before if before.startswith("-") else "an argument"
        raise InputError(name, "an empty text", "a name or a value",
                         "give one, or leave it out (a variable of the shell that isn't set?)")


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code (0 done, 2 the input cannot be used, 130 interrupted)."""
    if not sys.warnoptions:  # numerical warnings are for developers: `python -W default -m dieseltwin`
        warnings.simplefilter("ignore", RuntimeWarning)
    # Numpy reads it when first imported, which is after this. Its matrices are small here: on two busy cores a second
    # spinning thread doubles a discovery's processor time and up to quadruples the wait. Simulations have own threads.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    # Importing makes a million objects that stay: looking for garbage among them every 700 takes a fifth of the start.
    gc.set_threshold(100_000, 50, 100)
    try:
        _refuse_empty(sys.argv[1:] if arguments is None else arguments)
        result = _commands()(args=arguments, prog_name="dieseltwin", standalone_mode=False)
    except DieselTwinError as error:
        return _fail(error, error.exit_code)
    except _ClickError as error:  # a wrong option or argument
        message = shortened(one_line(error.format_message()).rstrip("."), 200)  # type: ignore[attr-defined]
        context = getattr(error, "ctx", None)
        command = "dieseltwin" if context is None else context.command_path
        return _fail(f"{message}; see `{command} --help`", InputError.exit_code)
    except BrokenPipeError:  # `dieseltwin engine show | head`: the flush at the end must not complain either
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (OSError, ImportError) as error:  # of an input; outputs are checked where they are written
        if _short_of_memory(error):
            return _fail(_OUT_OF_MEMORY, 1)
        if isinstance(error, OSError) and error.errno == errno.ENOSPC:
            return _fail(_NO_ROOM, 1)
        if not isinstance(error, OSError) or error.errno not in _OF_A_PATH or error.filename is None:
            raise
        got = (error.strerror or str(error)).lower()
        unread = InputError(str(error.filename), got, "a file you may read", "check the path")
        return _fail(unread, unread.exit_code)
    except MemoryError:
        return _fail(_OUT_OF_MEMORY, 1)
    except SystemError as error:  # of compiled code that forgot to look whether it got its memory
        return _fail(f"a library failed inside ({error}), as happens when memory is short; {_OUT_OF_MEMORY}", 1)
    except (typer.Abort, KeyboardInterrupt):
        result = _INTERRUPTED
    if result == _INTERRUPTED:  # typer makes it of Ctrl-C, without a word
        return _fail("interrupted; no file is half-written, and what was finished before is kept", _INTERRUPTED)
    return result if isinstance(result, int) else 0


if __name__ == "__main__":
    sys.exit(main())
