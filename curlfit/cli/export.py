"""`curlfit export`: saved results in other forms."""

from __future__ import annotations

import json
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

import curlfit
from curlfit.cli.saved import of_record
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


_GAME = (Form.c, Form.js, Form.table)


@of_record
def export(
    folder: Annotated[
        Path, Parameter(help="Folder of a fit, a joint fit or a comparison, or the JSON in it.")
    ],
    /,
    *,
    to: Annotated[
        list[Form],
        Parameter(
            help="csv: parameters, and the path with its residuals. netcdf: the sampled posterior "
            "for ArviZ. json: what `curlfit show --json` prints. latex: a table with booktabs. "
            "table, c, js: the accelerations of the stone by speed and spin, as JSON, C header and "
            "JavaScript module, for games and simulators; game: all three."
        ),
    ],
    out: Annotated[
        Path | None,
        option(PATH, "Folder for the files. [default: the result's name with -export]", "DIR"),
    ] = None,
    law: s.LawOfFit = None,
) -> None:
    """Export a saved fit, joint fit or comparison to other programs and papers.

    Examples:

    `curlfit export throw-fit --to csv --to latex`: parameters.csv, path.csv, table.tex

    `curlfit export throw-fit --to game --out game`: accelerations.json, curlfit_stone.h, .mjs
    """
    from curlfit.errors import InputError
    from curlfit.output.files import atomic_write, prepare_folder

    kind = s.kind_of(folder)
    if kind not in ("fit", "joint", "compare"):
        raise InputError(
            f"{folder}: a result of curlfit {kind}; expected the folder of a fit, a joint fit or a "
            "comparison"
        )
    forms = list(dict.fromkeys(one for form in to for one in _expanded(form)))
    for form in to:
        if form in (Form.netcdf, Form.game, *_GAME) and kind != "fit":
            such = f", such as {folder}/NAME" if kind == "joint" else ""
            raise InputError(f"--to {form.value}: expected the fit of one throw{such}")
    result = _load(folder, kind)
    if law is not None:
        if kind == "compare":
            raise InputError(f"--law: {folder} is no fit; expected the folder of a fit")
        result.with_law(law)
    # Everything is made before anything is written.
    made: dict[str, Callable[[Path], Any]] = {}
    game, note = _game(result) if set(forms) & set(_GAME) else ({}, "")
    for form in forms:
        made |= {name: write for name, write in game.items() if name == _GAME_FILES.get(form)}
        made |= _files(form, result, kind, folder)
    target = prepare_folder(out or Path(f"{s.name_of(folder)}-export"))
    for name, write in made.items():
        with atomic_write(target / name) as temporary:
            write(temporary)
    say("Written: " + ", ".join(str(target / name) for name in made))
    if note:
        say(note)


_GAME_FILES = {
    Form.table: "accelerations.json",
    Form.c: "curlfit_stone.h",
    Form.js: "curlfit_stone.mjs",
}


def _expanded(form: Form) -> tuple[Form, ...]:
    return (Form.table, Form.c, Form.js) if form is Form.game else (form,)


def _load(folder: Path, kind: str) -> Any:
    loaders = {"joint": "load_joint", "compare": "load_comparison", "fit": "load_fit"}
    return getattr(curlfit, loaders[kind])(folder)


def _text(text: str) -> Callable[[Path], Any]:
    return lambda file: file.write_text(text, encoding="utf-8")


def _files(form: Form, result: Any, kind: str, folder: Path) -> dict[str, Callable[[Path], Any]]:
    """What to write, by file name."""
    if form is Form.csv:
        from curlfit.export.tables import candidates_csv, parameters_csv, path_csv

        if kind == "compare":
            return {"candidates.csv": _text(candidates_csv(result))}
        fits = result.throws if kind == "joint" else (result,)
        return {
            "parameters.csv": _text(parameters_csv(result)), "path.csv": _text(path_csv(fits)),
        }  # fmt: skip
    if form is Form.latex:
        from curlfit.export.latex import candidates_table, estimates_table

        made = candidates_table if kind == "compare" else estimates_table
        return {"table.tex": _text(made(result))}
    if form is Form.json:
        return {f"{kind}.json": _text(json.dumps(result.summary(), indent=1) + "\n")}
    if form is Form.netcdf:
        data = _inference_data(folder)
        tree = data.to_datatree() if hasattr(data, "to_datatree") else data  # of ArviZ before 1.0
        # In memory, as HDF5 does not recover from a full disk; a copy, as a view of a buffer that
        # the garbage collector closes is an error on Python 3.13.
        image = bytes(tree.to_netcdf(engine="h5netcdf"))
        return {"posterior.nc": lambda file: file.write_bytes(image)}
    return {}


def _inference_data(folder: Path) -> Any:
    from curlfit.errors import InputError

    result, chain = s.load_fit_and_chain(folder)
    if chain is None:
        raise InputError(
            f"--to netcdf: {folder} has no sampled posterior; `curlfit fit ... --resume` samples it"
        )
    return chain.to_arviz(result)


def _game(fit: FitResult) -> tuple[dict[str, Callable[[Path], Any]], str]:
    """The files of a stone for games, and what of the fit they do not include."""
    from curlfit.export.accelerations import tabulate
    from curlfit.export.game import c_header, javascript_module, not_included

    table = tabulate(fit)
    files = {
        "accelerations.json": _text(json.dumps(table.to_json(), indent=1) + "\n"),
        "curlfit_stone.h": _text(c_header(table)),
        "curlfit_stone.mjs": _text(javascript_module(table)),
    }
    return files, not_included(table)
