"""Which figures a verb writes: their formats, and their files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from curlfit.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = ("png", "pdf", "svg")


class FigureFiles(NamedTuple):
    """The formats in which a verb writes its figures; none where it draws nothing."""

    formats: tuple[str, ...]

    @classmethod
    def of(cls, text: str | None, flag: str = "--figures", *, none: bool = False) -> FigureFiles:
        """Formats as they are written, separated by commas; PNG where nothing is.

        Raises
        ------
        InputError : an unknown format, or formats and none at once.
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

    def write(self, folder: Path, draw: Callable[[], Mapping[str, Figure]]) -> list[Path]:
        """Draw figures, by name, and write them in each format; returns the files."""
        if not self.formats:
            return []
        from curlfit.output.figures import save_figure

        written = []
        for name, figure in draw().items():
            for format in self.formats:
                written.append(folder / f"{name}.{format}")
                save_figure(figure, written[-1])
        return written

    def replace(
        self, folder: Path, names: Sequence[str], draw: Callable[[], Mapping[str, Figure]]
    ) -> list[Path]:
        """The same in place of the figures of an earlier result, of which none stays."""
        written = self.write(folder, draw)
        for name in names:
            remove_figure(folder, name, keep=written)
        return written


def remove_figure(folder: Path, name: str, keep: Sequence[Path] = ()) -> None:
    """Remove a figure of an earlier result in all formats, but for some files."""
    for format in FORMATS:
        file = folder / f"{name}.{format}"
        if file not in keep:
            file.unlink(missing_ok=True)
