"""Independent computations in parallel threads, and what the system grants a process.

Python runs in one thread at a time, but XLA compiles, loads and runs
programs concurrently.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

Result = TypeVar("Result")

_MOST_THREADS = 4  # more would only wait for Python
_ADDRESS_SPACE = 1_600_000 * 1024
"""Bytes of addresses that a fit needs: XLA ends it by SIGABRT under a `ulimit -v` of
1,400,000 kB, and it succeeds under 1,600,000 kB."""


def cores() -> int:
    """Processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def in_threads(
    function: Callable[..., Result], arguments: Sequence[tuple[Any, ...]]
) -> Iterator[Iterator[Result]]:
    """The results of a function for each of several arguments, in order.

    Calls not yet begun when the context ends, by an error or by Ctrl-C, are cancelled.
    """
    from concurrent.futures import ThreadPoolExecutor

    pool = ThreadPoolExecutor(min(cores(), _MOST_THREADS))
    try:
        yield pool.map(lambda args: function(*args), arguments)
    finally:
        pool.shutdown(cancel_futures=True)


def require_address_space() -> None:
    """Raise `MemoryError` where `ulimit -v` leaves the process too few addresses: XLA
    would end it by a signal."""
    try:
        import resource
    except ImportError:  # Windows has no such limit
        return
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and limit < _ADDRESS_SPACE:
        raise MemoryError
