"""`curlfit show`: print a saved fit again."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer


def show(
    folder: Annotated[
        Path, typer.Argument(help="Folder of a fit, or its fit.json.", metavar="DIR")
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print the JSON record.")] = False,
) -> None:
    """Print the report of a saved fit, without fitting again."""
    from rich.console import Console

    from curlfit.report import print_fit
    from curlfit.results import load_fit

    result = load_fit(folder)
    if as_json:
        print(json.dumps(result.summary(), indent=1))
    else:
        print_fit(result, Console(width=None if sys.stdout.isatty() else 110))
