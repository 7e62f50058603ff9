"""The folder of compiled programs: its owner, access to it and its size.

Loading a compiled program means running it. A file is therefore read only if it belongs to the user
(or to root) and nobody else may write to it or to the folders above it. Above `LIMIT` the least
recently used files are deleted. Any number of processes may read, write and delete concurrently:
files appear atomically, and a missing one is compiled again.

The folder is the user's cache folder; `CURLFIT_CACHE` names another, or disables the cache if it is
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
"""Bytes above which the least recently used files are deleted."""

PARTS = ("programs", "jax")
"""Folders within the cache: programs of `curlfit.numerics.compiled`, and JAX's own."""

command = ""
"""The command whose programs are read ahead, without what differs from one throw to the next."""

_CHECK_INTERVAL = 1 / 32  # of the limit, written by a process between two checks of the size


@cache
def folder(part: str) -> Path | None:
    """The folder of one of the `PARTS`, created if missing; None where there is no cache."""
    try:
        root = _root()
        if root is None:
            return None
        path = root / part
        for missing in [p for p in (*reversed(path.parents), path) if not p.exists()]:
            missing.mkdir(mode=0o700, exist_ok=True)
        writable = _writable_by_others(path)
    except (OSError, RuntimeError):  # the latter without a home directory
        return None
    if writable is not None:
        warn_once(
            f"compiled programs are not kept in {root}, since others may write to {writable}; "
            "let CURLFIT_CACHE name a folder of your own, or be off"
        )
        return None
    return path if os.access(path, os.W_OK) else None


def _root() -> Path | None:
    setting = os.environ.get("CURLFIT_CACHE", "")
    if setting.lower() in {"off", "0", "no", "false"}:
        return None
    if setting:
        return Path(setting).expanduser().resolve()
    from platformdirs import user_cache_path

    root = user_cache_path("curlfit", appauthor=False)
    return root.resolve() if root.is_absolute() else None  # "~/.cache" without a home


def _writable_by_others(path: Path) -> Path | None:
    """The first of a folder and its parents to which somebody else may write."""
    if not hasattr(os, "geteuid"):  # Windows, where a user's folders are private
        return None
    for directory in (path, *path.parents):
        status = directory.stat()
        # With the sticky bit, as in /tmp, nobody can move the files of others.
        if not _private(status) and not (status.st_uid == 0 and status.st_mode & stat.S_ISVTX):
            return directory
    return None


def _private(status: os.stat_result) -> bool:
    """Whether the user or root owns the file, and nobody else may write to it."""
    if not hasattr(os, "geteuid"):
        return True
    return status.st_uid in (os.geteuid(), 0) and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def read(file: Path) -> bytes | None:
    """The content of a file, which is marked as used; None if it cannot be read safely."""
    try:
        with file.open("rb") as opened:
            if not _private(os.fstat(opened.fileno())):
                warn_once(f"{file} is not read, since others may write to it; it is compiled again")
                return None
            content = opened.read()
        with suppress(OSError):
            os.utime(file)
    except OSError:
        return None
    return content


def write(file: Path, content: bytes) -> None:
    """Write a file of the cache atomically."""
    global _written
    with suppress(InputError):
        with atomic_write(file, private=True) as temporary:
            temporary.write_bytes(content)
        _written += len(content)
        if _written > LIMIT * _CHECK_INTERVAL:
            _written = 0
            _evict(file.parent.parent)


_written: float = float("inf")  # bytes since the last check; the first file triggers one


def _evict(root: Path) -> None:
    """Delete the least recently used files, down to the limit."""
    files = []
    for part in PARTS:
        with suppress(OSError), os.scandir(root / part) as entries:
            for entry in entries:
                with suppress(OSError):
                    status = entry.stat(follow_symlinks=False)
                    if stat.S_ISREG(status.st_mode):
                        files.append((status.st_mtime_ns, status.st_size, entry.path))
    total = sum(size for _, size, _ in files)
    for _, size, path in sorted(files):
        if total <= LIMIT:
            return
        with suppress(OSError):
            os.unlink(path)
        total -= size
