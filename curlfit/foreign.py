"""What comes from outside, in files, names and options: numbers that can be used,
and text made harmless where it leaves, in messages, on the terminal, in tables, as
names of folders."""

from __future__ import annotations

import csv
import hashlib
import math
import re
import reprlib
import sys
from collections.abc import Iterable, Sequence
from io import StringIO
from typing import Any

STANDARD_INPUT = "standard input"
"""The name of standard input where a file is named; `-` on the command line."""
LARGEST = 1e12
"""No measurement or setting, in SI, is larger; times since 1970 are smaller."""
_SMALLEST = 1e-30  # of a setting other than 0
SIZES = "0, or 1e-30 to 1e12 in size"
_LONGEST_QUOTE = 60
_LONGEST_MESSAGE = 1000
_LONGEST_NAME = 150  # bytes; a file's name may have 255, and suffixes are added
_SHORT = reprlib.Repr()  # of anything, however long or deep
_SHORT.maxother = _SHORT.maxlong = _LONGEST_QUOTE
_UNSAFE = re.compile(r'[\x00-\x1f\x7f<>:"/\\|?*]|^[-. ]+|[. ]+$')
_DEVICES = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.I)  # of Windows


def is_number(value: object, *, infinite: bool = False) -> bool:
    """Whether a value is a number of at most `LARGEST`, or infinite if
    that is allowed."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) <= LARGEST or (infinite and abs(value) == math.inf)


def is_size(value: float) -> bool:
    """Whether a number is 0 or such that what is computed from it is finite."""
    return value == 0 or _SMALLEST <= abs(value) <= LARGEST


def quoted(value: object) -> str:
    """A value for a message: in quotes if it is text, cut, control characters
    as escapes, and backticks too, since between these are options that curlfit
    proposes."""
    text = repr(cut(value)) if isinstance(value, str) else cut(_SHORT.repr(value))
    return text.replace("`", r"\x60")


def cut(text: str, most: int = _LONGEST_QUOTE) -> str:
    """The text, without its middle if it has more than `most` characters."""
    end = most // 4
    return text if len(text) <= most else f"{text[: most - end - 3]}...{text[-end:]}"


def counted(number: int, what: str) -> str:
    """A number of things, such as "1 row" or "2 rows"."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def printable(text: str) -> str:
    """Text with what moves the cursor, hides or reverses other text (control characters
    and such) as escapes."""
    if text.isprintable():
        return text
    return "".join(
        char if char.isprintable() else char.encode("unicode_escape").decode()
        for char in text
    )


def message(text: str) -> str:
    """A message in one line, cut if something in it is endless."""
    return printable(cut(text, _LONGEST_MESSAGE))


def say(text: str, *, error: bool = False) -> None:
    """Print lines that may contain names of files."""
    print(
        "\n".join(map(printable, text.split("\n"))),
        file=sys.stderr if error else sys.stdout,
    )


def file_and_number(name: str) -> tuple[str, str]:
    """The file of a throw, and its number in it, which is empty if the file
    has no other."""
    match = re.fullmatch(r"(.*) (?:row|throw) (\d+)", name, re.S)
    return (match[1], match[2]) if match is not None else (name, "")


def safe_name(text: str) -> str:
    """A name for a folder, of this or any other system; a usual name is
    left as it is."""
    if text.startswith(STANDARD_INPUT):
        text = text.replace(" ", "-", 1)
    name = _UNSAFE.sub(lambda match: "_" * len(match[0]), printable(text)) or "_"
    if _DEVICES.fullmatch(name):
        name += "_"
    raw = name.encode()
    if len(raw) <= _LONGEST_NAME:
        return name
    mark = hashlib.sha256(text.encode(errors="surrogateescape")).hexdigest()[:8]
    return f"{raw[:_LONGEST_NAME].decode(errors='ignore')}_{mark}"


def csv_lines(rows: Iterable[Sequence[Any]]) -> str:
    """Rows as CSV: numbers in full precision, empty cells for missing values, text by
    `csv_cell`."""
    out = StringIO()
    csv.writer(out, lineterminator="\n").writerows(map(csv_cell, row) for row in rows)
    return out.getvalue()


def csv_cell(value: Any) -> Any:
    """A cell, text without line breaks; an apostrophe precedes what a spreadsheet
    would compute."""
    if isinstance(value, str):
        shown = printable(value)
        return f"'{shown}" if shown.startswith(("=", "+", "-", "@")) else shown
    if isinstance(value, float):
        return "" if math.isnan(value) else repr(float(value))
    return value
