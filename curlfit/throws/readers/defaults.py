"""Settings of a throw in the `#` lines of its file."""

from __future__ import annotations

import tomllib
from bisect import bisect_left
from pathlib import Path
from typing import Any, NoReturn

from curlfit.errors import InputError
from curlfit.foreign import quoted
from curlfit.friction import find_law
from curlfit.settings.choices import SEED, Modelling, Reading
from curlfit.stone import Stone
from curlfit.throws.readers.axes import parse_axes
from curlfit.throws.readers.parsed_file import ParsedFile
from curlfit.throws.readers.text import TextFile
from curlfit.throws.reference import Reference

_SETTINGS = (
    "since", "until", "exclude", "swept", "law", "load", "stone", "sigma", "seed", "reference",
    "axes", "as_given", "keep",
)  # fmt: skip
_MOST_SETTINGS, _MOST_NOTES = 500, 5
_FORMS = {**Modelling.forms(), **Reading.forms(), "seed": SEED}


def begun(
    file: TextFile, format: str, until: int | None = None, source: Path | str | None = None
) -> ParsedFile:
    """A parsed file with the settings, reference and notes from its comments, and no columns yet.

    Comments that are not `key = value` are skipped.

    Parameters
    ----------
    until : index of the line before which comments are settings; all are, if None.
    source : a name in place of the file.

    Raises
    ------
    DataError : a setting that cannot be read or used.
    """
    found: list[tuple[int, str]] = []
    unknown: list[str] = []
    for number, line in file.comments(until):
        body = line.lstrip().lstrip("#").strip()
        key = body.split("=", 1)[0].strip().split(".")[0]
        if "=" not in body or not key.isidentifier():
            continue
        if key in _SETTINGS:
            found.append((number, body))
        else:
            unknown.append(f"line {number}: setting {quoted(key)} is not known and was ignored")
    if len(found) > _MOST_SETTINGS:
        fault = f"more than {_MOST_SETTINGS} settings; expected those of one throw"
        raise file.error(fault, found[_MOST_SETTINGS][0] - 1)
    notes, more = unknown[:_MOST_NOTES], len(unknown) - _MOST_NOTES
    if more > 0:
        notes.append(f"{more} more settings are not known and were ignored")
    try:
        settings = _settings([body for _, body in found])
    except (ValueError, RecursionError, InputError):
        _raise_at_fault(file, found)
    given = settings.pop("reference", None)
    reference = None if given is None else _reference(file, given)
    return ParsedFile(
        source or file.path, format, settings=settings, reference=reference, notes=notes
    )


def _settings(bodies: list[str]) -> dict[str, Any]:
    """The settings in some lines, each of them valid TOML."""
    text = "\n".join(bodies)
    if any(mark in text for mark in ("[", '"""', "'''")):  # values that may extend over lines
        for body in bodies:
            tomllib.loads(body)
    found = tomllib.loads(text)
    _check(found)
    return found


def _raise_at_fault(file: TextFile, found: list[tuple[int, str]]) -> NoReturn:
    """Raise `DataError` with the first line that makes the settings unusable."""

    def fault(count: int) -> str:
        """What is wrong with the first lines; more lines mend nothing."""
        try:
            _settings([body for _, body in found[:count]])
        except InputError as error:
            return str(error)
        except (ValueError, RecursionError):
            return (
                f"cannot read the setting {quoted(found[count - 1][1])}; expected key = value as "
                "in TOML, text in quotes, each key once"
            )
        return ""

    last = 1 + bisect_left(range(1, len(found)), True, key=lambda count: bool(fault(count)))
    raise file.error(fault(last), found[last - 1][0] - 1)


def _check(settings: dict[str, Any]) -> None:
    """Raise `InputError` for settings that cannot be used."""
    for name, value in settings.items():
        if name in _FORMS and name != "reference":  # there, values to compare with
            _FORMS[name].checked(name, value)
    Stone().with_values(settings.get("stone", {}))
    if "law" in settings:
        find_law(settings["law"], from_files=False)
    parse_axes(settings.get("axes"))


def _reference(file: TextFile, found: Any) -> Reference:
    try:
        return Reference(
            source=str(found.get("source", "reference")),
            law=str(found["law"]),
            values={str(name): float(value) for name, value in found["values"].items()},
            note=str(found.get("note", "")),
            **{key: _stone_constants(found.get(key, {})) for key in ("stone", "rounding")},
        )
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError):
        raise file.error(
            'a reference needs reference.law = "NAME" and reference.values.NAME = number, and may '
            "have reference.stone.NAME and reference.rounding.NAME, NAME being R, rho, h or m"
        ) from None


def _stone_constants(found: dict[str, Any]) -> dict[str, float]:
    Stone().with_values(found)  # checks names and signs
    return {str(name): float(value) for name, value in found.items()}
