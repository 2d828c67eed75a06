"""From a file or a table to a recording or settled points; tables with labels in and out (the extra `tables`)."""

from __future__ import annotations

import sys
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar, Union

import numpy as np
import pandas as pd

from dieseltwin.api.engines import AnyEngine, Engine, diesel_engine, engine
from dieseltwin.api.results import Result
from dieseltwin.engine import EngineParameters
from dieseltwin.errors import InputError
from dieseltwin.petrol.parameters import PetrolParameters
from dieseltwin.petrol.recording import PetrolRecording, read_petrol
from dieseltwin.recordings.channels import INPUTS, TIME, ChannelMap, foreign_hint
from dieseltwin.recordings.named_columns import Imported, import_columns
from dieseltwin.recordings.reader import Recording, read_recording
from dieseltwin.recordings.standing import standing
from dieseltwin.recordings.steady_points import SteadyPoints, read_points
from dieseltwin.rigs.parameters import RigParameters
from dieseltwin.rigs.recording import RigRecording, read_rig, refuse_still
from dieseltwin.settings.extras import require
from dieseltwin.settings.names import listed, refuse_options
from dieseltwin.symbols import BY_COLUMN

if TYPE_CHECKING:  # an extra
    import xarray as xr

Channels: TypeAlias = ChannelMap | str | Path
"""A channel map, or its YAML file."""

Source: TypeAlias = Union[str, Path, pd.DataFrame, "xr.Dataset"]
"""A file, or a table or a dataset with the columns of one."""

Made: TypeAlias = Recording | SteadyPoints | PetrolRecording | RigRecording
"""What `read` makes of one."""

Item = TypeVar("Item")

Opened: TypeAlias = Imported | Made
"""The columns of one, not yet checked, or what was made of them already."""

_MADE: Mapping[type, str] = {
    Recording: "one of a diesel engine", SteadyPoints: "settled points of a diesel engine",
    PetrolRecording: "one of a petrol engine", RigRecording: "one of a rig",
}  # fmt: skip


def several(items: Item | Sequence[Item]) -> Sequence[Item]:
    """Some of a kind, or one that stands for itself: a file's name is no sequence of letters."""
    return items if isinstance(items, Sequence) and not isinstance(items, str) else (items,)  # type: ignore[list-item]


def read(
    source: Source, channels: Channels | None = None, engine: AnyEngine | None = None
) -> Made:
    """Read and check a recording, or settled points where there is no column of time.

    Args:
        source: CSV, Parquet, Excel, MATLAB, MDF file or CAN trace, or a table or dataset of the same columns.
        channels: channel map for foreign names and units.
        engine: gives ambient values where the columns are absent and the size of a cylinder; a petrol engine reads
            petrol recordings, a rig its own columns. The published engine without it.

    Raises:
        InputError: one line saying what is wrong with the file.
    """
    machine = as_engine(engine)
    found = opened(source, machine, channels)
    if isinstance(machine, RigParameters):
        return rig_recording(found, machine)
    if isinstance(machine, PetrolParameters):
        return petrol_recording(found)
    if not isinstance(found, Imported):
        return found
    if found.timed:
        return read_recording(found, engine=machine, sensors=())
    return read_points(found, engine=machine, needed=INPUTS)


def description(found: Made) -> list[str]:
    """What was read, in sentences: size and rate, the quantities, and what reading did to the file."""
    if isinstance(found, SteadyPoints):
        return [f"{found.size} settled points with {', '.join(found.columns)}.", *found.notes]
    if isinstance(found, PetrolRecording):
        minutes = found.signals.time_s[-1] / 60.0
        return [f"{minutes:.1f} minutes of a petrol engine with {', '.join(found.columns)}.", *found.notes]
    if isinstance(found, RigRecording):
        columns = ", ".join((*found.inputs, *found.readings))
        return [f"{len(found.time_s)} samples of a rig with {columns}.", *found.notes]
    rate = 1.0 / float(np.median(np.diff(found.time_s)))
    there = [name for name in found.channels if name != TIME]
    return [f"{found.duration_s / 60.0:.1f} minutes at {rate:.3g} Hz with {', '.join(there)}.", *found.notes]


def as_engine(source: AnyEngine | None) -> Engine:
    """`engines.engine`, the published engine for None."""
    return diesel_engine(None) if source is None else engine(source)


def opened(source: Source | Made, machine: Engine, channels: Channels | None) -> Opened:
    """The columns of a file or a table by our names, so that it is read once; what was made of one already as it is.

    Args:
        machine: that it is of; a rig's file names the columns itself.

    Raises:
        InputError: a file or a channel map that can't be read, a map for a rig.
    """
    if isinstance(machine, RigParameters):
        refuse_options({"--channels": channels}, f"for {machine.name}: its file names the columns")
    source = as_table(source)
    return import_columns(source, channels) if isinstance(source, str | Path | pd.DataFrame) else source


def named(file: Path, channels: Path | None, name: str) -> Imported:
    """A file by its channel map under another name, which may say its date."""
    return replace(import_columns(file, channels), path=Path(name))


def settled(read: Opened) -> bool:
    """Whether it is settled points, not a recording over time."""
    return isinstance(read, SteadyPoints) or (isinstance(read, Imported) and not read.timed)


def _of_another(made: object, wanted: str) -> InputError:
    """The refusal of what was made of another machine's recording."""
    return InputError("recording", _MADE.get(type(made), "something else"), wanted, "name the machine that it is of")


def over_time(read: Opened) -> Imported | Recording:
    """A recording over time of a diesel engine, checked or not.

    Raises:
        InputError: anything else.
    """
    if isinstance(read, PetrolRecording | RigRecording):
        raise _of_another(read, "one of a diesel engine")
    if isinstance(read, SteadyPoints) or settled(read):
        raise InputError(str(read.path or "recording"), "settled points", "recordings over time of a diesel engine",
                         "judge settled points by themselves with `dieseltwin discover`")  # fmt: skip
    return read


