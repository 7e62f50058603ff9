"""Display of results: a few lines of text, and a table in a notebook."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar

from rich.text import Text

from curlfit.output import html

_LONG = 110  # maximum number of characters in a first line


@dataclass(frozen=True)
class Overview:
    """A result at a glance.

    Attributes
    ----------
    finding : whether the result is usable, or what it shows, in a few words.
    subject : what it is about.
    lines : the numbers, in one or two lines of text.
    parts : the same for HTML: texts and tables.
    warnings : sentences without a full stop.
    style : style of the finding.
    """

    finding: str
    subject: str
    lines: Sequence[str] = ()
    parts: Sequence[Any] = ()
    warnings: Sequence[str] = ()
    style: str = ""

    def as_text(self, name: str, more: str) -> str:
        """A few lines; `name` is that of the class, `more` that of what shows everything."""
        gap = " " if len(name + self.finding + self.subject) < _LONG else "\n"
        lines = [f"{name}, {self.finding}:{gap}{self.subject}", *filter(None, self.lines)]
        if self.warnings:
            count = len(self.warnings)
            also = f", see {more}" if more else ""
            lines.append(f"{count} warning{'s' if count > 1 else ''}{also}")
        return "\n".join(lines)

    def as_html(self, name: str) -> str:
        """A self-contained block of HTML, the finding first."""
        heading = Text(f"{name}, ", style="bold").append(self.finding, style=self.style)
        warnings = [Text(f"Warning: {one}.", style="yellow") for one in self.warnings]
        return html.page([heading, Text(self.subject, style="dim"), *self.parts, *warnings])


class Displayed:
    """Base of results, shown as a few lines by `repr` and as a table in a notebook."""

    _report: ClassVar[str] = ""
    """module with a function `overview` of the result; loaded when the result is shown"""
    _printer: ClassVar[str] = ""
    """function that prints the whole result"""

    def _overview(self) -> Overview:
        found: Overview = import_module(self._report).overview(self)
        return found

    def __repr__(self) -> str:
        """A few lines."""
        return self._overview().as_text(type(self).__name__, self._printer)

    def _repr_html_(self) -> str:
        """A table, for notebooks."""
        return self._overview().as_html(type(self).__name__)
