"""A command that runs beside the page, as it does in a terminal, and can be stopped."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import sys
from collections.abc import Sequence
from html import escape
from pathlib import Path

from curlfit.foreign import cut

_LONGEST = 120  # characters of a line of progress
_CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|[━╸╺⠀-⣿]")
# a terminal of which no line is too long, so that progress is shown and
# sentences are whole
_TERMINAL = {"FORCE_COLOR": "1", "COLUMNS": "9999", "PYTHONIOENCODING": "utf-8"}


class Work:
    """One command, running or done.

    Attributes
    ----------
    verb, words : what is typed after `curlfit`.
    complaints, warnings : what it said. page : the page that it wrote,
        within the folder.
    stopped, over : whether it was told to stop, and whether it has ended.
    """

    def __init__(self, verb: str, words: Sequence[str]) -> None:
        self.verb, self.words = verb, words
        self.complaints: list[str] = []
        self.warnings: list[str] = []
        self.page: Path | None = None
        self.stopped, self.over = False, asyncio.Event()
        self._line = "Starting"
        self._process: asyncio.subprocess.Process | None = None

    async def run(self, folder: Path) -> None:
        """Run it in a folder, to its end."""
        self._process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "curlfit",
            self.verb,
            *self.words,
            cwd=folder,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
            env=os.environ | _TERMINAL,
        )
        if self.stopped:
            self._process.kill()
        assert self._process.stdout is not None
        rest = b""
        while chunk := await self._process.stdout.read(4096):
            *lines, rest = re.split(rb"[\r\n]+", rest + chunk)
            for line in lines:
                self._hear(line)
        status = await self._process.wait()
        if self.page is None and not self.complaints:
            self.complaints = [f"the command ended with status {status}: {self._line}"]
        self.over.set()

    def _hear(self, raw: bytes) -> None:
        self._line = (
            " ".join(_CONTROL.sub("", raw.decode(errors="replace")).split())
            or self._line
        )
        kind, _, text = self._line.partition(": ")
        if kind == "Written" and text.endswith("report.html"):
            self.page = Path(text)
        heard = {"curlfit": self.complaints, "Warning": self.warnings}.get(kind, [text])
        heard.extend({text}.difference(heard))

    @property
    def progress(self) -> str:
        """Its last line and how much is done, as HTML."""
        count = re.search(r"(\d+)/(\d+)", self._line)
        value = f' value="{count[1]}" max="{count[2]}"' if count else ""
        line = "Stopping" if self.stopped else cut(self._line, _LONGEST)
        return f"<p>{escape(line)}</p><progress{value}></progress>"

    def stop(self) -> None:
        """Stop it as Ctrl-C does; at once if it was told so before."""
        if self._process is not None and self._process.returncode is None:
            if self.stopped or sys.platform == "win32":
                self._process.kill()
            else:
                self._process.send_signal(signal.SIGINT)
        self.stopped = True
