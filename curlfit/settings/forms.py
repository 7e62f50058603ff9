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

    Parameters
    ----------
    check : returns a value of a file or of Python in the type that is used, and raises
        an error for any other.
    parse : returns what a word of the command line stands for, which is then checked.
    words : returns the word of the command line that gives a value.

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
        words: Callable[[Any], str] | None = None,
    ) -> None:
        self.expected = expected
        self.written = written or expected
        self.check = check
        self._parse = parse
        self._words = words or _word

    def checked(self, name: str, value: Any) -> Any:
        """A value of a file or of Python, for the choice `name`. Raises `InputError` if
        it is of another kind."""
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


def _word(value: Any) -> str:
    """A value as one word of a command line."""
    return f"{value:.10g}" if isinstance(value, float) else str(value)


class Table(Form):
    """Values by name, `NAME=VALUE`, any number of times; with commas
    between if `many`."""

    def __init__(self, value: Form, written: str, *, many: bool = False) -> None:
        super().__init__(
            f"a table of names, each with {value.expected}", dict, written=written
        )
        self.value = value
        self.many = many

    def checked(self, name: str, value: Any) -> dict[str, Any]:
        """A table of a file or of Python, for the choice `name`. Raises `InputError` if
        it, or one of its values, is of another kind."""
        if hasattr(value, "as_dict"):  # constants of a stone
            value = value.as_dict()
        if not isinstance(value, Mapping):
            raise InputError(
                f"{name} = {quoted(value)}; expected "
                f"{name}.NAME = {self.value.expected}"
            )
        return {
            str(key): self.value.checked(f"{name}.{key}", entry)
            for key, entry in value.items()
        }

    def __call__(self, _: Any, tokens: Sequence[Any]) -> dict[str, Any]:
        """The table of all words after a flag."""
        value_by_name: dict[str, Any] = {}
        for token in tokens:
            for entry in token.value.split(",") if self.many else [token.value]:
                name, _, text = entry.partition("=")
                name = name.strip()
                text = text.strip()
                if not name or not text:
                    raise InputError(
                        f"{token.keyword} {cut(token.value)}: expected {self.written}"
                    )
                if name in value_by_name:
                    raise InputError(f"{token.keyword}: {cut(name)} is given twice")
                flag = f"{token.keyword} {cut(name)}="
                value_by_name[name] = self.value.read_word(flag, text)
        return value_by_name

    def words(self, value: Mapping[str, Any]) -> list[str]:
        """One word for each name."""
        return [f"{name}={self.value.words(entry)[0]}" for name, entry in value.items()]


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
        self.value = value
        self.commas = commas
        self.text = text

    def checked(self, name: str, value: Any) -> tuple[Any, ...]:
        """Values of a file or of Python, each once, for the choice `name`. Raises
        `InputError` if they are no list, or one of them is of another kind."""
        if self.text and isinstance(value, str):
            value = [part.strip() for part in value.split(",")]
        elif self.text and isinstance(value, type):  # one law, as its class
            value = [value]
        if isinstance(value, str | Mapping) or not hasattr(value, "__iter__"):
            raise InputError(f"{name} = {quoted(value)}; expected {self.expected}")
        return _distinct([self.value.checked(name, entry) for entry in value])

    def __call__(self, _: Any, tokens: Sequence[Any]) -> tuple[Any, ...]:
        """The values of all words after a flag."""
        return tuple(
            self.value.read_word(f"{token.keyword} ", part)
            for token in tokens
            for part in (token.value.split(",") if self.commas else [token.value])
            if part.strip()
        )

    def words(self, value: Sequence[Any]) -> list[str]:
        """One word for each value."""
        return [word for entry in value for word in self.value.words(entry)]


def _distinct(values: Sequence[Any]) -> tuple[Any, ...]:
    """Values in their order, each once."""
    with suppress(TypeError):
        return tuple(dict.fromkeys(values))
    # noises have no hash, and are few
    distinct: list[Any] = []
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
            first, second = value
            low = float(_real(first))
            high = float(_real(second))
            if not is_number(low, infinite=True) or not is_number(high, infinite=True):
                raise ValueError
            if not (open_ended or low < high):
                raise ValueError
            return low, high

        super().__init__(expected, check, parse, written)

    def words(self, value: Sequence[float]) -> list[str]:
        """The ends with a colon between, nothing for an infinite one."""
        ends = [f"{end:.10g}" if math.isfinite(end) else "" for end in value]
        return [":".join(ends)]


def _real(value: Any) -> Any:
    """The value. Raises `TypeError` unless it is a real number."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise TypeError
    return value


def _finite(value: Any) -> float:
    """A number of a possible size. Raises `TypeError` or `ValueError` for any other
    value."""
    number = float(_real(value))
    if not is_size(number):
        raise ValueError
    return number


def _of_type(kind: type) -> Callable[[Any], Any]:
    """A function that returns values of a type, and raises `TypeError` for others."""

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
        return next(
            name for name, named_value in self.values.items() if named_value == value
        )


TEXT = Form("a quoted string", _of_type(str), written="a word")


def numbers(count: int, written: str) -> Form:
    """So many finite numbers with commas between."""

    def check(value: Any) -> tuple[float, ...]:
        finite = tuple(map(_finite, value))
        if len(finite) != count:
            raise ValueError
        return finite

    return Form(
        f"{count} numbers",
        check,
        lambda word: map(float, word.split(",")),
        written,
        words=lambda value: ",".join(f"{number:.10g}" for number in value),
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
        lambda prior: prior if hasattr(prior, "kind") else TEXT.check(prior),
    ),
    "NAME=PRIOR",
)
TEXTS = Several(TEXT, "a list of strings", "a text", commas=False)


def refusal_of(error: CycloptsError) -> CurlfitError:
    """Why a command line cannot be carried out: what a form says of the value at fault,
    or what the parser says."""
    cause = error.__cause__  # what was raised by a form
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
