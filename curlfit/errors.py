"""The errors and warnings a user can meet. Each message says what, where, and what was expected."""

from __future__ import annotations

import sys
from functools import cache
from os import PathLike


class CurlfitError(Exception):
    """Base of every error that curlfit raises on purpose; `exit_status` is the command's."""

    exit_status = 1

    def __str__(self) -> str:
        """One line: what does not print in a name or a cell of the user's is escaped."""
        text = super().__str__()
        return "".join(
            sign if sign.isprintable() else sign.encode("unicode_escape").decode() for sign in text
        )


class InputError(CurlfitError, ValueError):
    """The data, an option or a name is wrong (exit status 2)."""

    exit_status = 2


class DataError(InputError):
    """A data file cannot be used; the message begins with the file, line and column."""

    def __init__(
        self,
        message: str,
        *,
        file: str | PathLike[str] | None = None,
        line: int | None = None,
        column: str | None = None,
    ) -> None:
        self.file, self.line, self.column = file, line, column
        place = [] if file is None else [str(file)]
        if line is not None:
            place.append(f"line {line}")
        if column is not None:
            place.append(f"column {column}")
        super().__init__(f"{', '.join(place)}: {message}" if place else message)


class UnusableFitError(CurlfitError):
    """The data were read, but no usable fit came of them (exit status 1)."""


@cache
def warn_once(sentence: str) -> None:
    """Print a warning on stderr, the first time that it is given."""
    print(f"curlfit: Warning: {sentence}", file=sys.stderr)
