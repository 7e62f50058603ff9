"""A table is rows and columns: a column knows its heading, how it gets the value of a
row, how it writes it, and in which unit.

Each way to show a table stands once: on a terminal in `console`, in a notebook in
`html`, on a page in `html_report.blocks`, as CSV and pandas in `frames`, and as LaTeX
in `latex`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

from rich.text import Text

Row = TypeVar("Row")
Cell = str | Text | tuple[Text, ...]
"""What a page shows of a row; texts of a tuple stand side by side."""


@dataclass(frozen=True)
class Column(Generic[Row]):
    """A column of a table.

    Attributes
    ----------
    heading : above the column on a page.
    value : gets the value of a row, which is None where the row has none; by default
        the attribute of the row that has the name of the column.
    format : how a value is written on a page: a format specification such as ".3g",
        or a function.
    words : writes the cell of a row on a page, where this needs more than the value.
    unit : of the numbers on a page, shown after the heading; on a line of its own
        after a heading that ends with a line break.
    key : its name for programs, as in CSV and pandas, where values are in full
        precision and SI units; the heading if empty.
    missing : on a page where the row has no value.
    right : whether cells are aligned to the right, as numbers are.
    wraps : whether cells may be wrapped.
    """

    heading: str
    value: Callable[[Row], Any] | None = None
    format: str | Callable[[Any], Cell] = ""
    words: Callable[[Row], Cell] | None = None
    unit: str = ""
    key: str = ""
    missing: str = "-"
    right: bool = False
    wraps: bool = False

    @property
    def title(self) -> str:
        """The heading with the unit in parentheses."""
        if not self.unit:
            return self.heading
        gap = "" if self.heading.endswith("\n") else " "
        return f"{self.heading}{gap}({self.unit})"

    @property
    def name(self) -> str:
        """The name for programs."""
        return self.key or self.heading

    def get(self, row: Row) -> Any:
        """The value of a row."""
        if self.value is None:
            return getattr(row, self.name)
        return self.value(row)

    def but(self, **changes: Any) -> Column[Row]:
        """The column with another heading, format ..."""
        return replace(self, **changes)

    def cell(self, row: Row) -> Cell:
        """What a page shows of a row."""
        if self.words is not None:
            return self.words(row)
        value = self.get(row)
        if value is None:
            return self.missing
        if callable(self.format):
            return self.format(value)
        return format(value, self.format)

    def has_content(self, row: Row) -> bool:
        """Whether a page shows something of a row, other than that a value is
        missing."""
        if self.words is None and self.get(row) is None:
            return False
        return self.cell(row) not in ("", ())


@dataclass(frozen=True)
class Table(Generic[Row]):
    """Rows and columns.

    Attributes
    ----------
    rows : of any kind that the columns can read.
    caption : what the table shows, for pages; a terminal and a notebook do without.
    keys : number of columns, from the left, that tell the rows apart; they are
        repeated where a terminal is too narrow for all columns side by side.
    note : a text directly below.
    """

    rows: Sequence[Row]
    columns: Sequence[Column[Row]]
    caption: str = ""
    keys: int = 1
    note: Text | None = None

    def __bool__(self) -> bool:
        return bool(self.shown)

    @property
    def shown(self) -> list[Column[Row]]:
        """The columns that a page shows: those with content in some row."""
        return [
            column
            for column in self.columns
            if any(column.has_content(row) for row in self.rows)
        ]
