"""Programs that the same command needed last time, loaded while this one is still starting.

XLA loads a program outside Python, so that loading takes no time where a core is free. Which
programs a command needs is known only when it needs them, so a list of those of its last run is
stored beside them.
"""

from __future__ import annotations

import atexit
import hashlib
import pickle
import threading
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from jax.experimental.serialize_executable import deserialize_and_load

from curlfit.numerics import program_cache as cache
from curlfit.numerics.threads import cores

_MOST = 8  # programs that are read ahead


def deserialized(content: bytes) -> tuple[Any, bytes]:
    """A program of arrays, and the structure of its result, from the content of its file."""
    if b"lapack" in content:  # a tenth of a second to load
        from jaxlib import lapack

        lapack.prepare_lapack_call("geqrf_ffi", np.dtype(float))
    serialized, structure = pickle.loads(content)
    return deserialize_and_load(*serialized), structure


class ReadAhead:
    """The programs of the command named by `program_cache.command`; none if it is empty."""

    def __init__(self) -> None:
        folder = cache.folder("programs")
        if not cache.command or folder is None or cores() < 2:
            self.list: Path | None = None
            return
        self.list = folder / f"{hashlib.sha256(cache.command.encode()).hexdigest()}.list"
        self.noted: list[str] = []
        self.expected = (cache.read(self.list) or b"").decode(errors="replace").split()
        self.programs: dict[str, Future[Any]] = {name: Future() for name in self.expected}
        atexit.register(self._write)
        if self.expected:
            todo = [(folder / name, program) for name, program in self.programs.items()]
            threading.Thread(target=self._load_all, args=(todo,)).start()

    def _load_all(self, todo: list[tuple[Path, Future[Any]]]) -> None:
        for file, program in todo:
            if not threading.main_thread().is_alive():
                return
            if program.set_running_or_notify_cancel():
                try:
                    content = cache.read(file)
                    program.set_result(None if content is None else deserialized(content))
                except Exception:  # a damaged file is detected where it is needed
                    program.set_result(None)

    def taken(self, file: Path) -> Any:
        """Hand over a program that was read ahead, once; None for any other."""
        program = None if self.list is None else self.programs.pop(file.name, None)
        return None if program is None or program.cancel() else program.result()

    def note(self, file: Path) -> None:
        """Note that a program was needed."""
        if self.list is not None and file.name not in self.noted:
            self.noted.append(file.name)

    def _write(self) -> None:
        names = self.noted[:_MOST]
        if self.list is not None and names and names != self.expected:
            with suppress(Exception):
                cache.write(self.list, "\n".join(names).encode())


AHEAD = ReadAhead()
