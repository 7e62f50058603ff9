"""Text of a file: lines, cells and numbers."""

from __future__ import annotations

import os
import re
import stat
from pathlib import Path
from typing import NamedTuple

from curlfit.errors import DataError, InputError, Option
from curlfit.findings import Finding
from curlfit.foreign import STANDARD_INPUT, quoted
from curlfit.throws.readers.columns import has_japanese_words
from curlfit.throws.readers.spreadsheet import text_of_sheet

EXPECTED = (
    "expected a header such as t,x,y,phi (time in s, position in m, angle in rad)"
)
# first bytes; of other archives too
_SPREADSHEETS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
_MOST_BYTES = 50_000_000
_MOST_BYTES_OF_SETTINGS = 64_000
_MOST_IN_HEAD = 1000  # characters of a comment, a header or a setting
_MOST_IN_ROW = 20_000  # characters; a line of JSON may have any number
_MOST_LINES = 2_000_000
_of_pipes: dict[tuple[int, int], bytes] = {}  # contents by device and inode
_MINUS = "\u2212"  # of typography
_SEPARATOR_LINE = re.compile(r"\"?sep=.?\"?[;,\t]*", re.I)  # for spreadsheets


def _bytes_of(path: Path, what: str, most: int) -> bytes:
    """The content of a file; a pipe, such as `<(zcat FILE)`, and standard input are
    read once and kept. Raises `DataError` where there is none, or too much."""
    source = 0 if str(path) == STANDARD_INPUT else path
    try:
        status = os.stat(source)
        inode = (status.st_dev, status.st_ino)
        if inode in _of_pipes:
            return _of_pipes[inode]
        with open(source, "rb", closefd=source != 0) as stream:
            raw = stream.read(most + 1)
    except ValueError:
        raise DataError("this is not a file name", file=quoted(str(path))) from None
    except OSError as error:
        fault = f"cannot be read ({error.strerror})"
        if isinstance(error, FileNotFoundError):
            fault = "no such file"
        elif isinstance(error, IsADirectoryError):
            fault = "this is a folder, expected a file"
        raise DataError(fault, file=path) from None
    if len(raw) > most:
        raise DataError(f"larger than {most // 1000} kB; expected {what}", file=path)
    if source == 0 or stat.S_ISFIFO(status.st_mode):
        _of_pipes[inode] = raw
    return raw


def decoded(raw: bytes) -> str:
    """Text with "\\n" line ends, in UTF-8, UTF-16 with byte order mark, Windows cp932
    with headings in Japanese, or Windows cp1252."""
    encoding = "utf-16" if raw[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        text = raw.decode(encoding)
    except UnicodeDecodeError:
        marked = encoding == "utf-16" or raw[:3] == b"\xef\xbb\xbf"
        if not marked:
            encoding = _old_encoding(raw)
        text = raw.decode(encoding, errors="replace")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _old_encoding(raw: bytes) -> str:
    """The encoding of a file that is not in Unicode: that of Windows in Japan or
    in the West."""
    begin = raw[:_MOST_IN_ROW].decode("cp932", "replace")
    return "cp932" if has_japanese_words(begin) else "cp1252"


class TextFile(NamedTuple):
    """A file and its lines, none of them longer than any throw needs.

    Attributes
    ----------
    note : on what of it was read, if it has more.
    """

    path: Path
    lines: list[str]
    note: Finding | None = None

    @classmethod
    def read(
        cls, path: Path, worksheet: str | None = None, *, settings: bool = False
    ) -> TextFile:
        """A file of data, or a worksheet of a workbook: its first one with data,
        if none is named; or a file of `settings`, in which all lines are as short
        as comments.

        Raises
        ------
        DataError : no such file, a folder, not readable, too large, not text, or a line
            is too long. InputError : no such worksheet.
        """
        if settings:
            raw = _bytes_of(path, "settings", _MOST_BYTES_OF_SETTINGS)
        else:
            raw = _bytes_of(path, "throws", _MOST_BYTES)
        note = None
        if raw.startswith(_SPREADSHEETS):
            text, note = text_of_sheet(raw, path, _MOST_BYTES, worksheet)
        elif worksheet is not None:
            raise InputError(
                f"--worksheet: {path} is no workbook and holds no worksheets"
            )
        else:
            text = decoded(raw)
        # In sentences, what is between backticks is an option that curlfit proposes.
        if not text.isascii():
            text = text.replace(_MINUS, "-")
        lines = text.replace("`", "'").split("\n")
        if _SEPARATOR_LINE.fullmatch(lines[0]):
            lines[0] = ""
        file = cls(path, lines, note)
        if "\x00" in text:
            raise file.error(f"this is not a text file; {EXPECTED}")
        if len(file.lines) > _MOST_LINES + 1:
            raise file.error(f"more than {_MOST_LINES} lines; expected throws")
        file._require_short_lines(settings)
        return file

    def _require_short_lines(self, settings: bool) -> None:
        """Raise `DataError` for a line that is longer than any throw needs; one of JSON
        may have any length."""
        if max(map(len, self.lines)) <= _MOST_IN_HEAD:
            return
        header = next(
            (k for k, line in enumerate(self.lines) if not is_aside(line)), -1
        )
        json = not settings and self.lines[header].lstrip()[:1] in ("{", "[")
        for index, line in enumerate(self.lines):
            comment = is_aside(line)
            if json and not comment:
                continue
            short = settings or comment or index == header
            most = _MOST_IN_HEAD if short else _MOST_IN_ROW
            if len(line) > most:
                fault = f"a line of {len(line)} characters; expected at most {most}"
                raise self.error(fault, index)

    def error(
        self,
        message: str,
        index: int | None = None,
        column: str | None = None,
        options: tuple[Option, ...] = (),
    ) -> DataError:
        """An error at the line of this index, with options to type instead."""
        line = None if index is None else index + 1
        return DataError(
            message, file=self.path, line=line, column=column, options=options
        )

    def head(self, expected: str = EXPECTED) -> int:
        """Index of the first line that is not a comment.

        Raises
        ------
        DataError : the file is empty or contains only comments.
        """
        index = next(
            (k for k, line in enumerate(self.lines) if not is_aside(line)), None
        )
        if index is None:
            blank = not any(map(str.strip, self.lines))
            what = "the file is empty" if blank else "the file holds comments only"
            raise self.error(f"{what}; {expected}")
        return index

    def comments(self, until: int | None = None) -> list[tuple[int, str]]:
        """The comments before the line of an index, with their own indices."""
        lines = enumerate(self.lines[:until])
        return [(k, line) for k, line in lines if line.lstrip()[:1] == "#"]


def is_aside(line: str) -> bool:
    """Whether a line is blank or a comment."""
    return line.lstrip()[:1] in ("", "#")
