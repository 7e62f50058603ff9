"""What is compared of records, tables, printed pages and reports."""

from __future__ import annotations

import csv
import json
import re
from collections import defaultdict
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

NUMBER = re.compile(r"(?<![\w.])[-+]?\d[\d,]*(?:\.\d+)?(?:\(\d+\))?(?:e[-+]?\d+)?")

Table = dict[str, list[str]]
"""Cells of a table by column."""


@dataclass(frozen=True)
class Page:
    """What is compared of a printed page or a report."""

    headings: list[str]
    """and the words in tables, numbers apart"""
    numbers: list[str]


class _ReportParser(HTMLParser):
    """Collect the headings, the cells and the text of a report in HTML."""

    HEADINGS = ("h1", "h2", "h3", "h4", "th", "td", "figcaption")
    HIDDEN = ("script", "style", "svg", "title")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.headings: list[str] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        if tag not in ("img", "br", "meta", "link", "input", "hr", "source", "wbr"):
            self.open.append(tag)
        if tag in self.HEADINGS:
            self.headings.append("")

    def handle_endtag(self, tag: str) -> None:
        while self.open and self.open.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        if any(tag in self.HIDDEN for tag in self.open):
            return
        self.text.append(data)
        if any(tag in self.HEADINGS for tag in self.open):
            self.headings[-1] += data


def html_page(file: Path) -> Page:
    """What a report in HTML shows."""
    parser = _ReportParser()
    parser.feed(file.read_text(encoding="utf-8"))
    headings = [masked(" ".join(text.split())) for text in parser.headings]
    return Page(headings, numbers_in(" ".join(parser.text)))


def text_page(file: Path) -> Page:
    """What a printed page shows: a line of cells, two spaces apart, is of a table."""
    headings = []
    text = file.read_text(encoding="utf-8")
    for line in text.splitlines():
        cells = [cell for cell in re.split(r"\s{2,}|\t|&|\|", line.strip()) if cell]
        if len(cells) > 1:
            headings.append(masked(" | ".join(cells)))
    return Page(headings, numbers_in(text))


def read_json(file: Path) -> Any:
    """What a file of JSON holds."""
    return json.loads(file.read_text(encoding="utf-8"))


def read_table(file: Path) -> Table:
    """A table with a header, below comments."""
    lines = file.read_text(encoding="utf-8").splitlines()
    rows = list(csv.reader(line for line in lines if not line.startswith("#")))
    table = defaultdict(list)
    for row in rows[1:]:
        for column, cell in zip(rows[0], row, strict=True):
            table[column].append(cell)
    return dict(table)


def standard_errors(column: str, table: Table) -> list[float | None] | None:
    """The standard errors beside a column of values; None where there are none."""
    beside = [f"{column}_stderr", f"{column} stderr"]
    if column in ("value", "estimate"):
        beside.append("stderr")
    for name in beside:
        if name in table:
            return [as_number(cell) for cell in table[name]]
    return None


def as_number(cell: str) -> float | None:
    """The number in a cell; None where there is none."""
    try:
        return float(cell)
    except ValueError:
        return None


def parameters_of(expression: str) -> str:
    """The parameters in a weighted sum: "b, omega0" of "b + 0.26 omega0"."""
    return ", ".join(re.findall(r"[A-Za-z]\w*", expression))


def masked(text: str) -> str:
    """A text with its numbers replaced."""
    return NUMBER.sub("#", text)


def numbers_in(text: str) -> list[str]:
    """The numbers of a text, as they are printed."""
    return NUMBER.findall(text)


def printed_number(text: str) -> tuple[float, float]:
    """A printed number and one unit of its last digit: 0.008 and 0.001 of 0.008(2)."""
    digits = re.sub(r"\(\d+\)|,", "", text)
    mantissa, _, exponent = digits.partition("e")
    decimals = len(mantissa.partition(".")[2])
    return float(digits), 10.0 ** (int(exponent or 0) - decimals)
