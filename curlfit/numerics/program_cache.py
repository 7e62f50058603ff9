"""The folder of compiled programs: whose it is, what is read from it, and how large it grows.

To read a compiled program is to run it. So a file counts only where it belongs to the user (or to
root) and nobody else may write to it or to the folders it lies in. Above `LIMIT` the files that
were not used for longest are dropped. Any number of processes may read, write and drop at a time:
files are moved into place whole, and one that has gone is made again.

The place is the user's cache folder; `CURLFIT_CACHE` names another, or switches the cache off with
`off`.
"""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from functools import cache
from pathlib import Path

from curlfit.errors import InputError, warn_once
from curlfit.output.files import atomic_write

LIMIT = 256 * 2**20
"""Bytes above which the files that were not used for longest are dropped."""

PARTS = ("programs", "jax")
"""Folders within the cache: programs of `curlfit.numerics.compiled`, and JAX's own."""

_SWEEP = 1 / 32  # of the limit, written by a process until it looks again at how much there is


@cache
def folder(part: str) -> Path | None:
    """One of the `PARTS`, there to be read and written; None where there is to be no cache."""
    try:
        place = _place()
        if place is None:
            return None
        wanted = place / part
        for missing in [path for path in (*reversed(wanted.parents), wanted) if not path.exists()]:
            missing.mkdir(mode=0o700, exist_ok=True)
        intruded = _open_to_others(wanted)
    except (OSError, RuntimeError):  # the second where there is no home
        return None
    if intruded is not None:
        warn_once(
            f"compiled programs are not kept in {place}, since others may write to {intruded}; "
            "let CURLFIT_CACHE name a folder of your own, or be off"
        )
        return None
    return wanted if os.access(wanted, os.W_OK) else None


def _place() -> Path | None:
    setting = os.environ.get("CURLFIT_CACHE", "")
    if setting.lower() in {"off", "0", "no", "false"}:
        return None
    if setting:
        return Path(setting).expanduser().resolve()
    from platformdirs import user_cache_path

    place = user_cache_path("curlfit", appauthor=False)
    return place.resolve() if place.is_absolute() else None  # "~/.cache" without a home


def _open_to_others(path: Path) -> Path | None:
    """The first of a folder and those above it to which somebody else may write."""
    if not hasattr(os, "geteuid"):  # Windows, where a user's folders are his own
        return None
    for one in (path, *path.parents):
        status = one.stat()
        # Where the sticky bit is set, as for /tmp, nobody moves what is another's.
        if not _private(status) and not (status.st_uid == 0 and status.st_mode & stat.S_ISVTX):
            return one
    return None


def _private(status: os.stat_result) -> bool:
    """Whether the user, or root, owns it, and nobody else may write to it."""
    if not hasattr(os, "geteuid"):
        return True
    return status.st_uid in (os.geteuid(), 0) and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def read(file: Path) -> bytes | None:
    """The content of a file of the cache, which has then been used; None where there is none."""
    try:
        with file.open("rb") as opened:
            if not _private(os.fstat(opened.fileno())):
                warn_once(f"{file} is not read, since others may write to it; it is made again")
                return None
            content = opened.read()
        with suppress(OSError):
            os.utime(file)
    except OSError:
        return None
    return content


def write(file: Path, content: bytes) -> None:
    """Put a file into the cache, whole or not at all."""
    global _written
    with suppress(InputError):
        with atomic_write(file, private=True) as temporary:
            temporary.write_bytes(content)
        _written += len(content)
        if _written > LIMIT * _SWEEP:
            _written = 0
            _sweep(file.parent.parent)


_written: float = float("inf")  # bytes since the last sweep; one comes with the first file


def _sweep(place: Path) -> None:
    """Drop what was not used for longest, down to the limit."""
    found = []
    for part in PARTS:
        with suppress(OSError), os.scandir(place / part) as entries:
            for entry in entries:
                with suppress(OSError):
                    status = entry.stat(follow_symlinks=False)
                    if stat.S_ISREG(status.st_mode):
                        found.append((status.st_mtime_ns, status.st_size, entry.path))
    total = sum(size for _, size, _ in found)
    for _, size, path in sorted(found):
        if total <= LIMIT:
            return
        with suppress(OSError):
            os.unlink(path)
        total -= size
