"""What the verbs share of their output: its folder and figures, a progress line,
the last words."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from cyclopts import Group, Parameter

from curlfit.numerics.jax_settings import require_jax
from curlfit.options.figures import FigureFiles
from curlfit.output.display import document_of, figures_of
from curlfit.output.kinds import KINDS
from curlfit.settings.choices import Choices
from curlfit.settings.forms import PATH, SWITCH, TEXT, option

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import ProgressColumn

    Show = Callable[..., None]

OUTPUT = Group("Output", sort_key=2)
COMPILES = "(a first run on a machine compiles the model)"


class Saved(NamedTuple):
    """What remains to be done after a verb.

    Attributes
    ----------
    page : folder of the saved result of which a page is to be written; None for none.
    quiet : whether the page is not mentioned.
    status : exit status.
    """

    page: Path | None
    quiet: bool = False
    status: int = 0


@Parameter(name="*", group=OUTPUT)
@dataclass(frozen=True, kw_only=True)
class Output(Choices):
    """Where and how results are written.

    Attributes
    ----------
    out : Folder for the results. [default: the name of DATA or FIT, with the numbers
        given by --shot and --stone-index, and the verb; of several files joint-fit]
    figures : Format of the figures, `png`, `pdf` or `svg`; several separated by commas.
        [default: png]
    no_figures : Draw no figures.
    report : Also write `report.html`, the result as one self-contained page, as
        `curlfit report` does.
    quiet : Print nothing but errors.
    """

    out: Annotated[Path | None, option(PATH, "DIR")] = None
    figures: Annotated[str | None, option(TEXT, "FORMAT")] = None
    no_figures: Annotated[bool, option(SWITCH)] = False
    report: Annotated[bool, option(SWITCH)] = False
    quiet: Annotated[bool, option(SWITCH, name=["--quiet", "-q"])] = False

    def drawn(self) -> FigureFiles:
        """The figures to be drawn of what will be computed. Raises `InputError` for an
        unknown format, or where JAX cannot compute."""
        require_jax()
        return FigureFiles.of(self.figures, none=self.no_figures)

    def console(self) -> Console:
        """Where to print."""
        from curlfit.output.console import terminal

        return terminal(quiet=self.quiet)

    @contextmanager
    def status(self, text: str) -> Iterator[None]:
        """A line on the terminal that says what is done, as long as it is done."""
        from rich.console import Console
        from rich.progress import SpinnerColumn

        console = Console(stderr=True, quiet=self.quiet)
        with progress_line(console, SpinnerColumn(), text):
            yield

    def finish(
        self,
        result: Any,
        folder: Path,
        drawn: FigureFiles,
        *,
        files: Sequence[Path] = (),
        remarks: Sequence[object] = (),
        more: str = "",
    ) -> Saved:
        """Save a result, draw its figures, print it, and say what was written.

        Parameters
        ----------
        result : of a kind in `KINDS`.
        drawn : the figures, and how they are written.
        files : written already. remarks : warnings to be printed beneath the result.
        more : end of the last line.
        """
        record = folder / f"{result.kind}.json"
        result.save(record)
        written = [record, *files]
        kind = KINDS[result.kind]
        if "corner" in kind.figure_names:
            chain_file = folder / "chain.h5"
            if result.chain is None:
                chain_file.unlink(missing_ok=True)  # of an earlier result
            else:
                written.append(chain_file)  # which was saved with the record
        drawn.replace(folder, kind.figure_names, partial(figures_of, result))
        console = self.console()
        console.print(document_of(result))
        for remark in remarks:
            console.print(f"Warning: {remark}.", style="yellow", markup=False)
        return self.written(folder, written + drawn.written(), console, more)

    def written(
        self, folder: Path, files: Sequence[Path], console: Console, more: str = ""
    ) -> Saved:
        """Say which files were written, with `more` at the end of the line; a page that
        shows an earlier result is removed."""
        console.print("Written: " + ", ".join(map(str, files)) + more, soft_wrap=True)
        if not self.report:
            (folder / "report.html").unlink(missing_ok=True)
        return Saved(folder if self.report else None, self.quiet)


@contextmanager
def progress_line(console: Console, *columns: str | ProgressColumn) -> Iterator[Show]:
    """A line of progress, on a terminal, and a function that shows a text and how
    much is done."""
    from rich.progress import Progress

    hidden = console.quiet or not console.is_terminal
    with Progress(
        *columns, console=console, disable=hidden, transient=True
    ) as progress:
        task = progress.add_task("", total=None)

        def show(text: str = "", done: float = 0, total: float | None = None) -> None:
            progress.update(task, description=text, completed=done, total=total)

        yield show
