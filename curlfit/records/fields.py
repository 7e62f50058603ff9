"""What fields of records say about their place in a file, and the base of objects
within a record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import Field, dataclass, fields
from typing import Any

from curlfit.findings import Level
from curlfit.numerics.arrays import Floats

UNSAVED = {"saved": False}
"""Metadata of a field that is not in the file."""
ADDED = {"needed": False}
"""Metadata of a field that files of earlier versions lack."""
SERIES = {"series": True}
"""Metadata of a field that a summary leaves out."""

LEVELS = {"warnings": Level.WARNING, "notes": Level.NOTE}
"""Keys of findings, which are sentences in a file; beside them stands the key
`findings`, with the code, numbers and remedies of each."""


def written_as(key: str) -> dict[str, str]:
    """Metadata of a field whose key in the file is no name in Python."""
    return {"key": key}


def key_of(field: Field[Any]) -> str:
    """The key of a field in the file."""
    return str(field.metadata.get("key", field.name))


def saved_fields(kind: Any) -> list[Field[Any]]:
    """The fields of a dataclass that are in its file."""
    return [field for field in fields(kind) if field.metadata.get("saved", True)]


@dataclass(frozen=True)
class Entry:
    """Base of the objects within a record, which also have items: `fit.data.file` is
    `fit.data["file"]`, by the keys of the file."""

    def __getitem__(self, key: str) -> Any:
        for field in saved_fields(type(self)):
            if key_of(field) == key:
                return getattr(self, field.name)
        raise KeyError(key)


def require(place: str, holds: bool, what: str) -> None:
    """Raise `ValueError` unless fields of a record agree."""
    if not holds:
        raise ValueError(f"{place}: expected {what}")


def require_rows(
    place: str, series: Mapping[str, Sequence[Any] | Floats], rows: int
) -> None:
    """Raise `ValueError` unless all series have as many values."""
    same = all(len(values) == rows for values in series.values())
    require(place, same, f"series of {rows} values each")
