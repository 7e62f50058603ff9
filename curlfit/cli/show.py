"""`curlfit show`: print a saved fit again."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from curlfit.options.settings import chain_beside, kind_of
from curlfit.output.files import json_safe


def show(
    folder: Annotated[
        Path,
        typer.Argument(help="Folder of results, or the JSON file in it.", metavar="DIR"),
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print the JSON record.")] = False,
) -> None:
    """Print the report again of a saved fit, joint fit, comparison, prediction, profile, design."""
    from curlfit.output.console import terminal

    console = terminal()
    kind = kind_of(folder)
    record: Callable[[], Any]
    printed: Callable[[], None]
    if kind == "joint":
        from curlfit.inference.joint.report import print_joint
        from curlfit.inference.joint.result import load_joint

        joint = load_joint(folder)
        record, printed = joint.to_json, partial(print_joint, joint, console)
    elif kind == "compare":
        from curlfit.comparison.report import print_comparison
        from curlfit.comparison.result import load_comparison

        comparison = load_comparison(folder)
        record, printed = comparison.to_json, partial(print_comparison, comparison, console)
    elif kind == "predict":
        from curlfit.prediction.report import print_prediction
        from curlfit.prediction.result import load_prediction

        prediction = load_prediction(folder)
        record, printed = prediction.summary, partial(print_prediction, prediction, console)
    elif kind == "design":
        from curlfit.optimal_design.report import print_design
        from curlfit.optimal_design.result import load_design

        design = load_design(folder)
        record, printed = design.to_json, partial(print_design, design, console)
    elif kind == "profile":
        from curlfit.profile_likelihood.report import print_profile
        from curlfit.profile_likelihood.result import load_profile

        profile = load_profile(folder)
        record, printed = profile.summary, partial(print_profile, profile, console)
    else:
        from curlfit.inference.fit.result import load_fit
        from curlfit.inference.report import print_fit

        result = load_fit(folder)
        if result.sampling == "unfinished":
            from curlfit.inference.mcmc.sampler import so_far

            found = so_far(result, chain_beside(folder))
            result = result if found is None else found[0]
        record, printed = result.summary, partial(print_fit, result, console)
    if as_json:
        print(json.dumps(json_safe(record()), indent=1))
    else:
        printed()
