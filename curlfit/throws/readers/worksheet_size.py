"""The size of the worksheets of a workbook, before their cells are laid out in a grid.

A grid has every cell from the first to the farthest, whether it has a value or not, so
that one stray cell XFD1048576 would need some 400 GB.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from xml.parsers.expat import ParserCreate
from zipfile import ZipFile

from curlfit.errors import DataError

MOST_CELLS = 2_000_000
"""Of all worksheets, with or without a value; 50 MB of XML hold as many values."""
# attributes that tell of a value in an .ods
_OF_A_VALUE = {
    *("office:value", "office:value-type", "office:string-value", "office:date-value"),
    *("office:time-value", "office:boolean-value", "table:formula"),
}
# kinds of records in an .xlsb: a row, and a cell with a value (kind 1 is one without)
_XLSB_ROW = 0
_XLSB_CELLS = range(2, 12)


@dataclass
class Extent:
    """How far the cells with a value of a worksheet reach.

    Attributes
    ----------
    lowest, rightmost : row and column, counted from 1, of the last cell of the last row
        with a value, and of the last column.
    """

    lowest: tuple[int, int] = (0, 0)
    rightmost: tuple[int, int] = (0, 0)

    def include(self, row: int, column: int) -> None:
        """Add a cell with a value."""
        if (row, column) > self.lowest:
            self.lowest = row, column
        if (column, row) > self.rightmost[::-1]:
            self.rightmost = row, column

    @property
    def cells(self) -> int:
        """Number of cells of the grid."""
        return self.lowest[0] * self.rightmost[1]


def require_size(archive: ZipFile, file: Path) -> None:
    """Raise `DataError` for a workbook whose worksheets have too many cells.

    Raises
    ------
    BadZipFile, ExpatError : no workbook.
    """
    extents: list[Extent] = []
    for part in archive.infolist():
        content = archive.read(part)
        if part.filename == "content.xml":
            extents += _extents_of_ods(content)
        elif b"sheetData" in content:
            extents.append(_extent_of_xlsx(content))
        elif "worksheets/" in part.filename and part.filename.endswith(".bin"):
            extents.append(_extent_of_xlsb(content))
    if sum(extent.cells for extent in extents) > MOST_CELLS:
        raise too_many_cells(max(extents, key=lambda extent: extent.cells), file)


def too_many_cells(extent: Extent, file: Path) -> DataError:
    """The error of a worksheet whose cells are too far apart, with the farthest."""
    ends = dict.fromkeys((extent.lowest, extent.rightmost))
    farthest = " and ".join(f"{_letters(column)}{row}" for row, column in ends)
    return DataError(
        f"the cells of a worksheet reach to {farthest}, {extent.lowest[0]} rows of "
        f"{extent.rightmost[1]} columns, and a workbook may have {MOST_CELLS} cells: "
        "delete what is beyond the table, or save the table as CSV",
        file=file,
    )


def _letters(column: int) -> str:
    """The name of a column: A, Z, AA ..."""
    name = ""
    while column > 0:
        column, letter = divmod(column - 1, 26)
        name = chr(ord("A") + letter) + name
    return name


def _extent_of_xlsx(content: bytes) -> Extent:
    extent = Extent()
    row = row_of_cell = column = 0

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal row, row_of_cell, column
        reference = attributes.get("r", "")
        if name == "row":
            row = int(reference[:20]) if reference.isdecimal() else row + 1
            column = 0
        elif name == "c":
            row_of_cell, column = _row_and_column(reference, row, column + 1)
        elif name in ("v", "is"):  # a cell without a value has a style alone
            extent.include(row_of_cell, column)

    _parse(content, start)
    return extent


def _row_and_column(reference: str, row: int, column: int) -> tuple[int, int]:
    """Row and column of a reference such as AB12; the given ones where it is empty."""
    name = reference.rstrip("0123456789")
    digits = reference[len(name) :][:20]
    if digits:
        row = int(digits)
    if name:
        column = 0
        for letter in name.upper()[:20]:
            column = 26 * column + ord(letter) - ord("A") + 1
    return row, column


def _extents_of_ods(content: bytes) -> list[Extent]:
    """One for each worksheet; rows and cells may be repeated."""
    extents = [Extent()]
    # the number of rows above the current ones and how often these are repeated, and
    # likewise of cells from the left
    above = rows = left = columns = 0

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal above, rows, left, columns
        if name == "table":
            extents.append(Extent())
            above = rows = 0
        elif name == "table-row":
            above += rows
            rows = _repeats(attributes, "table:number-rows-repeated")
            left = columns = 0
        elif name in ("table-cell", "covered-table-cell"):
            left += columns
            columns = _repeats(attributes, "table:number-columns-repeated")
            if _OF_A_VALUE & attributes.keys():
                extents[-1].include(above + rows, left + columns)
        elif name == "p":  # the text of a cell
            extents[-1].include(above + rows, left + columns)

    _parse(content, start)
    return extents


def _repeats(attributes: dict[str, str], name: str) -> int:
    number = attributes.get(name, "")[:20]
    return int(number) if number.isdecimal() else 1


def _extent_of_xlsb(content: bytes) -> Extent:
    """A record is its kind, its length and as many bytes; a row begins with its index,
    and a cell with that of its column, in 4 bytes."""
    extent = Extent()
    row = 0
    offset = 0
    while offset < len(content):
        kind, offset = _number_of_xlsb(content, offset)
        length, offset = _number_of_xlsb(content, offset)
        index = int.from_bytes(content[offset : offset + 4], "little")
        if kind == _XLSB_ROW:
            row = index + 1
        elif kind in _XLSB_CELLS:
            extent.include(row, index + 1)
        offset += length
    return extent


def _number_of_xlsb(content: bytes, offset: int) -> tuple[int, int]:
    """A number in 7 bits of each of at most 4 bytes, and the offset of what follows it.
    The highest bit of a byte says whether another one follows."""
    number = 0
    for position, byte in enumerate(content[offset : offset + 4]):
        number |= (byte & 0x7F) << 7 * position
        if byte < 0x80:
            return number, offset + position + 1
    return number, offset + 4


def _parse(content: bytes, start: Callable[[str, dict[str, str]], None]) -> None:
    """Call `start` at each tag of an XML document, by its name without a prefix. Raises
    `ExpatError` for another document."""
    parser = ParserCreate()
    parser.StartElementHandler = lambda name, attributes: start(
        name.rpartition(":")[2], attributes
    )
    parser.Parse(content, True)
