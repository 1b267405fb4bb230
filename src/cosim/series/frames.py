"""Samples over time as pandas and xarray have them; both come with an extra."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from cosim.arrays import Vector
from cosim.host.optional_packages import optional_module
from cosim.series.column import Column

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


def data_frame(
    columns: Sequence[Column], time: Vector, values: Vector, attrs: Mapping[str, Any]
) -> pd.DataFrame:
    """Return a `pandas.DataFrame` of SI values indexed by time.

    Raises:
        MissingTool: pandas is not installed.
    """
    names = tuple(column.name for column in columns)
    frame: pd.DataFrame = optional_module("pandas", "data").DataFrame(
        values, columns=names, index=time
    )
    frame.index.name = "time"
    frame.attrs = dict(attrs)
    return frame


def data_set(
    columns: Sequence[Column], time: Vector, values: Vector, attrs: Mapping[str, Any]
) -> xr.Dataset:
    """Return an `xarray.Dataset` of SI values over time, unit and meaning in `attrs`.

    Raises:
        MissingTool: xarray is not installed.
    """
    variables = {
        column.name: ("time", own, column.facts)
        for column, own in zip(columns, values.T, strict=True)
    }
    coordinates = {"time": ("time", time, {"units": "s"})}
    found: xr.Dataset = optional_module("xarray", "data").Dataset(variables, coordinates, attrs)
    return found
