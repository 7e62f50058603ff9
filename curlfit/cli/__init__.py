"""The command line: parses arguments, calls the computation, prints its report."""

from __future__ import annotations

import os
import sys
from typing import Annotated, Any

import typer

from curlfit.batch.command import batch
from curlfit.cli.example import example
from curlfit.cli.export import export
from curlfit.cli.fit import fit
from curlfit.cli.laws import laws
from curlfit.cli.saved import plot, report, show, write_page
from curlfit.cli.throws import check, simulate
from curlfit.comparison.command import compare
from curlfit.errors import CurlfitError
from curlfit.numerics import program_cache
from curlfit.optimal_design.command import design
from curlfit.options.flags import Saved
from curlfit.paper.command import reproduce
from curlfit.prediction.command import predict
from curlfit.profile_likelihood.command import profile
from curlfit.version import __version__

app = typer.Typer(
    name="curlfit",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


_LIBRARIES = ("jax", "jaxlib", "optimistix", "numpy", "scipy", "emcee", "matplotlib")


def _version(requested: bool) -> None:
    if requested:
        import platform
        from importlib.metadata import version

        typer.echo(f"curlfit {__version__}")
        libraries = ", ".join(f"{name} {version(name)}" for name in _LIBRARIES)
        typer.echo(f"Python {platform.python_version()}, {libraries}")
        typer.echo(f"{platform.platform()}, {platform.machine()}")
        raise typer.Exit


def _finished(saved: Saved | None, **_: Any) -> None:
    """Write the page of the result saved by a verb, if requested with `--report`."""
    if isinstance(saved, Saved):
        file = write_page(saved.folder)
        if not saved.quiet:
            typer.echo(f"Written: {file}")
        if saved.status:
            raise typer.Exit(saved.status)


@app.callback(result_callback=_finished)
def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=_version,
            is_eager=True,
            help="Print the versions of curlfit and of the libraries it uses.",
        ),
    ] = False,
) -> None:
    """Estimate friction coefficients from the trajectory of a curling stone.

    Begin with `curlfit fit DATA.csv`, where DATA.csv has columns t, x, y, phi (s, m, m, rad).
    """


for _verb in (
    check, fit, compare, batch, predict, profile, design, show, plot, report, export, simulate,
    laws, reproduce, example,
):  # fmt: skip
    app.command()(_verb)


def _without_data(words: list[str]) -> str:
    """A command without files and numbers."""
    return " ".join(
        word
        for word in words
        if not any(letter in "./\\=" or letter.isdigit() for letter in word)
        and not os.path.exists(word)
    )


_INTERRUPTED = 130


def main() -> None:
    """Run the command; errors of the input become one sentence and an exit status."""
    # NumPy is not loaded yet. Its matrices here are small: threads would wait for one another.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    program_cache.command = _without_data(sys.argv[1:])
    try:
        try:
            app()
        finally:
            sys.stdout.flush()
    except CurlfitError as error:
        print(f"curlfit: {error}", file=sys.stderr)
        sys.exit(error.exit_status)
    except (KeyboardInterrupt, SystemExit) as stop:  # typer exits silently on Ctrl-C
        if isinstance(stop, SystemExit) and stop.code != _INTERRUPTED:
            raise
        print("curlfit: stopped", file=sys.stderr)
        sys.exit(_INTERRUPTED)
    except OSError as error:
        # Unprinted output is dropped; Python would otherwise try to write it again on exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        print(f"curlfit: {error.filename or 'output'}: {error.strerror or error}", file=sys.stderr)
        sys.exit(2)
