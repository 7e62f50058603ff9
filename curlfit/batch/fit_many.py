"""Rows of a batch's table: throws of many files, read and fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike
from typing import Any

from curlfit.batch.columns import BatchRow, columns
from curlfit.batch.settings import BatchSettings
from curlfit.batch.table import Status
from curlfit.errors import CurlfitError, UnusableFitError
from curlfit.findings import Finding
from curlfit.inference.fit.fit import fit_throws
from curlfit.inference.fit.result import FitResult
from curlfit.settings.choices import Fitting
from curlfit.throws.load import Part, parts_of
from curlfit.throws.odd_row import odd_row_findings
from curlfit.throws.throw import Throw


def fit_files(
    files: Sequence[str | PathLike[str]], plan: BatchSettings
) -> list[dict[str, Any]]:
    """One row for each throw in the files, in their order, by the names of the columns.

    The status is "ok", "odd" (a row of a stopwatch table that contradicts the others
    and is left out), "not usable" (the data were read but gave no usable fit) or
    "failed" (they could not be read); `reason` says why. Unavailable values are
    missing.

    Raises
    ------
    InputError : the settings themselves are impossible.
    """
    columns_of_table = columns(plan)
    parts = _read(files, plan)
    throws = [
        part.throw
        for _, part in parts
        if isinstance(part.throw, Throw) and part.odd_row is None
    ]
    choices = {name: getattr(plan, name) for name in Fitting.forms()}
    choices["systematics"] = plan.systematics or None
    fits = iter(fit_throws(throws, curves=bool(plan.systematics), **choices))
    rows = []
    for file, part in parts:
        row = BatchRow(file, part.shot, part.stone_index, status=Status.FAILED)
        if part.odd_row is not None:
            finding = odd_row_findings([part.odd_row])[0]
            row = replace(row, status=Status.ODD, reason=str(finding))
        elif isinstance(part.throw, CurlfitError):
            row = replace(row, reason=_without_file(part.throw, file))
        else:
            row = _with_fit(row, next(fits), plan)
        rows.append({column.name: column.get(row) for column in columns_of_table})
    return rows


def _read(
    files: Sequence[str | PathLike[str]], plan: BatchSettings
) -> list[tuple[str, Part]]:
    """Every throw in the files, with the name of its file."""
    parts_by_file = []
    for file in map(str, files):
        try:
            parts = parts_of(file, plan)
        except CurlfitError as error:
            parts = [Part(None, None, error)]
        for part in parts:
            parts_by_file.append((file, part._replace(throw=part.alone or part.throw)))
    return parts_by_file


def _without_file(error: CurlfitError, file: str) -> str:
    """What an error says; the file is in a column of its own."""
    return str(error).removeprefix(f"{file}: ")


def _with_fit(
    row: BatchRow, fit: FitResult | CurlfitError, plan: BatchSettings
) -> BatchRow:
    """The row of a throw that was read, with its fit or the error that it gave."""
    if isinstance(fit, CurlfitError):
        reason = _without_file(fit, row.file)
        return replace(row, status=Status.NOT_USABLE, reason=reason)
    if not fit.converged:
        return replace(
            row,
            status=Status.NOT_USABLE,
            reason=fit.status,
            fit=fit,
            warnings=fit.warnings,
        )
    quantiles: Mapping[str, Mapping[str, float]] = {}
    warnings = list(fit.warnings)
    if plan.posterior:
        quantiles, warnings_of_posterior = _sampled(fit, plan.seed)
        warnings += warnings_of_posterior
    derived = [fit.derive(expression) for expression in plan.derive]
    return replace(
        row,
        status=Status.OK,
        fit=fit,
        derived={quantity.expression: quantity for quantity in derived},
        quantiles=quantiles,
        warnings=warnings,
    )


def _sampled(
    result: FitResult, seed: int
) -> tuple[Mapping[str, Mapping[str, float]], list[Finding]]:
    """Quantiles of the posterior by name, or a warning that says why there are none."""
    from curlfit.inference.sampling.sampler import sample

    try:
        fit_with_posterior, _ = sample(result, seed=seed)
    except UnusableFitError as error:
        return {}, [Finding.warning("no-posterior", fault=str(error))]
    posterior = fit_with_posterior.posterior
    assert posterior is not None
    if not posterior.converged:
        return {}, [Finding.warning("no-quantiles", status=posterior.status)]
    return posterior.quantiles, []
