"""The words of a command line, made such that their parser reads what was meant."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from cyclopts import App

from curlfit.errors import InputError
from curlfit.foreign import STANDARD_INPUT
from curlfit.settings.forms import Form, in_home

READ_STANDARD_INPUT = ("check", "fit", "compare", "profile")
"""Verbs that read data from files."""


class _Names(NamedTuple):
    """Names of the options of a verb.

    Attributes
    ----------
    with_value : of those that take one.
    short : with one hyphen.
    """

    with_value: frozenset[str]
    short: frozenset[str]


def parser_words(cli: App, words: Sequence[str]) -> list[str]:
    """The words of a command, with the home in place of `~` in files, the name of
    standard input in place of `-`, and a value that begins with a minus joined to its
    option by `=`, since the parser would take it for an option.

    Raises
    ------
    InputError : `-` is given twice, or to a verb that reads no data.
    """
    if not words or words[0] not in cli:
        return list(words)
    verb, *rest = words
    end = rest.index("--") if "--" in rest else len(rest)
    names = _names(cli, verb) if any(map(_has_one_hyphen, rest[:end])) else None
    parsed = [verb]
    for word in rest[:end]:
        option = parsed[-1]
        if names is None or not _has_one_hyphen(word):
            parsed.append(in_home(word))
        elif option in names.with_value and word not in names.short:
            parsed[-1] = f"{option}={word}"
        elif word == "-":
            parsed.append(_standard_input(verb, parsed))
        else:
            parsed.append(word)
    return [*parsed, *rest[end:]]


def _has_one_hyphen(word: str) -> bool:
    """Whether a word begins with one hyphen, or is one."""
    return word[:1] == "-" and word[:2] != "--"


def _names(cli: App, verb: str) -> _Names:
    """The names of the options of a verb."""
    arguments = cli[verb].assemble_argument_collection()
    with_value = [
        argument.name
        for argument in arguments
        if isinstance(argument.parameter.converter, Form)
    ]
    short = ["-h"]
    for argument in arguments:
        short += filter(_has_one_hyphen, argument.names)
    return _Names(frozenset(with_value), frozenset(short))


def _standard_input(verb: str, before: Sequence[str]) -> str:
    """What stands for `-` among the words of a verb, after those `before`."""
    if verb not in READ_STANDARD_INPUT:
        *verbs, last = READ_STANDARD_INPUT
        raise InputError(
            f"{verb} -: only {', '.join(verbs)} and {last} read standard input; "
            "expected a name"
        )
    if STANDARD_INPUT in before:
        raise InputError(f"{verb} - -: standard input is read once; expected one `-`")
    return STANDARD_INPUT
