"""Rows of a batch's table: throws of many files, read and fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any

from curlfit.batch.settings import (
    DURATION,
    INFORMATION,
    LABELS,
    LEFT_OPEN,
    QUANTILES,
    BatchSettings,
    columns,
)
from curlfit.batch.table import ODD
from curlfit.errors import CurlfitError, UnusableFitError
from curlfit.findings import Finding
from curlfit.inference.fit.coefficient_rows import left_open, rows_told
from curlfit.inference.fit.fit import fit_throws
from curlfit.inference.fit.result import FitResult
from curlfit.settings.choices import Fitting
from curlfit.throws.load import Part, parts_of
from curlfit.throws.odd_row import odd_row_findings
from curlfit.throws.throw import Throw


def fit_files(
    files: Sequence[str | PathLike[str]], plan: BatchSettings
) -> list[dict[str, Any]]:
    """One row for each throw in the files, in their order, with the keys of `columns`.

    The status is "ok", "odd" (a row of a stopwatch table that contradicts the others
    and is left out), "not usable" (the data were read but gave no usable fit) or
    "failed" (they could not be read); `reason` says why. Unavailable values are
    missing.

    Raises
    ------
    InputError : the settings themselves are impossible.
    """
    rows, names, parts = [], columns(plan), _read(files, plan)
    throws = [
        part.throw
        for _, part in parts
        if isinstance(part.throw, Throw) and part.odd_row is None
    ]
    choices = {name: getattr(plan, name) for name in Fitting.forms()}
    choices["systematics"] = plan.systematics or None
    fits = iter(fit_throws(throws, curves=bool(plan.systematics), **choices))
    sums = tuple(plan.sums())
    for file, part in parts:
        row: dict[str, Any] = dict.fromkeys(names)
        row |= {"file": file, "shot": part.shot, "stone_index": part.stone_index}
        if part.odd_row is not None:
            (odd,) = odd_row_findings([part.odd_row])
            row["status"] = ODD
            row["reason"] = str(odd)
            rows.append(row)
            continue
        result = next(fits) if isinstance(part.throw, Throw) else part.throw
        if isinstance(result, CurlfitError):
            row["status"] = "not usable" if isinstance(part.throw, Throw) else "failed"
            row["reason"] = str(result).removeprefix(f"{file}: ")
        else:
            row |= _row(result, plan, sums)
        rows.append(row)
    return rows


def _read(
    files: Sequence[str | PathLike[str]], plan: BatchSettings
) -> list[tuple[str, Part]]:
    """Every throw in the files, with the name of its file."""
    found = []
    for file in map(str, files):
        try:
            parts = parts_of(file, plan)
        except CurlfitError as error:
            parts = [Part(None, None, error)]
        found += [
            (file, part._replace(throw=part.alone or part.throw)) for part in parts
        ]
    return found


def _row(result: FitResult, plan: BatchSettings, sums: Sequence[str]) -> dict[str, Any]:
    labels = result.data.labels.items()
    row: dict[str, Any] = {
        "status": "ok" if result.converged else "not usable",
        "reason": None if result.converged else result.status,
        "n_observations": result.n_observations,
        "combinations": "; ".join(
            f"{item.expression} = {item.value!r}"
            + ("" if item.stderr is None else f" +- {item.stderr!r}")
            for item in result.combinations
        ),
        DURATION: result.data.end - result.data.begin,
        LABELS: "; ".join(
            f"{name} = {label.replace(';', ',')}" for name, label in labels
        ),
        **{f"rms_{name}": result.rms.get(name) for name in ("x", "y", "phi")},
        **{f"{name}_verdict": item.verdict for name, item in result.parameters.items()},
    }

    def column(name: str, what: str) -> str:
        return f"{name}{'_' if name in result.parameters else ' '}{what}"

    known: dict[str, Any] = dict(result.parameters)
    known |= {
        item.expression: item for item in result.combinations if item.expression in sums
    }
    if result.converged:
        numbers = rows_told(result).ravel()
        told = ", ".join(f"{number:.17g}" for number in numbers)
        row[INFORMATION] = f"[{told}]"
        row[LEFT_OPEN] = "; ".join(left_open(result))
        known |= {
            item.expression: item for item in result.with_derived(plan.derive).derived
        }
    for name, item in known.items():
        row |= {name: item.value, column(name, "stderr"): item.stderr}
    if plan.systematics:
        for name, error in result.systematics.errors.items():
            row[column(name, "systematic")] = error
    warnings = list(result.warnings)
    if plan.posterior and result.converged:
        quantiles_by_name, warnings_of_posterior = _sampled(result, plan.seed)
        warnings += warnings_of_posterior
        for name, quantiles in quantiles_by_name.items():
            if name in known:
                row |= {column(name, q): quantiles[q] for q in QUANTILES}
    row["warnings"] = "; ".join(map(str, warnings))
    return row


def _sampled(
    result: FitResult, seed: int
) -> tuple[Mapping[str, Mapping[str, float]], list[Finding]]:
    """Quantiles of the posterior by name, or a warning that says why there are none."""
    from curlfit.inference.mcmc.sampler import sample

    try:
        sampled, _ = sample(result, seed=seed)
    except UnusableFitError as error:
        return {}, [Finding.warning("no-posterior", fault=str(error))]
    posterior = sampled.posterior
    assert posterior is not None
    if not posterior.converged:
        return {}, [Finding.warning("no-quantiles", status=posterior.status)]
    return posterior.quantiles, []
