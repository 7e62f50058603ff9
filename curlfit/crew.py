"""Who does the work of a batch: processes on this machine, or the workers of a Dask scheduler.

Throws go out in chunks, and answers come back in the order of the chunks, so that a table is the
same whoever made it.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from curlfit.batch import fit_files
from curlfit.errors import InputError
from curlfit.plan import Plan

Rows = list[dict[str, Any]]
Fitted = Callable[[Iterable[Sequence[str]]], Iterator[Rows]]

_ONE_THREAD = {
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
}
CHUNK = 128
"""Throws that are read and fitted together."""
_AHEAD = 3  # chunks that wait for each worker


@contextmanager
def crew(plan: Plan, *, workers: int | None = None, dask: str | None = None) -> Iterator[Fitted]:
    """A function that fits chunks of files, in order.

    Parameters
    ----------
    workers : processes; by default one for each core.
    dask : address of a scheduler, or "local".

    Raises
    ------
    InputError : Dask is not installed, or its scheduler does not answer.
    """
    if dask is not None:
        with _dask_crew(plan, dask, workers) as fitted:
            yield fitted
        return
    count = workers or os.cpu_count() or 1
    if count == 1:
        yield lambda chunks: (fit_files(chunk, plan) for chunk in chunks)
        return
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    with (
        _settings(_ONE_THREAD),
        ProcessPoolExecutor(count, mp_context=get_context("spawn")) as pool,
    ):
        yield lambda chunks: _in_order(
            lambda chunk: pool.submit(fit_files, chunk, plan), chunks, count * _AHEAD
        )


@contextmanager
def _dask_crew(plan: Plan, address: str, workers: int | None) -> Iterator[Fitted]:
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise InputError("--dask needs Dask: pip install 'curlfit[dask]'") from None
    cluster = None
    try:
        with _settings(_ONE_THREAD):
            if address == "local":
                count = workers or os.cpu_count() or 1
                cluster = LocalCluster(
                    n_workers=count, threads_per_worker=1, dashboard_address=None
                )
            client = Client(cluster or address, timeout="10s")
    except (OSError, ValueError) as error:
        raise InputError(f"--dask {address}: no scheduler answers there ({error})") from None
    try:
        ahead = max(len(client.scheduler_info()["workers"]), 1) * _AHEAD
        # A worker that dies takes its chunk with it; the scheduler gives it to another.
        yield lambda chunks: _in_order(
            lambda chunk: client.submit(fit_files, list(chunk), plan, pure=False, retries=5),
            chunks,
            ahead,
        )
    finally:
        client.close()
        if cluster is not None:
            cluster.close()


def _in_order(
    submit: Callable[[Sequence[str]], Any], chunks: Iterable[Sequence[str]], ahead: int
) -> Iterator[Rows]:
    """Results in the order of the chunks, with no more than `ahead` of them in hand."""
    waiting: deque[Any] = deque()
    for chunk in chunks:
        waiting.append(submit(chunk))
        if len(waiting) >= ahead:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()


@contextmanager
def _settings(values: dict[str, str]) -> Iterator[None]:
    """Environment of processes that are started within."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update({name: value for name, value in values.items() if name not in os.environ})
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
