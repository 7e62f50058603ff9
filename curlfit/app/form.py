"""The flags of a command as fields of a form, and what is written there as words."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from cyclopts import App, Token

from curlfit.errors import InputError
from curlfit.foreign import cut
from curlfit.friction import LAWS, TERMS
from curlfit.settings.choices import FILE, FLAGS, LAW
from curlfit.settings.forms import PATH, SWITCH, Form, Several, Table

_NAMES = {flag: name for name, flag in FLAGS.items()}
_OPTION = re.compile(r"`(--[a-z][^`]*)`")
_WORDS_OF_FILES = ("--columns", "--by", "--trend", "--worksheet")


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
        return "".join(re.findall(r"\[default: ([^\];]+)", self.help))

    @property
    def takes_file(self) -> bool:
        """Whether its value is a file."""
        return self.form in (FILE, PATH)

    @property
    def _takes_words(self) -> bool:
        """Whether its value is in words, with a flag of their own each."""
        return isinstance(self.form, Table) and not self.form.many

    def words(self, text: str) -> list[str]:
        """The flag with its value, once for each value that needs a word of its own."""
        if self.form is SWITCH:
            return [self.flag]
        try:
            words = shlex.split(text) if self._takes_words else [text.strip()]
        except ValueError:  # refused by `value`
            words = [text.strip()]
        return [f"{self.flag}={word}" for word in words]

    def value(self, text: str) -> Any:
        """What the command makes of it. Raises `InputError`."""
        if self.form is SWITCH:
            return True
        if self._takes_words:
            try:
                shlex.split(text)
            except ValueError:  # a mark at the end, or one without its counterpart
                raise InputError(
                    f"{self.flag} {cut(text)}: a quotation mark or a backslash has "
                    f"no end; expected {self.written}"
                ) from None
        values = [word.partition("=")[2] for word in self.words(text)]
        return self.form(
            None, [Token(keyword=self.flag, value=value) for value in values]
        )


def fields_of(cli: App, verb: str) -> dict[str, Field]:
    """The fields of a command by their flags, but for those of its output."""
    found = {}
    for one in cli[verb].assemble_argument_collection(parse_docstring=True):
        groups: Any = one.parameter.group
        group, form = str(groups[0].name), one.parameter.converter
        if one.name.startswith("--") and one.name != "--resume" and group != "Output":
            found[one.name] = Field(
                one.name,
                group,
                " ".join((one.parameter.help or "").split()),
                str(one.parameter.metavar or ""),
                form if isinstance(form, Form) else SWITCH,
            )
    return found


def words_of(fields: Mapping[str, Field], written: Mapping[str, str]) -> list[str]:
    """The words of a command, of the fields that it has."""
    return [
        w
        for flag, text in written.items()
        if flag in fields
        for w in fields[flag].words(text)
    ]


def values_of(
    fields: Mapping[str, Field], written: Mapping[str, str]
) -> dict[str, Any]:
    """Choices by name, as the command has them. Raises `InputError`."""
    return {
        _NAMES.get(flag, flag[2:].replace("-", "_")): fields[flag].value(text)
        for flag, text in written.items()
    }


def proposals(fields: Mapping[str, Field], sentence: str) -> list[tuple[str, str]]:
    """The options between backticks that can be set as they stand, as flag and text;
    flags that the sentence wants a file for have none.

    Text of a file has no backticks (`TextFile.read`), and an option that curlfit makes
    of words of a file, such as a heading, is for the user to type.
    """
    proposed = []
    for code in _OPTION.findall(sentence):
        flag, _, text = code.partition(" ")
        field = fields.get(flag)
        if field is None:
            continue
        if field.takes_file:
            proposed.append((flag, ""))
        elif field.form is SWITCH:
            proposed.append((flag, "yes"))
        elif text not in ("", field.written) and _is_of_curlfit(field, text):
            proposed.append((flag, text))
    return list(dict.fromkeys(proposed))


def _is_of_curlfit(field: Field, text: str) -> bool:
    """Whether a proposed value holds no words of a file: neither a heading, a label or
    a worksheet, nor a law outside curlfit, which would run."""
    if field.form is LAW:
        return all(part in LAWS or part in TERMS for part in text.split("+"))
    return field.flag not in _WORDS_OF_FILES and not set(text) & set("\"'\\")


def merged(field: Field, before: str, text: str) -> str:
    """What a field holds once an option is added to it."""
    if not before or not isinstance(field.form, Table | Several):
        return text
    gap = "," if getattr(field.form, "many", True) else " "
    return before if text in before.split(gap) else f"{before}{gap}{text}"
