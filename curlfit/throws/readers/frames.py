"""Throws from tables in memory: pandas, polars, xarray, mappings of arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from curlfit.errors import InputError
from curlfit.settings.choices import Reading
from curlfit.throws.readers.assemble import assemble
from curlfit.throws.readers.columns import Column, parse_header, parse_units, with_unit
from curlfit.throws.readers.parsed_file import ParsedFile, columns_of
from curlfit.throws.readers.several import contents_of
from curlfit.throws.readers.table import TABLE
from curlfit.throws.readers.text import clock_times


def values_of(table: Any, reading: Reading, name: str = "table") -> dict[str, Any]:
    """The values in a table in memory, as arguments of `Throw.from_arrays`.

    Parameters
    ----------
    table : as for `Throw.from_frame`. name : name of the throw.

    Raises
    ------
    DataError, InputError : not a table, a column that is missing or not numeric.
    """
    TABLE.check(name, reading)
    units = parse_units(reading.units)
    parsed = ParsedFile(name, "table")
    values, stated = _variables(table, parsed)
    names = list(values)
    columns, parsed.ignored = columns_of(names, reading, parsed.error)
    lengths = {len(values[names[index]]) for index in columns}
    if len(lengths) > 1:
        raise parsed.error(f"columns of different lengths ({', '.join(map(str, sorted(lengths)))})")
    if lengths == {0}:
        raise parsed.error("no rows")
    for index, column in columns.items():
        header = names[index]
        if column.base not in units:
            try:
                column = with_unit(column, stated.get(header))
            except InputError as error:
                raise parsed.error(str(error), quantity=header) from None
        parsed.add(header, column, _numbers(values[header], column, parsed, header))
    words = {names[k]: values[names[k]].tolist() for k in range(len(names)) if k not in columns}
    contents = contents_of(parsed, words)
    return assemble(TABLE.selected(name, contents, reading.stone_index, "stone_index ="), reading)


def _variables(table: Any, parsed: ParsedFile) -> tuple[dict[str, Any], dict[str, str]]:
    """Columns by name, and their stated units."""
    if hasattr(table, "data_vars") and hasattr(table, "coords"):
        return _of_dataset(table, parsed)
    if hasattr(table, "columns") and hasattr(table, "__getitem__"):
        return _of_frame(table, parsed), {}
    if isinstance(table, Mapping):
        # of masked arrays, of any kind, masked entries are gaps
        filled = {
            str(key): np.ma.filled(v.astype(float), np.nan) if np.ma.isMaskedArray(v) else v
            for key, v in table.items()
        }
        return {name: np.asarray(values) for name, values in filled.items()}, {}
    raise InputError(
        f"{type(table).__name__}: expected a DataFrame, a Dataset or a mapping of names to arrays"
    )


def _of_dataset(table: Any, parsed: ParsedFile) -> tuple[dict[str, Any], dict[str, str]]:
    values, stated, used = {}, {}, {}
    for key in [*table.coords, *table.data_vars]:
        variable, name = table[key], str(key)
        if len(variable.dims) != 1:
            parsed.notes.append(
                f"variable {key} has {len(variable.dims)} dimensions and was ignored"
            )
            continue
        values[name] = np.asarray(variable.values)
        unit = variable.attrs.get("units", variable.attrs.get("unit"))
        if isinstance(unit, str) and unit.strip():
            stated[name] = unit
        if parse_header(name) is not None:
            used[name] = variable.dims[0]
    if len(set(used.values())) > 1:
        listed = ", ".join(f"{name} along {dim}" for name, dim in used.items())
        raise parsed.error(f"variables along different dimensions ({listed}); merge them to one")
    return values, stated


def _of_frame(table: Any, parsed: ParsedFile) -> dict[str, Any]:
    values = {str(key): np.asarray(table[key]) for key in table.columns}
    if len(values) < len(table.columns):
        raise parsed.error("two columns of the same name")
    index = getattr(table, "index", None)
    if index is None or any(_is_time(name) for name in values) or getattr(index, "nlevels", 1) > 1:
        return values
    own = str(getattr(index, "name", None))
    dated = getattr(getattr(index, "dtype", None), "kind", "") in "mM"
    if _is_time(own) or dated:
        values = {own if _is_time(own) else "time": np.asarray(index), **values}
    return values


def _is_time(name: str) -> bool:
    column = parse_header(name)
    return column is not None and column.quantity == "t"


def _numbers(values: Any, column: Column, parsed: ParsedFile, header: str) -> np.ndarray:
    """Numbers in the column's unit; dates and durations as seconds."""
    if values.ndim != 1:
        raise parsed.error(f"{values.ndim} dimensions, expected one", quantity=header)
    if values.dtype.kind in "mM" and column.quantity.startswith("t"):
        blank = np.isnat(values)
        if blank.all():
            raise parsed.error("every time is missing", quantity=header)
        origin = values[~blank][0] if values.dtype.kind == "M" else np.timedelta64(0, "ns")
        numbers = (values - origin) / np.timedelta64(1, "s") / column.factor
        return np.where(blank, np.nan, numbers)
    if column.quantity.startswith("t") and values.dtype.kind in "OU":
        clock, bad = clock_times([None if _blank(v) else str(v) for v in values.tolist()])
        if not bad and np.isfinite(clock).any():
            return clock / column.factor
    try:
        numbers = np.array([np.nan if _blank(v) else v for v in values.tolist()], dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise parsed.error("expected numbers", quantity=header) from None
    if np.isinf(numbers).any():
        row = int(np.argmax(np.isinf(numbers)))
        raise parsed.error(f"{numbers[row]} found, expected a finite number", row, header)
    return numbers


def _blank(value: Any) -> bool:
    return value is None or type(value).__name__ == "NAType"  # of pandas
