"""Elements of a page: sections of texts, tables, drawings and interactive parts."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from markupsafe import Markup
from rich.console import Group
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from curlfit.output.html import COLORS, inline

_WARNING, _NOTE = "Warning: ", "Note: "
_CODE = re.compile(r"`([^`]+)`")
_LONG = 40  # characters above which a cell is wrapped


@dataclass(frozen=True)
class Block:
    """A part of a section: a template and its content."""

    template: str
    shows: Mapping[str, Any]


@dataclass(frozen=True)
class Section:
    """A part of a page under a heading; left out if it has no blocks."""

    id: str
    heading: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True)
class Page:
    """A result as a page.

    Attributes
    ----------
    title, subject : what the page is about.
    finding : the result, in a sentence or two.
    good : whether the result may be used.
    lines : the numbers, in a few lines of text.
    warnings : number of warnings.
    sections : in order.
    data : of the interactive parts, by id; JSON.
    """

    title: str
    subject: str
    finding: str
    good: bool
    lines: tuple[str, ...]
    warnings: int
    sections: tuple[Section, ...]
    data: dict[str, Any] = field(default_factory=dict)


@dataclass
class Report:
    """The parts of a printed report: texts and tables, warnings and notes."""

    parts: list[Text | Table]
    warnings: list[str]
    notes: list[str]

    @classmethod
    def of(cls, renderable: Any) -> Report:
        """The parts of the report of a result."""
        found = cls([], [], [])
        for part in _flat(renderable):
            text = part.plain if isinstance(part, Text) else ""
            if text.startswith(_WARNING):
                found.warnings.append(text.removeprefix(_WARNING))
            elif text.startswith(_NOTE):
                found.notes.append(text.removeprefix(_NOTE))
            elif text or isinstance(part, Table):
                found.parts.append(part)
        return found


def _flat(part: Any) -> list[Any]:
    if isinstance(part, Padding):
        return _flat(part.renderable)
    if isinstance(part, Group | list):
        items = part.renderables if isinstance(part, Group) else part
        return [one for item in items for one in _flat(item)]
    return [part if isinstance(part, Text | Table) else Text(str(part))]


def marked(text: Any) -> Markup:
    """A text, or the content of a cell, as HTML: escaped, in the colours of the page, with text
    between backticks as code."""
    found = _CODE.sub(r"<code>\1</code>", inline(text))
    for name, color in COLORS.items():
        found = found.replace(f"color: {color}", f"color: var(--{name})")
    return Markup(found)


def sentence(text: str, names: Iterable[str] = ()) -> str:
    """A text with a capital letter, unless it begins with a name, and a full stop."""
    first = re.split(r"[ :,]", text, maxsplit=1)[0]
    if first not in names and re.fullmatch(r"[a-z][a-z-]*", first):
        text = text[:1].upper() + text[1:]
    return text if text.endswith(".") else f"{text}."


def others(parts: Iterable[Any], said: Iterable[str]) -> list[Any]:
    """The parts of a report, except texts that appear elsewhere."""
    known = {text.strip().rstrip(".").lower() for text in said}
    return [
        part
        for part in parts
        if not isinstance(part, Text) or part.plain.strip().rstrip(".").lower() not in known
    ]


def section(id: str, heading: str, *blocks: Block | Iterable[Block] | None) -> Section:
    """A section of blocks, single or several, some of which may be missing."""
    found: list[Block] = []
    for item in blocks:
        found += [item] if isinstance(item, Block) else item or ()
    return Section(id, heading, tuple(found))


def paragraph(text: Any, role: str = "") -> Block:
    """A paragraph; its role is a class of the style sheet."""
    return Block("paragraph", {"text": marked(text), "role": role})


def bullets(items: Iterable[str], role: str = "") -> list[Block]:
    """Sentences as a list."""
    found = tuple(map(marked, items))
    return [Block("bullets", {"items": found, "role": role})] if found else []


def rows(caption: str, items: Mapping[str, str]) -> Block:
    """A table of two columns: names and values."""
    return Block("rows", {"caption": caption, "items": tuple(items.items())})


def table(found: Table, caption: str) -> Block:
    """A table whose first column of words contains the row headers."""
    columns = found.columns
    words = next((place for place, one in enumerate(columns) if one.justify != "right"), 0)
    rows = [
        [
            (marked(cell), _style(cell, column.justify))
            for cell, column in zip(row, columns, strict=True)
        ]
        for row in zip(*(one.cells for one in columns), strict=True)
    ]
    heads = [(marked(one.header), _style("", one.justify)) for one in columns]
    return Block("table", {"caption": caption, "heads": heads, "rows": rows, "words": words})


def _style(cell: Any, justify: str) -> str:
    """The class of a cell."""
    if justify == "right":
        return "right"
    return "long" if len(re.sub("<[^>]*>", "", inline(cell))) > _LONG else ""


def blocks_of(parts: Iterable[Any], captions: Mapping[str, str]) -> list[Block]:
    """Texts and tables of a report as blocks.

    Parameters
    ----------
    captions : of tables, by the heading of their first column. A bold line above a table is used as
        its caption instead.
    """
    found: list[Block] = []
    title = ""
    for part in (one for item in parts for one in _flat(item)):
        if isinstance(part, Table):
            head = str(part.columns[0].header)
            found.append(table(part, title or captions.get(head, captions.get("", "Results"))))
            title = ""
        elif part.style == "bold":
            title = part.plain
        elif part.plain:
            found.append(paragraph(part))
    return found


def warned(
    warnings: Sequence[str], notes: Iterable[str] = (), *more: Block, names: Iterable[str] = ()
) -> Section:
    """The section of warnings and notes.

    Parameters
    ----------
    warnings, notes : sentences, which may lack a capital letter or a full stop.
    names : words that keep a lower-case initial.
    """
    known = set(names)
    said = [bullets([sentence(text, known) for text in warnings], "warning"), more]
    small = bullets([sentence(text, known) for text in notes], "note")
    heading = " and ".join([*["Warnings"] * any(map(bool, said)), *["notes"] * bool(small)])
    return section("warnings", heading[:1].upper() + heading[1:], *said, small)


def drawings(*figures: Block) -> Section:
    """The section of figures."""
    return section("figures", "Figures", figures)
