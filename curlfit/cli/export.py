"""`curlfit export`: saved results in other forms."""

from __future__ import annotations

import json
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from curlfit.cli.saved import of_record
from curlfit.errors import InputError
from curlfit.foreign import say
from curlfit.options import settings as s
from curlfit.output.kinds import KINDS
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
_EXPORTED = ("joint", "compare", "fit")


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
    if kind not in _EXPORTED:
        raise InputError(
            f"{folder}: a result of curlfit {kind}; expected the folder of a fit, "
            "a joint fit or a comparison"
        )
    forms: list[Form] = []
    for form in to:
        forms += _GAME if form is Form.game else (form,)
    forms = list(dict.fromkeys(forms))
    for form in to:
        if form in (Form.netcdf, Form.game, *_GAME) and kind != "fit":
            such = f", such as {folder}/NAME" if kind == "joint" else ""
            raise InputError(f"--to {form.value}: expected the fit of one throw{such}")
    result = KINDS[kind].load(folder)
    if law is not None:
        if kind == "compare":
            raise InputError(f"--law: {folder} is no fit; expected the folder of a fit")
        result.with_law(law)
    # everything is made before anything is written
    contents: dict[str, bytes] = {}
    for form in forms:
        if form not in _GAME:
            contents |= _files(form, result, kind, folder)
    note = ""
    if not set(forms).isdisjoint(_GAME):
        games, note = _game(result, forms)
        contents |= games
    target = claim_folder(out or Path(f"{s.name_of(folder)}-export"))
    for name, content in contents.items():
        atomic_write(target / name, content)
    say("Written: " + ", ".join(str(target / name) for name in contents))
    if note:
        say(note)


def _files(form: Form, result: Any, kind: str, folder: Path) -> dict[str, bytes]:
    """Contents of the files of a form, games apart, by file name."""
    from curlfit.comparison.tables import candidates_csv, candidates_table
    from curlfit.export.tables import estimates_table, parameters_csv, path_csv

    if form is Form.csv and kind == "compare":
        return {"candidates.csv": candidates_csv(result).encode()}
    if form is Form.csv:
        files = {"parameters.csv": parameters_csv(result).encode()}
        fits = result.throws if kind == "joint" else (result,)
        if fits:
            files["path.csv"] = path_csv(fits).encode()
        return files
    if form is Form.latex:
        table = candidates_table if kind == "compare" else estimates_table
        return {"table.tex": table(result).encode()}
    if form is Form.json:
        text = json.dumps(result.summary(), indent=1) + "\n"
        return {f"{kind}.json": text.encode()}
    result, sample = s.load_fit_and_chain(folder)
    if sample is None:
        raise InputError(
            f"--to netcdf: {folder} has no sampled posterior; "
            "`curlfit fit ... --resume` samples it"
        )
    data = sample.to_arviz(result)
    if hasattr(data, "to_datatree"):  # ArviZ before 1.0
        data = data.to_datatree()
    # In memory, as HDF5 does not recover from a full disk; a copy, as a view of a
    # buffer that the garbage collector closes is an error on Python 3.13.
    return {"posterior.nc": bytes(data.to_netcdf(engine="h5netcdf"))}


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
    files = {}
    for form in forms:
        if form is Form.table:
            files["accelerations.json"] = json.dumps(table.to_json(), indent=1) + "\n"
        elif form is Form.c:
            files["curlfit_stone.h"] = c_header(table)
        elif form is Form.js:
            files["curlfit_stone.mjs"] = javascript_module(table)
    contents = {name: text.encode() for name, text in files.items()}
    return contents, not_included(table)
