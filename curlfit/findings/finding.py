"""Findings: what a user should know about data or a result, and what to do about it.

A finding is a code with its numbers. Programs decide by the code; the words stand in
`messages.toml` beside this file, and text is made where a result is shown.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, Self

from curlfit.errors import Option
from curlfit.findings.words import clause, messages, sentence


class Level(StrEnum):
    """How grave a finding is.

    A refusal makes a fit impossible or unusable; a warning says why a result may
    mislead; a note says what was done.
    """

    REFUSAL = "refusal"
    WARNING = "warning"
    NOTE = "note"


@dataclass(frozen=True)
class Remedy:
    """What to do about a finding.

    Attributes
    ----------
    code : of its words.
    option : what to type; None where an option does not help.
    numbers : that its words name.
    """

    code: str
    option: Option | None = None
    numbers: dict[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        """The remedy as a clause."""
        return clause(self.code, {"option": self.option, **self.numbers})


@dataclass(frozen=True)
class Finding:
    """Something that a user should know about data or a result.

    Attributes
    ----------
    code : keyword for programs, such as "outliers"; `curlfit explain` lists them.
    level : refusal, warning or note.
    numbers : its values by name: numbers, texts, None, and lists of them.
    remedies : what to do about it, the first one first.
    about : throws or laws that it is about, where others of the result are not.

    Examples
    --------
    >>> finding = curlfit.Finding.note("text", text="rows are sorted by time")
    >>> finding.level, str(finding)
    (<Level.NOTE: 'note'>, 'rows are sorted by time')
    """

    code: str
    level: Level
    numbers: dict[str, Any] = field(default_factory=dict)
    remedies: tuple[Remedy, ...] = ()
    about: tuple[str, ...] = ()

    @classmethod
    def refusal(cls, code: str, /, *remedies: Remedy, **numbers: Any) -> Self:
        """A finding that makes a fit impossible or unusable."""
        return cls(code, Level.REFUSAL, numbers, remedies)

    @classmethod
    def warning(cls, code: str, /, *remedies: Remedy, **numbers: Any) -> Self:
        """A finding for which a result may mislead."""
        return cls(code, Level.WARNING, numbers, remedies)

    @classmethod
    def note(cls, code: str, /, *remedies: Remedy, **numbers: Any) -> Self:
        """A finding that says what was done."""
        return cls(code, Level.NOTE, numbers, remedies)

    def at_level(self, level: Level) -> Self:
        """The finding, as grave as `level`."""
        return replace(self, level=level)

    def with_remedies(self, *remedies: Remedy) -> Self:
        """The finding with further remedies after its own."""
        return replace(self, remedies=(*self.remedies, *remedies))

    def of(self, *names: str) -> Self:
        """The finding as one about the named throws or laws."""
        return replace(self, about=names)

    @property
    def options(self) -> tuple[Option, ...]:
        """What to type, the first remedy first."""
        return tuple(
            remedy.option for remedy in self.remedies if remedy.option is not None
        )

    @property
    def is_refusal(self) -> bool:
        """Whether it makes a fit impossible or unusable."""
        return self.level is Level.REFUSAL

    @property
    def brief(self) -> str:
        """What was found, in a few words."""
        message = messages()[self.code]
        return message.brief.format(**self.numbers) or message.title

    @property
    def means(self) -> str:
        """What it means and what to do, in a few sentences."""
        return " ".join(messages()[self.code].means.split())

    @property
    def has_words(self) -> bool:
        """Whether this version of curlfit knows the code and its numbers, as it may
        not for a finding from a file."""
        try:
            str(self)
        except (KeyError, IndexError, AttributeError, TypeError, ValueError):
            return False
        return True

    def __str__(self) -> str:
        """A sentence without a full stop: what was found, then its remedies."""
        return sentence(self.code, self.numbers, map(str, self.remedies), self.about)

    def __hash__(self) -> int:
        return hash(self.code)
