"""A table in LaTeX, as of a paper, with booktabs."""

from __future__ import annotations

import re
from pathlib import Path
from string import Template
from typing import Any

from curlfit.foreign import printable
from curlfit.output.table import Table
from curlfit.version import __version__

_SPECIAL = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
}


def latex_of(table: Table[Any]) -> str:
    """A `table` by the template `table.tex.in`. Headings, cells and caption are LaTeX
    already."""
    columns = table.shown
    lines = [" & ".join(column.title for column in columns)]
    for row in table.rows:
        lines.append(" & ".join(str(column.cell(row)) for column in columns))
    head, *rows = [rf"    {line} \\" for line in lines]
    sides = " ".join("r" if column.right else "l" for column in columns)
    text = Path(__file__).with_name("table.tex.in").read_text(encoding="utf-8")
    return Template(text).substitute(
        caption=table.caption, sides=sides, head=head, rows="\n".join(rows)
    )


def escaped(text: str) -> str:
    """Text with the special characters of TeX and control characters escaped."""
    return "".join(
        _SPECIAL.get(character, character) for character in printable(str(text))
    )


def number(text: str) -> str:
    """A number as written by `format` or `wording.compact`, in math mode."""
    text = text.replace("+-", r"\pm")
    text = re.sub(
        r"e([-+]?)0*(\d+)",
        lambda match: rf" \times 10^{{{match[1].strip('+')}{match[2]}}}",
        text,
    )
    return f"${text}$"


def file_name(path: str) -> str:
    """The name of a file without its folder."""
    return escaped(re.split(r"[\\/]", path)[-1])


def made_with() -> str:
    """The last sentence of a caption."""
    return f"Computed with curlfit {escaped(__version__)}."
