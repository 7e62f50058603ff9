"""Systematic errors due to the conditions that a fit holds fixed, to first order.

If a condition c differs by d from its assumed value, the measured path differs by (df/dc) d, and
the least-squares estimates are shifted: by -(J^T J)^+ J^T W (df/dc) d from the estimate to the true
value, where W contains the weights 1/sigma and J = W (df/dp) is the Jacobian of the weighted
residuals (model - observed). Shifts due to different conditions are independent and add in
quadrature.
"""

from __future__ import annotations

from collections.abc import Mapping

from curlfit.inference.likelihood import predict_many

# isort: split
import numpy as np

from curlfit.inference.conditions import ALL, WIDTHS, check_systematics
from curlfit.inference.identifiability import Identifiability, inverted, visible
from curlfit.inference.model import Model
from curlfit.inference.noise.losses import root_slope
from curlfit.inference.noise.whitening import whitened
from curlfit.inference.problem import Problem
from curlfit.numerics.arrays import Floats
from curlfit.numerics.compiled import unstacked
from curlfit.stone import UNITS as STONE_UNITS
from curlfit.throws.events import EventArrays

_STEP = 1e-2  # of a width, for finite differences: the path is accurate to 1e-7 of it


def widths_of(model: Model, given: Mapping[str, float] | None = None) -> dict[str, float]:
    """Standard uncertainty of each condition that a model holds fixed.

    Parameters
    ----------
    given : in place of `WIDTHS`; 0 where a condition is known. "all" stands for all not named.

    Raises
    ------
    InputError : a name that is not a condition, or a negative width.
    """
    given = dict(given or {})
    check_systematics(given)
    common = given.pop(ALL, None)
    found = {name: width if common is None else common for name, width in WIDTHS.items()} | given
    return {name: width for name, width in found.items() if width and name not in model.conditions}


def residual_changes(
    model: Model,
    problems: Problem,
    values: Floats,
    paths: Floats,
    widths: Mapping[str, float],
    loss: str,
    batch: int,
) -> dict[str, Floats]:
    """Change of the weighted residuals of many throws for one width of each condition.

    Parameters
    ----------
    values : of the parameters, shape (throws, parameters), and their `paths`, (throws, 5, n).
    widths : from `widths_of`.

    Returns
    -------
    By condition, each of the shape of the residuals, (throws, channels, n).
    """
    channels = problems.observed.shape[1]
    found = {}
    for name, width in widths.items():
        if name == "length_scale":
            change = np.zeros_like(paths)
            first = len(model.law.coefficients()) + len(model.conditions)
            change[:, :2] = paths[:, :2] - values[:, first : first + 2, None]
            if problems.events is not None:
                change[:, -1] = _of_events(model, problems, values, paths, width, batch)
            change = change * width
        else:
            changed = with_condition_off(problems, name, _STEP * width)
            change = (predict_many(model, values, changed, batch) - paths) / _STEP
        change = change[:, :channels] * problems.weight
        if problems.whitener is not None:
            pairs = zip(change, unstacked(problems.whitener), strict=True)
            change = np.array([whitened(*pair) for pair in pairs])
        if loss != "linear":
            residual = (paths[:, :channels] - problems.observed) * problems.weight
            change = change * root_slope(residual, loss)
        found[name] = change
    return found


def _of_events(
    model: Model, problems: Problem, values: Floats, paths: Floats, width: float, batch: int
) -> Floats:
    """Derivative of the predicted events by the length scale (measured/true), shape (throws, n)."""
    assert problems.events is not None
    events: EventArrays = problems.events
    first = len(model.law.coefficients()) + len(model.conditions)
    x0, y0 = values[:, first, None], values[:, first + 1, None]
    small = _STEP * width
    nearer = events._replace(lines=y0 + (events.lines - y0) / (1 + small))
    moved = predict_many(model, values, problems._replace(events=nearer), batch)[:, -1]
    places, x, y = events.places()
    found = predict_many(model, values, problems._replace(events=places), batch)[:, -1].copy()
    found[:, : x.shape[1]] -= x * x0 + y * y0
    return (moved - paths[:, -1]) / small + found


def with_condition_off(problems: Problem, name: str, by: float) -> Problem:
    """Problems with a condition changed by `by`."""
    if name == "time_scale":
        events = problems.events
        events = None if events is None else events.with_clock(1 + by)
        return problems._replace(times=problems.times / (1 + by), events=events)
    group = "stone" if name in STONE_UNITS else "environment"
    record = getattr(problems, group)
    values = {key: value + by * (key == name) for key, value in vars(record).items()}
    return problems._replace(**{group: type(record)(**values)})


def shifts(factor: Floats, gradients: Mapping[str, Floats], typical: Floats) -> dict[str, Floats]:
    """Shifts from the estimates to the true values, by condition, along determined directions.

    Parameters
    ----------
    factor : R factor of the Jacobian with respect to the open parameters.
    gradients : J^T times the change of the residuals, by condition.
    typical : sizes of the open parameters.
    """
    _, singular, right = np.linalg.svd(factor * typical, full_matrices=False)
    inverse = right.T * inverted(singular, visible(singular))
    return {
        name: -typical * (inverse @ (inverse.T @ (typical * gradient)))
        for name, gradient in gradients.items()
    }


def shifts_by_name(
    known: Identifiability, by_condition: Mapping[str, Floats]
) -> dict[str, dict[str, float]]:
    """Shifts of each determined parameter and each combination, by condition."""
    return {
        name: {condition: float(row @ shift) for condition, shift in by_condition.items()}
        for name, row in known.determined().items()
    }
