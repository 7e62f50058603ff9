"""The temporary folder of the page."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir

from curlfit.output.locks import locked

_SUFFIX = "-curlfit-app"
_LOCK = "in-use"  # locked while the page is there


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """A folder of the user alone, that goes with this process: at its end or, if it was
    killed, when the next page is opened."""
    _remove_those_left()
    with (
        TemporaryDirectory(_SUFFIX, ignore_cleanup_errors=True) as name,
        (Path(name) / f"{_LOCK}-soon").open("wb") as stream,
    ):
        locked(stream.fileno())
        # another page that begins now finds the lock only once it is held
        folder = Path(name)
        (folder / f"{_LOCK}-soon").rename(folder / _LOCK)
        yield folder


def _remove_those_left() -> None:
    """Remove the folders of pages that were killed."""
    for folder in Path(gettempdir()).glob(f"*{_SUFFIX}"):
        if folder.is_symlink() or not _is_of_user(folder):
            continue
        try:
            with (folder / _LOCK).open("rb+") as stream:
                is_left = locked(stream.fileno())
        except OSError:
            continue
        if is_left:
            shutil.rmtree(folder, ignore_errors=True)


def _is_of_user(folder: Path) -> bool:
    """Whether a folder is there and belongs to the user of this process."""
    if not hasattr(os, "geteuid"):  # Windows, where the temporary folder is private
        return True
    try:
        return folder.lstat().st_uid == os.geteuid()
    except OSError:
        return False
