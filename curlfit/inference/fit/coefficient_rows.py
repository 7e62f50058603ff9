"""What a fit of one throw says of the coefficients of its law, whatever the other
parameters are: rows for fits of many throws, and for tables of `curlfit batch`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from curlfit.inference.fit.result import FitResult
from curlfit.inference.information.directions import (
    directions_of_squares,
    standard_error,
)
from curlfit.inference.information.ridge_information import information_along
from curlfit.inference.information.thresholds import WEAK_ERROR
from curlfit.numerics.arrays import Booleans, Floats

# eigenvalue over the largest, of information in typical sizes, that is not rounding
_SEEN = 1e-10

# share of a coefficient in what the data cannot tell in any case
_HARDLY_TOLD = 0.5


def rows_told(fit: FitResult, names: Sequence[str] | None = None) -> Floats:
    """All that the throw says of the coefficients of its law, or of the named
    parameters: `coefficient_rows`, or both parts along the ridge, one after
    the other."""
    if fit.ridge:
        return np.vstack(coefficient_rows_along_ridge(fit, names))
    return coefficient_rows(fit, names)


def coefficient_rows(fit: FitResult, names: Sequence[str] | None = None) -> Floats:
    """What the throw says of the coefficients of its law, or of the named
    parameters, to first order about its optimum: rows that are multiplied by these,
    with what they then give as the last column, shape
    (coefficients, coefficients + 1); errors are one."""
    names = list(fit.coefficients) if names is None else names
    free, typical, matrix, gradient = _information_in_typical_sizes(fit)
    wanted = _among(free, names)
    # Whatever the other parameters are: the Schur complement.
    inverse = np.linalg.pinv(matrix[~wanted][:, ~wanted], hermitian=True)
    follow: Any = matrix[wanted][:, ~wanted] @ inverse
    reduced = matrix[wanted][:, wanted] - follow @ matrix[~wanted][:, wanted]
    reduced_gradient = gradient[wanted] - follow @ gradient[~wanted]
    squares, axes = np.linalg.eigh(reduced)
    seen = squares > _SEEN * squares.max(initial=0.0)
    root = np.sqrt(squares[seen])
    directions_seen = axes[:, seen].T
    slopes = directions_seen * root[:, None] / typical[wanted]
    steps = directions_seen @ reduced_gradient / root
    rows = _padded(fit, np.column_stack([slopes, steps]), names)
    values = np.array([fit.parameters[name].value for name in names])
    count = len(steps)
    rows[:count, -1] += rows[:count, :-1] @ values
    return rows


def coefficient_rows_along_ridge(
    fit: FitResult, names: Sequence[str] | None = None
) -> tuple[Floats, Floats]:
    """What the throw says of the coefficients of its law, or of the named
    parameters, where chi squared is no quadratic: rows as those of
    `coefficient_rows`, of which the second are as wide as the ridge, each of shape
    (coefficients, coefficients + 1)."""
    names = list(fit.coefficients) if names is None else names
    free, typical, matrix, gradient = _information_in_typical_sizes(fit)
    rises = np.array([point.rise for point in fit.ridge])
    moves = _moves_along_ridge(fit, free) / typical
    step: Any = np.linalg.pinv(matrix, rcond=_SEEN, hermitian=True) @ gradient
    wanted = _among(free, names)
    kept, stretched = information_along(matrix, moves, rises).of(wanted, step)
    values = np.array([fit.parameters[name].value for name in names])
    sizes = np.append(typical[wanted], 1.0)
    rows_kept = _padded(fit, kept / sizes, names)
    rows_kept[:, -1] += rows_kept[:, :-1] @ values
    rows_stretched = _padded(fit, stretched / sizes, names)
    rows_stretched[:, -1] += rows_stretched[:, :-1] @ values
    return rows_kept, rows_stretched


def stderr_of_coefficients(fit: FitResult, weights: Floats) -> float | None:
    """Standard error of a weighted sum of the coefficients of the law, as wide as
    the ridge; None where the throw says nothing of it."""
    typical = np.array(
        [coefficient.typical for coefficient in fit.coefficients.values()]
    )
    rows = rows_told(fit)[:, :-1]
    return standard_error(rows * typical, weights * typical)


def left_open(fit: FitResult) -> tuple[str, ...]:
    """Coefficients that the ridge leaves open: that differ along it, and of which
    the throw says too little, though it would with its initial state known. None
    where chi squared is a quadratic."""
    if not fit.ridge:
        return ()
    names = [name for name in fit.coefficients if name in fit.information.names]
    typical = np.array([fit.parameters[name].typical for name in names])
    moves = np.abs(_moves_along_ridge(fit, names) / typical).max(0)
    places = [fit.information.names.index(name) for name in names]
    with_start_known = fit.information.matrix[np.ix_(places, places)]
    *_, null = directions_of_squares(with_start_known, typical)
    # Each of two coefficients of which only the sum enters has a share of 0.7.
    told = np.linalg.norm(null, axis=0) < _HARDLY_TOLD
    open_ = []
    for name, move, is_told in zip(names, moves, told, strict=True):
        unit = np.array([1.0 if other == name else 0.0 for other in fit.coefficients])
        stderr = stderr_of_coefficients(fit, unit)
        weak = WEAK_ERROR * fit.parameters[name].typical
        if move > WEAK_ERROR and is_told and (stderr is None or stderr >= weak):
            open_.append(name)
    return tuple(open_)


def _moves_along_ridge(fit: FitResult, names: Sequence[str]) -> Floats:
    """Moves of parameters from the estimates to the points of the ridge, shape
    (points, parameters)."""
    places = [list(fit.parameters).index(name) for name in names]
    points = np.array([point.values for point in fit.ridge])
    return (points.reshape(-1, len(fit.parameters)) - fit.values)[:, places]


def _information_in_typical_sizes(
    fit: FitResult,
) -> tuple[Sequence[str], Floats, Floats, Floats]:
    """Names of the free parameters, their typical sizes, and the information matrix
    and the gradient in these."""
    names = fit.information.names
    typical = np.array([fit.parameters[name].typical for name in names])
    matrix = fit.information.matrix * typical * typical[:, None]
    gradient = fit.information.gradient * typical
    return names, typical, matrix, gradient


def _padded(fit: FitResult, rows: Floats, names: Sequence[str]) -> Floats:
    """Rows on the free ones of some parameters, with what they give as the last
    column, as rows on all of these parameters, as many as there are of them."""
    columns = np.append(_among(names, fit.information.names), True)
    padded = np.zeros((len(names), len(names) + 1))
    padded[: len(rows), columns] = rows
    return padded


def _among(names: Sequence[str], others: Sequence[str]) -> Booleans:
    """Whether each name is among others."""
    return np.array([name in others for name in names], bool)
