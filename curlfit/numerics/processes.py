"""Processes that work for this one, and end with it."""

from __future__ import annotations

import gc
import os
import signal
import threading
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing import active_children, get_context, parent_process
from typing import Any


class _Pool(ProcessPoolExecutor):
    def submit(self, *task: Any, **options: Any) -> Future[Any]:
        hold = getattr(signal, "pthread_sigmask", lambda *_: None)  # Windows has none
        # in a process that this may start, for good
        hold(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return super().submit(*task, **options)
        finally:
            hold(signal.SIG_UNBLOCK, {signal.SIGINT})


def worker_processes(count: int) -> ProcessPoolExecutor:
    """A pool of processes that leave Ctrl-C to this one and end when it ends,
    even if killed.

    Python starts them with `-c`, which would put the working folder first on their path
    of modules until they have that of this process: a file of data named `signal.py`
    would run there.
    """
    os.environ["PYTHONSAFEPATH"] = "1"
    # Python's own process that clears up after a kill does so without a word.
    os.environ.setdefault("PYTHONWARNINGS", "ignore:resource_tracker")
    return _Pool(
        count, get_context("spawn"), initializer=_begin, initargs=gc.get_threshold()
    )


def end_workers() -> None:
    """End the processes of all pools; what they have not finished is lost."""
    for process in active_children():
        process.kill()


def _begin(*garbage: int) -> None:
    gc.set_threshold(*garbage)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "SIGHUP"):  # of a terminal that was closed
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
