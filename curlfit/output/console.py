"""What is printed on a terminal: no trailing blanks, tables that fit its width."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

from rich.console import (
    Console,
    ConsoleOptions,
    ConsoleRenderable,
    RenderHook,
    RenderResult,
)
from rich.measure import Measurement
from rich.segment import Segment
from rich.table import Table as RichTable
from rich.text import Text

from curlfit.foreign import printable
from curlfit.output.table import Cell, Column, Table

_DEFAULT_WIDTH = 110  # columns, if the output is not a terminal
_MIN_TEXT_WIDTH = 24  # columns of a wrapped cell
_UNLIMITED = 10_000
_GAP = "   "
_RUNS = re.compile(r"(?: *[^ \n])+| +|\n")
_BETWEEN = 2  # blanks between columns
_PLAIN: dict[str, Any] = {
    "box": None,
    "pad_edge": False,
    "padding": (0, _BETWEEN, 0, 0),
    "show_edge": False,
}
"""Style of a table without rules."""


def terminal(*, quiet: bool = False, highlight: bool = True) -> Console:
    """The console of the command line: width of the terminal or of
    `COLUMNS`, else 110."""
    from_terminal = sys.stdout.isatty() or "COLUMNS" in os.environ
    width = None if from_terminal else _DEFAULT_WIDTH
    # Names of files are no markup.
    console = Console(
        quiet=quiet, highlight=highlight, width=width, markup=False, emoji=False
    )
    console.push_render_hook(_Trimmer())
    return console


class _Trimmer(RenderHook):
    """What is printed on a console, without trailing blanks."""

    def process_renderables(
        self, renderables: list[ConsoleRenderable]
    ) -> list[ConsoleRenderable]:
        return [_TrimmedLines(printed) for printed in renderables]


class _TrimmedLines:
    """A text or a table without trailing blanks."""

    def __init__(self, printed: ConsoleRenderable) -> None:
        self.printed = printed

    def __rich_console__(
        self, console: Console, options: ConsoleOptions
    ) -> RenderResult:
        yield from _trim(console.render(self.printed, options))


def _trim(segments: Iterable[Segment]) -> Iterator[Segment]:
    """The segments without trailing blanks, and without control characters of
    foreign text."""
    blanks: list[Segment] = []
    for segment in segments:
        runs = [segment.text] if segment.control else _RUNS.findall(segment.text)
        for run in runs:
            safe = run if segment.control or run == "\n" else printable(run)
            part = Segment(safe, segment.style, segment.control)
            if run.isspace() and run != "\n":
                blanks.append(part)
                continue
            if run != "\n":
                yield from blanks
            blanks = []
            yield part
    yield from blanks


class SideBySide:
    """Texts side by side, wrapped between texts where possible."""

    def __init__(self, texts: Sequence[Text]) -> None:
        self.texts = texts

    def __rich_console__(
        self, console: Console, options: ConsoleOptions
    ) -> RenderResult:
        line = Text()
        for text in self.texts:
            if line and line.cell_len + len(_GAP) + text.cell_len > options.max_width:
                yield line
                line = Text()
            if line:
                line.append(_GAP)
            line.append_text(text)
        yield line

    def __rich_measure__(
        self, console: Console, options: ConsoleOptions
    ) -> Measurement:
        longest_words = [
            Measurement.get(console, options, text).minimum for text in self.texts
        ]
        least = max(longest_words, default=0)
        one_line = sum(text.cell_len + len(_GAP) for text in self.texts)
        return Measurement(
            min(least, options.max_width), min(one_line, options.max_width)
        )


class Printed:
    """A table as it is printed: without rules, and never truncated. If it is wider than
    the terminal, its columns are printed in blocks, one below the other, each repeating
    the first `keys` columns. The note follows below.
    """

    def __init__(self, table: Table[Any]) -> None:
        self.table = table

    def __rich_console__(
        self, console: Console, options: ConsoleOptions
    ) -> RenderResult:
        unlimited = options.update_width(_UNLIMITED)
        columns = []
        for column in self.table.shown:
            cells = [column.cell(row) for row in self.table.rows]
            width = _width_of_column(column, cells, console, unlimited)
            columns.append(_PrintedColumn(column, cells, width))
        keys = columns[: self.table.keys]
        blocks = _blocks(keys, columns[self.table.keys :], options.max_width)
        for number, block in enumerate(blocks):
            if number:
                yield Text("")
            yield _block(keys, block, options.max_width, whole=len(blocks) == 1)
        if self.table.note is not None:
            yield self.table.note


class _PrintedColumn(NamedTuple):
    """A column with its cells, and the width that it needs.

    Attributes
    ----------
    cells : of all rows.
    width : in characters, without the blanks between columns.
    """

    column: Column[Any]
    cells: list[Cell]
    width: int


def _width_of_column(
    column: Column[Any],
    cells: Sequence[Cell],
    console: Console,
    unlimited: ConsoleOptions,
) -> int:
    """Width of the longest line of a column or, where its cells may be wrapped, of the
    longest word but not less than a few words."""
    sizes = [
        console.measure(renderable(cell), options=unlimited)
        for cell in (column.title, *cells)
    ]
    longest_line = max(size.maximum for size in sizes)
    if not column.wraps:
        return longest_line
    longest_word = max(size.minimum for size in sizes)
    return min(longest_line, max(longest_word, _MIN_TEXT_WIDTH))


def renderable(cell: Cell) -> Text | SideBySide:
    """A cell for a console, without markup."""
    if isinstance(cell, tuple):
        return SideBySide(cell)
    return Text(cell) if isinstance(cell, str) else cell


def _blocks(
    keys: Sequence[_PrintedColumn],
    others: Sequence[_PrintedColumn],
    max_width: int,
) -> list[list[_PrintedColumn]]:
    """The columns of each block without the keys, as many as fit; at least one."""
    blocks: list[list[_PrintedColumn]] = [[]]
    for column in others:
        if blocks[-1] and _width([*keys, *blocks[-1], column]) > max_width:
            blocks.append([])
        blocks[-1].append(column)
    return blocks


def _width(columns: Sequence[_PrintedColumn]) -> int:
    """Width of columns side by side."""
    between = _BETWEEN * (len(columns) - 1)
    return sum(column.width for column in columns) + between


def _block(
    keys: Sequence[_PrintedColumn],
    others: Sequence[_PrintedColumn],
    max_width: int,
    *,
    whole: bool,
) -> RichTable:
    """A block of columns beside the keys. Unless it is the whole table, rows of which
    it would show the keys alone are left out."""
    columns = [*keys, *others]
    fits = _width(columns) <= max_width
    block = RichTable(**_PLAIN)
    for printed in columns:
        block.add_column(
            Text(printed.column.title),
            justify="right" if printed.column.right else "left",
            no_wrap=fits and not printed.column.wraps,
            overflow="fold",
        )
    for row in zip(*(printed.cells for printed in columns), strict=True):
        if whole or any(map(str, row[len(keys) :])):
            block.add_row(*map(renderable, row))
    return block
