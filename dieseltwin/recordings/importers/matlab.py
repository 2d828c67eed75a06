"""MATLAB files: version 4 to 7 by scipy, 7.3 (and plain HDF5) by h5py. Vectors, structures, structures with time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import scipy  # its `io` loads when it is wanted: a tenth of a second that other recordings need not wait

from dieseltwin.errors import InputError
from dieseltwin.recordings.importers.layout import told_unit
from dieseltwin.recordings.importers.signals import RawChannels, Signal, unique_names, unreadable
from dieseltwin.settings.extras import require

# fields of a structure that holds one signal, in lower case
TIME_FIELDS = ("time", "t", "timestamps", "zeit")
VALUE_FIELDS = ("values", "value", "data", "samples", "signal", "y")
UNIT_FIELDS = ("unit", "units", "einheit")
TIME_NAMES = (*TIME_FIELDS, "time_s", "tout", "timestamp", "t_s", "zeit_s")
OPAQUE = "a MATLAB object (timetable, table or timeseries)"
OPAQUE_DO = (
    "in MATLAB: S = timetable2table(tt) as plain vectors, save('x.mat', '-struct', 'S'), or writetimetable(tt, 'x.csv')"
)


@dataclass(frozen=True)
class Leaf:
    """A vector found in the file: its path, values, and time and unit where its structure has them."""

    name: str
    values: np.ndarray
    time_s: np.ndarray | None = None
    unit: str | None = None


def read_matlab(path: Path) -> RawChannels:
    """Read a MAT file of version 4 to 7.

    Raises:
        InputError: not readable, or no vectors of numbers inside.
    """
    try:
        content = scipy.io.loadmat(path, squeeze_me=True, struct_as_record=False, mat_dtype=True)
    except NotImplementedError:
        return read_hdf5(path)
    except Exception as error:  # scipy lets zlib, struct and its own errors through
        raise unreadable(path, "MATLAB", error) from None
    tree = {str(name): _plain(value) for name, value in content.items() if not name.startswith("__")}
    opaque = sorted(name for name, value in content.items() if type(value).__name__ == "MatlabOpaque")
    return _assembled(path, "MATLAB", tree, opaque or (["None"] if "None" in content else []))


def _plain(value: Any) -> Any:
    """scipy's structures as dictionaries, everything else as it is."""
    fields = value._fieldnames if isinstance(value, scipy.io.matlab.mat_struct) else None
    if fields is not None:
        return {str(name): _plain(value.__dict__[name]) for name in fields}
    if isinstance(value, np.ndarray) and value.dtype == object and value.size < 10_000:
        return [_plain(item) for item in value.ravel()]
    return value


def read_hdf5(path: Path) -> RawChannels:
    """Read a MAT file of version 7.3, or a plain HDF5 file.

    Raises:
        InputError: h5py is missing, not readable, or no vectors of numbers inside.
    """
    require("h5py", "formats", f"{path}: a MATLAB 7.3 file")
    import h5py

    opaque: list[str] = []

    def tree_of(group: Any) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for name, item in group.items():
            if name.startswith("#"):
                continue
            if "MATLAB_object_decode" in item.attrs:
                opaque.append(str(name))
            elif isinstance(item, h5py.Group):
                found[str(name)] = tree_of(item)
            else:
                found[str(name)] = _dataset(item, h5py, file)
        return found

    try:
        with h5py.File(path, "r") as file:
            tree = tree_of(file)
            kind = "MATLAB 7.3" if any("MATLAB_class" in item.attrs for item in file.values()) else "HDF5"
    except (OSError, KeyError, ValueError, RuntimeError) as error:
        raise unreadable(path, "MATLAB 7.3", error) from None
    return _assembled(path, kind, tree, opaque)


def _dataset(item: Any, h5py: Any, file: Any) -> Any:
    if item.attrs.get("MATLAB_class") == b"char" or item.attrs.get("MATLAB_empty"):
        return (
            "".join(chr(int(code)) for code in np.asarray(item).ravel()) if not item.attrs.get("MATLAB_empty") else ""
        )
    if item.dtype == h5py.ref_dtype:
        return [
            _dataset(file[reference], h5py, file)
            if isinstance(file[reference], h5py.Dataset)
            else {str(k): _dataset(v, h5py, file) for k, v in file[reference].items() if isinstance(v, h5py.Dataset)}
            for reference in np.asarray(item).ravel()
        ]
    if item.dtype.kind in "OS":
        return [text.decode() if isinstance(text, bytes) else str(text) for text in np.asarray(item).ravel()]
    unit = next((item.attrs[key] for key in ("unit", "units") if key in item.attrs), None)
    values = np.asarray(item).squeeze()
    if unit is not None:
        return {"values": values, "unit": unit.decode() if isinstance(unit, bytes) else str(unit)}
    return values


