"""Elements of a page: what each shows, and the template that writes it as HTML."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from markupsafe import Markup

from curlfit.findings import Finding, Level
from curlfit.output.document import Part, Said
from curlfit.output.html import COLORS, inline
from curlfit.output.table import Cell as Words, Column, Table
from curlfit.records import plain
from curlfit.wording import capital

_CODE = re.compile(r"`([^`]+)`")
_LONG = 40  # characters above which a cell is wrapped


@dataclass(frozen=True)
class Block:
    """A part of a section, of which its template writes the fields."""

    template: ClassVar[str]


@dataclass(frozen=True)
class InteractiveBlock(Block):
    """A part that a program of the page moves.

    Attributes
    ----------
    id : of its element.
    data : a dataclass, which the program reads as JSON.
    """

    id: str
    data: Any

    def to_json(self) -> dict[str, Any]:
        """What the program reads; `kind` is the name of the program."""
        return {"kind": self.template, **plain(self.data)}


@dataclass(frozen=True)
class Paragraph(Block):
    """A text, or what rich prints; its role is a class of the style sheet."""

    template = "paragraph"
    text: Any
    role: str = ""


@dataclass(frozen=True)
class ListedFinding:
    """A finding as a sentence; `means` is empty for a note, which needs no more."""

    text: str
    code: str
    means: str


@dataclass(frozen=True)
class FindingList(Block):
    """Findings; what a warning means is shown on request."""

    template = "findings"
    findings: Sequence[ListedFinding]
    role: str


@dataclass(frozen=True)
class NamedValues(Block):
    """A table of two columns: names and values, of which empty ones are left out."""

    template = "rows"
    caption: str
    values: Mapping[str, str]


@dataclass(frozen=True)
class Cell:
    """What is in a cell of a table, and its class in the style sheet."""

    content: Any
    style: str


@dataclass(frozen=True)
class TableBlock(Block):
    """A table; the cells of one column are the headers of the rows."""

    template = "table"
    caption: str
    heads: Sequence[Cell]
    rows: Sequence[Sequence[Cell]]
    header_column: int


@dataclass(frozen=True)
class FigureBlock(Block):
    """A figure as an `<svg>` element, with its caption."""

    template = "drawing"
    svg: Markup
    caption: str


@dataclass(frozen=True)
class Commands(Block):
    """Commands as they are typed."""

    template = "commands"
    lines: Sequence[str]


def marked(text: Any) -> Markup:
    """A text, or the content of a cell, as HTML: escaped, in the colours of the page,
    with text between backticks as code."""
    html = _CODE.sub(r"<code>\1</code>", inline(text))
    for name, color in COLORS.items():
        html = html.replace(f"color: {color}", f"color: var(--{name})")
    return Markup(html)


def sentence(text: str, names: Collection[str] = ()) -> str:
    """A text with a capital letter, unless it begins with a name, and a full stop."""
    first_word = re.split(r"[ :,]", text, maxsplit=1)[0]
    if first_word not in names and re.fullmatch(r"[a-z][a-z-]*", first_word):
        text = capital(text)
    return text if text.endswith(".") else f"{text}."


def list_of_findings(
    findings: Sequence[Finding], role: str, names: Collection[str] = ()
) -> list[Block]:
    """Findings as one block, with a class of the style sheet; none without findings.
    `names` are words that keep a lower-case initial."""
    if not findings:
        return []
    listed = [
        ListedFinding(
            text=sentence(str(finding), names),
            code=finding.code,
            means="" if finding.level is Level.NOTE else finding.means,
        )
        for finding in findings
    ]
    return [FindingList(listed, role)]


def blocks_of(parts: Iterable[Part]) -> Iterator[Block]:
    """Texts and tables of a document as blocks, except those that the page has said
    above."""
    for part in parts:
        if isinstance(part, Table):
            yield _table(part)
            if part.note:
                yield Paragraph(part.note)
        elif not isinstance(part, Said):
            yield Paragraph(part)


def _table(table: Table[Any]) -> TableBlock:
    """A table; the first column of words has the headers of the rows."""
    columns = table.shown
    columns_of_words = [
        number for number, column in enumerate(columns) if not column.right
    ]
    return TableBlock(
        caption=table.caption,
        heads=[
            Cell(column.title, "right" if column.right else "left")
            for column in columns
        ],
        rows=[
            [_styled_cell(column, column.cell(row)) for column in columns]
            for row in table.rows
        ],
        header_column=columns_of_words[0] if columns_of_words else 0,
    )


def _styled_cell(column: Column[Any], words: Words) -> Cell:
    """A cell with its class in the style sheet: numbers to the right, long words
    wrapped."""
    style = ""
    if column.right:
        style = "right"
    elif column.wraps or len(words) > _LONG:
        style = "long"
    return Cell(words, style)
