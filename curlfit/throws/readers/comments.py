"""Settings of a throw in the `#` lines of its file."""

from __future__ import annotations

import re
import tomllib
from bisect import bisect_left
from collections.abc import Sequence
from typing import Any, NamedTuple

from curlfit.errors import InputError
from curlfit.findings import Finding
from curlfit.foreign import cut, quoted
from curlfit.friction import find_law
from curlfit.settings.choices import SEED, Modelling, Reading
from curlfit.stone import Stone
from curlfit.throws.readers.axes import parse_axes
from curlfit.throws.readers.text import TextFile
from curlfit.throws.reference import Reference

_SETTINGS = (
    "since",
    "until",
    "exclude",
    "swept",
    "law",
    "load",
    "stone",
    "sigma",
    "seed",
    "reference",
    "axes",
    "as_given",
    "keep",
    "columns",
)
_MOST_SETTINGS = 500
_MOST_NAMED = 5  # settings that are not known
_KEY = re.compile(r"\w+(\.\w+)*")
_FORMS = {**Modelling.forms(), **Reading.forms(), "seed": SEED}
_REFERENCE = (
    'a reference needs reference.law = "NAME" and reference.values.NAME = number, '
    "and may have reference.stone.NAME and reference.rounding.NAME, "
    "NAME being R, rho, h or m"
)


class Comments(NamedTuple):
    """What the comments of a file say of its throw.

    Attributes
    ----------
    settings : defaults of a fit and of how it is read, by name.
    reference : published values, if there are any.
    notes : on settings that are not known.
    """

    settings: dict[str, Any]
    reference: Reference | None
    notes: list[Finding]


def read_comments(file: TextFile, until: int | None = None) -> Comments:
    """The settings, the reference and the notes in the comments of a file.

    Comments that are not `key = value` are skipped, but `key: value` is refused where
    `key = value` would be a setting.

    Parameters
    ----------
    until : index of the line before which comments are settings; all are, if None.

    Raises
    ------
    DataError : a setting that cannot be read or used.
    """
    settings_lines: list[tuple[int, str]] = []
    unknown: list[dict[str, Any]] = []
    for index, line in file.comments(until):
        body = line.lstrip().lstrip("#").strip()
        key, dot, _ = body.split("=", 1)[0].strip().partition(".")
        if "=" not in body:
            _require_no_colon(file, index, body)
            continue
        if not key.isidentifier():
            continue
        if key in _SETTINGS and (key != "columns" or dot):
            settings_lines.append((index, body))
        else:
            unknown.append({"key": quoted(key), "line": index + 1})
    if len(settings_lines) > _MOST_SETTINGS:
        fault = f"more than {_MOST_SETTINGS} settings; expected those of one throw"
        raise file.error(fault, settings_lines[_MOST_SETTINGS][0])
    settings, fault = _settings(settings_lines)
    if fault:
        # The fault is that of the first line with which the lines so far have one: by
        # bisection, as each trial reads all lines so far.
        first = bisect_left(
            range(len(settings_lines)),
            True,
            key=lambda last: bool(_settings(settings_lines[: last + 1])[1]),
        )
        _, fault = _settings(settings_lines[: first + 1])
        raise file.error(fault, settings_lines[first][0])
    notes = []
    if unknown:
        more = len(unknown) - _MOST_NAMED
        ignored = Finding.note(
            "unknown-settings",
            settings=unknown[:_MOST_NAMED],
            more=more if more > 0 else None,
        )
        notes.append(ignored)
    reference = _reference(file, settings.pop("reference", None))
    return Comments(settings, reference, notes)


def headings_named_in(file: TextFile, until: int | None = None) -> dict[str, str]:
    """The headings that the comments of a file name, by quantity, as in
    `# columns.y = "Distance"`. Only comments that have such a line are read.

    Parameters
    ----------
    until : as of `read_comments`.

    Raises
    ------
    DataError : a setting that cannot be read or used.
    """
    if not any("columns." in line for _, line in file.comments(until)):
        return {}
    named: dict[str, str] = read_comments(file, until).settings.get("columns", {})
    return named


def _require_no_colon(file: TextFile, index: int, body: str) -> None:
    """Raise `DataError` for a comment that would be a setting with `=` for its colon;
    a text may lack its quotes. Words such as "law: see the paper" are a comment."""
    key, _, value = (part.strip() for part in body.partition(":"))
    first, dot, _ = key.partition(".")
    if first not in _SETTINGS or not value or not _KEY.fullmatch(key):
        return
    expected = f"{key} = {value}"
    usable = True
    if _settings([(index, expected)])[1]:
        in_quotes = f"{key} = '{value}'"
        usable = not _settings([(index, in_quotes)])[1]
        if usable:
            expected = in_quotes
    if dot or (usable and first not in ("reference", "columns")):
        fault = f"{quoted(body)} is no setting; expected {cut(expected)}"
        raise file.error(fault, index)


def _settings(lines: Sequence[tuple[int, str]]) -> tuple[dict[str, Any], str]:
    """Settings by name, and what is wrong with those of the last line, if
    anything is."""
    try:
        settings = tomllib.loads("\n".join(body for _, body in lines))
        _check(settings)
    except InputError as error:
        return {}, str(error)
    except (ValueError, RecursionError):
        return {}, (
            f"cannot read the setting {quoted(lines[-1][1])}; expected key = value as "
            "in TOML, text in quotes, each key once"
        )
    return settings, ""


def _check(settings: dict[str, Any]) -> None:
    """Raise `InputError` for settings that cannot be used."""
    for name, value in settings.items():
        if name in _FORMS and name != "reference":  # there, values to compare with
            _FORMS[name].checked(name, value)
    if "stone" in settings:
        Stone().with_values(settings["stone"])
    if "law" in settings:
        find_law(settings["law"], from_files=False)
    if "axes" in settings:
        parse_axes(settings["axes"])


def _reference(file: TextFile, setting: Any) -> Reference | None:
    """The reference in a setting, if there is one. Raises `DataError` for another
    value."""
    if setting is None:
        return None
    try:
        stated = {
            "source": "reference",
            "note": "",
            "stone": {},
            "rounding": {},
            **setting,
        }
        for key in ("stone", "rounding"):
            Stone().with_values(stated[key])  # checks names and signs
        tables = {
            key: {str(name): float(value) for name, value in stated[key].items()}
            for key in ("values", "stone", "rounding")
        }
        return Reference(
            str(stated["source"]),
            str(stated["law"]),
            note=str(stated["note"]),
            **tables,
        )
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError):
        raise file.error(_REFERENCE) from None
