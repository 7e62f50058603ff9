"""Execution of a batch by processes on this machine, or by the workers of a
Dask scheduler.

Throws are sent out in chunks and results returned in the order of the chunks, so that a
table does not depend on who computed it.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

from curlfit.batch.settings import CHUNK, BatchSettings
from curlfit.errors import InputError
from curlfit.numerics.threads import cores, require_address_space

Rows = list[dict[str, Any]]
FitInChunks = Callable[[Sequence[str]], Iterator[Rows]]
"""Fits files, and yields the rows of each chunk of them."""

_MEGABYTE = 1 << 20
_WORKER_ENVIRONMENT = {
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    # The C library returns large arrays to the system, which clears each page of the
    # next ones: an eighth of the time. These settings make it keep them (glibc;
    # ignored elsewhere).
    "MALLOC_MMAP_THRESHOLD_": str(32 * _MEGABYTE),
    "MALLOC_TRIM_THRESHOLD_": str(256 * _MEGABYTE),
    "MALLOC_TOP_PAD_": str(64 * _MEGABYTE),
}
_SMALLEST_CHUNK = 64  # throws not worth dividing between two processes
_SAMPLED_CHUNK = 16  # throws, if each is sampled, which takes seconds


@contextmanager
def executor(
    plan: BatchSettings, *, workers: int | None = None, dask: str | None = None
) -> Iterator[FitInChunks]:
    """A function that fits files and yields rows in their order, chunk by chunk.

    Parameters
    ----------
    workers : processes; by default one for each core.
    dask : address of a scheduler.

    Raises
    ------
    InputError : Dask is not installed, or its scheduler does not answer.
    BrokenExecutor : a process was killed.
    """
    if dask is not None:
        with _dask_executor(plan, dask) as fit_in_chunks:
            yield fit_in_chunks
        return
    require_address_space()
    count = workers or cores()
    fit = partial(_fit, plan=plan)
    if count == 1:
        yield lambda files: map(fit, _chunks(files, plan, 1))
        return
    from curlfit.numerics.processes import end_workers, worker_processes

    for name, value in _WORKER_ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    with worker_processes(count) as pool:
        try:
            submit = partial(pool.submit, fit)
            yield lambda files: _in_order(submit, _chunks(files, plan, count))
        except BaseException:  # Ctrl-C among them: what they are at is not waited for
            end_workers()
            raise


@contextmanager
def _dask_executor(plan: BatchSettings, address: str) -> Iterator[FitInChunks]:
    """A function that fits files by the workers of a scheduler."""
    try:
        from distributed import Client
    except ImportError:
        raise InputError("--dask needs Dask: pip install 'curlfit[dask]'") from None
    try:
        client = Client(address, timeout="10s")
    except (OSError, ValueError) as error:
        raise InputError(
            f"--dask {address}: no scheduler answers there ({error})"
        ) from None
    try:
        workers = max(len(client.scheduler_info()["workers"]), 1)
        # If a worker dies, the scheduler gives its chunk to another one.
        submit = partial(client.submit, partial(_fit, plan=plan), pure=False, retries=5)
        yield lambda files: _in_order(submit, _chunks(files, plan, workers))
    finally:
        client.close()


def _fit(files: Sequence[str], plan: BatchSettings) -> Rows:
    from curlfit.batch.fit_many import fit_files  # loads JAX, which only workers need

    return fit_files(files, plan)


def _chunks(
    files: Sequence[str], plan: BatchSettings, workers: int
) -> Iterator[Sequence[str]]:
    """The files in chunks, equally many for each worker."""
    largest = _SAMPLED_CHUNK if plan.posterior else CHUNK
    chunks_of_worker = math.ceil(len(files) / (largest * workers))
    size = math.ceil(len(files) / max(chunks_of_worker * workers, 1))
    size = max(size, min(largest, _SMALLEST_CHUNK))
    return (files[first : first + size] for first in range(0, len(files), size))


def _in_order(
    submit: Callable[[Sequence[str]], Any], chunks: Iterator[Sequence[str]]
) -> Iterator[Rows]:
    """Results in the order of the chunks, all of which are submitted at once."""
    futures = [submit(chunk) for chunk in chunks]
    return (future.result() for future in futures)
