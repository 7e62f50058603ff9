"""What a result says, once: sections of texts and tables, for a terminal, a
notebook or a page."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.text import Text

from curlfit.findings import Finding
from curlfit.foreign import STANDARD_INPUT, counted
from curlfit.output.console import Printed, terminal
from curlfit.output.table import Table

Part = str | Text | Table[Any] | None
"""What a section consists of; nothing, where a result has nothing to say."""

LONG = 110  # maximum number of characters in a first line


class Said(Text):
    """A text whose content is also in the finding or the lines, which a page
    shows first."""


@dataclass(frozen=True)
class Section:
    """Texts and tables under a heading.

    Attributes
    ----------
    id : by which a page adds figures and interactive parts.
    parts : of which empty ones are left out.
    titled : whether the heading is printed on a terminal.
    brief : whether the section is shown in a notebook.
    """

    id: str
    heading: str
    parts: Sequence[Part] = ()
    titled: bool = False
    brief: bool = True

    def __iter__(self) -> Iterator[Text | Table[Any]]:
        """The parts that are not empty."""
        for part in self.parts:
            if part:
                yield Text(part) if isinstance(part, str) else part


@dataclass(frozen=True, kw_only=True)
class Document:
    """A result in words and tables.

    Attributes
    ----------
    finding : whether the result is usable, or what it shows, in a few words.
    style : of the finding.
    subject : what the result is about.
    headline : first line of a report, where that is not the subject.
    about : lines of a report below the first.
    lines : the numbers, in one or two lines of text.
    warnings, notes : sentences without a full stop, as text.
    title : of a page.
    settings : how the result was made, by name.
    command : that makes it again; empty if there is none.
    names : words that keep a lower-case initial.
    """

    finding: str
    subject: str | Text
    style: str = ""
    headline: str | Text = ""
    about: Sequence[str | Text] = ()
    lines: Sequence[str] = ()
    sections: Sequence[Section] = ()
    warnings: Sequence[Finding] = ()
    notes: Sequence[Finding] = ()
    title: str = ""
    settings: Mapping[str, str] = field(default_factory=dict)
    command: str = ""
    names: Collection[str] = ()

    @property
    def heading(self) -> tuple[str | Text, ...]:
        """The first lines of a report."""
        return (self.headline or self.subject, *(line for line in self.about if line))

    @property
    def introduction(self) -> list[str]:
        """The first lines of a report without what the finding or the lines say."""
        return [str(line) for line in self.heading if not isinstance(line, Said)]

    def __rich_console__(
        self, console: Console, options: ConsoleOptions
    ) -> RenderResult:
        """The whole report on a terminal."""
        for line in self.heading:
            yield Text(line) if isinstance(line, str) else line
        yield Text("")
        for section in self.sections:
            parts = list(section)
            if section.titled and parts:
                yield Text(section.heading, style="bold")
                yield Text("")
            for part in parts:
                yield Printed(part) if isinstance(part, Table) else part
                yield Text("")
        yield from self.warned(spaced=True)

    def warned(self, *, spaced: bool = False) -> Iterator[Text]:
        """Warnings and notes as paragraphs, `spaced` with a blank line after each
        warning, and how to learn more of the warnings."""
        for warning in self.warnings:
            yield Text(f"Warning: {warning}.", style="yellow")
            if spaced:
                yield Text("")
        for note in self.notes:
            yield Text(f"Note: {note}.", style="dim")
        if self.warnings:
            codes = " ".join(dict.fromkeys(finding.code for finding in self.warnings))
            yield Text(f"What this means: curlfit explain {codes}", style="dim")

    def as_text(self, name: str, more: str) -> str:
        """The result in a few lines.

        Parameters
        ----------
        name : of the class of the result.
        more : name of the function that shows the warnings; empty if there is none.
        """
        gap = " " if len(f"{name}{self.finding}{self.subject}") < LONG else "\n"
        lines = [f"{name}, {self.finding}:{gap}{self.subject}"]
        lines += [line for line in self.lines if line]
        if self.warnings:
            where = f", see {more}" if more else ""
            lines.append(f"{counted(len(self.warnings), 'warning')}{where}")
        return "\n".join(lines)


def show(document: RenderableType, console: Console | None = None) -> None:
    """Print a document on a console, by default the terminal."""
    (console or terminal()).print(document)


def command_line(*words: str) -> str:
    """A command of curlfit as it is typed, from its words without `curlfit`."""
    typed = ["-" if word == STANDARD_INPUT else word for word in words]
    return shlex.join(["curlfit", *typed])
