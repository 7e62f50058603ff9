"""The command line: parses arguments, calls the computation, prints its report."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from cyclopts import App, Parameter
from cyclopts.exceptions import CycloptsError

from curlfit.batch.command import batch
from curlfit.cli.example import example
from curlfit.cli.explain import explain
from curlfit.cli.export import export
from curlfit.cli.fit import fit
from curlfit.cli.laws import laws
from curlfit.cli.page import app as page
from curlfit.cli.saved import plot, report, show, write_page
from curlfit.cli.throws import check, simulate
from curlfit.comparison.command import compare
from curlfit.errors import CurlfitError
from curlfit.foreign import say
from curlfit.optimal_design.command import design
from curlfit.options.output import Saved
from curlfit.paper.command import reproduce
from curlfit.prediction.command import predict
from curlfit.profile_likelihood.command import profile
from curlfit.settings.command_words import parser_words
from curlfit.settings.forms import refusal_of
from curlfit.version import __version__

_LIBRARIES = ("jax", "jaxlib", "optimistix", "numpy", "scipy", "emcee", "matplotlib")
_NARROWEST = 20  # columns of a terminal
# exit statuses; those of errors of curlfit are in `errors`
_NO_MEMORY = 1
_NO_OUTPUT = 2
_INTERRUPTED = 130  # as of a shell after Ctrl-C


def _version() -> None:
    """Print the versions of curlfit and of the libraries it uses."""
    import platform
    from importlib.metadata import version

    libraries = ", ".join(f"{name} {version(name)}" for name in _LIBRARIES)
    print(f"curlfit {__version__}\nPython {platform.python_version()}, {libraries}")
    print(f"{platform.platform()}, {platform.machine()}")


app = App(
    name="curlfit",
    help=(
        "Estimate friction coefficients from the trajectory of a curling stone.\n\n"
        "Begin with `curlfit fit DATA.csv`, where DATA.csv has columns t, x, y, "
        "phi (s, m, m, rad)."
    ),
    help_format="markdown",
    version_flags=[],
    default_parameter=Parameter(negative=(), show_default=False, show_choices=False),
    print_error=False,
    exit_on_error=False,
    suppress_keyboard_interrupt=False,
    result_action="return_value",
)
for _verb in (
    check,
    fit,
    compare,
    batch,
    predict,
    profile,
    design,
    show,
    plot,
    report,
    export,
    simulate,
    laws,
    explain,
    reproduce,
    example,
    page,
):
    app.command(_verb)
app.command(_version, name="--version")


def run(words: Sequence[str]) -> int:
    """Carry out a command; returns its exit status."""
    try:
        saved = app(parser_words(app, words))
        if not isinstance(saved, Saved):
            return 0
        if saved.page is not None:
            file = write_page(saved.page)
            if not saved.quiet:
                say(f"Written: {file}")
        return saved.status
    except CycloptsError as error:
        raise refusal_of(error) from None
    finally:
        # folders are claimed by a module that quick commands do not load
        files = sys.modules.get("curlfit.output.files")
        if files is not None:
            files.release_folders()


def main() -> None:
    """Run the command; errors of the input become one sentence and an exit status."""
    # NumPy is not loaded yet. Its matrices here are small: threads would wait for
    # one another.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    columns = os.environ.get("COLUMNS", "")
    if columns.isdecimal() and int(columns[:9]) < _NARROWEST:
        del os.environ["COLUMNS"]  # no text fits into such a width
    try:
        try:
            status = run(sys.argv[1:])
        finally:
            sys.stdout.flush()
    except CurlfitError as error:
        say(f"curlfit: {error}", error=True)
        status = error.exit_status
    except KeyboardInterrupt:
        say("curlfit: stopped", error=True)
        status = _INTERRUPTED
    except (MemoryError, ImportError) as error:
        # of a library for which no memory was left
        if isinstance(error, ImportError) and "failed to map" not in str(error):
            raise
        say(
            "curlfit: not enough memory; expected about 2 GB, which `ulimit -v` may "
            "limit",
            error=True,
        )
        status = _NO_MEMORY
    except OSError as error:
        # Unprinted output is dropped; Python would otherwise try to write it
        # again on exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        say(
            f"curlfit: {error.filename or 'output'}: {error.strerror or error}",
            error=True,
        )
        status = _NO_OUTPUT
    sys.exit(status)
