"""A table of results that grows row by row and survives being killed at any moment.

It is plain CSV. The settings of its rows are in a file beside it
(`season.settings.json` for `season.csv`); rows with other settings are never mixed in.
"""

from __future__ import annotations

import csv
import json
import os
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Any, Self

from curlfit.errors import DataError, InputError
from curlfit.foreign import csv_cell, csv_lines
from curlfit.output.locks import locked
from curlfit.records import plain, read_json, write_json
from curlfit.throws.readers.text import decoded
from curlfit.version import __version__

_MAKER = "curlfit batch"
_HEADER = re.compile(r'"?file"?[,;\t].*\bstone_index"?[,;\t].*\bstatus"?[,;\t]')
"""The first line, also of a table that a spreadsheet saved again."""
_LONGEST_HEADER = 4096  # bytes that are searched for it
_OTHERWISE = "name another table with --out, or write over it with --again"


class Status(StrEnum):
    """What became of a throw of a batch."""

    OK = "ok"
    ODD = "odd"
    """a row of a stopwatch table that contradicts the others and is left out"""
    NOT_USABLE = "not usable"
    """read, without a fit that can be used"""
    FAILED = "failed"
    """not read"""


def settings_file(table: Path) -> Path:
    """Where the settings of a table are kept."""
    return table.parent / f"{table.stem}.settings.json"


def is_table_of_batch(file: Path) -> bool:
    """Whether a file begins as a table of `curlfit batch` does."""
    if not file.is_file():  # a pipe can be read once
        return False
    try:
        with file.open("rb") as stream:
            return _HEADER.match(decoded(stream.read(_LONGEST_HEADER))) is not None
    except OSError:
        return False


def plan_of(settings: Path, otherwise: str) -> dict[str, Any]:
    """The recorded settings of a table's rows; `otherwise` says what to do
    without them.

    Raises
    ------
    DataError : they are not those of a table.
    """
    what = f"the settings of a table of `{_MAKER}`; {otherwise}"
    content = read_json(settings, what)
    plan = content.get("plan")
    if not str(content.get("made_by")).startswith(_MAKER) or not isinstance(plan, dict):
        raise DataError(f"not {what}", file=settings)
    return plan


