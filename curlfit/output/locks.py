"""A file that is locked by the process that has it open."""

from __future__ import annotations

import sys
from typing import BinaryIO


def locked(stream: BinaryIO) -> bool:
    """Lock an open file until it is closed, or this process ends; False where another
    process has locked it. On a disk that knows no locks, nothing is locked."""
    try:
        if sys.platform == "win32":
            import msvcrt

            stream.seek(1 << 40)  # of a byte that nobody reads
            msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        pass
    return True
