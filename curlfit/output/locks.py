"""A file or folder that is locked by the process that has it open."""

from __future__ import annotations

import os
import sys


def locked(descriptor: int) -> bool:
    """Lock an open file or folder until it is closed, or this process ends; False where
    another process has locked it. On a disk that knows no locks, nothing is locked."""
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(descriptor, 1 << 40, os.SEEK_SET)  # a byte that nobody reads
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:  # the disk knows no locks
        pass
    return True
