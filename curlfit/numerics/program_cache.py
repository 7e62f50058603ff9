"""The user's cache folder of compiled programs: whose it is, what it holds
and how much.

Loading a compiled program means running it. The folder is therefore used only if
nobody else may write to it or to the folders above it, and each file begins with the
SHA-256 of its name and the rest: a damaged file, or that of another program, would
crash the process or compute other numbers.
Above `LIMIT` the least recently used files are deleted. Any number of processes may
read, write and delete concurrently: files appear atomically, and a missing one is
compiled again.
"""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path

from curlfit.errors import InputError, warn_once
from curlfit.output.files import atomic_write

LIMIT = 256 * 2**20
"""Bytes above which the least recently used files are deleted."""


@cache
def folder() -> Path | None:
    """The folder, created if missing; None where there is none.

    `CURLFIT_CACHE` names another place, or is `off`.
    """
    try:
        root = _root()
        if root is None:
            return None
        path = root / "programs"
        for directory in (*reversed(path.parents), path):
            if not directory.exists():
                directory.mkdir(mode=0o700, exist_ok=True)
        writable = next((p for p in (path, *path.parents) if _open_to_others(p)), None)
    except (OSError, RuntimeError):  # the latter without a home directory
        return None
    if writable is not None:
        warn_once(
            f"compiled programs are not kept in {root}, since others may write to "
            f"{writable}; let CURLFIT_CACHE name a folder of your own, or be off"
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


def _open_to_others(path: Path) -> bool:
    """Whether anybody but the user and root may change what the folder
    or file holds."""
    if not hasattr(os, "geteuid"):  # Windows, where a user's folders are private
        return False
    status = path.stat()
    if status.st_uid == 0 and status.st_mode & stat.S_ISVTX:
        return False  # as /tmp, where nobody can move the files of others
    writable = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return status.st_uid not in (os.geteuid(), 0) or bool(writable)


def read(file: Path) -> bytes | None:
    """What was written to a file, which is marked as used; None if it is
    missing or damaged."""
    try:
        if _open_to_others(file):
            return None
        content = file.read_bytes()
        os.utime(file)
    except OSError:
        return None
    digest = content[:32]
    program = content[32:]
    return program if _digest(file, program) == digest else None


def _digest(file: Path, content: bytes) -> bytes:
    return sha256(file.name.encode() + content).digest()


def write(file: Path, content: bytes) -> None:
    """Write a file, and make room for it; nothing happens where that is
    not possible."""
    with suppress(InputError, OSError):
        atomic_write(file, _digest(file, content) + content, private=True)
        used = [(path.stat().st_mtime_ns, path) for path in file.parent.iterdir()]
        total = 0
        for _, path in sorted(used, reverse=True):
            total += path.stat().st_size
            if total > LIMIT:
                path.unlink(missing_ok=True)