def diesel_recording(
    source: Source | Opened, channels: Channels | None, engine: EngineParameters, *,
    sensors: Sequence[str], any_rate: bool = False,
) -> Recording:  # fmt: skip
    """A recording of a diesel engine, with the sensors that are asked for.

    Raises:
        InputError: one line saying what is wrong with it.
    """
    source = as_table(source)
    if isinstance(source, SteadyPoints | PetrolRecording | RigRecording):
        raise _of_another(source, "one of a diesel engine over time")
    if not isinstance(source, Recording):
        return read_recording(source, channels, engine, sensors=sensors, any_rate=any_rate)
    for name in sensors:
        if name not in source.columns:
            raise InputError(f"{source.path or 'recording'}: column {name}", f"none ({listed(source.channels)})",
                             "this column", foreign_hint(name, source.columns))
    return source


def of_a_healthy_engine(
    source: Source | Opened, channels: Channels | None, engine: EngineParameters
) -> list[Recording]:
    """What an engine is learned from: a recording over time, or settled points as those in which it stands.

    Raises:
        InputError: one line saying what is wrong with it.
    """
    source = opened(source, engine, channels)
    if settled(source):
        return standing(settled_points(source, channels, engine, INPUTS))
    return [diesel_recording(source, channels, engine, sensors=())]


def settled_points(
    source: Source | Opened, channels: Channels | None, engine: EngineParameters,
    needed: Sequence[str],
) -> SteadyPoints:  # fmt: skip
    """Settled points, or the quiet stretches of a recording as such.

    Args:
        needed: columns that must be there.

    Raises:
        InputError: one line saying what is wrong with them.
    """
    source = as_table(source)
    if isinstance(source, Recording | PetrolRecording | RigRecording):
        raise _of_another(source, "settled points of a diesel engine")
    return source if isinstance(source, SteadyPoints) else read_points(source, channels, engine, needed)


def rig_recording(source: object, rig: RigParameters, *, all_readings: bool = False) -> RigRecording:
    """A recording of a rig.

    Args:
        source: a file, a table or what `read` gave.
        all_readings: every reading that the rig's file names must be there, and move.

    Raises:
        InputError: what can't be used.
    """
    source = as_table(source)
    if not isinstance(source, str | Path | pd.DataFrame | Imported | RigRecording):
        raise _of_another(source, f"one of {rig.name}")
    found = source if isinstance(source, RigRecording) else read_rig(source, rig)
    missing = [name for name in rig.readings if name not in found.readings]
    if all_readings and missing:
        raise InputError(f"{found.path}: column {missing[0]}", "none, or no number in it",
                         f"every reading of {rig.name}", "add it")
    if all_readings:
        refuse_still(found, rig)
    return found


def petrol_recording(
    source: Source | Opened, channels: Channels | None = None, absent: Collection[str] = ()
) -> PetrolRecording:
    """A recording of a petrol engine.

    Args:
        source: a file, a table or what `read` gave.
        channels: channel map for foreign names and units.
        absent: columns of the surroundings that it needn't have.

    Raises:
        InputError: one line saying what is wrong with it.
    """
    source = as_table(source)
    if isinstance(source, Recording | SteadyPoints | RigRecording):
        raise _of_another(source, "one of a petrol engine")
    return source if isinstance(source, PetrolRecording) else read_petrol(source, channels, absent)


def dataset(of: Recording | Result | pd.DataFrame) -> xr.Dataset:
    """A recording, a result or a table as an xarray dataset, over `time_s` where there is one.

    Args:
        of: a recording of `read`, a result with a table, or a table in our columns.

    Returns:
        A variable a column, with its symbol, unit and meaning as `long_name`, `units` and `description`.

    Raises:
        InputError: xarray isn't installed.
    """
    require("xarray", "tables", "dataset")
    import xarray as xr

    frame = of if isinstance(of, pd.DataFrame) else of.frame() if isinstance(of, Recording) else of.table()
    indexed = frame.set_index(TIME) if TIME in frame else frame
    found = xr.Dataset.from_dataframe(indexed)
    for name in map(str, found.variables):
        symbol = BY_COLUMN.get(name)
        if symbol is not None:
            found[name].attrs = {"long_name": symbol.name, "units": symbol.unit, "description": symbol.meaning}
    return found


def as_table(source: Any) -> Any:
    """A dataset as a table of its columns, a table with names of text; a file, and what was read, as it is.

    Raises:
        InputError: a dataset over more than one dimension, a column twice, or nothing that can be read.
    """
    xarray = sys.modules.get("xarray")  # who has a dataset has imported it
    if xarray is not None and isinstance(source, xarray.Dataset):
        if len(source.sizes) != 1:
            raise InputError("dataset", f"dimensions {', '.join(map(str, source.sizes))}", "one, of time or of points",
                             "select along the others")
        return source.to_dataframe().reset_index()
    if isinstance(source, pd.DataFrame):
        names = [str(name) for name in source.columns]
        if twice := [name for name in names if names.count(name) > 1]:
            raise InputError(f"table: column {twice[0]}", f"{names.count(twice[0])} of that name", "every column once",
                             "drop or rename the others")
        return source if names == list(source.columns) else source.set_axis(names, axis=1)
    if isinstance(source, str | Path | Imported | Recording | SteadyPoints | PetrolRecording | RigRecording):
        return source
    do = "give its .table()" if isinstance(source, Result) else "give one of these"
    raise InputError("recording", f"a {type(source).__name__}", "a file, a table, a dataset or what `read` gave", do)
