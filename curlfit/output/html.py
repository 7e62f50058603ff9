"""Reports as HTML: texts and tables of rich, in the colours of the surrounding page.

Colours have a contrast above 4 on both white and black, where 4.58 is the maximum; all
else is inherited. Every text is escaped.
"""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from typing import Any

from rich.console import Console
from rich.text import Text

from curlfit.output.document import Document
from curlfit.output.table import Cell, Table

COLORS = {"green": "#2c8a4b", "yellow": "#a87000", "red": "#d9483b"}
"""Colours of words, by their names on a terminal."""
_LINE = "1px solid rgba(128, 128, 128, 0.4)"
_CELL = (
    "padding: 0.15em 1em 0.15em 0; vertical-align: top; background-color: transparent; "
    "color: inherit"
)
_STYLES = Console()  # nothing is printed on it


def brief(document: Document, name: str) -> str:
    """The main sections of a document as one self-contained block of HTML, the finding
    first; `name` is that of the class."""
    parts = [
        Text(f"{name}, ", style="bold").append(document.finding, style=document.style),
        *(Text(line, style="dim") for line in document.introduction),
        *(part for section in document.sections if section.brief for part in section),
        *document.warned(),
    ]
    return f'<div style="max-width: 60em">{"".join(map(_block, parts))}</div>'


def _block(part: Text | Table[Any]) -> str:
    """A paragraph, or a table with its note below."""
    if isinstance(part, Table):
        note = _block(part.note) if part.note else ""
        return _table(part) + note
    return f'<p style="margin: 0.4em 0; text-align: left">{inline(part)}</p>'


def inline(part: Cell) -> str:
    """A text, or the content of a cell, escaped."""
    if isinstance(part, tuple):
        return ", ".join(map(inline, part))
    if isinstance(part, Text):
        return "".join(_styled(run) for run in _runs(part))
    return escape(part).replace("\n", "<br>")


def _runs(text: Text) -> Iterable[Text]:
    """The pieces of a text in each of which the style is constant."""
    edges = {edge for span in text.spans for edge in (span.start, span.end)}
    return text.divide(sorted(edges - {0, len(text)}))


def _styled(run: Text) -> str:
    """A text of one style."""
    style = run.get_style_at_offset(_STYLES, 0)
    css = []
    if style.bold:
        css.append("font-weight: bold")
    if style.dim:
        css.append("opacity: 0.75")
    if style.color is not None and style.color.name in COLORS:
        css.append(f"color: {COLORS[style.color.name]}")
    text = escape(run.plain).replace("\n", "<br>")
    return f'<span style="{"; ".join(css)}">{text}</span>' if css else text


def _table(table: Table[Any]) -> str:
    """A table with its header, without its note."""
    columns = table.shown
    head = "".join(_cell(column.title, "th", right=column.right) for column in columns)
    body = ""
    for row in table.rows:
        cells = [
            _cell(column.cell(row), "td", right=column.right) for column in columns
        ]
        body += f'<tr style="background-color: transparent">{"".join(cells)}</tr>'
    return (
        '<table style="border-collapse: collapse; margin: 0.5em 0; color: inherit">'
        f'<thead><tr style="border-bottom: {_LINE}">{head}</tr></thead>'
        f"<tbody>{body}</tbody></table>"
    )


def _cell(content: Cell, tag: str, *, right: bool) -> str:
    """A cell of a table, aligned as on the terminal."""
    side = "right" if right else "left"
    return f'<{tag} style="text-align: {side}; {_CELL}">{inline(content)}</{tag}>'
