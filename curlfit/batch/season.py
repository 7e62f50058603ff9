"""The throws of a table of `curlfit batch`, for a second fit of all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path

import numpy as np

from curlfit.batch.settings import (
    DURATION,
    INFORMATION,
    LABELS,
    LEFT_OPEN,
    BatchSettings,
    columns,
)
from curlfit.batch.table import plan_of, settings_file
from curlfit.errors import DataError
from curlfit.findings import Finding
from curlfit.foreign import counted
from curlfit.friction import Law, find_law
from curlfit.inference.joint.result import JointResult
from curlfit.inference.joint.season import Season, mean_of
from curlfit.inference.model import Model
from curlfit.inference.parameters import START
from curlfit.inference.verdict import Verdict
from curlfit.numerics.arrays import Floats
from curlfit.stone import Stone
from curlfit.throws.readers.table import Table
from curlfit.throws.readers.text import TextFile

_AGAIN = "repeat the batch with --again"


def fit_season(
    file: str | PathLike[str],
    law: str | type[Law] | None = None,
    *,
    by: str | Sequence[str] = (),
    trend: str | Sequence[str] = (),
    trend_by: str | Sequence[str] = (),
    seed: int | None = None,
) -> JointResult:
    """Fit the mean of the throws in a table of `curlfit batch`, and how they
    vary about it.

    To first order it is what `fit_together` finds from the throws themselves. The cost
    is small: seconds for ten thousand throws.

    Parameters
    ----------
    file : the table, beside its settings.
    law : the law of the table, if it is your own.
    by, trend, trend_by : labels of the rows, or columns that were added, as in
        `fit_together`.
    seed : as in `fit_together`.

    Raises
    ------
    DataError : a file that is no such table, or is damaged.
    InputError : too few throws; labels that a throw lacks, or that give no
        groups or numbers.

    Examples
    --------
    >>> season = curlfit.fit_season("season.csv", by="sheet")
    >>> season.differences[-1].parameter, season.differences[-1].group
    ('hog_to_hog', '2')
    """
    return mean_of(_read(Path(file), law), by, trend, seed, trend_by)


def _read(file: Path, law: str | type[Law] | None = None) -> Season:
    """The usable throws of a table, with the labels of their rows and of columns
    that were added.

    Parameters
    ----------
    law : in place of the one that the settings of the table name.

    Raises
    ------
    DataError : a table of an earlier version or without its settings, or a cell that
        is no number.
    """
    plan = plan_of(settings_file(file), _AGAIN)
    kind = find_law(law) if law else find_law(str(plan.get("law")), from_files=False)
    chosen = BatchSettings.of(plan, law=kind)
    if chosen.priors:
        raise DataError(
            "priors of the batch would count once for each throw", file=file
        )
    names = [item.name for item in kind.coefficients()]
    names_of_numbers = [*names, *(item.name for item in START), DURATION]
    table = Table.find(TextFile.read(file), _is_header)
    needed = (*names_of_numbers, "status", INFORMATION, LABELS)
    place_of = table.sole(table.headings)
    for name in needed:
        if name not in place_of:
            raise table.error(f"no column {name}; {_AGAIN}")
    with_left_open = LEFT_OPEN in place_of
    written = set(columns(chosen))
    added = [name for name in place_of if name not in written]
    rows = [dict(zip(table.headings, row, strict=True)) for row in table.cells]
    usable = [number for number, row in enumerate(rows) if row["status"] == "ok"]
    doubtful = sum(
        not with_left_open and not _is_quadratic(rows[number]) for number in usable
    )
    if doubtful:
        raise DataError(
            f"{counted(doubtful, 'throw')} without an angle, which an earlier version "
            f"of curlfit took for quadratics in the coefficients; {_AGAIN}",
            file=file,
        )
    places = [place_of[name] for name in names_of_numbers]
    numbers = np.column_stack(table.numbers(places))[usable]
    _require_finite(table, numbers, usable)
    information = [
        _information(table, number, rows[number][INFORMATION], len(names))
        for number in usable
    ]
    stacked = np.array(information).reshape(-1, 2, len(names), len(names) + 1)
    values, start, durations = np.split(numbers, [len(names), -1], 1)
    not_ok = len(rows) - len(usable)
    notes = [*table.findings]
    if not_ok:
        notes.append(Finding.note("rows-not-ok", count=not_ok))
    return Season(
        file=str(file),
        model=Model(kind, chosen.load),
        stone=Stone().with_values(dict(chosen.stone)),
        labels=[
            (f"{file} row {number + 1}", _labels(rows[number], added))
            for number in usable
        ],
        values=values,
        start=start,
        durations=durations[:, 0],
        told=stacked[:, 0],
        notes=tuple(notes),
        conditions=tuple({*chosen.parameter_set().conditions} - {"sweep"}),
        stretched=stacked[:, 1],
        left_open=tuple(
            tuple(filter(None, rows[number].get(LEFT_OPEN, "").split("; ")))
            for number in usable
        ),
    )


def _is_header(table: Table) -> bool:
    """Whether headings are those of a table of `curlfit batch`."""
    return {"file", "status"} <= set(table.headings)


def _require_finite(table: Table, numbers: Floats, usable: Sequence[int]) -> None:
    """Raise `DataError` for a usable row without all of its numbers."""
    bad = ~np.isfinite(numbers).all(axis=1)
    if bad.any():
        row = table.rows[usable[int(np.argmax(bad))]]
        raise table.file.error("numbers that are not finite", row)


def _information(
    table: Table, number: int, cell: str, coefficients: int
) -> list[float]:
    """The rows of information of a throw, and those along a ridge, which are zeros
    where it has none.

    Raises
    ------
    DataError : not as many finite numbers.
    """
    size = coefficients * (coefficients + 1)
    try:
        told = [float(text) for text in cell.strip("[]").split(",")]
    except ValueError:
        told = []
    if len(told) not in (size, 2 * size) or not np.isfinite(told).all():
        raise table.not_a(
            f"list of {size} finite numbers or twice as many",
            number,
            table.headings.index(INFORMATION),
        )
    return told + [0.0] * (2 * size - len(told))


def _is_quadratic(row: Mapping[str, str]) -> bool:
    """Whether a throw of an earlier version, which took all for quadratics, is one
    as a rule: the angle was measured, or the path of a stone whose spin was given."""
    has_path = bool(row["rms_x"] or row["rms_y"])
    return bool(row["rms_phi"]) or (has_path and row["omega0_verdict"] == Verdict.FIXED)


def _labels(row: Mapping[str, str], added: Sequence[str]) -> dict[str, str]:
    """The labels of a row, and the cells of the columns that were added
    to the table."""
    pairs = (pair.partition(" = ") for pair in row[LABELS].split("; ") if pair)
    return {name: label for name, _, label in pairs} | {
        name: row[name] for name in added if row[name]
    }
