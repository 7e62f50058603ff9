"""What `curlfit fit` and `curlfit compare` do with a table of friction."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from curlfit.errors import InputError
from curlfit.options.output import COMPILES, Output, Saved
from curlfit.options.settings import result_folder
from curlfit.settings.choices import Choices, Reading
from curlfit.stone import Stone

_TAKEN = ("law", "laws", "load", "stone")


def fit_table(
    file: Path,
    flags: Choices,
    output: Output,
    kind: str,
    reading: Reading,
    *others: Choices,
) -> Saved:
    """Fit the laws that are named to the table in a file; `kind` ends the name
    of the folder.

    Raises
    ------
    InputError : a choice that has no meaning for such a table; otherwise
        as `fit_friction`.
    """
    from curlfit.output.files import claim_folder
    from curlfit.throws.friction_table import load_friction_table

    given = flags.given()
    of_table = {name: given[name] for name in given if name in _TAKEN}
    taken = type(flags)(**of_table).words()
    refused = [word for word in flags.words() if word not in taken]
    # the worksheet, columns and units are those of the table
    unread = replace(reading, worksheet=None, columns={}, units=None)
    for choices in (unread, *others):
        refused += [word for word in choices.words() if word != "--no-sample"]
    if refused:
        raise InputError(
            f"{refused[0]}: {file} is a table of friction against speed; "
            "expected it with a throw"
        )
    table = load_friction_table(file, reading.worksheet, reading.columns, reading.units)
    figures = output.drawn()
    folder = claim_folder(output.out or result_folder(file, kind, reading))
    usual = None if kind == "compare" else "front-back"  # None is all laws
    with output.status(f"Fitting {COMPILES}"):
        from curlfit.friction_tables.fit import fit_friction

        friction = fit_friction(
            table,
            given.get("laws") or given.get("law") or usual,
            load=given.get("load", "uniform"),
            stone=Stone().with_values(dict(given.get("stone", {}))),
        )
    saved = output.finish(friction, folder, figures, remarks=table.notes)
    if not friction.fits[0].converged:
        saved = saved._replace(status=1)
    return saved
