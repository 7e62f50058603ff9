"""`curlfit export`: saved results in other forms."""

from __future__ import annotations

import json
from collections.abc import Sequence
from enum import StrEnum
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import curlfit
from curlfit.cli.saved import of_record
from curlfit.errors import InputError
from curlfit.foreign import say
from curlfit.options import settings as s
from curlfit.settings.forms import PATH, option

if TYPE_CHECKING:
    from curlfit.inference.fit.result import FitResult


class Form(StrEnum):
    """What a result can be exported to."""

    csv = "csv"
    netcdf = "netcdf"
    json = "json"
    latex = "latex"
    game = "game"
    c = "c"
    js = "js"
    table = "table"


_GAME = (Form.table, Form.c, Form.js)
_LOADERS = {"joint": "load_joint", "compare": "load_comparison", "fit": "load_fit"}


@of_record
def export(
    folder: Path,
    /,
    *,
    to: list[Form],
    out: Annotated[Path | None, option(PATH, "DIR")] = None,
    law: s.LawOfFit = None,
) -> None:
    """Export a saved fit, joint fit or comparison to other programs and papers.

    Examples:

    `curlfit export throw-fit --to csv --to latex`: parameters.csv, path.csv, table.tex

    `curlfit export throw-fit --to game --out game`: accelerations.json,
    curlfit_stone.h, .mjs

    Parameters
    ----------
    folder
        Folder of a fit, a joint fit or a comparison, or the JSON in it.
    to
        csv: parameters, and the path with its residuals. netcdf: the sampled posterior
        for ArviZ. json: what `curlfit show --json` prints. latex: a table with
        booktabs. table, c, js: the accelerations of the stone by speed and spin, as
        JSON, C header and JavaScript module, for games and simulators; game: all three.
    out
        Folder for the files. [default: the result's name with -export]
    """
    from curlfit.output.files import atomic_write, claim_folder

    kind = s.kind_of(folder)
    if kind not in _LOADERS:
        raise InputError(
            f"{folder}: a result of curlfit {kind}; expected the folder of a fit, "
            "a joint fit or a comparison"
        )
    every = (_GAME if form is Form.game else (form,) for form in to)
    forms = list(dict.fromkeys(chain.from_iterable(every)))
    for form in to:
        if form in (Form.netcdf, Form.game, *_GAME) and kind != "fit":
            such = f", such as {folder}/NAME" if kind == "joint" else ""
            raise InputError(f"--to {form.value}: expected the fit of one throw{such}")
    result = getattr(curlfit, _LOADERS[kind])(folder)
    if law is not None:
        if kind == "compare":
            raise InputError(f"--law: {folder} is no fit; expected the folder of a fit")
        result.with_law(law)
    # Everything is made before anything is written.
    made: dict[str, bytes] = {}
    for form in forms:
        made |= {} if form in _GAME else _files(form, result, kind, folder)
    of_games, note = _game(result, forms) if {*forms} & {*_GAME} else ({}, "")
    made |= of_games
    target = claim_folder(out or Path(f"{s.name_of(folder)}-export"))
    for name, data in made.items():
        atomic_write(target / name, data)
    say("Written: " + ", ".join(str(target / name) for name in made))
    if note:
        say(note)


def _files(form: Form, result: Any, kind: str, folder: Path) -> dict[str, bytes]:
    """What to write, by file name."""
    from curlfit.export import tables

    if form is Form.csv and kind == "compare":
        return {"candidates.csv": tables.candidates_csv(result).encode()}
    if form is Form.csv:
        found = {"parameters.csv": tables.parameters_csv(result).encode()}
        if fits := result.throws if kind == "joint" else (result,):
            found["path.csv"] = tables.path_csv(fits).encode()
        return found
    if form is Form.latex:
        table = tables.candidates_table if kind == "compare" else tables.estimates_table
        return {"table.tex": table(result).encode()}
    if form is Form.json:
        return {
            f"{kind}.json": (json.dumps(result.summary(), indent=1) + "\n").encode()
        }
    result, sample = s.load_fit_and_chain(folder)
    if sample is None:
        raise InputError(
            f"--to netcdf: {folder} has no sampled posterior; "
            "`curlfit fit ... --resume` samples it"
        )
    data = sample.to_arviz(result)
    # of ArviZ before 1.0
    tree = data.to_datatree() if hasattr(data, "to_datatree") else data
    # In memory, as HDF5 does not recover from a full disk; a copy, as a view of a
    # buffer that the garbage collector closes is an error on Python 3.13.
    return {"posterior.nc": bytes(tree.to_netcdf(engine="h5netcdf"))}


def _game(fit: FitResult, forms: Sequence[Form]) -> tuple[dict[str, bytes], str]:
    """The stone for games in some forms, by file name, and what of the fit it does
    not include."""
    from curlfit.export.accelerations import (
        c_header,
        javascript_module,
        not_included,
        tabulate,
    )

    table = tabulate(fit)
    made = {
        Form.table: (
            "accelerations.json",
            json.dumps(table.to_json(), indent=1) + "\n",
        ),
        Form.c: ("curlfit_stone.h", c_header(table)),
        Form.js: ("curlfit_stone.mjs", javascript_module(table)),
    }
    files = (made[form] for form in forms if form in made)
    return {name: text.encode() for name, text in files}, not_included(table)
