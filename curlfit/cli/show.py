"""`curlfit show`: print a saved fit again."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from curlfit.cli.settings import chain_beside, kind_of
from curlfit.files import strict


def show(
    folder: Annotated[
        Path,
        typer.Argument(help="Folder of results, or the JSON file in it.", metavar="DIR"),
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print the JSON record.")] = False,
) -> None:
    """Print the report of a saved fit, joint fit or comparison, without fitting again."""
    from rich.console import Console

    console = Console(width=None if sys.stdout.isatty() else 110)
    kind = kind_of(folder)
    if kind == "joint":
        from curlfit.joint import load_joint
        from curlfit.report_joint import print_joint

        joint = load_joint(folder)
        if as_json:
            print(json.dumps(strict(joint.to_json()), indent=1))
        else:
            print_joint(joint, console)
        return
    if kind == "compare":
        from curlfit.comparison import load_comparison
        from curlfit.report_comparison import print_comparison

        comparison = load_comparison(folder)
        if as_json:
            print(json.dumps(strict(comparison.to_json()), indent=1))
        else:
            print_comparison(comparison, console)
        return
    from curlfit.report import print_fit
    from curlfit.results import load_fit

    result = load_fit(folder)
    if result.sampling == "unfinished":
        from curlfit.sampling import so_far

        found = so_far(result, chain_beside(folder))
        result = result if found is None else found[0]
    if as_json:
        print(json.dumps(result.summary(), indent=1))
    else:
        print_fit(result, console)
