"""Defaults that a data file carries: leading lines `# key = value`."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any

from curlfit.errors import DataError, InputError
from curlfit.friction import check_load, find_law
from curlfit.stone import Stone
from curlfit.throws.readers.axes import parse_axes
from curlfit.throws.throw import Reference

_SETTINGS = ("until", "law", "load", "stone", "sigma", "seed", "reference", "axes")


def defaults_of(
    path: Path, comments: Iterable[tuple[int, str]]
) -> tuple[dict[str, Any], Reference | None, list[str]]:
    """Settings, a reference and notes from comments with their line numbers.

    Other comments are comments.

    Raises
    ------
    DataError : a setting that cannot be read or used.
    """
    numbers, bodies, notes = [], [], []
    for number, line in comments:
        body = line.lstrip().lstrip("#").strip()
        key = body.split("=", 1)[0].strip().split(".")[0]
        if "=" not in body or not key.isidentifier():
            continue
        if key not in _SETTINGS:
            notes.append(f"line {number}: setting {key!r} is not known and was ignored")
            continue
        numbers.append(number)
        bodies.append(body)
    try:
        common = _settings(tuple(bodies))
    except (ValueError, RecursionError, InputError):
        _raise_at_fault(path, numbers, bodies)
        raise
    # Throws of a season say the same, and what each is given is its own to change.
    settings = {k: dict(v) if isinstance(v, dict) else v for k, v in common.items()}
    reference = settings.pop("reference", None)
    return settings, None if reference is None else _reference(path, reference), notes


@lru_cache(64)
def _settings(bodies: tuple[str, ...]) -> dict[str, Any]:
    """The settings that lines, each complete in itself, make together."""
    text = "\n".join(bodies)
    if any(mark in text for mark in ("[", '"""', "'''")):  # what could go on in the next line
        for body in bodies:
            tomllib.loads(body)
    found = tomllib.loads(text)
    _check(found)
    return found


def _raise_at_fault(path: Path, numbers: list[int], bodies: list[str]) -> None:
    """Name the first line with which the settings cannot be used."""
    for last, (number, body) in enumerate(zip(numbers, bodies, strict=True), 1):
        try:
            _settings(tuple(bodies[:last]))
        except InputError as error:
            raise DataError(str(error), file=path, line=number) from None
        except (ValueError, RecursionError):
            raise DataError(
                f"cannot read the setting {body!r}; expected key = value as in TOML, "
                "text in quotes, each key once",
                file=path,
                line=number,
            ) from None


def _check(settings: dict[str, Any]) -> None:
    """Refuse settings that no fit could use."""
    kinds = (("stone", dict), ("sigma", dict), ("law", str), ("load", str), ("axes", str))
    for key, expected in kinds:
        if not isinstance(settings.get(key, expected()), expected):
            raise InputError(f"{key} = {settings[key]!r} cannot be used")
    numbers = {f"stone.{name}": value for name, value in settings.get("stone", {}).items()}
    numbers |= {f"sigma.{name}": value for name, value in settings.get("sigma", {}).items()}
    numbers |= {"until": settings["until"]} if "until" in settings else {}
    for key, value in numbers.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
            raise InputError(f"{key} = {value!r}: expected a number")
    check_seed(settings.get("seed", 0))
    Stone().with_values(settings.get("stone", {}))
    if "law" in settings:
        find_law(settings["law"], from_files=False)
    if "load" in settings:
        check_load(settings["load"])
    parse_axes(settings.get("axes"))


def _reference(path: Path, found: Any) -> Reference:
    try:
        return Reference(
            source=str(found.get("source", "reference")),
            law=str(found["law"]),
            values={str(name): float(value) for name, value in found["values"].items()},
            note=str(found.get("note", "")),
            **{key: _stone_constants(found.get(key, {})) for key in ("stone", "rounding")},
        )
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError):
        raise DataError(
            'a reference needs reference.law = "NAME" and reference.values.NAME = number, and may '
            "have reference.stone.NAME and reference.rounding.NAME, NAME being R, rho, h or m",
            file=path,
        ) from None


def _stone_constants(found: dict[str, Any]) -> dict[str, float]:
    Stone().with_values(found)  # names and signs
    return {str(name): float(value) for name, value in found.items()}


def check_seed(seed: object) -> int:
    """A seed of random numbers, if it is one. Raises `InputError`."""
    if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < 2**32:
        raise InputError(f"seed = {seed!r}: expected a whole number from 0 to {2**32 - 1}")
    return seed
