"""Tables of quantities that are no throw, such as known points of a camera."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

from curlfit.errors import InputError
from curlfit.numerics.arrays import Floats
from curlfit.throws.readers.columns import (
    Column,
    named_column,
    parse_units,
    with_unit,
)
from curlfit.throws.readers.comments import headings_named_in
from curlfit.throws.readers.headings import named_columns
from curlfit.throws.readers.table import Table
from curlfit.throws.readers.text import TextFile

Meaning = Callable[[str], Column | None]


def find_table(
    file: TextFile,
    meaning: Meaning,
    required: Collection[str],
    expected: str,
    named: Mapping[str, str],
) -> Table:
    """The table of a file with columns of all required quantities, by their headings or
    as the user names them.

    Parameters
    ----------
    meaning : what a column of a heading holds; None for another column.
    expected : for a message. named : headings that the user names, by quantity.

    Raises
    ------
    DataError : the file is empty or begins with numbers.
    """

    def knows(table: Table) -> bool:
        columns = filter(None, map(meaning, table.headings))
        present = {column.quantity for column in columns} | named.keys()
        return table.has(named.values()) and set(required) <= present

    return Table.find(file, knows, expected)


def read_quantities(
    file: TextFile,
    meaning: Meaning,
    required: Collection[str],
    expected: str,
    named: Mapping[str, str] | None = None,
    units: str | None = None,
) -> tuple[Table, dict[str, Floats], dict[str, int]]:
    """A table, its quantities in SI (pixels), each of shape (rows,), with NaN for gaps,
    and the places of their columns.

    Parameters
    ----------
    meaning, required, expected, named : as of `find_table`; headings may be named by
        lines `# columns.NAME = "HEADING"` of the file too.
    units : in place of those of the headings, as of `parse_units`.

    Raises
    ------
    DataError : a required column is missing, two mean the same, or a cell is no number.
    """
    named = {**headings_named_in(file), **(named or {})}
    table = find_table(file, meaning, required, expected, named)

    def quantity_of(word: str) -> str | None:
        column = meaning(word)
        return None if column is None else column.quantity

    columns = [meaning(heading) for heading in table.headings]
    of_user = named_columns(
        named, table.headings, table.error, quantity_of, ", ".join(required)
    )
    for place, quantity in of_user.items():
        columns = [
            None if column and column.quantity == quantity else column
            for column in columns
        ]
        try:
            columns[place] = named_column(table.headings[place], quantity)
        except InputError as fault:
            raise table.error(str(fault)) from None
    place_of = table.sole([column.quantity if column else "" for column in columns])
    missing = [quantity for quantity in required if quantity not in place_of]
    if missing:
        raise table.error(f"no column for {' and '.join(missing)}; {expected}")
    numbers = table.numbers(list(place_of.values()))
    in_si = {}
    unit_of = parse_units(units)
    for (quantity, place), values in zip(place_of.items(), numbers, strict=True):
        column = columns[place]
        if column is not None:
            column = with_unit(column, unit_of.get(column.base))
        in_si[quantity] = values * (column.factor if column else 1.0)
    return table, in_si, place_of
