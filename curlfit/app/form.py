"""What is written on the page: law, stone and a line of further options, read as the
command line reads them."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from io import StringIO
from typing import Any, NamedTuple

from cyclopts import App
from cyclopts.exceptions import CycloptsError
from rich.console import Console

from curlfit.errors import InputError, Option
from curlfit.foreign import cut
from curlfit.friction import LAWS, TERMS
from curlfit.settings.choices import FILE, LAW
from curlfit.settings.command_words import parser_words
from curlfit.settings.forms import PATH, SWITCH, Form, refusal_of

_WORDS_OF_FILES = ("--columns", "--by", "--trend", "--worksheet")
_WIDTH = 100  # columns of the help


@dataclass(frozen=True)
class Flag:
    """A flag of a command; `written` is what its value looks like."""

    name: str
    written: str
    form: Form

    @property
    def takes_file(self) -> bool:
        """Whether its value is a file."""
        return self.form in (FILE, PATH)


@dataclass(frozen=True)
class Written:
    """What the user has written.

    Attributes
    ----------
    law, stone : values of `--law` and `--stone`; empty for the default.
    line : further options, as they are typed on the command line.
    """

    law: str = ""
    stone: str = ""
    line: str = ""

    def words(self) -> list[str]:
        """All options as words of a command. Raises `InputError` where the line is
        none that a shell would take."""
        try:
            words = shlex.split(self.line)
        except ValueError:
            raise InputError(
                f"further options {cut(self.line)}: a quotation mark or a backslash "
                "has no end; expected options as on the command line"
            ) from None
        if self.stone.strip():
            words = [f"--stone={self.stone.strip()}", *words]
        if self.law.strip():
            words = [f"--law={self.law.strip()}", *words]
        return words

    def with_option(self, flag: Flag, value: str) -> Written:
        """What is written with an option added; of options with one value, the last one
        counts."""
        if flag.name == "--law":
            return replace(self, law=value)
        if flag.name == "--stone":
            values = [part for part in self.stone.split(",") if part.strip()]
            return replace(self, stone=",".join(dict.fromkeys([*values, value])))
        words = [flag.name] if flag.form is SWITCH else [flag.name, value]
        option = shlex.join(words)
        if f" {option} " in f" {self.line} ":
            return self
        return replace(self, line=f"{self.line} {option}".strip())


def flags_of(cli: App, verb: str) -> dict[str, Flag]:
    """The flags of a command by name, but for those of its output."""
    flags = {}
    for argument in cli[verb].assemble_argument_collection(parse_docstring=True):
        groups: Any = argument.parameter.group
        name = argument.name
        if not name.startswith("--") or groups[0].name == "Output":
            continue
        if name == "--resume":  # there is nothing to be resumed
            continue
        form = argument.parameter.converter
        if not isinstance(form, Form):  # a flag without a value has no converter
            form = SWITCH
        flags[name] = Flag(name, str(argument.parameter.metavar or ""), form)
    return flags


def help_of(cli: App, verb: str) -> str:
    """What `--help` of a command prints."""
    printed = StringIO()
    cli.help_print([verb], console=Console(file=printed, width=_WIDTH, no_color=True))
    return printed.getvalue()


def values_of(cli: App, words: Sequence[str]) -> dict[str, Any]:
    """Choices of `curlfit fit` by name, as the command has them.

    Raises
    ------
    InputError : the command would refuse the words, or they are no options of a fit:
        a file, a place for results, `--help`.
    """
    try:
        command, bound, _ = cli.parse_args(parser_words(cli, ["fit", *words]))
    except CycloptsError as error:
        raise refusal_of(error) from None
    if command is not cli["fit"].default_command:
        raise InputError(
            "--help: expected options of the fit; all are listed below the line"
        )
    arguments = bound.arguments
    if files := arguments.get("data"):
        raise InputError(
            f"{cut(str(files[0]))}: expected an option, as --until 18; files are "
            "dropped above, and a value with spaces has quotation marks"
        )
    refused = arguments["output"].words() if "output" in arguments else []
    if "sampling" in arguments and arguments["sampling"].resume:
        refused.append("--resume")
    if refused:
        name = refused[0].partition("=")[0]
        raise InputError(
            f"{name}: the page itself writes and saves results; expected options of "
            "the fit"
        )
    choices = {"config": arguments["config"]} if arguments.get("config") else {}
    for group in ("flags", "reading"):
        if group in arguments:
            choices |= arguments[group].given()
    return choices


def words_for(flags: Collection[str], words: Sequence[str]) -> list[str]:
    """The words of a command that has only some of the flags. A word without two
    hyphens is the value of the flag before it."""
    kept = []
    keeps = True
    for word in words:
        if word.startswith("--"):
            keeps = word.partition("=")[0] in flags
        if keeps:
            kept.append(word)
    return kept


class Proposal(NamedTuple):
    """An option that a button sets: its flag and its value, which is empty for a file
    that the user has to choose."""

    name: str
    value: str


def proposals(flags: Mapping[str, Flag], options: Iterable[Option]) -> list[Proposal]:
    """Which options a button can set, each once.

    An option for which words of a file were used, such as a heading, is for the user to
    type.
    """
    proposed = []
    for option in options:
        name = f"--{option.name}"
        flag = flags.get(name)
        value = option.value
        if flag is None or option.left_out or option.in_python:
            continue
        if flag.takes_file:
            proposed.append(Proposal(name, ""))
        elif flag.form is SWITCH:
            proposed.append(Proposal(name, "yes"))
        elif _is_definite(flag, value) and _is_of_curlfit(flag, value):
            proposed.append(Proposal(name, value))
    return list(dict.fromkeys(proposed))


def _is_definite(flag: Flag, value: str) -> bool:
    """Whether a proposed value can be used as it is, unlike `N` or `phi=UNIT`."""
    return value not in ("", flag.written) and not value.endswith("=UNIT")


def _is_of_curlfit(flag: Flag, text: str) -> bool:
    """Whether a proposed value holds no words of a file: neither a heading, a label or
    a worksheet, nor a law outside curlfit, which would run."""
    if flag.form is LAW:
        return all(part in LAWS or part in TERMS for part in text.split("+"))
    return flag.name not in _WORDS_OF_FILES and not set(text) & set("\"'\\")