class GrowingTable:
    """A CSV file with one row for each throw, opened for appending.

    Parameters
    ----------
    file : the table.
    columns : names of its columns, `file`, `shot`, `stone_index` and `status` among
        them.
    plan : settings of the rows.
    files : data files whose throws the table is to contain.
    again : start again.

    Attributes
    ----------
    todo : the files whose rows are not complete.
    counts : number of rows by status.
    warned : number of usable rows with warnings.
    odd : what contradicts the other rows of stopwatch tables, in words.

    Raises
    ------
    InputError : the file is something else, has rows of another plan, or
        cannot be written.
    """

    def __init__(
        self,
        file: Path,
        columns: Sequence[str],
        plan: Mapping[str, Any],
        files: Sequence[str],
        *,
        again: bool = False,
    ) -> None:
        self.file = file
        self.columns = list(columns)
        self.counts: Counter[str] = Counter()
        self.warned = 0
        self.odd: list[str] = []
        self.settings = settings_file(file)
        try:
            recorded = None
            if self.settings.exists():
                recorded = plan_of(self.settings, _OTHERWISE)
            file.parent.mkdir(parents=True, exist_ok=True)
            self.stream = file.open("ab")
            try:
                done = self._continue_or_begin(
                    plain(dict(plan)), recorded, files, again=again
                )
            except BaseException:
                self.stream.close()
                raise
        except OSError as error:
            raise InputError(f"{file}: {error.strerror or error}") from None
        self.todo = [name for name in files if csv_cell(name) not in done]

    def _continue_or_begin(
        self,
        settings: dict[str, Any],
        recorded: dict[str, Any] | None,
        files: Sequence[str],
        *,
        again: bool,
    ) -> set[str]:
        """Read the complete rows of the table and cut off what follows, or begin it
        anew; returns the files that are done."""
        if not locked(self.stream.fileno()):
            raise InputError(
                f"{self.file}: another `{_MAKER}` is writing this table; name "
                "another with --out, or wait for its end"
            )
        header = csv_lines([self.columns])
        text = self.file.read_bytes().decode(errors="surrogateescape")
        # a kill while the header was written leaves a part of it
        if not again and not header.startswith(text):
            self._require_own(text, header, recorded, settings)
            size, done = self._read_complete_rows(text, files)
            self.stream.truncate(size)
            if size:
                return done
        self.stream.truncate(0)
        # The table is empty now: a kill cannot leave rows beside other settings.
        made_by = f"{_MAKER} {__version__}"
        write_json({"made_by": made_by, "plan": settings}, self.settings)
        self.stream.write(header.encode())
        self._settle()
        return set()

    def _require_own(
        self,
        text: str,
        header: str,
        recorded: dict[str, Any] | None,
        settings: dict[str, Any],
    ) -> None:
        """Raise `InputError` for a file that is no table with these settings; None are
        recorded where the file of the settings is missing."""
        if not text.startswith("file,"):
            fault = f", line 1: not a table of `{_MAKER}`"
        elif recorded is None:
            fault = (
                ": the settings of its rows are unknown, because "
                f"{self.settings} is missing"
            )
        else:
            fault = _change(recorded, settings)
            if not fault and not text.startswith(header):
                fault = ", line 1: other columns than this version of curlfit writes"
        if fault:
            raise InputError(f"{self.file}{fault}; {_OTHERWISE}")

    def _read_complete_rows(
        self, text: str, files: Sequence[str]
    ) -> tuple[int, set[str]]:
        """Read the rows of files that are done and count them; returns the length of
        the table up to the last of them, in bytes, and these files."""
        lines = text.split("\n")[:-1]  # what follows was cut off by a kill
        rows = []
        for number, cells in enumerate(csv.reader(lines[1:]), start=2):
            if len(cells) != len(self.columns):
                fault = f"expected {len(self.columns)} columns"
                raise DataError(fault, file=self.file, line=number)
            rows.append(dict(zip(self.columns, cells, strict=True)))
        if rows:
            last = rows[-1]
            # of a file with several throws others may be missing
            is_one_of_several = bool(last["shot"] or last["stone_index"])
            if is_one_of_several and last["file"] in map(csv_cell, files):
                while rows and rows[-1]["file"] == last["file"]:
                    rows.pop()
        self._count(rows)
        kept_text = "".join(f"{line}\n" for line in lines[: len(rows) + 1])
        size = len(kept_text.encode(errors="surrogateescape"))
        return size, {row["file"] for row in rows}

    def add(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Write rows in one piece and flush them to the disk. Raises `InputError` where
        it is full."""
        text = csv_lines([row[name] for name in self.columns] for row in rows)
        try:
            self.stream.write(text.encode())
            self._settle()
        except OSError as error:
            fault = f"cannot be written ({error.strerror or error})"
            raise InputError(f"{self.file}: {fault}") from None
        self._count(rows)

    def _count(self, rows: Iterable[Mapping[str, Any]]) -> None:
        for row in rows:
            status = row["status"]
            self.counts[status] += 1
            if status == Status.OK and row["warnings"]:
                self.warned += 1
            if status == Status.ODD:
                self.odd.append(f"{row['file']}: {row['reason']}")

    def _settle(self) -> None:
        """Write to the disk what is in memory."""
        self.stream.flush()
        os.fsync(self.stream.fileno())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stream.close()


def _change(recorded: Mapping[str, Any], settings: Mapping[str, Any]) -> str:
    """The first setting that is not as recorded, in words; empty where all are."""
    for key, value in settings.items():
        if recorded.get(key) == value:
            continue
        if key not in recorded:
            return f": made by an earlier version, whose settings have no {key}"
        before = _setting_in_words(recorded[key])
        now = _setting_in_words(value)
        return f": made with other settings ({key} = {before}, not {now})"
    return ""


def _setting_in_words(value: Any) -> str:
    return "none" if value in (None, {}) else json.dumps(value)
