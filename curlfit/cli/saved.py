"""`curlfit show`, `plot` and `report`: print or draw a saved result, or
write its page."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import curlfit
from curlfit.errors import CurlfitError, DataError, InputError
from curlfit.foreign import say
from curlfit.options.figures import FigureFiles, write_figures
from curlfit.options.settings import LawOfFit, chain_beside, kind_of, load_fit_and_chain
from curlfit.output.display import document_of, figures_of
from curlfit.output.kinds import KINDS
from curlfit.settings.forms import PATH, SWITCH, TEXT, TEXTS, option

if TYPE_CHECKING:
    from curlfit.inference.sampling.chain import Chain


Verb = TypeVar("Verb", bound=Callable[..., Any])


def of_record(verb: Verb) -> Verb:
    """A verb that refuses a record of the right types whose values contradict
    one another."""

    @wraps(verb)
    def checked(*given: Any, **options: Any) -> Any:
        try:
            return verb(*given, **options)
        except CurlfitError:
            raise
        except (
            ArithmeticError,
            LookupError,
            StopIteration,
            TypeError,
            ValueError,
        ) as error:
            raise DataError(
                f"its values contradict one another ({type(error).__name__}: "
                f"{error}); if no other program changed it, this is an "
                "error of curlfit",
                file=options["folder"] if "folder" in options else given[0],
            ) from error

    return checked  # type: ignore[return-value]


@of_record
def show(
    folder: Path,
    /,
    *,
    as_json: Annotated[bool, option(SWITCH, name="--json")] = False,
    derive: Annotated[Sequence[str], option(TEXTS, "EXPRESSION")] = (),
) -> None:
    """Print the report of a saved fit, joint fit, comparison, prediction,
    profile or design.

    Example: `curlfit show throw-fit --derive "mu2_xi - mu1_xi"`

    Parameters
    ----------
    folder
        Folder of results, or the JSON file in it.
    as_json
        Print the JSON record.
    derive
        A quantity derived from the parameters, as in `curlfit fit`.
    """
    from curlfit.output.console import terminal

    kind, result, chain = _load(folder, "--derive" if derive else "")
    if derive:
        if kind == "fit":
            result = result.with_derived(derive, chain)
        else:
            result = result.with_derived(derive)
    if as_json:
        print(json.dumps(result.summary(), indent=1))
    else:
        terminal().print(document_of(result))


@of_record
def plot(
    folder: Path,
    /,
    *,
    out: Annotated[Path | None, option(PATH, "DIR")] = None,
    format: Annotated[str, option(TEXT, "FORMAT")] = "png",
) -> None:
    """Draw the figures again of a saved fit, joint fit, comparison, prediction,
    profile, design.

    Parameters
    ----------
    folder
        Folder of results, or the JSON file in it.
    out
        Folder for the figures. [default: that of the results]
    format
        `png`, `pdf` or `svg`; several separated by commas. [default: png]
    """
    from curlfit.output.files import claim_folder
    from curlfit.reports.corner import corner_of

    formats = FigureFiles.of(format, "--format").formats
    _, result, chain = _load(folder)
    target = out or (folder if folder.is_dir() else folder.parent)
    figures = figures_of(result)
    if chain is not None:
        figures |= corner_of(result, chain)
    written = write_figures(claim_folder(target), figures, formats)
    say("Written: " + ", ".join(map(str, written)))


def report(
    folder: Path,
    /,
    *,
    out: Annotated[Path | None, option(PATH, "FILE.html")] = None,
    show_it: Annotated[bool, option(SWITCH, name="--open")] = False,
    law: LawOfFit = None,
) -> None:
    """Write a saved result as one HTML file to send: numbers, figures,
    warnings, animations.

    Of a fit, joint fit, comparison, prediction, profile or design. The file needs no
    network and no other file; animated are the stone on the sheet, the directions that
    the path does not determine, and the draws of a prediction.

    Example: `curlfit report throw-fit --open`

    Parameters
    ----------
    folder
        Folder of results, or the JSON file in it.
    out
        The file. [default: report.html among the results]
    show_it
        Open it in the browser.
    """
    file = write_page(folder, out, law)
    say(f"Written: {file}")
    if show_it:
        import webbrowser

        webbrowser.open(file.resolve().as_uri())


@of_record
def write_page(folder: Path, out: Path | None = None, law: Any = None) -> Path:
    """Write the page of a saved result; returns the file."""
    kind, result, chain = _load(folder, "" if law is None else "--law", law)
    if law is not None and kind == "joint":
        result = result.with_law(law)
    file = out or (folder if folder.is_dir() else folder.parent) / "report.html"
    curlfit.write_report(result, file, chain=chain)
    return file


def _load(
    folder: Path, flag: str = "", law: str | None = None
) -> tuple[str, Any, Chain | None]:
    """Kind, result and chain, of interrupted sampling the chain so far; `flag`
    needs a fit."""
    kind = kind_of(folder)
    if kind != "fit":
        if flag and kind != "joint":
            raise InputError(
                f"{flag}: {folder} is no fit; expected the folder of a fit"
            )
        return kind, KINDS[kind].load(folder), None
    result, chain = load_fit_and_chain(folder, law)
    if result.sampling == "unfinished":
        from curlfit.inference.sampling.summary import unfinished_posterior

        chain = None
        sampled = unfinished_posterior(result, chain_beside(folder))
        if sampled is not None:
            result, chain = sampled
    return kind, result, chain
