"""The page on a port of this computer, for its user alone."""

from __future__ import annotations

import signal
import socket
import sys
import webbrowser
from collections.abc import Callable
from contextlib import chdir, suppress
from pathlib import Path

from cyclopts import App

from curlfit.app.folder import temporary_folder
from curlfit.app.guard import Guard
from curlfit.errors import InputError
from curlfit.foreign import say
from curlfit.output.files import atomic_write

_HOST = "127.0.0.1"
_RECONNECT = 60.0
"""Seconds after which a browser that does not answer has gone. Within NiceGUI's 3 s, a
browser beside fits on all processors may not answer, and then loads the page anew,
which loses a file on its way."""
_OPENING = (
    '<!doctype html><meta charset="utf-8"><title>curlfit</title>'
    '<meta name="referrer" content="no-referrer">'
    '<meta http-equiv="refresh" content="0;url={address}">'
)


def serve(cli: App, port: int, *, browser: bool) -> None:
    """Show the page until Ctrl-C.

    Raises
    ------
    InputError : NiceGUI is not installed, or the port is taken.
    """
    try:
        import nicegui  # noqa: F401
    except ImportError:
        raise InputError("the page needs NiceGUI: pip install 'curlfit[app]'") from None
    try:
        listening = socket.create_server((_HOST, port))
    except OSError as error:
        raise InputError(
            f"--port {port}: {error.strerror or error}; give another"
        ) from None
    start = Path.cwd()
    port = listening.getsockname()[1]

    def opened() -> None:
        say(f"The page was opened; for another window: {guard.new_address()}")
        sys.stdout.flush()

    guard = Guard(_HOST, port, opened)
    with listening, temporary_folder() as folder:
        files = folder / "files"
        files.mkdir()
        with chdir(files):
            run = _server(cli, start, files, guard)
            say(f"The page is at {guard.new_address()} (Ctrl-C ends it)")
            sys.stdout.flush()
            if browser:
                _open(folder / "curlfit.html", guard.new_address())
            with suppress(KeyboardInterrupt):
                run(sockets=[listening])
    say("The page is closed.")


def _open(file: Path, address: str) -> None:
    """Open the browser at an address by way of a file of the user alone, since others
    on this computer see with what a browser is started."""
    atomic_write(file, _OPENING.format(address=address), private=True)
    webbrowser.open(file.as_uri())


def _server(cli: App, start: Path, folder: Path, guard: Guard) -> Callable[..., None]:
    """A function that serves the page on sockets until it is told to end: results are
    saved in `start`, and `folder` holds what was dropped and written."""
    import uvicorn
    from fastapi import FastAPI
    from nicegui import app, ui

    from curlfit.app.page import MOST_BYTES, Page

    page = Page(cli, start, folder)
    ui.page("/", title="curlfit")(page.build)
    app.add_static_files("/results", folder, max_cache_age=0)
    app.on_exception(page.fail)
    app.on_shutdown(page.close)
    outer = FastAPI(openapi_url=None)
    ui.run_with(
        outer,
        mount_path=guard.path,
        dark=None,
        tailwind=False,
        language="en-US",
        reconnect_timeout=_RECONNECT,
    )
    config = uvicorn.Config(
        guard.around(outer, MOST_BYTES), log_level="error", timeout_graceful_shutdown=1
    )
    server = uvicorn.Server(config)
    # the end of a terminal ends the server, unless its user asked for it to go on
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        signal.signal(signal.SIGHUP, server.handle_exit)
    return server.run
