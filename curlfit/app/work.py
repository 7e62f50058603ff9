"""A command that runs beside the page, as it does in a terminal, and can be stopped."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

_CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|[━╸╺⠀-⣿]")
_COUNT = re.compile(r"(\d+)/(\d+)")
_SAYS = "curlfit: "


class Done(NamedTuple):
    """How a command ended: its complaints, and the page that it wrote."""

    complaints: list[str]
    page: Path | None


class Work:
    """One command.

    Attributes
    ----------
    says : its last line. share : how much is done, 0 to 1; None while that is unknown.
    stopped, over : whether it was told to stop, and whether it has ended.
    """

    def __init__(self) -> None:
        self.says = "Starting"
        self.share: float | None = None
        self.stopped = False
        self.over = asyncio.Event()
        self._process: asyncio.subprocess.Process | None = None

    async def run(self, words: Sequence[str], folder: Path) -> Done:
        """Run `curlfit` with these words in a folder, to its end."""
        self._process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "curlfit", *words, cwd=folder,
            stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
            env={**os.environ, "FORCE_COLOR": "1", "COLUMNS": "200", "PYTHONIOENCODING": "utf-8"},
        )  # fmt: skip
        assert self._process.stdout is not None
        if self.stopped:
            self._process.kill()
        lines: list[str] = []
        rest = b""
        while chunk := await self._process.stdout.read(4096):
            *whole, rest = re.split(rb"[\r\n]+", rest + chunk)
            lines += [text for one in whole if (text := self._heard(one))]
        lines.append(self._heard(rest))
        status = await self._process.wait()
        self.over.set()
        said = [line.removeprefix(_SAYS) for line in lines if line.startswith(_SAYS)]
        written = [line.removeprefix("Written: ") for line in lines if line.startswith("Written: ")]
        page = folder / written[-1] if written and written[-1].endswith("report.html") else None
        if page is None and not said:
            said = [f"the command ended with status {status}: {lines[-1]}"]
        return Done(said, page)

    def _heard(self, raw: bytes) -> str:
        line = " ".join(_CONTROL.sub("", raw.decode(errors="replace")).split())
        if line:
            count = _COUNT.search(line)
            self.says = line if count or "..." in line or "Fitting" in line else self.says
            self.share = int(count[1]) / max(1, int(count[2])) if count else None
        return line

    def stop(self) -> None:
        """Stop it as Ctrl-C does; at once if it was told so before."""
        if self._process is not None and self._process.returncode is None:
            if self.stopped or sys.platform == "win32":
                self._process.kill()
            else:
                self._process.send_signal(signal.SIGINT)
        self.stopped = True