def _assembled(path: Path, kind: str, tree: Mapping[str, Any], opaque: list[str]) -> RawChannels:
    leaves = list(_leaves(tree, ""))
    if not leaves:
        if opaque:
            raise InputError(str(path), OPAQUE, "vectors of numbers, or structures of them", OPAQUE_DO)
        raise InputError(
            str(path),
            f"a {kind} file without vectors of numbers ({', '.join(tree) or 'nothing'})",
            "one vector a channel, and one of time",
            "save the vectors themselves",
        )
    notes = [f"{', '.join(opaque)} left out: {OPAQUE}"] if opaque and opaque != ["None"] else []
    leaves = _short_names(leaves)
    sizes = {leaf.values.size for leaf in leaves}
    if len(sizes) == 1 and all(leaf.time_s is None for leaf in leaves):
        frame = pd.DataFrame({leaf.name: leaf.values for leaf in leaves})
        units = {leaf.name: leaf.unit for leaf in leaves if leaf.unit}
        return RawChannels(path, kind, table=frame, units=units, notes=tuple(notes))
    return _several_rasters(path, kind, leaves, notes)


def _several_rasters(path: Path, kind: str, leaves: list[Leaf], notes: list[str]) -> RawChannels:
    """Vectors of several lengths: each takes the time vector of its own length (of its own structure first)."""
    clocks = [leaf for leaf in leaves if leaf.time_s is None and leaf.name.rsplit(".", 1)[-1].lower() in TIME_NAMES]
    signals = []
    for leaf in leaves:
        time = leaf.time_s
        if time is None:
            fitting = [clock for clock in clocks if clock.values.size == leaf.values.size and clock is not leaf]
            own = [clock for clock in fitting if clock.name.rpartition(".")[0] == leaf.name.rpartition(".")[0]]
            time = _seconds((own or fitting)[0]) if fitting else None
        if leaf in clocks:
            continue
        if time is None or time.size != leaf.values.size:
            notes.append(f"{leaf.name} left out: {leaf.values.size} values and no time vector of that length")
            continue
        signals.append(Signal(leaf.name, leaf.unit, np.asarray(time, dtype=np.float64), leaf.values, leaf.name))
    if not signals:
        raise InputError(
            str(path),
            "vectors of several lengths and none of time",
            "a time vector for each length",
            "save the times too (a vector called time)",
        )
    return RawChannels(path, kind, signals=unique_names(signals), notes=tuple(notes))


def _seconds(clock: Leaf) -> np.ndarray:
    """The times of a vector of them (n,), by its own unit [s]."""
    unit_s = told_unit(clock.name.rsplit(".", 1)[-1], clock.unit)
    return clock.values if unit_s is None else clock.values * unit_s


def _leaves(tree: Any, prefix: str) -> Iterator[Leaf]:
    if isinstance(tree, Mapping):
        yield from _structure(tree, prefix)
    elif isinstance(tree, list):
        for index, item in enumerate(tree):
            if isinstance(item, Mapping):  # an array of structures: a name inside tells them apart
                label = next(
                    (item[k] for k in ("name", "Name", "label", "blockName") if isinstance(item.get(k), str)), ""
                )
                yield from _leaves(item, f"{prefix}.{label or index + 1}" if prefix else str(label or index + 1))
    elif isinstance(tree, np.ndarray) and tree.dtype.kind in "fiub":
        values = np.asarray(tree, dtype=np.float64)
        if values.ndim == 1 and values.size > 1:
            yield Leaf(prefix, values)
        elif values.ndim == 2 and min(values.shape) > 1:
            table = values if values.shape[0] >= values.shape[1] else values.T
            for index in range(table.shape[1]):
                yield Leaf(f"{prefix}({index + 1})", np.ascontiguousarray(table[:, index]))


def _structure(tree: Mapping[str, Any], prefix: str) -> Iterator[Leaf]:
    """One structure: a signal with time and values, Simulink's 'structure with time', or a folder of further ones."""
    fields = {name.lower(): name for name in tree}
    time = _vector(tree, fields, TIME_FIELDS)
    values = _vector(tree, fields, VALUE_FIELDS)
    unit = next((str(tree[fields[key]]) for key in UNIT_FIELDS if isinstance(tree.get(fields.get(key, "")), str)), None)
    if values is not None and prefix:
        fits = time is not None and time.size == values.size
        yield Leaf(prefix, values, time if fits else None, unit)
        return
    if time is not None and "signals" in fields:
        for leaf in _leaves(tree[fields["signals"]], prefix):
            yield Leaf(leaf.name, leaf.values, time, leaf.unit) if leaf.values.size == time.size else leaf
        return
    for name, value in tree.items():
        yield from _leaves(value, f"{prefix}.{name}" if prefix else name)


def _vector(tree: Mapping[str, Any], fields: Mapping[str, str], wanted: tuple[str, ...]) -> np.ndarray | None:
    for key in wanted:
        value = tree.get(fields.get(key, ""))
        if isinstance(value, np.ndarray) and value.ndim == 1 and value.size > 1 and value.dtype.kind in "fiub":
            return np.asarray(value, dtype=np.float64)
    return None


def _short_names(leaves: list[Leaf]) -> list[Leaf]:
    """Names without the structure that all of them share ('data.n_e' -> 'n_e')."""
    first = {leaf.name.split(".", 1)[0] for leaf in leaves}
    if len(first) == 1 and all("." in leaf.name for leaf in leaves):
        return [Leaf(leaf.name.split(".", 1)[1], leaf.values, leaf.time_s, leaf.unit) for leaf in leaves]
    return leaves
