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

from curlfit.findings import Finding
from curlfit.foreign import cut
from curlfit.options.settings import kind_of
from curlfit.output.display import document_of
from curlfit.output.kinds import KINDS

_LONGEST = 120  # characters of a line of progress
_CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|[━╸╺⠀-⣿]")
# a terminal of which no line is too long, so that progress is shown and
# sentences are whole
_TERMINAL = {"FORCE_COLOR": "1", "COLUMNS": "9999", "PYTHONIOENCODING": "utf-8"}
# The other end of its standard input is held by the page alone: it ends with the page,
# even if that is killed (see `curlfit.__main__`).
_ENDS_WITH_PAGE = {"CURLFIT_ENDS_WITH_INPUT": "1"}


def warnings_beside(page: Path) -> list[Finding]:
    """The warnings of the result in the folder of its page."""
    kind = kind_of(page.parent)
    result = KINDS[kind].load(page.parent)
    return list(document_of(result).warnings)


class Work:
    """One command, running or done.

    Attributes
    ----------
    verb, words : what is typed after `curlfit`.
    complaints : what it said on failing. page : the page that it wrote, within the
        folder. warnings : of the result beside that page.
    stopped, over : whether it was told to stop, and whether it has ended.
    """

    def __init__(self, verb: str, words: Sequence[str]) -> None:
        self.verb = verb
        self.words = words
        self.complaints: list[str] = []
        self.warnings: list[Finding] = []
        self.page: Path | None = None
        self.stopped = False
        self.over = asyncio.Event()
        self._line = "Starting"
        self._process: asyncio.subprocess.Process | None = None

    async def run(self, folder: Path) -> None:
        """Run it in a folder, to its end; that it cannot start is a complaint."""
        try:
            await self._run(folder)
        except (OSError, ValueError) as error:  # a NUL, or more than the system takes
            self.complaints = [f"the command cannot be started ({error})"]
        finally:
            self.over.set()

    async def _run(self, folder: Path) -> None:
        """Start the command in a folder, hear all that it prints, and load the warnings
        of its result."""
        self._process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-P",  # dropped files are no modules
            "-m",
            "curlfit",
            self.verb,
            *self.words,
            cwd=folder,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
            env=os.environ | _TERMINAL | _ENDS_WITH_PAGE,
        )
        if self.stopped:  # while it was started
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
        if self.page is not None:
            self.warnings = warnings_beside(folder / self.page)

    def _hear(self, raw: bytes) -> None:
        """Take a line that the command printed, such as "Written: a-fit/report.html",
        "curlfit: the fit is not usable: ..." or one of progress; of an empty one, the
        line before stays."""
        printed = _CONTROL.sub("", raw.decode(errors="replace"))
        words = printed.split()
        if words:
            self._line = " ".join(words)
        beginning, _, rest = self._line.partition(": ")
        if beginning == "Written":
            page = Path(rest)
            is_in_folder = not page.is_absolute() and ".." not in page.parts
            if page.name == "report.html" and is_in_folder:
                self.page = page
        elif beginning == "curlfit" and rest not in self.complaints:
            self.complaints.append(rest)

    @property
    def progress(self) -> str:
        """Its last line and how much is done, as HTML."""
        count = re.search(r"(\d+)/(\d+)", self._line)
        value = f' value="{count[1]}" max="{count[2]}"' if count else ""
        line = "Stopping" if self.stopped else cut(self._line, _LONGEST)
        return f"<p>{escape(line)}</p><progress{value}></progress>"

    def stop(self) -> None:
        """Stop it as Ctrl-C does; at once if it was told so before."""
        if self.stopped or sys.platform == "win32":
            self.kill()
        elif self._process is not None and self._process.returncode is None:
            self._process.send_signal(signal.SIGINT)
        self.stopped = True

    def kill(self) -> None:
        """End it at once."""
        self.stopped = True
        if self._process is not None and self._process.returncode is None:
            self._process.kill()
