"""`curlfit app`: a page in the browser on which files are dropped."""

from __future__ import annotations

from typing import Annotated

from curlfit.settings.forms import SWITCH, option, whole


def app(
    *,
    port: Annotated[int, option(whole(0, 65535), "N")] = 0,
    no_browser: Annotated[bool, option(SWITCH)] = False,
) -> None:
    """Open a page in the browser on which files are dropped, read, fitted and compared.

    It runs `check`, `fit` and `compare`, and shows their commands. It is for this
    computer alone, and needs no network. Needs `pip install 'curlfit[app]'`.
    Ctrl-C ends it.

    Parameters
    ----------
    port
        Port of this computer. [default: one that is free]
    no_browser
        Print the address of the page without opening it.
    """
    from curlfit.app.server import serve
    from curlfit.cli import app as commands

    serve(commands, port, browser=not no_browser)
