"""Which figures a verb writes: their formats, their files, and the process that draws them."""

from __future__ import annotations

import os
import pickle
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from curlfit.errors import InputError
from curlfit.numerics.threads import cores

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    from matplotlib.figure import Figure

FORMATS = ("png", "pdf", "svg")


class FigureFiles:
    """The figures of a verb and the formats in which they are written; none if nothing is
    drawn."""

    def __init__(self, formats: tuple[str, ...]) -> None:
        self.formats = formats
        self._second: Connection | None = None
        self._tasks: list[_Task] = []
        self._files: list[Path] = []

    @classmethod
    def of(cls, text: str | None, flag: str = "--figures", *, none: bool = False) -> FigureFiles:
        """Formats from a list separated by commas; PNG if none is given.

        Raises
        ------
        InputError : an unknown format, or formats together with `none`.
        """
        if none and text is not None:
            raise InputError(f"{flag} {text}: --no-figures draws nothing; give one of them")
        names = (
            []
            if none
            else [one.strip().lower() for one in (FORMATS[0] if text is None else text).split(",")]
        )
        for name in names:
            if name not in FORMATS:
                raise InputError(
                    f"{flag} {text}: expected {', '.join(FORMATS[:-1])} or {FORMATS[-1]}, or "
                    "several separated by commas"
                )
        return cls(tuple(dict.fromkeys(names)))

    def draw_beside(self) -> None:
        """From now on, draw in a second process, which loads matplotlib while this one computes.

        Figures are drawn here if there is only one core or if JAX is already loaded, whose threads
        a fork does not copy. The second process ends with this one.
        """
        if self._second is None and self.formats and cores() > 1 and "jax" not in sys.modules:
            import multiprocessing

            context: Any = multiprocessing.get_context(
                "fork" if sys.platform == "linux" else "spawn"
            )
            self._second, other = context.Pipe()
            context.Process(target=_draw, args=(other,), daemon=True).start()
            other.close()

    def replace(
        self, folder: Path, names: Sequence[str], draw: Callable[[], Mapping[str, Figure]]
    ) -> None:
        """Draw figures, by name, and write them in place of all those of an earlier result;
        `written` waits for the files.

        Parameters
        ----------
        names : names of all possible figures.
        draw : a module-level function with its arguments, so that another process can call it.
        """
        task = _Task(folder, tuple(names), self.formats, draw)
        if self._second is not None:
            try:
                self._second.send_bytes(pickle.dumps(task))
            except (pickle.PicklingError, AttributeError, TypeError, OSError):
                pass  # as with a user's own law, or because the process is gone
            else:
                self._tasks.append(task)
                return
        self._files += task.carried_out()

    def written(self) -> list[Path]:
        """The files of all figures, once they are written; raises what drawing them raised."""
        for task in self._tasks:
            assert self._second is not None
            try:
                found = self._second.recv()
            except (EOFError, OSError):  # killed, perhaps for lack of memory
                found = task.carried_out()
            if isinstance(found, Exception):
                raise found
            self._files += found
        self._tasks = []
        return self._files


class _Task(NamedTuple):
    """Figures to be drawn and written."""

    folder: Path
    names: tuple[str, ...]
    formats: tuple[str, ...]
    draw: Callable[[], Mapping[str, Figure]]

    def carried_out(self) -> list[Path]:
        """Draw and write; returns the files."""
        written = write_figures(self.folder, self.draw(), self.formats) if self.formats else []
        for name in self.names:
            remove_figure(self.folder, name, keep=written)
        return written


def _draw(tasks: Connection) -> None:
    """Main loop of the second process."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the first process
    _load_matplotlib()
    while True:
        try:
            task: _Task = pickle.loads(tasks.recv_bytes())
        except EOFError:
            return
        answer: Any
        try:
            answer = task.carried_out()
        except Exception as error:
            answer = error
        tasks.send(answer)


def _load_matplotlib() -> None:
    """Load everything that a first figure needs, including fonts."""
    from io import BytesIO

    from curlfit.output.figures import Picture

    figure = Picture(figsize=(1, 1))
    figure.text(0, 0, "$v_0$ 0")
    figure.savefig(BytesIO(), format="png")


def write_figures(
    folder: Path, figures: Mapping[str, Figure], formats: Sequence[str]
) -> list[Path]:
    """Write figures, by name, in each format; returns the files."""
    files = {
        folder / f"{name}.{format}": figure
        for name, figure in figures.items()
        for format in formats
    }
    saves = list(files.items())
    if len(saves) > 1 and cores() > 1 and sys.platform == "linux" and "jax" not in sys.modules:
        _save_side_by_side(saves)
    else:
        _save(saves)
    return list(files)


def _save(saves: Sequence[tuple[Path, Figure]]) -> None:
    from curlfit.output.figures import save_figure

    for file, figure in saves:
        save_figure(figure, file)


def _save_side_by_side(saves: Sequence[tuple[Path, Figure]]) -> None:
    """Save one share here and each of the others in a forked process, or here if that fails."""
    count = min(cores(), len(saves))
    own, *others = (saves[start::count] for start in range(count))
    copies = {}
    for share in others:
        process = os.fork()  # JAX is not loaded: no threads and programs to copy
        if not process:
            try:
                _save(share)
                os._exit(0)
            finally:
                os._exit(1)
        copies[process] = share
    try:
        _save(own)
    finally:
        failed = [share for process, share in copies.items() if os.waitpid(process, 0)[1]]
    for share in failed:
        _save(share)


def remove_figure(folder: Path, name: str, keep: Sequence[Path] = ()) -> None:
    """Remove a figure of an earlier result in all formats, except for some files."""
    for format in FORMATS:
        file = folder / f"{name}.{format}"
        if file not in keep:
            file.unlink(missing_ok=True)
