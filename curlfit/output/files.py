"""Atomic writing of files, and JSON records of every schema."""

from __future__ import annotations

import json
import math
import os
import re
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import fields
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

from curlfit.errors import DataError, InputError

_PREFIX = ".curlfit-"  # of temporary names


@contextmanager
def atomic_write(file: Path, *, private: bool = False) -> Iterator[Path]:
    """A temporary path beside `file`, renamed to it when the block ends without error.

    The permissions of the file follow the umask; a `private` one is for its owner only.

    Raises
    ------
    InputError : the folder cannot be written to, or the disk is full.
    """
    temporary = None
    try:
        handle, name = tempfile.mkstemp(prefix=_PREFIX, suffix=f"-{file.name}", dir=file.parent)
        os.close(handle)
        temporary = Path(name)
        yield temporary
        if not private:
            temporary.chmod(0o666 & ~_umask())
        temporary.replace(file)
    except OSError as error:
        raise InputError(f"{file}: cannot be written ({error.strerror or error})") from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def require_replaceable(file: Path, what: str, mark: str) -> None:
    """Raise `InputError` where a file is not one that curlfit itself has written.

    Parameters
    ----------
    what, mark : the kind of file that is to be written, and a text that each of them contains.
    """
    if file.is_dir():
        raise InputError(f"{file}: this is a folder, expected the name of {what}")
    try:
        found = file.read_text(encoding="utf-8")
    except (FileNotFoundError, NotADirectoryError):
        return
    except (OSError, ValueError):
        found = ""
    if mark not in found:
        raise InputError(
            f"{file}: this file exists and is not {what} that curlfit wrote; give another name, or "
            "delete it"
        )


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def prepare_folder(folder: Path) -> Path:
    """Make the folder if it does not exist; `InputError` if it cannot be written to."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder, prefix=_PREFIX):
            pass
        _remove_stale_files(folder)
    except FileExistsError:
        raise InputError(f"{folder}: this is a file, expected a folder for the results") from None
    except OSError as error:
        raise InputError(
            f"{folder}: the output folder cannot be written ({error.strerror or error})"
        ) from None
    return folder


def _remove_stale_files(folder: Path) -> None:
    """Remove temporary files of killed runs; no writing takes as long as a minute."""
    for file in folder.glob(f"{_PREFIX}*"):
        with suppress(OSError):  # a folder, or of another user
            if time.time() - file.stat().st_mtime > 60:
                file.unlink()


Result = TypeVar("Result")

RECORDS = ("fit", "compare", "joint", "predict", "profile", "design")
"""Kinds of saved results; a folder's kind is the name of its JSON file."""


def read_json(file: Path, schema: int) -> dict[str, Any]:
    """Read a record of the given schema written by `write_json`.

    Raises
    ------
    DataError : the file does not exist, is not such a record, or has another schema.
    """
    kind = next((f"{name}.json" for name in RECORDS if name in file.name), "fit.json")
    try:
        record = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise DataError("no such file", file=file) from None
    except OSError as error:
        raise DataError(f"cannot be read ({error.strerror})", file=file) from None
    except ValueError:
        raise DataError(f"this is not JSON; expected a {kind} of curlfit", file=file) from None
    version = record.get("schema") if isinstance(record, dict) else None
    if not isinstance(version, int) or isinstance(version, bool):
        raise DataError(f"this is not a {kind} of curlfit: it names no schema", file=file)
    if version > schema:
        raise DataError(
            f"written by a newer curlfit: schema {version} found, "
            f"this version reads up to {schema}",
            file=file,
        )
    if version < schema:
        raise DataError(f"schema {version} found, which was never written", file=file)
    return record


def load_record(
    file: str | PathLike[str],
    kind: str,
    schema: int,
    build: Callable[[dict[str, Any], Path], Result],
) -> Result:
    """A saved result, from its JSON file or the folder with it.

    Parameters
    ----------
    build : makes the result from the entries of the file and its path.

    Raises
    ------
    DataError : as `read_json`; entries are missing or of a wrong type.
    """
    path = Path(file)
    if path.is_dir():
        path = path / f"{kind}.json"
    entries = read_json(path, schema)
    try:
        return build(entries, path)
    except DataError:  # from a file beside it
        raise
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise DataError(
            f"not a complete {kind}.json of curlfit ({type(error).__name__}: {error})", file=path
        ) from None


def known_fields(record: type, entries: Mapping[str, Any]) -> dict[str, Any]:
    """The entries for which a dataclass has fields; a later version may have written more."""
    names = {item.name for item in fields(record)}
    return {key: value for key, value in entries.items() if key in names}


def write_json(record: dict[str, Any], file: Path) -> None:
    """Write a record atomically, as JSON that any program can read."""
    text = json.dumps(json_safe(record), indent=1, allow_nan=False)
    with atomic_write(file) as temporary:
        temporary.write_text(_compact_series(text) + "\n", encoding="utf-8")


def json_safe(value: Any) -> Any:
    """A value with NaN as null and infinities as text, since JSON has no such numbers."""
    if isinstance(value, dict):
        return {key: json_safe(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_safe(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value


def _compact_series(text: str) -> str:
    """JSON with each list of numbers on one line, which keeps the rest readable."""
    number = r"(?:-?\d[-+.eE\d]*|null)"
    return re.sub(
        rf"\[\s+({number}(?:,\s+{number})*)\s+\]",
        lambda match: "[" + re.sub(r",\s+", ", ", match[1]) + "]",
        text,
    )
