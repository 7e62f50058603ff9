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
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

from curlfit.errors import DataError, InputError
from curlfit.foreign import csv_cell, csv_lines
from curlfit.output.locks import locked
from curlfit.records import plain, read_json, write_json
from curlfit.throws.readers.text import decoded
from curlfit.version import __version__

ODD = "odd"
"""Status of a row of a stopwatch table that contradicts the others and is left out."""
_MAKER = "curlfit batch"
_HEAD = re.compile(r'"?file"?[,;\t].*\bstone_index"?[,;\t].*\bstatus"?[,;\t]')
"""The first line, also of a table that a spreadsheet saved again."""
_LONG = 4096
_OTHERWISE = "name another table with --out, or write over it with --again"


def settings_file(table: Path) -> Path:
    """Where the settings of a table are kept."""
    return table.parent / f"{table.stem}.settings.json"


def is_table_of_batch(file: Path) -> bool:
    """Whether a file begins as a table of `curlfit batch` does."""
    if not file.is_file():  # a pipe can be read once
        return False
    try:
        with file.open("rb") as stream:
            return _HEAD.match(decoded(stream.read(_LONG))) is not None
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
    found = read_json(settings, what)
    plan = found.get("plan")
    if not str(found.get("made_by")).startswith(_MAKER) or not isinstance(plan, dict):
        raise DataError(f"not {what}", file=settings)
    return plan


class Table:
    """A CSV file with one row for each throw, opened for appending.

    Parameters
    ----------
    file : the table. columns : its columns, including `file`, `shot`, `stone_index`
        and `status`.
    plan : settings of the rows. files : data files whose throws the table
        is to contain.
    again : start again.

    Attributes
    ----------
    todo : the files whose rows are not complete. counts : number of rows by status.
    warned : number of usable rows with warnings. odd : what contradicts the other rows
        of stopwatch tables, in words.

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
        self.file, self.columns = file, list(columns)
        self.counts: Counter[str] = Counter()
        self.warned = 0
        self.odd: list[str] = []
        self.settings = settings_file(file)
        head, settings = csv_lines([self.columns]), plain(dict(plan))
        size, done = 0, set[str]()
        try:
            before = (
                plan_of(self.settings, _OTHERWISE) if self.settings.exists() else None
            )
            file.parent.mkdir(parents=True, exist_ok=True)
            with ExitStack() as opened:
                self.stream = opened.enter_context(file.open("ab"))
                if not locked(self.stream.fileno()):
                    raise InputError(
                        f"{file}: another `{_MAKER}` is writing this table; name "
                        "another with --out, or wait for its end"
                    )
                whole = file.read_bytes().decode(errors="surrogateescape")
                # killed while the header was written
                if not (again or head.startswith(whole)):
                    self._require_own(whole, head, before, settings)
                    size, done = self._read(whole, files)
                self.stream.truncate(size)
                if not size:
                    # The table is empty now: a kill cannot leave rows beside
                    # other settings.
                    made_by = f"{_MAKER} {__version__}"
                    write_json({"made_by": made_by, "plan": settings}, self.settings)
                    self.stream.write(head.encode())
                    self._settle()
                opened.pop_all()
        except OSError as error:
            raise InputError(f"{file}: {error.strerror or error}") from None
        self.todo = [name for name in files if csv_cell(name) not in done]

    def _require_own(
        self,
        whole: str,
        head: str,
        before: dict[str, Any] | None,
        settings: dict[str, Any],
    ) -> None:
        """Raise `InputError` for a file that is no table with these settings."""
        fault, recorded = "", before or {}
        other = next(
            (key for key in settings if recorded.get(key) != settings[key]), None
        )
        if not whole.startswith("file,"):
            fault = f", line 1: not a table of `{_MAKER}`"
        elif before is None:
            fault = (
                ": the settings of its rows are unknown, because "
                f"{self.settings} is missing"
            )
        elif other is not None:
            here, now = _shown(recorded.get(other)), _shown(settings[other])
            fault = f": made with other settings ({other} = {here}, not {now})"
        elif not whole.startswith(head):
            fault = ", line 1: other columns than this version of curlfit writes"
        if fault:
            raise InputError(f"{self.file}{fault}; {_OTHERWISE}")

    def _read(self, whole: str, files: Sequence[str]) -> tuple[int, set[str]]:
        """Count complete rows; returns the length of the table up to the last of them,
        in bytes, and the files that are done."""
        lines = whole.split("\n")[:-1]  # what follows was cut off by a kill
        done = []
        for number, row in enumerate(csv.reader(lines[1:]), start=2):
            if len(row) != len(self.columns):
                fault = f"expected {len(self.columns)} columns"
                raise DataError(fault, file=self.file, line=number)
            done.append(dict(zip(self.columns, row, strict=True)))
        # If the last rows are of a file with several throws, others of this file
        # may be missing.
        last = done[-1] if done else {"file": "", "shot": "", "stone_index": ""}
        if (last["shot"] or last["stone_index"]) and last["file"] in map(
            csv_cell, files
        ):
            while done and done[-1]["file"] == last["file"]:
                done.pop()
        self._count(done)
        kept = "".join(f"{line}\n" for line in lines[: len(done) + 1])
        return len(kept.encode(errors="surrogateescape")), {row["file"] for row in done}

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
            self.counts[row["status"]] += 1
            self.warned += row["status"] == "ok" and bool(row["warnings"])
            if row["status"] == ODD:
                self.odd.append(f"{row['file']}: {row['reason']}")

    def _settle(self) -> None:
        self.stream.flush()
        os.fsync(self.stream.fileno())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stream.close()


def _shown(value: Any) -> str:
    return "none" if value in (None, {}) else json.dumps(value)
