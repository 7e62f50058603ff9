"""What a fit of one throw says of the coefficients of its law, whatever the other
parameters are: rows for fits of many throws, and for tables of `curlfit batch`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from curlfit.inference.fit.result import FitResult
from curlfit.inference.information.directions import (
    directions_of_squares,
    standard_error,
)
from curlfit.inference.information.information import Information
from curlfit.inference.information.ridge_information import information_along
from curlfit.inference.information.thresholds import WEAK_ERROR
from curlfit.numerics.arrays import Floats

_UNSEEN_SHARE = 0.5
"""Share of a coefficient in what the data cannot tell in any case, below which it is
told of: each of two coefficients of which only the sum enters has a share of 0.7."""


def all_coefficient_rows(fit: FitResult, names: Sequence[str] | None = None) -> Floats:
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
    information = _information_of(fit)
    marginal = information.marginal(np.isin(information.names, names)).information
    return _as_table(marginal.along_axes(), names)


def coefficient_rows_along_ridge(
    fit: FitResult, names: Sequence[str] | None = None
) -> tuple[Floats, Floats]:
    """What the throw says of the coefficients of its law, or of the named
    parameters, where chi squared is no quadratic: rows as those of
    `coefficient_rows`, of which the second are as wide as the ridge, each of shape
    (coefficients, coefficients + 1)."""
    names = list(fit.coefficients) if names is None else names
    information = _information_of(fit)
    moves = _moves_along_ridge(fit, information.names) / information.typical
    rises = np.array([point.rise for point in fit.ridge])
    of_throw = information_along(information, moves, rises)
    marginal = of_throw.marginal(np.isin(information.names, names))
    return _as_table(marginal.kept, names), _as_table(marginal.stretched, names)


def left_open(fit: FitResult) -> tuple[str, ...]:
    """Coefficients that the ridge leaves open: that differ along it, and of which
    the throw says too little, though it would with its initial state known. None
    where chi squared is a quadratic."""
    if not fit.ridge:
        return ()
    coefficients = list(fit.coefficients)
    typical = np.array([fit.parameters[name].typical for name in coefficients])
    rows = all_coefficient_rows(fit)[:, :-1] * typical
    free = [name for name in coefficients if name in fit.information.names]
    is_free = np.isin(coefficients, free)
    moves = np.abs(_moves_along_ridge(fit, free) / typical[is_free]).max(0)
    with_start_known = fit.information.among(free)
    *_, null = directions_of_squares(with_start_known, typical[is_free])
    unseen_shares = np.linalg.norm(null, axis=0)
    open_ = []
    for name, move, unseen in zip(free, moves, unseen_shares, strict=True):
        weights = typical * [other == name for other in coefficients]
        stderr = standard_error(rows, weights)
        weak = WEAK_ERROR * fit.parameters[name].typical
        is_weak = stderr is None or stderr >= weak
        if move > WEAK_ERROR and unseen < _UNSEEN_SHARE and is_weak:
            open_.append(name)
    return tuple(open_)


def _moves_along_ridge(fit: FitResult, names: Sequence[str]) -> Floats:
    """Moves of parameters from the estimates to the points of the ridge, shape
    (points, parameters)."""
    columns = [list(fit.parameters).index(name) for name in names]
    points = np.array([point.values for point in fit.ridge])
    return (points.reshape(-1, len(fit.parameters)) - fit.values)[:, columns]


def _information_of(fit: FitResult) -> Information:
    """What a record says of its free parameters, about the estimates."""
    saved = fit.information
    estimates = [fit.parameters[name] for name in saved.names]
    return Information.of_squares(
        saved.names,
        np.array([estimate.value for estimate in estimates]),
        np.array([estimate.typical for estimate in estimates]),
        saved.matrix,
        saved.gradient,
    )


def _as_table(information: Information, names: Sequence[str]) -> Floats:
    """As many rows as there are names, of which some may be fixed, with what they give
    as the last column."""
    count = len(information.rows)
    columns = [names.index(name) for name in information.names]
    table = np.zeros((len(names), len(names) + 1))
    table[:count, columns] = information.slopes
    table[:count, -1] = information.slopes @ information.values - information.residual
    return table
