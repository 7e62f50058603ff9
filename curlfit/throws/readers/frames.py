"""Tables in memory: of pandas, polars, xarray, or mappings of arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from curlfit.errors import InputError
from curlfit.findings import Finding
from curlfit.numerics.arrays import filled, floats
from curlfit.settings.choices import Reading
from curlfit.throws.readers.assemble import assemble
from curlfit.throws.readers.clocks import AmbiguousTimesError, clock_times
from curlfit.throws.readers.columns import Column, parse_header, parse_units, with_unit
from curlfit.throws.readers.headings import Headings
from curlfit.throws.readers.parsed_file import ParsedFile
from curlfit.throws.readers.path import TABLE
from curlfit.throws.readers.throws_in_rows import throws_of

_Variables = tuple[dict[str, Any], dict[str, str]]  # arrays, and stated units, by name


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
    chosen = parse_units(reading.units)
    parsed = ParsedFile(name, "table")
    values, stated = _variables(table, parsed)
    names = list(values)

    def numeric(index: int) -> bool:
        return bool(values[names[index]].dtype.kind in "fiu")

    columns = Headings(names, parsed.error, numeric).of_throw(
        parsed, reading, python=True
    )
    shapes = sorted({values[names[index]].shape for index in columns})
    if len(shapes) > 1 or len(shapes[0]) != 1:
        listed = ", ".join(map(str, shapes))
        raise parsed.error(
            f"columns of different lengths, or of several dimensions: {listed}"
        )
    if shapes == [(0,)]:
        raise parsed.error("no rows")
    for index, column in columns.items():
        header = names[index]
        if column.base not in chosen:
            try:
                column = with_unit(column, stated.get(header))
            except InputError as error:
                raise parsed.error(str(error), quantity=header) from None
        parsed.add(header, column, _numbers(values[header], column, parsed, header))
    words = {
        name: values[name].tolist() for k, name in enumerate(names) if k not in columns
    }
    return assemble(
        TABLE.selected(name, throws_of(parsed, words), reading.stone_index), reading
    )


def _variables(table: Any, parsed: ParsedFile) -> _Variables:
    if hasattr(table, "data_vars") and hasattr(table, "coords"):
        return _of_dataset(table, parsed)
    if hasattr(table, "columns") and hasattr(table, "__getitem__"):
        return _of_frame(table, parsed), {}
    if isinstance(table, Mapping):
        return {str(name): filled(values) for name, values in table.items()}, {}
    raise InputError(
        f"{type(table).__name__}: expected a DataFrame, a Dataset or a mapping "
        "of names to arrays"
    )


def _of_dataset(table: Any, parsed: ParsedFile) -> _Variables:
    every = {str(key): table[key] for key in [*table.coords, *table.data_vars]}
    flat = {
        name: variable for name, variable in every.items() if len(variable.dims) == 1
    }
    if len(flat) < len(every):
        others = [name for name in every if name not in flat]
        parsed.notes.append(Finding.note("variables-ignored", variables=others))
    used = {
        name: v.dims[0] for name, v in flat.items() if parse_header(name) is not None
    }
    if len(set(used.values())) > 1:
        listed = ", ".join(f"{name} along {dim}" for name, dim in used.items())
        raise parsed.error(
            f"variables along different dimensions ({listed}); merge them to one"
        )
    units = {
        name: str(v.attrs["units"]) for name, v in flat.items() if v.attrs.get("units")
    }
    return {name: np.asarray(variable.values) for name, variable in flat.items()}, units


def _of_frame(table: Any, parsed: ParsedFile) -> dict[str, Any]:
    """The columns; an index of times or dates is the time where no column is."""
    values = {str(key): np.asarray(table[key]) for key in table.columns}
    if len(values) < len(table.columns):
        raise parsed.error("two columns of the same name")
    index = getattr(table, "index", None)
    if index is None or any(map(_is_time, values)) or getattr(index, "nlevels", 1) > 1:
        return values
    own, times = str(index.name), np.asarray(index)
    if _is_time(own):
        return {own: times, **values}
    return {"time": times, **values} if times.dtype.kind in "mM" else values


def _is_time(name: str) -> bool:
    column = parse_header(name)
    return column is not None and column.quantity == "t"


def _numbers(
    values: Any, column: Column, parsed: ParsedFile, header: str
) -> np.ndarray:
    """Numbers in the column's unit; dates and durations as seconds."""
    is_time = column.quantity.startswith("t")
    if values.dtype.kind in "mM" and is_time:
        blank = np.isnat(values)
        if blank.all():
            raise parsed.error("every time is missing", quantity=header)
        origin = (
            values[~blank][0] if values.dtype.kind == "M" else np.timedelta64(0, "ns")
        )
        numbers = (values - origin) / np.timedelta64(1, "s") / column.factor
        return np.where(blank, np.nan, numbers)
    if is_time and values.dtype.kind in "OU":
        # of pandas
        found = [None if type(v).__name__ == "NAType" else v for v in values.tolist()]
        try:
            clock = clock_times([None if v is None else str(v) for v in found])
        except AmbiguousTimesError as error:
            raise parsed.error(str(error), quantity=header) from None
        if clock.first and not clock.bad:
            return clock.seconds / column.factor
    try:
        return floats(values)
    except (TypeError, ValueError, OverflowError):
        raise parsed.error("expected numbers", quantity=header) from None
