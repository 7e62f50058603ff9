"""Entry point of `curlfit` and of `python -m curlfit`."""

from __future__ import annotations

import atexit
import gc
import os
import sys
import threading

_GARBAGE = 300_000  # new objects between searches for garbage; the default, 700, costs time


def run() -> None:
    """Run the command and end the process as soon as all work is done.

    Python would tear down JAX, XLA's programs and matplotlib piece by piece, which takes a tenth of
    the time of a fit.
    """
    # before the imports: of NumPy, whose threads would wait for one another over small matrices,
    # and of objects that live to the end
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.set_threshold(_GARBAGE)
    from curlfit.cli import main

    try:
        main()
        status = 0
    except SystemExit as stop:
        if not isinstance(stop.code, int | None):
            raise
        status = stop.code or 0
    for thread in threading.enumerate():
        if thread is not threading.current_thread() and not thread.daemon:
            thread.join()  # until the program being compiled is stored
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


if __name__ == "__main__":
    run()
