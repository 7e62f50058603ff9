"""The flags of a command as fields of a form, and what is written there as words."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from cyclopts import App, Token

from curlfit.settings.choices import FILE, FLAGS
from curlfit.settings.forms import PATH, SWITCH, Form, Several, Table

_NAMES = {flag: name for name, flag in FLAGS.items()}
_LEFT_OUT = {"Output", "--resume"}  # group and flag: the page sees to them itself
_OPTION = re.compile(r"`(--[a-z][^`]*)`")


@dataclass(frozen=True)
class Field:
    """One flag.

    Attributes
    ----------
    group : heading under which `--help` lists it. written : what its value looks like.
    """

    flag: str
    group: str
    help: str
    written: str
    form: Form

    @property
    def usual(self) -> str:
        """The default in a word or two, if its help states one."""
        found = re.search(r"\[default: ([^\];]+)", self.help)
        return found[1].strip() if found else ""

    @property
    def takes_file(self) -> bool:
        """Whether its value is a file."""
        return self.form in (FILE, PATH)

    def words(self, text: str) -> list[str]:
        """The flag with its value, once for each value that needs a word of its own."""
        if self.form is SWITCH:
            return [self.flag]
        each = isinstance(self.form, Table) and not self.form.many
        return [f"{self.flag}={word}" for word in (shlex.split(text) if each else [text.strip()])]

    def value(self, text: str) -> Any:
        """What the command makes of it. Raises `InputError`."""
        if self.form is SWITCH:
            return True
        tokens = [Token(keyword=self.flag, value=one.split("=", 1)[1]) for one in self.words(text)]
        return self.form(None, tokens)


def fields_of(cli: App, verb: str) -> dict[str, Field]:
    """The fields of a command by their flags."""
    found = {}
    for one in cli[verb].assemble_argument_collection(parse_docstring=True):
        groups: Any = one.parameter.group
        group = str(groups[0].name)
        if not one.name.startswith("--") or {group, one.name} & _LEFT_OUT:
            continue
        form = one.parameter.converter
        found[one.name] = Field(
            one.name, group, " ".join((one.parameter.help or "").split()),
            str(one.parameter.metavar or ""), form if isinstance(form, Form) else SWITCH,
        )  # fmt: skip
    return found


def words_of(fields: Mapping[str, Field], written: Mapping[str, str]) -> list[str]:
    """The words of a command, of the fields that it has."""
    return [w for flag, text in written.items() if flag in fields for w in fields[flag].words(text)]


def values_of(fields: Mapping[str, Field], written: Mapping[str, str]) -> dict[str, Any]:
    """Choices by name, as the command has them. Raises `InputError`."""
    return {
        _NAMES.get(flag, flag[2:].replace("-", "_")): fields[flag].value(text)
        for flag, text in written.items()
        if flag in fields
    }


class Proposal(NamedTuple):
    """An option that a sentence proposes; without a value, a file that it asks for."""

    flag: str
    text: str


def proposals(fields: Mapping[str, Field], sentence: str) -> list[Proposal]:
    """The options between backticks that can be set as they stand, and flags that want a file."""
    found = []
    for code in _OPTION.findall(sentence):
        flag, _, text = code.partition(" ")
        field = fields.get(flag)
        if field is None or field.takes_file or text == field.written != "":
            continue
        if bool(text) != (field.form is SWITCH):
            found.append(Proposal(flag, " ".join(shlex.split(text)) or "yes"))
    files = [Proposal(f, "") for f, one in fields.items() if one.takes_file and f"{f} " in sentence]
    return list(dict.fromkeys(found + files))


def merged(field: Field, before: str, text: str) -> str:
    """What a field holds once an option is added to it."""
    if not before or not isinstance(field.form, Table | Several):
        return text
    gap = "," if getattr(field.form, "many", True) else " "
    return before if text in before.split(gap) else f"{before}{gap}{text}"
