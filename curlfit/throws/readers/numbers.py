"""Numbers as people and spreadsheets write them."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import NamedTuple

from curlfit.throws.readers.cells import is_gap

_GROUPED = re.compile(
    r"[-+]?\d{1,3}(?P<mark>[.,'\u2019\s])\d{3}(?:(?P=mark)\d{3})*(?:[.,]\d+)?"
)


class Thousands(NamedTuple):
    """A mark between the thousands of numbers, and the first number that has it."""

    mark: str
    example: str


def parse_number(cell: str, *, decimal_comma: bool = True) -> float | None:
    """A cell as a number; None if it is not one."""
    if "_" in cell:
        return None
    try:
        return float(cell)
    except ValueError:
        pass
    if not decimal_comma or "," not in cell or "." in cell:
        return None
    try:
        return float(cell.replace(",", "."))
    except ValueError:
        return None


def is_number(cell: str) -> bool:
    """Whether a cell is a number, with a decimal point or a decimal comma."""
    return parse_number(cell) is not None


def is_grouped(cell: str) -> bool:
    """Whether a cell is a number with its thousands apart."""
    return _GROUPED.fullmatch(cell) is not None


def without_groups(cell: str, mark: str) -> str:
    """A number with a decimal point and without the marks that separate its thousands;
    none where such a mark is anywhere else."""
    grouped = _GROUPED.fullmatch(cell)
    if mark in cell and (grouped is None or grouped["mark"] != mark):
        return "?"
    return cell.replace(mark, "").replace(",", ".")


def thousands_that_bar(
    columns: Sequence[Sequence[str]], *, decimal_comma: bool
) -> Thousands | None:
    """The mark between thousands in a cell that is no number otherwise, such as
    `1.085,3`; None where there is none.

    Parameters
    ----------
    decimal_comma : whether a comma may be that of decimals.
    """
    for column in columns:
        for cell in column:
            grouped = _GROUPED.fullmatch(cell)
            if grouped and parse_number(cell, decimal_comma=decimal_comma) is None:
                return Thousands(grouped["mark"], cell)
    return None


def thousands_of_whole_numbers(cells: Sequence[str]) -> Thousands | None:
    """The mark between thousands in a column of whole numbers, such as `1,085` below
    985; None for another column. Numbers with three decimals are known by this: none
    of the others is a whole number of three digits."""
    marked = None
    has_three_digits = False
    for cell in cells:
        digits = cell.lstrip("-+")
        if digits.isdigit():
            if len(digits) > 3:
                return None
            has_three_digits |= len(digits) == 3
        elif match := _GROUPED.fullmatch(cell):
            if digits[0] == "0" or not digits.replace(match["mark"], "").isdigit():
                return None
            marked = marked or Thousands(match["mark"], cell)
        elif not is_gap(cell):
            return None
    return marked if has_three_digits else None


def numbers_in(
    cells: Sequence[str], mark: str = "", *, decimal_comma: bool = True
) -> list[float | None]:
    """The numbers in a column: NaN for gaps, None for what is no finite number.

    Parameters
    ----------
    mark : between thousands; none, if empty.
    """
    values: list[float | None] = []
    for cell in cells:
        text = without_groups(cell, mark) if mark and not is_gap(cell) else cell
        value = parse_number(text, decimal_comma=decimal_comma)
        if value is None or not math.isfinite(value):
            value = math.nan if is_gap(cell) else None
        values.append(value)
    return values
