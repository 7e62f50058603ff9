"""Tables for programs, in CSV and as pandas DataFrames, and optional packages."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

from curlfit.errors import InputError
from curlfit.foreign import csv_lines
from curlfit.output.table import Table


def optional(module: str, extra: str) -> Any:
    """A package installed by an extra of curlfit.

    Raises
    ------
    InputError : it is not installed.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if error.name != module:
            raise
        raise InputError(
            f"{module} is not installed: pip install 'curlfit[{extra}]'"
        ) from None


def frame(columns: Mapping[str, Any], index: Any = None) -> Any:
    """A pandas DataFrame of columns.

    Raises
    ------
    InputError : pandas is not installed.
    """
    return optional("pandas", "notebook").DataFrame(dict(columns), index=index)


def frame_of(table: Table[Any]) -> Any:
    """A table as a pandas DataFrame, its columns by their names.

    Raises
    ------
    InputError : pandas is not installed.
    """
    return frame(
        {
            column.name: [column.get(row) for row in table.rows]
            for column in table.columns
        }
    )


def csv_of(table: Table[Any]) -> str:
    """A table as CSV text: the names of its columns and all values, empty where a row
    has none."""
    lines = [[column.name for column in table.columns]]
    for row in table.rows:
        lines.append([column.get(row) for column in table.columns])
    return csv_lines(lines)
