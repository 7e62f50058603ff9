"""Tables in memory: pandas, polars and xarray objects, by what they can do."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from curlfit.errors import DataError, InputError
from curlfit.throws.readers.assemble import assemble
from curlfit.throws.readers.columns import Column, in_unit, parse_units, understand, with_units
from curlfit.throws.readers.parsed_file import Reading, columns_of, in_si
from curlfit.throws.throw import Throw


def from_table(
    table: Any,
    *,
    axes: str | None = None,
    units: str | None = None,
    reference: str | PathLike[str] | None = None,
    name: str = "table",
) -> Throw:
    """A throw from a table in memory.

    Parameters
    ----------
    table : a pandas or polars DataFrame, an xarray Dataset, or a mapping of names to arrays of
        one length. Columns are named as in files, units in the names; a variable's
        `attrs["units"]` comes before. The index of a frame, or the coordinate of a dataset,
        stands for the time where no column does. Times may be dates or durations.
    axes, units, reference : as for `load_throw`.
    name : what to call the throw.

    Raises
    ------
    DataError, InputError : the table is none, a column is missing or no numbers.
    """
    wanted = parse_units(units)
    values, stated, notes = _variables(table, name)
    names = list(values)
    columns, ignored = columns_of(name, names, wanted, pixels=reference is not None)
    reading = Reading(name, "table", [], ignored, notes=notes)
    lengths = {len(values[names[place]]) for place in columns}
    if len(lengths) > 1:
        raise DataError(
            f"columns of different lengths ({', '.join(map(str, sorted(lengths)))})", file=name
        )
    if lengths == {0}:
        raise DataError("no rows", file=name)
    for place, column in columns.items():
        header = names[place]
        if header in stated and column.quantity.removeprefix("sigma_") not in wanted:
            column = _stated(name, header, column, stated[header])
        numbers = _numbers(values[header], column, name, header)
        reading.series.append(in_si(reading, header, column, numbers))
    return assemble(reading, axes=axes, reference=None if reference is None else Path(reference))


def _variables(table: Any, name: str) -> tuple[dict[str, Any], dict[str, str], list[str]]:
    """Columns by name, the units they state, and notes."""
    values: dict[str, Any] = {}
    stated: dict[str, str] = {}
    notes: list[str] = []
    if hasattr(table, "data_vars") and hasattr(table, "coords"):
        for key in [*table.coords, *table.data_vars]:
            variable = table[key]
            if len(variable.dims) != 1:
                notes.append(f"variable {key} has {len(variable.dims)} dimensions and was ignored")
                continue
            values[str(key)] = np.asarray(variable.values)
            unit = variable.attrs.get("units", variable.attrs.get("unit"))
            if isinstance(unit, str) and unit.strip():
                stated[str(key)] = unit
        used = {str(key): table[key].dims[0] for key in [*table.coords, *table.data_vars]
                if str(key) in values and understand(str(key)) is not None}  # fmt: skip
        if len(set(used.values())) > 1:
            raise DataError(
                "variables along different dimensions ("
                + ", ".join(f"{key} along {dim}" for key, dim in used.items())
                + "); merge them to one",
                file=name,
            )
        return values, stated, notes
    if hasattr(table, "columns") and hasattr(table, "__getitem__"):
        keys = list(table.columns)
        if len({str(key) for key in keys}) < len(keys):
            raise DataError("two columns of the same name", file=name)
        index = getattr(table, "index", None)
        known = {c.quantity for key in keys if (c := understand(str(key))) is not None}
        if index is not None and not known & {"t"} and getattr(index, "nlevels", 1) == 1:
            own = getattr(index, "name", None)
            meaning = understand(str(own)) if own is not None else None
            dated = getattr(getattr(index, "dtype", None), "kind", "") in "mM"
            if (meaning is not None and meaning.quantity == "t") or dated:
                label = str(own) if meaning is not None and meaning.quantity == "t" else "time"
                values[label] = np.asarray(index)
        values |= {str(key): np.asarray(table[key]) for key in keys}
        return values, stated, notes
    if isinstance(table, Mapping):
        return {str(key): _filled(table[key]) for key in table}, stated, notes
    raise InputError(
        f"{type(table).__name__}: expected a DataFrame, a Dataset or a mapping of names to arrays"
    )


def _stated(name: str, header: str, column: Column, unit: str) -> Column:
    try:
        return with_units(column, {column.quantity.removeprefix("sigma_"): unit})
    except InputError:
        try:
            return in_unit(column.quantity, unit)
        except InputError as error:
            raise DataError(str(error), file=name, column=header) from None


def _numbers(values: Any, column: Column, name: str, header: str) -> np.ndarray:
    """Numbers as they stand; times as seconds, in the column's unit."""
    if values.ndim != 1:
        raise DataError(f"{values.ndim} dimensions, expected one", file=name, column=header)
    if values.dtype.kind in "mM" and column.quantity.startswith("t"):
        blank = np.isnat(values)
        if blank.all():
            raise DataError("every time is missing", file=name, column=header)
        origin = values[~blank][0] if values.dtype.kind == "M" else np.timedelta64(0, "ns")
        numbers = (values - origin) / np.timedelta64(1, "s") / column.factor
        return np.where(blank, np.nan, numbers)
    try:
        numbers = np.array([np.nan if _blank(v) else v for v in values.tolist()], dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise DataError("expected numbers", file=name, column=header) from None
    if np.isinf(numbers).any():
        row = int(np.argmax(np.isinf(numbers)))
        raise DataError(f"row {row}: {numbers[row]} found, expected a finite number",
                        file=name, column=header)  # fmt: skip
    return numbers


def _blank(value: Any) -> bool:
    return value is None or type(value).__name__ == "NAType"  # of pandas


def _filled(values: Any) -> np.ndarray:
    """An array; masked entries are gaps."""
    if isinstance(values, np.ma.MaskedArray):
        return np.ma.filled(values.astype(float), np.nan)
    return np.asarray(values)
