"""Elements of a page: a template and its content each."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup
from rich.table import Column, Table

from curlfit.findings import Finding, Level
from curlfit.output.document import Part, Said
from curlfit.output.html import COLORS, inline
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
            if note := getattr(part, "note", None):
                yield paragraph(note)
        elif not isinstance(part, Said):
            yield paragraph(part)


def _table(table: Table) -> Block:
    """A table whose first column of words contains the row headers."""
    heads = []
    cells_by_column = []
    for column in table.columns:
        heads.append((marked(column.header), column.justify))
        cells = [(marked(cell), _cell_style(column, cell)) for cell in column.cells]
        cells_by_column.append(cells)
    words = [column.justify != "right" for column in table.columns]
    return Block(
        "table",
        {
            "caption": getattr(table, "called", ""),
            "heads": [
                (marked(column.header), column.justify) for column in table.columns
            ],
            "rows": list(zip(*cells_by_column, strict=True)),
            "words": words.index(True) if True in words else 0,
        },
    )


def _cell_style(column: Column, cell: Any) -> str:
    """Class of a cell in the style sheet: numbers to the right, long words wrapped."""
    if column.justify == "right":
        return "right"
    return "long" if not column.no_wrap or len(str(cell)) > _LONG else ""
