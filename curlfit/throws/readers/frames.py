"""Tables in memory: of pandas, polars, PyArrow, xarray, or mappings of arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from curlfit.errors import DataError, InputError
from curlfit.findings import Finding
from curlfit.foreign import quoted
from curlfit.numerics.arrays import Floats
from curlfit.settings.choices import Reading
from curlfit.throws.readers.assemble import assemble
from curlfit.throws.readers.columns import Column, parse_header, parse_units, with_unit
from curlfit.throws.readers.headings import Headings
from curlfit.throws.readers.parsed_file import ParsedFile
from curlfit.throws.readers.path import TABLE
from curlfit.throws.readers.sequences import as_array, numbers, times
from curlfit.throws.readers.throws_in_rows import throws_of

_TABLES = "a DataFrame, a Dataset, a table or a mapping of names to arrays"
_Variables = tuple[dict[str, Any], dict[str, str]]  # columns, and stated units, by name


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
    units_of_user = parse_units(reading.units)
    parsed = ParsedFile(name, "table")
    values, stated = _variables(table, parsed)
    names = list(values)

    def numeric(index: int) -> bool:
        return as_array(values[names[index]]).dtype.kind in "fiu"

    columns = Headings(names, parsed.error, numeric).of_throw(
        parsed, reading, python=True
    )
    arrays: dict[int, Floats] = {}
    for index, column in columns.items():
        header = names[index]
        if column.base not in units_of_user:
            try:
                column = with_unit(column, stated.get(header))
            except InputError as error:
                raise parsed.error(str(error), quantity=header) from None
        columns[index] = column
        arrays[index] = _in_unit(values[header], column, parsed, header)
    lengths = {names[index]: len(array) for index, array in arrays.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{header} {rows}" for header, rows in lengths.items())
        raise parsed.error(
            f"columns of unlike lengths ({listed}); expected one value of each in "
            "every row"
        )
    if not all(lengths.values()):
        raise parsed.error("no rows")
    for index, column in columns.items():
        parsed.add(names[index], column, arrays[index])
    rows = len(parsed.series[0].values)
    cells_by_header = {}  # of columns that may name the throw of each row
    for index, header in enumerate(names):
        array = as_array(values[header])
        if index not in columns and array.shape == (rows,):
            cells_by_header[header] = array.tolist()
    contents = throws_of(parsed, cells_by_header)
    return assemble(TABLE.selected(name, contents, reading.stone_index), reading)


def _in_unit(values: Any, column: Column, parsed: ParsedFile, header: str) -> Floats:
    """The numbers of a column in its unit."""

    def fault(message: str) -> DataError:
        return parsed.error(message, quantity=header)

    if column.quantity.startswith("t"):
        return times(values, fault, column.factor)
    return numbers(values, fault)


def _variables(table: Any, parsed: ParsedFile) -> _Variables:
    """The columns of a table, whatever has made it, and the units that it states."""
    if hasattr(table, "data_vars") and hasattr(table, "coords"):
        return _of_dataset(table, parsed)
    if hasattr(table, "collect") and hasattr(table, "lazy"):  # a LazyFrame of polars
        table = table.collect()
    if isinstance(table, Mapping):
        return {str(name): values for name, values in table.items()}, {}
    if hasattr(table, "columns") and hasattr(table, "__getitem__"):
        return _of_frame(table, parsed), {}
    fields = getattr(getattr(table, "dtype", None), "names", None)
    if fields:  # an array of NumPy with named fields
        return {name: table[name] for name in fields}, {}
    fault = f"{type(table).__name__} found, expected {_TABLES}"
    if isinstance(table, str):
        fault = f"{quoted(table)} found, expected {_TABLES}; load_throw reads a file"
    raise InputError(f"table: {fault}")


def _of_dataset(table: Any, parsed: ParsedFile) -> _Variables:
    """The variables along one dimension, and the units that they state."""
    variables = {str(key): table[key] for key in [*table.coords, *table.data_vars]}
    flat = {
        name: variable
        for name, variable in variables.items()
        if len(variable.dims) == 1
    }
    if len(flat) < len(variables):
        ignored = [name for name in variables if name not in flat]
        parsed.notes.append(Finding.note("variables-ignored", variables=ignored))
    dimensions = {
        name: variable.dims[0]
        for name, variable in flat.items()
        if parse_header(name) is not None
    }
    if len(set(dimensions.values())) > 1:
        listed = ", ".join(f"{name} along {dim}" for name, dim in dimensions.items())
        raise parsed.error(
            f"variables along different dimensions ({listed}); merge them to one"
        )
    units = {
        name: str(variable.attrs["units"])
        for name, variable in flat.items()
        if variable.attrs.get("units")
    }
    return {name: variable.values for name, variable in flat.items()}, units


def _of_frame(table: Any, parsed: ParsedFile) -> dict[str, Any]:
    """The columns; an index of times or dates is the time where no column is."""
    keys = list(getattr(table, "column_names", table.columns))  # PyArrow's, or others'
    if len({str(key) for key in keys}) < len(keys):
        raise parsed.error("two columns of the same name")
    values = {str(key): table[key] for key in keys}
    index = getattr(table, "index", None)
    if index is None or any(map(_is_time, values)) or getattr(index, "nlevels", 1) > 1:
        return values
    name = str(index.name)
    if _is_time(name):
        return {name: index, **values}
    dates = as_array(index).dtype.kind in "mM"
    return {"time": index, **values} if dates else values


def _is_time(name: str) -> bool:
    column = parse_header(name)
    return column is not None and column.quantity == "t"
