"""`curlfit reproduce`: the paper's claims, recomputed."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from curlfit.errors import InputError
from curlfit.options.figures import FigureFiles
from curlfit.options.output import progress_line
from curlfit.settings.forms import PATH, SWITCH, TEXT, option

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_FIGURES = {
    "path": ("eq14", "prop5"),
    "isotropic": ("isotropic",),
    "eq28": ("eq28",),
    "ring": ("eq24", "split"),
}
"""Figures, by the last study that each shows."""


def reproduce(
    *,
    out: Annotated[Path, option(PATH, "DIR")] = Path("reproduction"),
    figures: Annotated[str | None, option(TEXT, "FORMAT")] = None,
    quiet: Annotated[bool, option(SWITCH, name=["--quiet", "-q"])] = False,
    as_json: Annotated[bool, option(SWITCH, name="--json")] = False,
) -> None:
    """Recompute every numbered claim of Ivanov and Shuvalov (2012) and give a
    verdict on each.

    Eq. 12 is differentiated, friction is integrated over the ring, and the laws are
    fitted. Takes about a minute on the first run of a machine.

    Parameters
    ----------
    out
        Folder for claims.json, claims.md and its figures. [default: reproduction]
    figures
        Format of the figures: `png`, `pdf`, `svg`; several with commas between.
    quiet
        Print nothing.
    as_json
        Print claims.json in place of the table.
    """
    from curlfit.numerics.jax_settings import require_jax
    from curlfit.output.files import atomic_write, claim_folder

    if quiet and as_json:
        raise InputError(
            "--json prints the claims, and --quiet prints nothing; give one of them"
        )
    drawn = FigureFiles.of(figures)
    require_jax()
    folder = claim_folder(out)

    from curlfit.output.console import terminal

    console = terminal(quiet=quiet or as_json)
    drawn.draw_beside()

    def draw(study: str, studies: Any) -> None:
        for name in _FIGURES[study]:
            drawn.replace(folder, [name], partial(_figure, name, studies))

    from rich.progress import BarColumn, TimeElapsedColumn

    with progress_line(
        console, "{task.description}", BarColumn(), TimeElapsedColumn()
    ) as show:
        show("compiling")
        from curlfit.paper.reproduce import reproduce as recompute

        result = recompute(show, draw)

    from curlfit.paper.claim import page, printed_claims, verdicts

    claims = json.dumps([claim.as_dict() for claim in result.claims], indent=1)
    written = [folder / "claims.json", folder / "claims.md"]
    for file, text in zip(
        written, (claims + "\n", page(result, drawn.formats[0])), strict=True
    ):
        atomic_write(file, text)
    if as_json:
        print(claims)
    console.print(printed_claims(result.claims))
    console.print(verdicts(result.claims))
    written += drawn.written()
    console.print("Written: " + ", ".join(map(str, written)), soft_wrap=True)


def _figure(name: str, studies: Any) -> dict[str, Figure]:
    from curlfit.paper.figures import FIGURES

    return {name: FIGURES[name](studies)}
