"""Elements of a page: a template and its content each."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from curlfit.findings import Finding, Level
from curlfit.output.document import Part, Said
from curlfit.output.html import COLORS, inline
from curlfit.output.table import Cell, Column, Table
from curlfit.wording import capital

_CODE = re.compile(r"`([^`]+)`")
_LONG = 40  # characters above which a cell is wrapped


@dataclass(frozen=True)
class Block:
    """A part of a section: a template and its content."""

    template: str
    shows: Mapping[str, Any]


def marked(text: Any) -> Markup:
    """A text, or the content of a cell, as HTML: escaped, in the colours of the page,
    with text between backticks as code."""
    html = _CODE.sub(r"<code>\1</code>", inline(text))
    for name, color in COLORS.items():
        html = html.replace(f"color: {color}", f"color: var(--{name})")
    return Markup(html)


def sentence(text: str, names: Collection[str] = ()) -> str:
    """A text with a capital letter, unless it begins with a name, and a full stop."""
    first = re.split(r"[ :,]", text, maxsplit=1)[0]
    if first not in names and re.fullmatch(r"[a-z][a-z-]*", first):
        text = capital(text)
    return text if text.endswith(".") else f"{text}."


def paragraph(text: Any, role: str = "") -> Block:
    """A paragraph; its role is a class of the style sheet."""
    return Block("paragraph", {"text": marked(text), "role": role})


def of_findings(
    findings: Sequence[Finding], role: str, names: Collection[str] = ()
) -> list[Block]:
    """Findings as a list; what a warning means is shown on request."""
    items = [
        {
            "text": marked(sentence(str(finding), names)),
            "code": finding.code,
            "means": "" if finding.level is Level.NOTE else marked(finding.means),
        }
        for finding in findings
    ]
    return [Block("findings", {"items": items, "role": role})] if items else []


def rows(caption: str, items: Mapping[str, str]) -> Block:
    """A table of two columns: names and values, of which empty ones are left out."""
    shown = [(name, value) for name, value in items.items() if value]
    return Block("rows", {"caption": caption, "items": shown})


def blocks_of(parts: Iterable[Part]) -> Iterator[Block]:
    """Texts and tables of a document as blocks, except those that are said above."""
    for part in parts:
        if isinstance(part, Table):
            yield _table(part)
            if part.note:
                yield paragraph(part.note)
        elif not isinstance(part, Said):
            yield paragraph(part)


def _table(table: Table[Any]) -> Block:
    """A table whose first column of words contains the row headers."""
    columns = table.shown
    words = [index for index, column in enumerate(columns) if not column.right]
    rows_of_cells = [
        [_styled_cell(column, column.cell(row)) for column in columns]
        for row in table.rows
    ]
    return Block(
        "table",
        {
            "caption": table.caption,
            "heads": [
                (marked(column.title), "right" if column.right else "left")
                for column in columns
            ],
            "rows": rows_of_cells,
            "words": words[0] if words else 0,
        },
    )


def _styled_cell(column: Column[Any], cell: Cell) -> tuple[Markup, str]:
    """A cell as HTML, and its class in the style sheet: numbers to the right, long
    words wrapped."""
    style = ""
    if column.right:
        style = "right"
    elif column.wraps or len(cell) > _LONG:
        style = "long"
    return marked(cell), style
