"""JSON in files: read within limits, and written whole or not at all."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from curlfit.errors import DataError
from curlfit.output.files import atomic_write

_LARGEST = 32_000_000  # bytes
_MOST_PARTS = 1_000_000  # lists and objects


def read_json(file: Path, what: str) -> dict[str, Any]:
    """The JSON object in a file, of at most as many bytes as a record can have.

    Parameters
    ----------
    what : is expected, for the sentence of an error.

    Raises
    ------
    DataError : the file does not exist, is too large, or is not such JSON.
    """
    try:
        is_small = file.stat().st_size <= _LARGEST
        text = file.read_text(encoding="utf-8") if is_small else ""
        is_small = is_small and text.count("[") + text.count("{") <= _MOST_PARTS
        entries = json.loads(text, parse_constant=_refuse) if is_small else None
    except FileNotFoundError:
        raise DataError("no such file", file=file) from None
    except OSError as error:
        raise DataError(f"cannot be read ({error.strerror})", file=file) from None
    except (ValueError, RecursionError):
        raise DataError(f"this is not JSON; expected {what}", file=file) from None
    if not is_small:
        raise DataError(f"larger than {what} can be", file=file)
    if type(entries) is not dict:
        raise DataError(f"not {what}", file=file)
    return entries


def _refuse(constant: str) -> None:
    """Refuse NaN and Infinity, which are not JSON."""
    raise ValueError(constant)


def write_json(entries: dict[str, Any], file: Path) -> None:
    """Write plain values atomically, as JSON that any program can read."""
    text = json.dumps(entries, indent=1, allow_nan=False)
    atomic_write(file, _compact_series(text) + "\n")


def _compact_series(text: str) -> str:
    """JSON with each list of numbers on one line, which keeps the rest readable."""
    number = r"(?:-?\d[-+.eE\d]*|null)"
    return re.sub(
        rf"\[\s+({number}(?:,\s+{number})*)\s+\]",
        lambda match: "[" + re.sub(r",\s+", ", ", match[1]) + "]",
        text,
    )
