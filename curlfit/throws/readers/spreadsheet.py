"""A spreadsheet as text: its first sheet with data."""

from __future__ import annotations

import csv
from datetime import date, datetime, time, timedelta
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

from curlfit.errors import DataError


def text_of_sheet(raw: bytes, path: Path, most_bytes: int) -> str:
    """The cells as a table separated by semicolons; row n is line n. Clock times are HH:MM, with
    seconds if any has some.

    Raises
    ------
    DataError : not a spreadsheet, without data, too large, or its reader is not installed.
    """
    fault = "this is a spreadsheet or another archive, not a text file; save the sheet as CSV"
    try:
        from python_calamine import CalamineError, CalamineWorkbook
    except ImportError:
        fault += ", or have it read after pip install 'curlfit[spreadsheet]'"
        raise DataError(fault, file=path) from None
    try:
        if raw.startswith(b"PK"):
            with ZipFile(BytesIO(raw)) as archive:
                if sum(part.file_size for part in archive.infolist()) > most_bytes:
                    raise DataError(f"larger than {most_bytes // 1000} kB unpacked", file=path)
        book = CalamineWorkbook.from_filelike(BytesIO(raw))
        sheets = (book.get_sheet_by_name(name) for name in book.sheet_names)
        tables = (sheet.to_python(skip_empty_area=False) for sheet in sheets)
        rows = [list(map(_plain, row)) for row in next(filter(None, tables), [])]
    except (CalamineError, BadZipFile, NotImplementedError):
        raise DataError(fault, file=path) from None
    if not rows:
        raise DataError("a spreadsheet without data", file=path)
    clocks = [cell for row in rows for cell in row if isinstance(cell, time | datetime)]
    exact = any(clock.second or clock.microsecond for clock in clocks)
    lines = StringIO()
    write = csv.writer(lines, delimiter=";", lineterminator="\n").writerow
    for row in rows:
        found = [_shown(cell, "%H:%M:%S.%f" if exact else "%H:%M") for cell in row]
        if found[0].startswith("#") or not any(found):
            lines.write(" ".join(filter(None, found)) + "\n")
        else:
            write(found)
    return lines.getvalue()


def _plain(cell: Any) -> Any:
    """A cell of a spreadsheet; a duration, or a time without a date, as a clock time."""
    if isinstance(cell, timedelta):
        return (datetime.min + cell % timedelta(days=1)).time()
    return cell.time() if isinstance(cell, datetime) and cell.year < 1901 else cell


def _shown(cell: Any, clock: str) -> str:
    if isinstance(cell, time | datetime):
        return cell.strftime(clock if isinstance(cell, time) else f"%Y-%m-%d {clock}")
    if isinstance(cell, date):
        return cell.isoformat()
    if isinstance(cell, float) and cell.is_integer():
        return str(int(cell))
    return " ".join(str(cell).split())
