"""Writing files so that a reader never meets half of one."""

from __future__ import annotations

import json
import math
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from curlfit.errors import InputError


@contextmanager
def replaced(file: Path) -> Iterator[Path]:
    """A temporary path beside `file`; moved into its place when the block ends without error.

    Raises
    ------
    InputError : the folder cannot be written to, or the disk is full.
    """
    temporary = None
    try:
        handle, name = tempfile.mkstemp(
            prefix=f".{file.name}.", suffix=file.suffix, dir=file.parent
        )
        os.close(handle)
        temporary = Path(name)
        yield temporary
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(file)
    except OSError as error:
        raise InputError(f"{file}: cannot be written ({error.strerror or error})") from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def prepared_folder(folder: Path) -> Path:
    """Make the folder if need be and see that it can be written to. Raises `InputError`."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder, prefix=".curlfit-"):
            pass
    except FileExistsError:
        raise InputError(f"{folder}: this is a file, expected a folder for the results") from None
    except OSError as error:
        raise InputError(
            f"{folder}: the output folder cannot be written ({error.strerror or error})"
        ) from None
    return folder


def write_json(record: dict[str, Any], file: Path) -> None:
    """Write a record as JSON that any program can read, whole or not at all."""
    text = json.dumps(strict(record), indent=1, allow_nan=False)
    with replaced(file) as temporary:
        temporary.write_text(_compact_series(text) + "\n")


def strict(value: Any) -> Any:
    """The same with NaN as null and infinities as text, which JSON has no numbers for."""
    if isinstance(value, dict):
        return {key: strict(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [strict(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value


def _compact_series(text: str) -> str:
    """Lists of numbers on one line each, so that a person can read the rest."""
    number = r"(?:-?\d[-+.eE\d]*|null)"
    return re.sub(
        rf"\[\s+({number}(?:,\s+{number})*)\s+\]",
        lambda found: "[" + re.sub(r",\s+", ", ", found[1]) + "]",
        text,
    )
