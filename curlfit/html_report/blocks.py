"""Elements of a page: a template and its content each."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup
from rich.table import Table

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
    found = _CODE.sub(r"<code>\1</code>", inline(text))
    for name, color in COLORS.items():
        found = found.replace(f"color: {color}", f"color: var(--{name})")
    return Markup(found)


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
    return Block(
        "rows", {"caption": caption, "items": [one for one in items.items() if one[1]]}
    )


def blocks_of(parts: Iterable[Part]) -> Iterator[Block]:
    """Texts and tables of a document as blocks, except those that are said above."""
    for part in parts:
        if isinstance(part, Table):
            yield _table(part)
            if note := getattr(part, "note", None):
                yield paragraph(note)
        elif not isinstance(part, Said):
            yield paragraph(part)


def _table(found: Table) -> Block:
    """A table whose first column of words contains the row headers."""
    columns = found.columns

    def style(cell: Any, place: int) -> str:
        if columns[place].justify == "right":
            return "right"
        return "long" if not columns[place].no_wrap or len(str(cell)) > _LONG else ""

    return Block(
        "table",
        {
            "caption": getattr(found, "called", ""),
            "heads": [(marked(one.header), one.justify) for one in columns],
            "rows": [
                [(marked(cell), style(cell, place)) for place, cell in enumerate(row)]
                for row in zip(*(one.cells for one in columns), strict=True)
            ],
            "words": next(
                (k for k, one in enumerate(columns) if one.justify != "right"), 0
            ),
        },
    )
