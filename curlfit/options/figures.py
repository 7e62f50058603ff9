"""Which figures a verb writes: their formats, their files, and the process
that draws them."""

from __future__ import annotations

import pickle
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from curlfit.errors import InputError
from curlfit.numerics.threads import cores, require_address_space

if TYPE_CHECKING:
    from concurrent.futures import Future, ProcessPoolExecutor

    from matplotlib.figure import Figure

    Draw = Callable[[], Mapping[str, Figure]]

FORMATS = ("png", "pdf", "svg")


@dataclass(frozen=True)
class _SentTask:
    """Figures that the second process draws and writes; `result` is that of their task,
    or None where the task could not be sent."""

    task: Callable[[], list[Path]]
    result: Future[list[Path]] | None


class FigureFiles:
    """The figures of a verb and the formats in which they are written; none if
    nothing is drawn."""

    def __init__(self, formats: tuple[str, ...]) -> None:
        self.formats = formats
        self._second_process: ProcessPoolExecutor | None = None
        self._sent: list[_SentTask] = []
        self._files: list[Path] = []

    @classmethod
    def of(
        cls, text: str | None, flag: str = "--figures", *, none: bool = False
    ) -> FigureFiles:
        """Formats from a list separated by commas; PNG if none is given.

        Raises
        ------
        InputError : an unknown format, or formats together with `none`.
        """
        if none:
            if text is not None:
                raise InputError(
                    f"{flag} {text}: --no-figures draws nothing; give one of them"
                )
            return cls(())
        if text is None:
            return cls((FORMATS[0],))
        formats = [format.strip().lower() for format in text.split(",")]
        if not set(formats) <= set(FORMATS):
            raise InputError(
                f"{flag} {text}: expected {', '.join(FORMATS[:-1])} or {FORMATS[-1]}, "
                "or several separated by commas"
            )
        return cls(tuple(dict.fromkeys(formats)))

    def draw_beside(self) -> None:
        """From now on, draw in a second process, which loads matplotlib while this
        one loads JAX.

        Figures are drawn here if there is only one core, or if JAX is loaded already.

        Raises
        ------
        MemoryError : too little of it for JAX, by `ulimit -v`.
        """
        require_address_space()
        if self.formats and cores() > 1 and "jax" not in sys.modules:
            from curlfit.numerics.processes import worker_processes

            self._second_process = worker_processes(1)
            self._second_process.submit(_load_matplotlib)

    def replace(self, folder: Path, names: Sequence[str], draw: Draw) -> None:
        """Draw figures, by name, and write them in place of all those of an earlier
        result; `written` waits for the files.

        Parameters
        ----------
        names : names of all possible figures.
        draw : a module-level function with its arguments, so that another process
            can call it.
        """
        task = partial(_replace, folder, names, self.formats, draw)
        if self._second_process is None:
            self._files += task()
            return
        result = None
        with suppress(Exception):  # what cannot be sent is drawn here, in `written`
            result = self._second_process.submit(_call_pickled, pickle.dumps(task))
        self._sent.append(_SentTask(task, result))

    def written(self) -> list[Path]:
        """The files of all figures, once they are written; raises what drawing
        them raised."""
        for sent in self._sent:
            files = None
            if sent.result is not None:
                # the second process does not know a law, or was killed
                with suppress(Exception):
                    files = sent.result.result()
            self._files += sent.task() if files is None else files
        self._sent = []
        return self._files


def _replace(
    folder: Path, names: Sequence[str], formats: Sequence[str], draw: Draw
) -> list[Path]:
    """Draw and write figures, and remove the others of these names; returns the
    files."""
    written = write_figures(folder, draw(), formats) if formats else []
    for name in names:
        remove_figure(folder, name, keep=written)
    return written


def _call_pickled(task: bytes) -> list[Path]:
    """The files of a pickled task. It is unpickled here, where an error is the task's,
    and not by the pool, where an error would end the process."""
    return pickle.loads(task)()


def _load_matplotlib() -> None:
    """Load everything that a first figure needs, including fonts."""
    from curlfit.output.figures import Picture

    figure = Picture(figsize=(1, 1))
    figure.text(0, 0, "$v_0$ 0")
    figure._repr_png_()


def write_figures(
    folder: Path, figures: Mapping[str, Figure], formats: Sequence[str]
) -> list[Path]:
    """Write figures, by name, in each format; returns the files."""
    from curlfit.output.figures import save_figure

    files = []
    for name, figure in figures.items():
        for format in formats:
            file = folder / f"{name}.{format}"
            save_figure(figure, file)
            files.append(file)
    return files


def remove_figure(folder: Path, name: str, keep: Sequence[Path] = ()) -> None:
    """Remove a figure of an earlier result in all formats, except for some files."""
    for format in FORMATS:
        file = folder / f"{name}.{format}"
        if file not in keep:
            file.unlink(missing_ok=True)
