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
    taken = type(flags)(
        **{name: given[name] for name in given if name in _TAKEN}
    ).words()
    words = [word for word in flags.words() if word not in taken]
    others = (replace(reading, worksheet=None, columns={}, units=None), *others)
    words += [
        word for other in others for word in other.words() if word != "--no-sample"
    ]
    if words:
        raise InputError(
            f"{words[0]}: {file} is a table of friction against speed; "
            "expected it with a throw"
        )
    table = load_friction_table(file, reading.worksheet, reading.columns, reading.units)
    drawn = output.drawn()
    folder = claim_folder(output.out or result_folder(file, kind, reading))
    laws = (
        given.get("laws")
        or given.get("law")
        or (None if kind == "compare" else "front-back")
    )
    with output.status(f"Fitting {COMPILES}"):
        from curlfit.friction_tables.fit import fit_friction

        found = fit_friction(
            table,
            laws,
            load=given.get("load", "uniform"),
            stone=Stone().with_values(dict(given.get("stone", {}))),
        )
    done = output.finish(found, folder, drawn, remarks=table.notes)
    return done if found.fits[0].converged else done._replace(status=1)
