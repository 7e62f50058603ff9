"""Writing files so that a reader never meets half of one."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

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
