"""Errors and warnings. Each message says what was found, where, and what
was expected."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from os import PathLike

from curlfit.foreign import message, quoted, say


@dataclass(frozen=True)
class Option:
    """An option that mends what was found, as the user types it.

    Attributes
    ----------
    name : as on the command line, without hyphens.
    value : as it is typed after the name; empty for a switch.
    in_python : whether the data came from arrays, so that it is a keyword.
    left_out : whether the option is to be left out instead.

    Examples
    --------
    >>> from curlfit.errors import Option
    >>> str(Option("units", "t=ms")), str(Option("since", "3", in_python=True))
    ('`--units t=ms`', '`since=3`')
    """

    name: str
    value: str = ""
    in_python: bool = False
    left_out: bool = False

    def __str__(self) -> str:
        """The option between backticks."""
        if self.left_out:
            return f"leave out `{self.name if self.in_python else f'--{self.name}'}`"
        if not self.in_python:
            return f"`--{self.name} {self.value}`" if self.value else f"`--{self.name}`"
        if self.name in ("units", "axes"):
            return f'`Throw.from_arrays(..., {self.name}="{self.value}")`'
        if self.name == "as-given":
            return '`Throw.from_arrays(..., defaults={"as_given": True})`'
        return f"`{self.name}={self.value}`"


class CurlfitError(Exception):
    """Base of all errors that curlfit raises on purpose; `exit_status` is that of
    the command, and `options` are what to type instead.

    Examples
    --------
    >>> issubclass(curlfit.UnusableFitError, curlfit.CurlfitError)
    True
    """

    exit_status = 1
    options: tuple[Option, ...] = ()

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

    def __init__(self, *args: object, options: tuple[Option, ...] = ()) -> None:
        super().__init__(*args)
        self.options = options


def require_kind(
    value: object, kind: type | tuple[type, ...], name: str, expected: str
) -> None:
    """Raise `InputError` for an argument of another type."""
    if not isinstance(value, kind):
        argument = f"{type(value).__name__} {quoted(str(value))}"
        raise InputError(f"{name}: {argument} found, expected {expected}")


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
        options: tuple[Option, ...] = (),
    ) -> None:
        self.file, self.line, self.column = file, line, column
        location = [] if file is None else [str(file)]
        if line is not None:
            location.append(f"line {line}")
        if column is not None:
            location.append(f"column {column}")
        text = f"{', '.join(location)}: {message}" if location else message
        super().__init__(text, options=options)


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
