"""Errors and warnings. Each message says what was found, where, and what
was expected."""

from __future__ import annotations

from functools import cache
from os import PathLike

from curlfit.foreign import message, quoted, say


class CurlfitError(Exception):
    """Base of all errors that curlfit raises on purpose; `exit_status` is that of
    the command.

    Examples
    --------
    >>> issubclass(curlfit.UnusableFitError, curlfit.CurlfitError)
    True
    """

    exit_status = 1

    def __str__(self) -> str:
        """One line of bounded length; unprintable characters are escaped."""
        return message(super().__str__())


class InputError(CurlfitError, ValueError):
    """The data, an option or a name is wrong (exit status 2).

    Examples
    --------
    >>> curlfit.find_law("glue")
    Traceback (most recent call last):
        ...
    curlfit.errors.InputError: ...
    """

    exit_status = 2


def require_kind(
    value: object, kind: type | tuple[type, ...], name: str, expected: str
) -> None:
    """Raise `InputError` for an argument of another type."""
    if not isinstance(value, kind):
        found = f"{type(value).__name__} {quoted(str(value))}"
        raise InputError(f"{name}: {found} found, expected {expected}")


class DataError(InputError):
    """A data file cannot be used; the message begins with the file, line and column.

    Examples
    --------
    >>> curlfit.load_throw("nothing.csv")
    Traceback (most recent call last):
        ...
    curlfit.errors.DataError: nothing.csv: no such file...
    """

    def __init__(
        self,
        message: str,
        *,
        file: str | PathLike[str] | None = None,
        line: int | None = None,
        column: str | None = None,
    ) -> None:
        self.file, self.line, self.column = file, line, column
        location = [] if file is None else [str(file)]
        if line is not None:
            location.append(f"line {line}")
        if column is not None:
            location.append(f"column {column}")
        super().__init__(f"{', '.join(location)}: {message}" if location else message)


class UnusableFitError(CurlfitError):
    """The data were read, but the fit is not usable (exit status 1).

    Examples
    --------
    >>> curlfit.UnusableFitError.exit_status
    1
    """


@cache
def warn_once(sentence: str) -> None:
    """Print a warning to stderr, each one only once."""
    say(f"curlfit: Warning: {sentence}", error=True)
