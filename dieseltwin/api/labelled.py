"""Tables with labels: xarray datasets in and out (the extra `tables`)."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import pandas as pd

from dieseltwin.api.results import Result
from dieseltwin.errors import InputError
from dieseltwin.recordings.reader import Recording
from dieseltwin.settings.extras import require
from dieseltwin.symbols import BY_COLUMN

if TYPE_CHECKING:
    import xarray as xr

TIME = "time_s"


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
    """A dataset as a table of its columns; anything else as it is.

    Raises:
        InputError: a dataset over more than one dimension.
    """
    xarray = sys.modules.get("xarray")  # who has a dataset has imported it
    if xarray is None or not isinstance(source, xarray.Dataset):
        return source
    if len(source.sizes) != 1:
        raise InputError("dataset", f"dimensions {', '.join(map(str, source.sizes))}", "one, of time or of points",
                         "select along the others")
    return source.to_dataframe().reset_index()
