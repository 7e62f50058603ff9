"""The throws of a table of `curlfit batch`, for a second fit of all of them."""

from __future__ import annotations

import csv
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
from curlfit.foreign import counted, printable
from curlfit.friction import Law, find_law
from curlfit.inference.joint.result import JointResult
from curlfit.inference.joint.season import Season, mean_of
from curlfit.inference.model import Model
from curlfit.inference.parameters import START
from curlfit.inference.verdict import Verdict
from curlfit.stone import Stone

_AGAIN = "repeat the batch with --again"
_LONGEST = 100_000  # characters of a cell


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
    size = len(names) * (len(names) + 1)
    labels: list[tuple[str, dict[str, str]]] = []
    numbers: list[list[float]] = []
    information: list[list[float]] = []
    left_open: list[tuple[str, ...]] = []
    not_ok = 0
    doubtful = 0
    try:
        with file.open(encoding="utf-8", newline="") as stream:
            reader = csv.DictReader(stream)
            head = reader.fieldnames or ()
            for name in (*names_of_numbers, "status", INFORMATION, LABELS):
                if name not in head:
                    raise KeyError(f"no column {name}; {_AGAIN}")
            written = columns(chosen)
            if LEFT_OPEN not in head:
                written.remove(LEFT_OPEN)
            added = [name for name in head if name not in written]
            for row in reader:
                if any(len(cell or "") > _LONGEST for cell in row.values()):
                    raise ValueError(f"a cell of more than {_LONGEST} characters")
                if row["status"] != "ok":
                    not_ok += 1
                    continue
                if LEFT_OPEN not in head and not _is_quadratic(row):
                    doubtful += 1
                open_names = row.get(LEFT_OPEN, "").split("; ")
                left_open.append(tuple(filter(None, open_names)))
                throw = f"{file} row {reader.line_num - 1}"
                labels.append((throw, _labels(row, added)))
                numbers.append([float(row[name]) for name in names_of_numbers])
                cells = row[INFORMATION].strip("[]").split(",")
                told = [float(cell) for cell in cells]
                if len(told) not in (size, 2 * size):
                    raise ValueError("another number of numbers")
                # without a ridge there is no second part
                information.append(told + [0.0] * (2 * size - len(told)))
    except KeyError as error:
        raise DataError(error.args[0], file=file, line=1) from None
    except (AttributeError, TypeError, ValueError, csv.Error) as error:
        fault = f"not a row of `curlfit batch`: {printable(str(error))}"
        raise DataError(fault, file=file, line=reader.line_num) from None
    if doubtful:
        raise DataError(
            f"{counted(doubtful, 'throw')} without an angle, which an earlier version "
            f"of curlfit took for quadratics in the coefficients; {_AGAIN}",
            file=file,
        )
    throws = len(numbers)
    table = np.array(numbers).reshape(throws, len(names_of_numbers))
    rows = np.array(information).reshape(throws, 2, len(names), len(names) + 1)
    if not (np.isfinite(table).all() and np.isfinite(rows).all()):
        raise DataError("numbers that are not finite", file=file)
    values, start, durations = np.split(table, [len(names), -1], 1)
    notes = (Finding.note("rows-not-ok", count=not_ok),) if not_ok else ()
    return Season(
        file=str(file),
        model=Model(kind, chosen.load),
        stone=Stone().with_values(dict(chosen.stone)),
        labels=labels,
        values=values,
        start=start,
        durations=durations[:, 0],
        told=rows[:, 0],
        notes=notes,
        conditions=tuple({*chosen.parameter_set().conditions} - {"sweep"}),
        stretched=rows[:, 1],
        left_open=tuple(left_open),
    )


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
