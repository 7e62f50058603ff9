"""Output on the terminal: no trailing blanks, tables that fit its width."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any

from rich.console import (
    Console,
    ConsoleOptions,
    ConsoleRenderable,
    RenderHook,
    RenderResult,
)
from rich.measure import Measurement
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from curlfit.foreign import printable

_DEFAULT_WIDTH = 110  # columns, if the output is not a terminal
_MIN_TEXT_WIDTH = 24  # columns of a wrapped cell
_UNLIMITED = 10_000
_GAP = "   "
_RUNS = re.compile(r"(?: *[^ \n])+| +|\n")
_PLAIN: dict[str, Any] = {
    "box": None,
    "pad_edge": False,
    "padding": (0, 2, 0, 0),
    "show_edge": False,
}


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


class Items:
    """Texts side by side, wrapped between texts where possible."""

    def __init__(self, items: Iterable[Text]) -> None:
        self.items = list(items)

    def __rich_console__(
        self, console: Console, options: ConsoleOptions
    ) -> RenderResult:
        line = Text()
        for text in self.items:
            if line and line.cell_len + len(_GAP) + text.cell_len > options.max_width:
                yield line
                line = Text()
            line.append(_GAP if line else "").append_text(text)
        yield line

    def __rich_measure__(
        self, console: Console, options: ConsoleOptions
    ) -> Measurement:
        whole = sum(text.cell_len + len(_GAP) for text in self.items)
        words = [Measurement.get(console, options, text).minimum for text in self.items]
        least = max(words, default=0)
        return Measurement(min(least, options.max_width), min(whole, options.max_width))


class PlainTable(Table):
    """A table without rules that is never truncated: if it is wider than the terminal,
    its columns are printed in blocks, one below the other, each repeating the first
    `keys` columns.

    Parameters
    ----------
    rows : cells by heading, "-" for None. Columns whose heading begins with > are
        aligned to the right, cells of those that begin with ~ may be wrapped; columns
        without content, or with None alone, are left out.
    caption : what the table shows, for pages; a terminal and a notebook do without.
    note : a text directly below.
    """

    def __init__(
        self,
        rows: Iterable[Mapping[str, Any]] = (),
        caption: str = "",
        *,
        keys: int = 1,
        note: Text | None = None,
    ) -> None:
        super().__init__(**_PLAIN)
        self.keys = keys
        self.called = caption
        self.note = note
        rows = list(rows)
        heads = dict.fromkeys(head for row in rows for head in row)
        shown = [
            head
            for head in heads
            if any(row.get(head, "") not in ("", None) for row in rows)
        ]
        for head in shown:
            side: Any = "right" if head.startswith(">") else "left"
            self.add_column(
                head.lstrip(">~ "), justify=side, no_wrap=not head.startswith("~")
            )
        for row in rows:
            cells = (row.get(head, "") for head in shown)
            self.add_row(*("-" if cell is None else cell for cell in cells))

    def __bool__(self) -> bool:
        return bool(self.columns)

    def __rich_console__(
        self, console: Console, options: ConsoleOptions
    ) -> RenderResult:
        """The table, or its blocks."""
        widths = self._widths(console, options)
        blocks = self._blocks(widths, options.max_width)
        for number, block in enumerate(blocks):
            if number:
                yield Text("")
            fits = _total_width(widths, block) <= options.max_width
            columns = [self.columns[index] for index in block]
            heads = [
                replace(
                    column, no_wrap=column.no_wrap and fits, overflow="fold", _cells=[]
                )
                for column in columns
            ]
            table = Table(*heads, **_PLAIN)
            for row in zip(*(column.cells for column in columns), strict=True):
                if len(blocks) == 1 or any(map(str, row[self.keys :])):
                    table.add_row(*row)
            yield table
        if self.note is not None:
            yield self.note

    def _widths(self, console: Console, options: ConsoleOptions) -> list[int]:
        """Width that each column needs, in characters."""
        wide = options.update_width(_UNLIMITED)
        widths = []
        for column in self.columns:
            sizes = [
                console.measure(cell, options=wide)
                for cell in (column.header, *column.cells)
            ]
            whole = max(size.maximum for size in sizes)
            words = max(size.minimum for size in sizes)
            least = whole if column.no_wrap else min(whole, max(words, _MIN_TEXT_WIDTH))
            widths.append(least)
        return widths

    def _blocks(self, widths: list[int], max_width: int) -> list[list[int]]:
        """The columns of each block."""
        keys = list(range(min(self.keys, len(widths))))
        blocks = [list(keys)]
        for index in range(len(keys), len(widths)):
            block = [*blocks[-1], index]
            if len(block) > len(keys) + 1 and _total_width(widths, block) > max_width:
                blocks.append(list(keys))
            blocks[-1].append(index)
        return blocks


def _total_width(widths: list[int], block: list[int]) -> int:
    """Width of the columns of a block, with two blanks between them."""
    return sum(widths[index] for index in block) + 2 * (len(block) - 1)
