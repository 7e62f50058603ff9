"""Tables of measured friction against speed, as of a sledge or of a stone
without a path."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from curlfit.errors import DataError, InputError
from curlfit.findings import Finding
from curlfit.foreign import counted
from curlfit.numerics.arrays import Floats
from curlfit.throws.readers.columns import Column, parse_header, quantities_of
from curlfit.throws.readers.quantities import find_table, read_quantities
from curlfit.throws.readers.text import TextFile

_COLUMNS = {
    "mu": "mu|µ|μ|friction|coefficientoffriction|frictioncoefficient",
    "sigma": "(sigma|sd|std|err(or)?|unc(ertainty)?)(mu|friction)?",
}
_REQUIRED = ("speed", "mu")
_EXPECTED = "expected columns speed and mu"
_MOST_SPEED = 10.0
"""m/s; no stone is as fast."""
_MOST = 1.0
"""No coefficient of friction on ice is larger."""
_LEAST_ROWS = 3


@dataclass(frozen=True, eq=False)
class FrictionTable:
    """Coefficients of friction at given speeds.

    Attributes
    ----------
    name : of the file.
    speed : m/s, of the centre of the stone. mu : braking force over the weight.
    omega : spin, rad/s; 0 where the table has none. sigma : standard errors of
        mu, if given.
    notes : on how the file was read.

    Examples
    --------
    >>> speed, mu = np.array([0.5, 1.0, 2.0]), np.array([0.012, 0.009, 0.008])
    >>> measured = curlfit.FrictionTable("mine", speed, mu, omega=np.zeros(3))
    """

    name: str
    speed: Floats
    mu: Floats
    omega: Floats
    sigma: Floats | None = None
    notes: tuple[Finding, ...] = ()


def _meaning(heading: str) -> Column | None:
    """What a column holds: "speed", "omega", "mu" or "sigma"; None for another."""
    column = parse_header(heading)
    if column is not None and column.quantity in ("speed", "omega"):
        return column
    word = re.sub(r"[\s_\-./()\[\]]+", "", heading.lower())
    for quantity, words in _COLUMNS.items():
        if re.fullmatch(words, word):
            return Column(quantity, "1", 1.0)
    return None


def _of_friction(named: Mapping[str, str] | None) -> dict[str, str]:
    """The headings that the user names of a table of friction; others are those of
    tracks beside it."""
    return {key: heading for key, heading in (named or {}).items() if _meaning(key)}


def is_friction_table(
    file: Path, worksheet: str | None = None, named: Mapping[str, str] | None = None
) -> bool:
    """Whether a file has columns of speed and friction, and none of time.

    Parameters
    ----------
    named : headings that the user names, by quantity.
    """
    named = _of_friction(named)
    try:
        text = TextFile.read(file, worksheet)
        table = find_table(text, _meaning, _REQUIRED, _EXPECTED, named)
    except InputError:  # told where it is read as what it should be
        return False
    columns = filter(None, map(_meaning, table.headings))
    present = {column.quantity for column in columns} | named.keys()
    times = "t" in quantities_of(table.headings)
    return present >= set(_REQUIRED) and not times


def load_friction_table(
    file: str | PathLike[str],
    worksheet: str | None = None,
    columns: Mapping[str, str] | None = None,
    units: str | None = None,
) -> FrictionTable:
    """Read a table with the columns speed and mu, and if possible sigma_mu and omega.

    Parameters
    ----------
    worksheet : of a workbook, by its name; the first one with data by default.
    columns : headings of columns that are not understood by their names, by what they
        hold: speed, mu, sigma, omega.
    units : in place of those of the headings, such as "speed=km/h".

    Raises
    ------
    DataError : a column is missing, a value is not such a number, or there are fewer
        than three rows.

    Examples
    --------
    >>> table = curlfit.load_friction_table("data/sutor_1988_friction.csv")
    >>> len(table.mu)
    13
    """
    path = Path(file)
    text = TextFile.read(path, worksheet)
    table, values, place_of = read_quantities(
        text, _meaning, _REQUIRED, _EXPECTED, _of_friction(columns), units
    )
    notes = [] if text.note is None else [text.note]
    notes += table.findings
    complete = np.all([np.isfinite(column) for column in values.values()], axis=0)
    if not complete.all():
        gaps = int((~complete).sum())
        notes.append(Finding.note("rows-without-friction", count=gaps))
    lines = np.array(table.rows)[complete] + 1
    values = {name: column[complete] for name, column in values.items()}
    limits = {"speed": _MOST_SPEED, "mu": _MOST, "sigma": _MOST}
    for name, most in limits.items():
        if name not in values:
            continue
        wrong = ~((values[name] > 0) & (values[name] <= most))
        if wrong.any():
            row = int(np.argmax(wrong))
            raise DataError(
                f"{values[name][row]:g} found, expected a number above 0, up to "
                f"{most:g}",
                file=path,
                line=int(lines[row]),
                column=table.headings[place_of[name]],
            )
    if len(values["mu"]) < _LEAST_ROWS:
        fault = f"{counted(len(values['mu']), 'row')}, expected at least {_LEAST_ROWS}"
        raise DataError(fault, file=path)
    return FrictionTable(
        path.name,
        values["speed"],
        values["mu"],
        values.get("omega", np.zeros(len(values["mu"]))),
        values.get("sigma"),
        tuple(notes),
    )
