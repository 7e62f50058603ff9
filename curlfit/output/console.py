"""The terminal: lines without blanks at their ends, and tables that fit its width."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable, Iterator
from dataclasses import replace

from rich.console import Console, ConsoleOptions, ConsoleRenderable, RenderHook, RenderResult
from rich.measure import Measurement
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

_PIPED = 110  # columns where the output is no terminal
_LEAST_TEXT = 24  # columns of a cell that is wrapped
_NO_LIMIT = 10_000
_BETWEEN = "   "
_RUNS = re.compile(r"(?: *[^ \n])+| +|\n")


def terminal(*, quiet: bool = False, highlight: bool = True) -> Console:
    """The console of the command line: as wide as the terminal or as `COLUMNS` says, else 110."""
    own_width = sys.stdout.isatty() or "COLUMNS" in os.environ
    console = Console(quiet=quiet, highlight=highlight, width=None if own_width else _PIPED)
    console.push_render_hook(_Trimmer())
    return console


class _Trimmer(RenderHook):
    def process_renderables(self, renderables: list[ConsoleRenderable]) -> list[ConsoleRenderable]:
        return [_Trimmed(item) for item in renderables]


class _Trimmed:
    def __init__(self, item: ConsoleRenderable) -> None:
        self.item = item

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        yield from _trimmed(console.render(self.item, options))


def _trimmed(segments: Iterable[Segment]) -> Iterator[Segment]:
    """The segments without the blanks that a line ends with."""
    blanks: list[Segment] = []
    for segment in segments:
        runs = [segment.text] if segment.control else _RUNS.findall(segment.text)
        for run in runs:
            part = Segment(run, segment.style, segment.control)
            if run.isspace() and run != "\n":
                blanks.append(part)
                continue
            if run != "\n":
                yield from blanks
            blanks = []
            yield part
    yield from blanks


class Items:
    """Texts in a row, of which none is broken that fits into a line."""

    def __init__(self, items: Iterable[Text]) -> None:
        self.items = list(items)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        line = Text()
        for item in self.items:
            if line and line.cell_len + len(_BETWEEN) + item.cell_len > options.max_width:
                yield line
                line = Text()
            line.append(_BETWEEN if line else "").append_text(item)
        yield line

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        whole = sum(item.cell_len + len(_BETWEEN) for item in self.items)
        words = [Measurement.get(console, options, item).minimum for item in self.items]
        least = max(words, default=0)
        return Measurement(min(least, options.max_width), min(whole, options.max_width))


class PlainTable(Table):
    """A table without lines, of which nothing is cut: where it is wider than the terminal, its
    columns are printed in blocks, one below the other, each after the first `keys` columns."""

    def __init__(self, keys: int = 1) -> None:
        super().__init__(box=None, pad_edge=False, padding=(0, 2, 0, 0), show_edge=False)
        self.keys = keys

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """The table, or its blocks."""
        widths = self._widths(console, options)
        blocks = self._blocks(widths, options.max_width)
        for place, block in enumerate(blocks):
            if place:
                yield Text("")
            fits = _total(widths, block) <= options.max_width
            part = Table(
                *(
                    replace(column, no_wrap=column.no_wrap and fits, overflow="fold", _cells=[])
                    for column in (self.columns[one] for one in block)
                ),
                box=None, pad_edge=False, padding=(0, 2, 0, 0), show_edge=False,
            )  # fmt: skip
            for row in zip(*(self.columns[one].cells for one in block), strict=True):
                if len(blocks) == 1 or any(map(str, row[self.keys :])):
                    part.add_row(*row)
            yield part

    def _widths(self, console: Console, options: ConsoleOptions) -> list[int]:
        """Columns of the terminal that each column needs."""
        wide, found = options.update_width(_NO_LIMIT), []
        for column in self.columns:
            sizes = [console.measure(cell, options=wide) for cell in (column.header, *column.cells)]
            whole = max(size.maximum for size in sizes)
            words = max(size.minimum for size in sizes)
            least = whole if column.no_wrap else min(whole, max(words, _LEAST_TEXT))
            found.append(max(least, column.min_width or 0))
        return found

    def _blocks(self, widths: list[int], most: int) -> list[list[int]]:
        """The columns of each block."""
        keys = list(range(min(self.keys, len(widths))))
        blocks = [list(keys)]
        for one in range(len(keys), len(widths)):
            if len(blocks[-1]) > len(keys) and _total(widths, [*blocks[-1], one]) > most:
                blocks.append(list(keys))
            blocks[-1].append(one)
        return blocks


def _total(widths: list[int], block: list[int]) -> int:
    return sum(widths[one] for one in block) + 2 * (len(block) - 1)
