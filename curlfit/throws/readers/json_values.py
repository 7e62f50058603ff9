"""JSON that other programs write: the values in a file, read only where they fit into
memory."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from curlfit.throws.readers.text import TextFile, is_aside

MOST_NUMBERS = 2_000_000
"""Numbers of one throw."""
_MOST_PARTS = 4_000_000
"""Lists and objects in a file; 16 million empty ones would take 1.2 GB."""
_MOST_VALUES = 6_000_000
"""Commas in a file; 12 million numbers take 0.6 GB, a log of 50 MB has 3 million."""


class _TooManyPartsError(ValueError):
    """JSON that would take too much memory."""


def value_in(file: TextFile, expected: str) -> Any:
    """The one JSON value of a file.

    Raises
    ------
    DataError : the file is not JSON, too deep or too large, with what was `expected`.
    """
    rows = _rows(file)
    try:
        return _loaded(_text(rows))
    except _TooManyPartsError as error:
        raise file.error(f"{error}; {expected}") from None
    except json.JSONDecodeError as error:
        index = rows[min(error.lineno, len(rows)) - 1][0] if rows else None
        raise file.error(f"not JSON; {expected}", index) from None
    except (ValueError, RecursionError):
        raise file.error(f"not JSON that can be read; {expected}") from None


def values_in(file: TextFile, expected: str) -> Iterator[tuple[int, Any]]:
    """The JSON values of a file, with their lines: one value, or one in each line.

    Raises
    ------
    DataError : a line is not JSON, too deep or too large, with what was `expected`.
    """
    rows = _rows(file)
    try:
        yield 1, _loaded(_text(rows))
    except (ValueError, RecursionError):
        for index, line in rows:
            try:
                yield index + 1, _loaded(line)
            except _TooManyPartsError as error:
                raise file.error(f"{error}; {expected}", index) from None
            except (ValueError, RecursionError):
                raise file.error(f"not a line of JSON; {expected}", index) from None


def does_not_move(stone: int, name: str, moving: Mapping[int, str]) -> str:
    """Why a stone is no throw: the fault, with the names of those that are.

    Parameters
    ----------
    stone : its index. moving : names of the stones that move, by index.
    """
    listed = ", ".join(f"{k + 1} ({name_of})" for k, name_of in moving.items())
    return f"stone {stone + 1} ({name}) does not move; those that do are {listed}"


def _rows(file: TextFile) -> list[tuple[int, str]]:
    """The lines without comments and blanks, with their indices."""
    return [(k, line) for k, line in enumerate(file.lines) if not is_aside(line)]


def _text(rows: list[tuple[int, str]]) -> str:
    return "\n".join(line for _, line in rows)


def _loaded(text: str) -> Any:
    """The value of JSON of at most as many parts as a throw can have."""
    if text.count("[") + text.count("{") > _MOST_PARTS:
        raise _TooManyPartsError(f"more than {_MOST_PARTS:,} lists and objects")
    if text.count(",") > _MOST_VALUES:
        raise _TooManyPartsError(f"more than {_MOST_VALUES:,} values")
    return json.loads(text)
