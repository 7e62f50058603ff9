"""Tables of measured friction against speed, as of a sledge or of a stone
without a path."""

from __future__ import annotations

import re
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from curlfit.errors import DataError, InputError
from curlfit.findings import Finding
from curlfit.foreign import counted
from curlfit.numerics.arrays import Floats
from curlfit.throws.readers.columns import parse_header
from curlfit.throws.readers.text import TextFile, TextTable

_COLUMNS = {
    "mu": "mu|µ|μ|friction|coefficientoffriction|frictioncoefficient",
    "sigma": "(sigma|sd|std|err(or)?|unc(ertainty)?)(mu|friction)?",
}
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
    note : on what of the file was read, if it has more.

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
    note: Finding | None = None


def _quantity(header: str) -> str:
    """What a column is: "speed", "omega", "mu" or "sigma"; empty for another."""
    column = parse_header(header)
    if column is not None and column.quantity in ("speed", "omega"):
        return column.quantity
    word = re.sub(r"[\s_\-./()\[\]]+", "", header.lower())
    return next((name for name, of in _COLUMNS.items() if re.fullmatch(of, word)), "")


def _columns(table: TextTable) -> dict[str, int]:
    return {_quantity(header): place for place, header in enumerate(table.names)}


def is_friction_table(file: Path, worksheet: str | None = None) -> bool:
    """Whether a file has columns of speed and friction, and none of time."""
    try:
        table = TextTable.of(TextFile.read(file, worksheet))
    except InputError:  # told where it is read as what it should be
        return False
    times = [
        header
        for header in table.names
        if (found := parse_header(header)) and found.base == "t"
    ]
    return {"speed", "mu"} <= _columns(table).keys() and not times


def load_friction_table(
    file: str | PathLike[str], worksheet: str | None = None
) -> FrictionTable:
    """Read a table with the columns speed and mu, and if possible sigma_mu and omega.

    Parameters
    ----------
    worksheet : of a workbook, by its name; the first one with data by default.

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
    table = TextTable.of(text)
    places = _columns(table)
    if missing := {"speed", "mu"} - places.keys():
        raise DataError(
            f"no column {' and '.join(sorted(missing))}; expected speed and mu",
            file=path,
        )
    names = [name for name in ("speed", "mu", "omega", "sigma") if name in places]
    numbers = table.numbers([places[name] for name in names])
    values: dict[str, Floats] = dict(zip(names, numbers, strict=True))
    for name in values.keys() & {"speed", "omega"}:
        column = parse_header(table.names[places[name]])
        values[name] = values[name] * (column.factor if column else 1.0)
    lines = table.rows
    limits = {"speed": (0.0, 10.0), "mu": (0.0, _MOST), "sigma": (0.0, _MOST)}
    for name, (low, high) in limits.items():
        if (
            name in values
            and (wrong := ~((values[name] > low) & (values[name] <= high))).any()
        ):
            row = int(np.argmax(wrong))
            raise DataError(
                f"{values[name][row]:g} found, expected a number above "
                f"{low:g}, up to {high:g}",
                file=path,
                line=lines[row] + 1,
                column=table.names[places[name]],
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
        text.note,
    )
