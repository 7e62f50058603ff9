"""How the value of a choice is written: on the command line, in a file of
settings, in Python."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from numbers import Integral, Real
from pathlib import Path
from typing import Any

from cyclopts import Parameter
from cyclopts.exceptions import CycloptsError

from curlfit.errors import CurlfitError, InputError
from curlfit.foreign import SIZES, cut, is_number, is_size, quoted


class Form:
    """A kind of value.

    Attributes
    ----------
    expected : what it is, as the end of a sentence.
    written : what it is on the command line, where that differs.
    """

    def __init__(
        self,
        expected: str,
        check: Callable[[Any], Any],
        parse: Callable[[str], Any] = str,
        written: str = "",
        words: Callable[[Any], str] = lambda one: (
            f"{one:.10g}" if isinstance(one, float) else str(one)
        ),
    ) -> None:
        self.expected, self.written = expected, written or expected
        self.check, self._parse, self._words = check, parse, words

    def checked(self, name: str, value: Any) -> Any:
        """A value of a file or of Python. Raises `InputError` if it is of
        another kind."""
        try:
            return self.check(value)
        except (TypeError, ValueError, OverflowError, AttributeError):
            raise InputError(
                f"{name} = {quoted(value)}; expected {self.expected}"
            ) from None

    def __call__(self, _: Any, tokens: Sequence[Any]) -> Any:
        """The value of the words after a flag, as cyclopts passes them."""
        (token,) = tokens
        return self.read_word(f"{token.keyword} ", token.value)

    def read_word(self, flag: str, word: str) -> Any:
        """The value of one word after the text `flag`. Raises `InputError`."""
        try:
            return self.check(self._parse(word.strip()))
        except InputError as error:
            raise InputError(f"{flag}{cut(word.strip())}: {error}") from None
        except (TypeError, ValueError, OverflowError):
            raise InputError(
                f"{flag}{cut(word.strip())}: expected {self.written}"
            ) from None

    def words(self, value: Any) -> list[str]:
        """The words after a flag that give a value."""
        return [self._words(value)]


class Table(Form):
    """Values by name, `NAME=VALUE`, any number of times; with commas
    between if `many`."""

    def __init__(self, value: Form, written: str, *, many: bool = False) -> None:
        super().__init__(
            f"a table of names, each with {value.expected}", dict, written=written
        )
        self.value, self.many = value, many

    def checked(self, name: str, value: Any) -> dict[str, Any]:
        """The same for each value."""
        value = value.as_dict() if hasattr(value, "as_dict") else value
        if not isinstance(value, Mapping):
            raise InputError(
                f"{name} = {quoted(value)}; expected "
                f"{name}.NAME = {self.value.expected}"
            )
        return {
            str(key): self.value.checked(f"{name}.{key}", one)
            for key, one in value.items()
        }

    def __call__(self, _: Any, tokens: Sequence[Any]) -> dict[str, Any]:
        """All words together."""
        found: dict[str, Any] = {}
        for token in tokens:
            for part in token.value.split(",") if self.many else [token.value]:
                name, equals, text = (one.strip() for one in part.partition("="))
                if not equals or not name or not text:
                    raise InputError(
                        f"{token.keyword} {cut(token.value)}: expected {self.written}"
                    )
                if name in found:
                    raise InputError(f"{token.keyword}: {cut(name)} is given twice")
                found[name] = self.value.read_word(
                    f"{token.keyword} {cut(name)}=", text
                )
        return found

    def words(self, value: Mapping[str, Any]) -> list[str]:
        """One word for each name."""
        return [f"{name}={self.value.words(one)[0]}" for name, one in value.items()]


class Several(Form):
    """Values with commas between, any number of times."""

    def __init__(
        self,
        value: Form,
        expected: str,
        written: str,
        *,
        commas: bool = True,
        text: bool = False,
    ) -> None:
        """`text` allows one text with commas in a file and in Python too."""
        super().__init__(expected, tuple, written=written)
        self.value, self.commas, self.text = value, commas, text

    def checked(self, name: str, value: Any) -> tuple[Any, ...]:
        """The same for each value."""
        if self.text and isinstance(value, type | str):
            each = value.split(",") if isinstance(value, str) else [value]
            value = [one.strip() if isinstance(one, str) else one for one in each]
        if isinstance(value, str | Mapping) or not hasattr(value, "__iter__"):
            raise InputError(f"{name} = {quoted(value)}; expected {self.expected}")
        return _distinct([self.value.checked(name, one) for one in value])

    def __call__(self, _: Any, tokens: Sequence[Any]) -> tuple[Any, ...]:
        """All words together."""
        return tuple(
            self.value.read_word(f"{token.keyword} ", part)
            for token in tokens
            for part in (token.value.split(",") if self.commas else [token.value])
            if part.strip()
        )

    def words(self, value: Sequence[Any]) -> list[str]:
        """One word for each value."""
        return [word for one in value for word in self.value.words(one)]


def _distinct(values: Sequence[Any]) -> tuple[Any, ...]:
    """Values in their order, each once."""
    with suppress(TypeError):
        return tuple(dict.fromkeys(values))
    distinct: list[Any] = []  # of noises, which have no hash and are few
    for value in values:
        if value not in distinct:
            distinct.append(value)
    return tuple(distinct)


class Interval(Form):
    """Two numbers with a colon between, in order; an end may be infinite
    if `open_ended`."""

    def __init__(
        self, expected: str, written: str, *, open_ended: bool = False
    ) -> None:
        def parse(word: str) -> tuple[float, float]:
            low, colon, high = word.partition(":")
            if not colon:
                raise ValueError
            if open_ended:
                return float(low or -math.inf), float(high or math.inf)
            return float(low), float(high)

        def check(value: Any) -> tuple[float, float]:
            low, high = (float(_real(one)) for one in value)
            if not all(is_number(end, infinite=True) for end in (low, high)):
                raise ValueError
            if not (open_ended or low < high):
                raise ValueError
            return low, high

        super().__init__(expected, check, parse, written)

    def words(self, value: Sequence[float]) -> list[str]:
        """The ends with a colon between."""
        return [":".join(f"{end:.10g}" if math.isfinite(end) else "" for end in value)]


def _real(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, Real):
        raise TypeError
    return value


def _finite(value: Any) -> float:
    if not is_size(number := float(_real(value))):
        raise ValueError
    return number


def _of_type(kind: type) -> Callable[[Any], Any]:
    def check(value: Any) -> Any:
        if not isinstance(value, kind):
            raise TypeError
        return value

    return check


def whole(low: int, high: int = 10**9) -> Form:
    """A whole number within limits."""

    def check(value: Any) -> int:
        if not (isinstance(value, Integral) and low <= _real(value) <= high):
            raise ValueError
        return int(value)

    return Form(f"a whole number from {low} to {high}", check, int)


class OneOf(Form):
    """One of some values, by its name or as it is; `others` are further names, each
    with the name whose value it stands for."""

    def __init__(self, what: str, values: Mapping[str, Any], **others: str) -> None:
        names = tuple(values)
        expected = (
            " or ".join(names) if len(names) < 3 else f"one of {', '.join(names)}"
        )

        def check(value: Any) -> Any:
            if not isinstance(value, str) and value in values.values():
                return value
            name = others.get(TEXT.check(value), value)
            if name not in values:
                raise InputError(f"unknown {what} {quoted(name)}; expected {expected}")
            return values[name]

        super().__init__(expected, check, words=self.name_of)
        self.values = values

    def name_of(self, value: Any) -> str:
        """The name of a value."""
        return next(name for name, known in self.values.items() if known == value)


TEXT = Form("a quoted string", _of_type(str), written="a word")


def numbers(count: int, written: str) -> Form:
    """So many finite numbers with commas between."""

    def check(value: Any) -> tuple[float, ...]:
        found = tuple(map(_finite, value))
        if len(found) != count:
            raise ValueError
        return found

    return Form(
        f"{count} numbers",
        check,
        lambda word: map(float, word.split(",")),
        written,
        words=lambda value: ",".join(f"{one:.10g}" for one in value),
    )


def in_home(name: str) -> str:
    """The name of a file, with the home in place of `~`: no shell replaces that of
    `--out=~/x`, or of a file of settings."""
    return os.path.expanduser(name) if name[:2] in ("~", f"~{os.sep}") else name


def file_named(word: str) -> str:
    """The file or folder that a word after an option names. Raises `InputError` for
    standard input."""
    if word == "-":
        raise InputError("expected a name; only data are read from standard input")
    return in_home(word)


PATH = Form(
    "a name of a file or folder",
    lambda name: Path(name),
    lambda word: Path(file_named(word)),
    "a file or folder",
)
NUMBER = Form(f"a number, {SIZES}", _finite, float)
TIME = Form("a time in s", _finite, float)
SWITCH = Form("true or false", _of_type(bool))
VALUES = Table(NUMBER, "NAME=VALUE", many=True)
LABELS = Table(TEXT, "LABEL=NAME", many=True)
HEADINGS = Table(TEXT, "QUANTITY=HEADING", many=True)
LIMITS = Table(Interval("[low, high]", "LOW:HIGH", open_ended=True), "NAME=LOW:HIGH")
PERIOD = Interval(
    "two times in s, the earlier first", "A:B, times in s with A before B"
)
PERIODS = Several(PERIOD, "[[A, B], ...], times in s with A before B", "A:B")
NAMES = Several(TEXT, "a list of names", "NAME,...")
NUMBERS = Several(NUMBER, "a list of numbers", "numbers separated by commas")
PRIORS = Table(
    Form(
        "a string such as '1+-0.1'",
        lambda one: one if hasattr(one, "kind") else TEXT.check(one),
    ),
    "NAME=PRIOR",
)
TEXTS = Several(TEXT, "a list of strings", "a text", commas=False)


def refusal_of(error: CycloptsError) -> CurlfitError:
    """Why a command line cannot be carried out: that of the value at fault, or that of
    the parser."""
    cause = error.__cause__  # of a value that cannot be used
    return cause if isinstance(cause, CurlfitError) else InputError(str(error))


def option(form: Form, metavar: str = "", **others: Any) -> Parameter:
    """A flag whose value is of a form; `others` as for `cyclopts.Parameter`.

    Its help is in the docstring of the class or of the verb.
    """
    if form is SWITCH:
        return Parameter(**others)
    return Parameter(
        metavar=metavar or None,
        converter=form,
        n_tokens=1,
        accepts_keys=False,
        allow_repeating=True,
        **others,
    )
