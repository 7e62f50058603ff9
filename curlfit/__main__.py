"""Entry point of `curlfit` and of `python -m curlfit`."""

from __future__ import annotations

import atexit
import gc
import os
import signal
import sys
import threading
import warnings
from io import BufferedWriter, FileIO, TextIOWrapper
from types import FrameType

_terminated: list[int] = []
# new objects between searches for garbage; the default, 700, costs time
_GARBAGE = 300_000


def run() -> None:
    """Run the command and end the process as soon as all work is done.

    SIGTERM stops the command as Ctrl-C does, with another exit status. Python would
    tear down JAX, XLA's programs and matplotlib piece by piece, which takes a tenth of
    the time of a fit.
    """
    # before the imports: of NumPy, whose threads would wait for one another over small
    # matrices, and of objects that live to the end
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.set_threshold(_GARBAGE)
    _open_streams()
    if not sys.warnoptions:  # what overflows is told by its result
        warnings.simplefilter("ignore", RuntimeWarning)
    for number in (signal.SIGINT, signal.SIGTERM):
        # as of Ctrl-C in the background
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _stop)
    from curlfit.cli import main

    try:
        main()
        status = 0
    except SystemExit as ended:
        if not isinstance(ended.code, int | None):
            raise
        status = ended.code or 0
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    if processes := sys.modules.get("curlfit.numerics.processes"):
        processes.end_workers()
    for thread in threading.enumerate():
        if thread is not threading.current_thread() and not thread.daemon:
            thread.join()  # until the program being compiled is stored
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(128 + signal.SIGTERM if _terminated else status)


def _stop(number: int, frame: FrameType | None) -> None:
    """Stop as by Ctrl-C; at once while JAX is being loaded, which no
    exception may leave."""
    if getattr(
        getattr(sys.modules.get("jax"), "__spec__", None), "_initializing", False
    ):
        os.write(2, b"curlfit: stopped\n")
        os._exit(128 + number)
    if number == signal.SIGTERM and number not in _terminated:
        _terminated.append(number)
    if _is_callback_of_garbage(frame):  # where Python drops exceptions
        threading.Timer(0.01, os.kill, (os.getpid(), number)).start()
        return
    raise KeyboardInterrupt


def _is_callback_of_garbage(frame: FrameType | None) -> bool:
    """Whether JAX is told of a collection of garbage."""
    while frame is not None and frame.f_code.co_name != "_xla_gc_callback":
        frame = frame.f_back
    return frame is not None


class _Pipe(FileIO):
    """An output whose reader may go: what remains is dropped, and the command
    does its work."""

    def write(self, text: bytes) -> int:  # type: ignore[override]
        try:
            return super().write(text)
        except BrokenPipeError:
            return len(text)


def _open_streams() -> None:
    """Standard streams to which anything can be written.

    A closed one, as by `>&-`, is the null device: its number must not become that of a
    file. Characters that the encoding of an output lacks become question marks.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        stream = getattr(sys, name)
        if stream is None:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
        if number and not (stream and stream.isatty()):
            raw = _Pipe(number, "w", closefd=False)
            encoding = stream.encoding if stream else "utf-8"
            stream = TextIOWrapper(
                BufferedWriter(raw), encoding, line_buffering=number == 2
            )
            setattr(sys, name, stream)
        if number:
            stream.reconfigure(errors="replace")


if __name__ == "__main__":
    run()
