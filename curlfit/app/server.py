"""The page on a port of this computer: for this computer alone, at an address
with a secret."""

from __future__ import annotations

import secrets
import socket
import sys
import webbrowser
from collections.abc import Callable
from contextlib import chdir, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from cyclopts import App

from curlfit.errors import InputError
from curlfit.foreign import say

_HOST = "127.0.0.1"


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
    start, temporary = (
        Path.cwd(),
        TemporaryDirectory("-curlfit-app", ignore_cleanup_errors=True),
    )
    with listening, temporary as folder, chdir(folder):
        secret = secrets.token_urlsafe(24)
        address = f"http://{_HOST}:{listening.getsockname()[1]}/{secret}/"
        run = _server(cli, start, Path(folder), secret)
        say(f"The page is at {address} (Ctrl-C ends it)")
        sys.stdout.flush()
        if browser:
            webbrowser.open(address)
        with suppress(KeyboardInterrupt):
            run(sockets=[listening])
    say("The page is closed.")


def _server(cli: App, start: Path, folder: Path, secret: str) -> Callable[..., None]:
    import uvicorn
    from fastapi import FastAPI, Request, Response
    from nicegui import app, ui

    from curlfit.app.page import MOST_BYTES, Page

    page = Page(cli, start, folder)
    ui.page("/", title="curlfit")(page.build)
    app.add_static_files("/results", folder, max_cache_age=0)
    app.on_exception(page.fail)
    app.on_shutdown(page.close)
    outer = FastAPI(openapi_url=None)

    async def limited(request: Request, proceed: Callable[..., Any]) -> Any:
        unknown = "0" if request.method == "GET" else "inf"
        if float(request.headers.get("content-length", unknown)) > MOST_BYTES:
            return Response(status_code=413)
        return await proceed(request)

    outer.middleware("http")(limited)
    ui.run_with(
        outer, mount_path=f"/{secret}", dark=None, tailwind=False, language="en-US"
    )
    config = uvicorn.Config(outer, log_level="error", timeout_graceful_shutdown=1)
    return uvicorn.Server(config).run
