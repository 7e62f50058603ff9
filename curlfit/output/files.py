"""Atomic writing of files, and folders that one process writes at a time."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from curlfit.errors import InputError
from curlfit.output.locks import locked

_PREFIX = ".curlfit-"  # of temporary names
_LONGEST_WRITING = 60  # s; no file takes as long
_descriptor_by_folder: dict[Path, int] = {}  # of the folders that this process writes


def atomic_write(file: Path, content: str | bytes, *, private: bool = False) -> None:
    """Write a file, text as UTF-8, under another name beside it first: whole
    or not at all.

    The permissions of the file follow the umask; a `private` one is for its owner only.

    Raises
    ------
    InputError : the folder cannot be written to, or the disk is full.
    """
    temporary = None
    try:
        handle, name = tempfile.mkstemp(
            prefix=_PREFIX, suffix=f"-{file.name}", dir=file.parent
        )
        temporary = Path(name)
        with open(handle, "wb") as stream:
            stream.write(content.encode() if isinstance(content, str) else content)
        if not private:  # as `mkstemp` makes it
            temporary.chmod(0o666 & ~_umask())
        temporary.replace(file)
    except OSError as error:
        raise InputError(
            f"{file}: cannot be written ({error.strerror or error})"
        ) from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def require_replaceable(file: Path, what: str, mark: str) -> None:
    """Raise `InputError` where a file exists that curlfit has not written itself.

    Parameters
    ----------
    what : the kind of file that is to be written, in words.
    mark : a text that each file of this kind contains.
    """
    if file.is_dir():
        raise InputError(f"{file}: this is a folder, expected the name of {what}")
    try:
        text = file.read_text(encoding="utf-8")
    except (FileNotFoundError, NotADirectoryError):
        return
    except (OSError, ValueError):  # not readable, or no text
        text = ""
    if mark not in text:
        raise InputError(
            f"{file}: this file exists and is not {what} that curlfit wrote; "
            "give another name, or delete it"
        )


def _umask() -> int:
    """The permissions that this process withholds from new files."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


def prepare_folder(folder: Path) -> Path:
    """Make a folder if it does not exist, and return it. Raises `InputError` if it
    cannot be written to."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder, prefix=_PREFIX):
            pass
        _remove_stale_files(folder)
    except FileExistsError:
        raise InputError(
            f"{folder}: this is a file, expected a folder for the results"
        ) from None
    except OSError as error:
        raise InputError(
            f"{folder}: the output folder cannot be written ({error.strerror or error})"
        ) from None
    return folder


def claim_folder(folder: Path) -> Path:
    """Prepare a folder and keep other processes from writing to it until this one ends,
    or until `release_folders`. Returns the folder.

    Raises
    ------
    InputError : it cannot be written to, or another process has claimed it.
    """
    path = prepare_folder(folder).resolve()
    if path in _descriptor_by_folder:
        return folder
    try:
        if sys.platform == "win32":  # where no folder can be opened
            flags = os.O_RDWR | os.O_CREAT | os.O_TEMPORARY
            descriptor = os.open(path / f"{_PREFIX}lock", flags)
        else:
            descriptor = os.open(path, os.O_RDONLY)
    except OSError:  # a folder that cannot be opened is written without a lock
        return folder
    if not locked(descriptor):
        os.close(descriptor)
        raise InputError(
            f"{folder}: another `curlfit` is writing its results there; name another "
            "folder with --out, or wait for its end"
        )
    _descriptor_by_folder[path] = descriptor
    return folder


def release_folders() -> None:
    """Let other processes write to the folders that this one has claimed."""
    while _descriptor_by_folder:
        _, descriptor = _descriptor_by_folder.popitem()
        if sys.platform != "win32":  # copies in forked processes may be open
            import fcntl

            with suppress(OSError):
                fcntl.flock(descriptor, fcntl.LOCK_UN)
        os.close(descriptor)


def _remove_stale_files(folder: Path) -> None:
    """Remove temporary files of killed runs."""
    for file in folder.glob(f"{_PREFIX}*"):
        with suppress(OSError):  # a folder, or of another user
            if time.time() - file.stat().st_mtime > _LONGEST_WRITING:
                file.unlink()
