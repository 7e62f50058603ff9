"""`Record`, the base of all results."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar, Self

from curlfit.errors import DataError
from curlfit.output.display import Displayed
from curlfit.records.json_file import read_json, write_json
from curlfit.records.plain import SCHEMA, plain
from curlfit.records.structure import structured


class Record(Displayed):
    """Base of all results: `save` writes one as JSON, `read` reads it.

    Class attributes: `kind`, the name of its file; `marks`, entries that tell it from
    others of this kind; `inner`, names that curlfit itself needs, which `dir` leaves
    out.
    """

    kind: ClassVar[str] = ""
    marks: ClassVar[Mapping[str, str]] = {}
    inner: ClassVar[Collection[str]] = ()

    def __dir__(self) -> list[str]:
        """What a user needs."""
        hidden = {"inner", "kind", "marks", "from_json", "read", "require_consistent"}
        return sorted(set(super().__dir__()) - hidden.union(self.inner))

    def to_json(self) -> dict[str, Any]:
        """The record as it is written; NaN is null, and infinities are text."""
        entries: dict[str, Any] = plain(self)
        return entries

    def summary(self) -> dict[str, Any]:
        """The record as it is written, without its series."""
        entries: dict[str, Any] = plain(self, series=False)
        return entries

    def save(self, file: str | PathLike[str]) -> None:
        """Write the record as JSON, whole or not at all."""
        write_json(self.to_json(), Path(file))

    @classmethod
    def from_json(cls, entries: Mapping[str, Any]) -> Self:
        """The record from the output of `to_json`. Raises `DataError` for
        anything else."""
        record: Self = structured(entries, cls)
        return record

    @classmethod
    def read(cls, file: str | PathLike[str]) -> Self:
        """Read a saved record, or the one in a folder.

        Raises
        ------
        DataError : missing, too large, not a record of this kind, or of
            another version.
        """
        path = Path(file)
        if path.is_dir():
            path = path / f"{cls.kind}.json"
        entries = read_json(path, f"a {cls.kind}.json of curlfit")
        version = entries.get("schema")
        if type(version) is not int:
            raise DataError(
                f"not a {cls.kind}.json of curlfit: it names no schema", file=path
            )
        if version != SCHEMA:
            newer = "a newer" if version > SCHEMA else "no"
            raise DataError(
                f"written by {newer} curlfit: schema {version} found, "
                f"this version reads up to {SCHEMA}",
                file=path,
            )
        try:
            return cls._from_file(entries, path.parent)
        except DataError as error:
            if error.file is not None:  # another one
                raise
            raise DataError(str(error), file=path) from None

    @classmethod
    def _from_file(cls, entries: dict[str, Any], folder: Path) -> Self:
        """The record of a file in a folder."""
        return cls.from_json(entries)

    def require_consistent(self) -> None:
        """Raise `ValueError` where fields of a record that was read contradict
        one another."""
