"""A worksheet of a workbook as text."""

from __future__ import annotations

import csv
import zlib
from collections.abc import Sequence
from datetime import date, datetime, time, timedelta
from functools import lru_cache
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any
from xml.parsers.expat import ExpatError
from zipfile import BadZipFile, ZipFile

from curlfit.errors import DataError, InputError, Option
from curlfit.findings import Finding, Remedy
from curlfit.throws.readers.worksheet_size import (
    MOST_CELLS,
    Extent,
    require_size,
    too_many_cells,
)

# of an archive or a part of it that is damaged, encrypted or of another kind
_ARCHIVE_FAULTS = (BadZipFile, zlib.error, EOFError, OSError, RuntimeError, ExpatError)


# The readers of tables ask one after another whether a file is theirs.
@lru_cache(maxsize=1)
def text_of_sheet(
    raw: bytes, path: Path, most_bytes: int, wanted: str | None = None
) -> tuple[str, Finding | None]:
    """The cells as a table separated by semicolons, and a note where other worksheets
    have data too.

    Row n is line n. Clock times are HH:MM, with seconds if any has some. If no
    worksheet is wanted, the first one with data is read.

    Raises
    ------
    DataError : not a spreadsheet, without data, too large, or its reader is
        not installed.
    InputError : no such worksheet.
    """
    fault = (
        "this is a spreadsheet or another archive, not a text file; "
        "save the sheet as CSV"
    )
    try:
        from python_calamine import CalamineError, CalamineWorkbook
    except ImportError:
        fault += ", or have it read after pip install 'curlfit[spreadsheet]'"
        raise DataError(fault, file=path) from None
    try:
        if raw.startswith(b"PK"):
            with ZipFile(BytesIO(raw)) as archive:
                if sum(part.file_size for part in archive.infolist()) > most_bytes:
                    raise DataError(
                        f"larger than {most_bytes // 1000} kB unpacked", file=path
                    )
                require_size(archive, path)
        book = CalamineWorkbook.from_filelike(BytesIO(raw))
        sheets = {name: book.get_sheet_by_name(name) for name in book.sheet_names}
        names = [name for name, sheet in sheets.items() if sheet.height]
        if not names:
            raise DataError("a spreadsheet without data", file=path)
        if wanted is not None and wanted not in names:
            fault = (
                f"--worksheet {wanted}: {path} has no such worksheet with "
                "data; expected one of"
            )
            raise InputError(f"{fault} {', '.join(map(_without_backticks, names))}")
        chosen = names[0] if wanted is None else wanted
        sheet = sheets[chosen]
        extent = Extent((sheet.total_height, 1), (1, sheet.total_width))
        if extent.cells > MOST_CELLS:  # of an .xls, which is no archive
            raise too_many_cells(extent, path)
        cells = sheet.to_python(skip_empty_area=False)
    except (CalamineError, *_ARCHIVE_FAULTS):
        raise DataError(fault, file=path) from None
    text = _separated_by_semicolons(cells)
    if len(names) == 1:
        return text, None
    several = Finding.note(
        "one-of-worksheets",
        Remedy("selects-another", Option("worksheet", "NAME")),
        count=len(names),
        worksheets=[_without_backticks(name) for name in names],
        taken=_without_backticks(chosen),
    )
    return text, several


def _separated_by_semicolons(cells: Sequence[Sequence[Any]]) -> str:
    """The rows of a worksheet as lines of text; comments are lines as they are."""
    rows = [[_plain(cell) for cell in row] for row in cells]
    clocks = [cell for row in rows for cell in row if isinstance(cell, time | datetime)]
    exact = any(clock.second or clock.microsecond for clock in clocks)
    clock_format = "%H:%M:%S.%f" if exact else "%H:%M"
    lines = StringIO()
    write = csv.writer(lines, delimiter=";", lineterminator="\n").writerow
    for row in rows:
        texts = [_shown(cell, clock_format) for cell in row]
        if texts[0].startswith("#") or not any(texts):
            lines.write(" ".join(filter(None, texts)) + "\n")
        else:
            write(texts)
    return lines.getvalue()


def _without_backticks(name: str) -> str:
    """A name for a sentence, in which what is between backticks is an option."""
    return name.replace("`", "'")


def _plain(cell: Any) -> Any:
    """A cell of a spreadsheet; a duration, or a time without a date, as
    a clock time."""
    if isinstance(cell, timedelta):
        return (datetime.min + cell % timedelta(days=1)).time()
    return cell.time() if isinstance(cell, datetime) and cell.year < 1901 else cell


def _shown(cell: Any, clock: str) -> str:
    """The text of a cell; times of the day have the format `clock`."""
    if isinstance(cell, time | datetime):
        return cell.strftime(clock if isinstance(cell, time) else f"%Y-%m-%d {clock}")
    if isinstance(cell, date):
        return cell.isoformat()
    if isinstance(cell, float) and cell.is_integer():
        return str(int(cell))
    return " ".join(str(cell).split())
