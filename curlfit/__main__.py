"""Entry point of `curlfit` and of `python -m curlfit`."""

from __future__ import annotations

import atexit
import errno
import gc
import os
import signal
import sys
import threading
import warnings
from contextlib import suppress
from io import BufferedWriter, FileIO, TextIOWrapper
from types import FrameType

_ENDINGS = [
    getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)
]
_ENDS_WITH_INPUT = "CURLFIT_ENDS_WITH_INPUT"  # set by curlfit.app.work
_terminated: list[int] = []
# new objects between searches for garbage; the default, 700, costs time
_GARBAGE = 300_000


def run() -> None:
    """Run the command and end the process as soon as all work is done.

    SIGTERM, and SIGHUP of a terminal that was closed, stop the command as Ctrl-C does,
    with another exit status. Python would tear down JAX, XLA's programs and matplotlib
    piece by piece, which takes a tenth of the time of a fit.
    """
    _import_nothing_from_the_working_folder()
    # before the imports: of NumPy, whose threads would wait for one another over small
    # matrices, and of objects that live to the end
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.set_threshold(_GARBAGE)
    _open_streams()
    if not sys.warnoptions:  # what overflows is told by its result
        warnings.simplefilter("ignore", RuntimeWarning)
    if os.environ.pop(_ENDS_WITH_INPUT, ""):
        threading.Thread(target=_end_with_input, daemon=True).start()
    sys.unraisablehook = _stop_again
    for number in (signal.SIGINT, *_ENDINGS):
        # as of Ctrl-C in the background, or of SIGHUP under nohup
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
    for number in (signal.SIGINT, *_ENDINGS):
        signal.signal(number, signal.SIG_DFL)
    if processes := sys.modules.get("curlfit.numerics.processes"):
        processes.end_workers()
    for thread in threading.enumerate():
        if thread is not threading.current_thread() and not thread.daemon:
            thread.join()  # until the program being compiled is stored
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(128 + _terminated[0] if _terminated else status)


def _import_nothing_from_the_working_folder() -> None:
    """Take the working folder from the path of modules, in this process and in those
    that it starts; what PYTHONPATH names stays, wherever processes are started."""
    sys.path[:] = [folder for folder in sys.path if folder]
    os.environ["PYTHONSAFEPATH"] = "1"
    if "PYTHONPATH" not in os.environ:
        return
    # an empty part, as of "$PYTHONPATH:/folder" where nothing was set, is that folder
    parts = os.environ["PYTHONPATH"].split(os.pathsep)
    named = [os.path.abspath(part) for part in parts if part]
    os.environ["PYTHONPATH"] = os.pathsep.join(named)
    unnamed = os.getcwd()
    if "" in parts and unnamed not in named and unnamed in sys.path:
        sys.path.remove(unnamed)


def _end_with_input() -> None:
    """End at once when the standard input does: the page that started this command
    holds its other end, and is gone."""
    while os.read(0, 1):
        pass
    os._exit(1)


def _stop(number: int, _: FrameType | None) -> None:
    """Stop as by Ctrl-C; at once while JAX is being loaded, which no
    exception may leave."""
    if getattr(
        getattr(sys.modules.get("jax"), "__spec__", None), "_initializing", False
    ):
        with suppress(OSError):  # of a terminal that is gone
            os.write(2, b"curlfit: stopped\n")
        os._exit(128 + number)
    if number in _ENDINGS and not _terminated:
        _terminated.append(number)
    raise KeyboardInterrupt


def _stop_again(dropped: sys.UnraisableHookArgs) -> None:
    """Stop once more where Python dropped the exception of `_stop`: in `__del__`, in a
    callback of a weak reference, where JAX is told of a collection of garbage."""
    if dropped.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(dropped)
        return
    number = _terminated[0] if _terminated else signal.SIGINT
    threading.Timer(0.01, os.kill, (os.getpid(), number)).start()


class _Output(FileIO):
    """An output whose reader, or whose terminal, may go: what remains is dropped, and
    the command does its work."""

    def __init__(self, number: int) -> None:
        super().__init__(number, "w", closefd=False)
        self._lost = {errno.EPIPE, errno.EIO} if self.isatty() else {errno.EPIPE}

    def write(self, text: bytes) -> int:  # type: ignore[override]
        try:
            return super().write(text)
        except OSError as error:
            if error.errno not in self._lost:
                raise
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
        # the console of Windows is no file
        if number and not (sys.platform == "win32" and stream and stream.isatty()):
            output = _Output(number)
            stream = TextIOWrapper(
                BufferedWriter(output),
                stream.encoding if stream else "utf-8",
                line_buffering=number == 2 or output.isatty(),
            )
            setattr(sys, name, stream)
        if number:
            stream.reconfigure(errors="replace")


if __name__ == "__main__":
    run()
