"""The throws of a table of `curlfit batch`, for a second fit of all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path

import numpy as np

from curlfit.batch.columns import (
    DURATION,
    FILE,
    INFORMATION,
    LABELS,
    LEFT_OPEN,
    RMS_PHI,
    RMS_X,
    RMS_Y,
    STATUS,
    names_of_columns,
)
from curlfit.batch.settings import BatchSettings
from curlfit.batch.table import Status, plan_of, settings_file
from curlfit.errors import DataError
from curlfit.findings import Finding
from curlfit.foreign import counted
from curlfit.friction import Law, find_law
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.model import Model
from curlfit.inference.model.parameters import START_NAMES
from curlfit.inference.together.result import JointResult
from curlfit.inference.together.season import Season, mean_of
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
    if law:
        law_of_table = find_law(law)
    else:  # a table must not make curlfit run a file
        law_of_table = find_law(str(plan.get("law")), from_files=False)
    settings = BatchSettings.of(plan, law=law_of_table)
    if settings.priors:
        raise DataError(
            "priors of the batch would count once for each throw", file=file
        )
    coefficients = [coefficient.name for coefficient in law_of_table.coefficients()]
    names_of_numbers = [*coefficients, *START_NAMES, DURATION.name]
    table = Table.find(TextFile.read(file), _is_header)
    index_by_name = table.sole(table.headings)
    for name in (*names_of_numbers, STATUS.name, INFORMATION.name, LABELS.name):
        if name not in index_by_name:
            raise table.error(f"no column {name}; {_AGAIN}")
    names_of_batch = names_of_columns(settings)
    added_names = [name for name in index_by_name if name not in names_of_batch]
    rows = [dict(zip(table.headings, cells, strict=True)) for cells in table.cells]
    usable = [index for index, row in enumerate(rows) if row[STATUS.name] == Status.OK]
    usable_rows = [rows[index] for index in usable]
    if LEFT_OPEN.name not in index_by_name:
        _require_quadratic(usable_rows, file)
    indices = [index_by_name[name] for name in names_of_numbers]
    numbers = np.column_stack(table.numbers(indices))[usable]
    _require_finite(table, numbers, usable)
    values, start, durations = np.split(numbers, [len(coefficients), -1], 1)
    information = [
        _information(table, index, rows[index][INFORMATION.name], len(coefficients))
        for index in usable
    ]
    # of each throw the rows of information, then those along its ridge
    information_rows = np.array(information).reshape(
        -1, 2, len(coefficients), len(coefficients) + 1
    )
    notes = [*table.findings]
    not_ok = len(rows) - len(usable)
    if not_ok:
        notes.append(Finding.note("rows-not-ok", count=not_ok))
    return Season(
        file=str(file),
        model=Model(law_of_table, settings.load),
        stone=Stone().with_values(dict(settings.stone)),
        labels=[
            (f"{file} row {index + 1}", _labels(rows[index], added_names))
            for index in usable
        ],
        values=values,
        start=start,
        durations=durations[:, 0],
        coefficient_rows=information_rows[:, 0],
        notes=tuple(notes),
        conditions=tuple({*settings.parameter_set().conditions} - {"sweep"}),
        stretched=information_rows[:, 1],
        left_open=tuple(map(_left_open, usable_rows)),
    )


def _is_header(table: Table) -> bool:
    """Whether headings are those of a table of `curlfit batch`."""
    return {FILE.name, STATUS.name} <= set(table.headings)


def _require_quadratic(rows: Sequence[Mapping[str, str]], file: Path) -> None:
    """Raise `DataError` for throws of an earlier version that it took wrongly for
    quadratics in the coefficients."""
    doubtful = sum(not _is_quadratic(row) for row in rows)
    if doubtful:
        raise DataError(
            f"{counted(doubtful, 'throw')} without an angle, which an earlier version "
            f"of curlfit took for quadratics in the coefficients; {_AGAIN}",
            file=file,
        )


def _require_finite(table: Table, numbers: Floats, usable: Sequence[int]) -> None:
    """Raise `DataError` for a usable row without all of its numbers."""
    bad = ~np.isfinite(numbers).all(axis=1)
    if bad.any():
        row = table.rows[usable[int(np.argmax(bad))]]
        raise table.file.error("numbers that are not finite", row)


def _information(table: Table, index: int, cell: str, coefficients: int) -> list[float]:
    """The rows of information of a throw about so many coefficients, and those along
    a ridge, which are zeros where it has none.

    Raises
    ------
    DataError : not as many finite numbers.
    """
    size = coefficients * (coefficients + 1)
    try:
        numbers = [float(text) for text in cell.strip("[]").split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (size, 2 * size) or not np.isfinite(numbers).all():
        raise table.not_a(
            f"list of {size} finite numbers or twice as many",
            index,
            table.headings.index(INFORMATION.name),
        )
    return numbers + [0.0] * (2 * size - len(numbers))


def _is_quadratic(row: Mapping[str, str]) -> bool:
    """Whether a throw of an earlier version, which took all for quadratics, is one
    as a rule: the angle was measured, or the path of a stone whose spin was given."""
    has_path = bool(row[RMS_X.name] or row[RMS_Y.name])
    given_spin = row["omega0_verdict"] == Verdict.FIXED
    return bool(row[RMS_PHI.name]) or (has_path and given_spin)


def _labels(row: Mapping[str, str], added: Sequence[str]) -> dict[str, str]:
    """The labels of a row, and its cells in the columns that were added to the
    table."""
    labels = {}
    for pair in filter(None, row[LABELS.name].split("; ")):
        name, _, label = pair.partition(" = ")
        labels[name] = label
    for name in added:
        if row[name]:
            labels[name] = row[name]
    return labels


def _left_open(row: Mapping[str, str]) -> tuple[str, ...]:
    """The coefficients that a throw leaves open; none in tables of earlier versions."""
    return tuple(filter(None, row.get(LEFT_OPEN.name, "").split("; ")))
