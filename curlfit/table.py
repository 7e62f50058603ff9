"""A table of results that grows row by row and survives a kill at any moment.

Its first line, a comment, says what was asked for; rows of another plan are never mixed in.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from curlfit.errors import DataError, InputError

_MARK = "# curlfit batch "


class Table:
    """A CSV file with a row for each `file`, opened to be added to.

    Parameters
    ----------
    file : the table. columns : its columns, the first two are `file` and `status`.
    plan : what the rows are made by. again : begin anew.

    Raises
    ------
    InputError : the file holds something else, or rows of another plan, or cannot be written.
    """

    def __init__(
        self, file: Path, columns: Sequence[str], plan: Mapping[str, Any], *, again: bool = False
    ) -> None:
        self.file, self.columns = file, list(columns)
        self.done: set[str] = set()
        self.counts: Counter[str] = Counter()
        head = _MARK + json.dumps(plan, sort_keys=True) + "\n" + _lines([self.columns])
        size = 0
        try:
            if file.exists() and not again:
                size = self._read(head)
            file.parent.mkdir(parents=True, exist_ok=True)
            self.stream = file.open("r+b" if size else "wb")
            self.stream.truncate(size)
            self.stream.seek(size)
            if not size:
                self.stream.write(head.encode())
                self._settle()
        except OSError as error:
            raise InputError(f"{file}: {error.strerror or error}") from None

    def _read(self, head: str) -> int:
        """Take note of whole rows; the length of the file up to the last of them, in bytes."""
        whole = self.file.read_bytes()
        if head.encode().startswith(whole):
            return 0  # killed while it was begun
        if not whole.startswith(_MARK.encode()):
            raise InputError(
                f"{self.file}, line 1: not a table of `curlfit batch`; name another with --out, or "
                "write over it with --again"
            )
        if not whole.startswith(head.encode()):
            raise InputError(
                f"{self.file}, line 1: made with other settings; name another table with --out, or "
                "write over it with --again"
            )
        size = whole.rfind(b"\n") + 1  # what follows was cut off by a kill
        text = whole[len(head.encode()) : size].decode(errors="replace")
        for number, row in enumerate(csv.reader(io.StringIO(text)), start=3):
            if len(row) != len(self.columns):
                raise DataError(
                    f"expected {len(self.columns)} columns", file=self.file, line=number
                )
            self.done.add(row[0])
            self.counts[row[1]] += 1
        return size

    def add(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Write rows, in one piece and to the disk."""
        self.stream.write(_lines([row[name] for name in self.columns] for row in rows).encode())
        self._settle()
        self.counts.update(row["status"] for row in rows)

    def _settle(self) -> None:
        self.stream.flush()
        os.fsync(self.stream.fileno())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stream.close()


def _lines(rows: Iterable[Sequence[Any]]) -> str:
    """Lines of CSV: numbers in full precision, nothing for what is missing, no line breaks."""
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(map(_cell, row) for row in rows)
    return out.getvalue()


def _cell(value: Any) -> Any:
    if isinstance(value, str):
        return " ".join(value.split()) if "\n" in value else value
    return None if isinstance(value, float) and math.isnan(value) else value
