"""Systematic errors due to the conditions that a fit holds fixed, to first order.

If a condition c differs by d from its assumed value, the measured path differs by (df/dc) d, and
the least-squares estimates are shifted: by -(J^T J)^+ J^T W (df/dc) d from the estimate to the true
value, where W contains the weights 1/sigma and J = W (df/dp) is the Jacobian of the weighted
residuals (model - observed). Shifts due to different conditions are independent and add in
quadrature.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from curlfit.inference.conditions import ALL, CALIBRATION, WIDTHS, check_systematics
from curlfit.inference.fit.prepared import PreparedThrow
from curlfit.inference.identifiability import Identifiability, inverted, visible
from curlfit.inference.likelihood import predict_many
from curlfit.inference.model import Model
from curlfit.inference.noise.losses import root_slope
from curlfit.inference.noise.whitening import whitened
from curlfit.inference.problem import Problem
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import unstacked
from curlfit.stone import UNITS as STONE_UNITS
from curlfit.throws.events import EventArrays
from curlfit.throws.readers.homography import displacements

_STEP = 1e-2  # of a width, for finite differences: the path is accurate to 1e-7 of it


def widths_of(
    model: Model, given: Mapping[str, float] | None = None, errors: int = 0
) -> dict[str, float]:
    """Standard uncertainty of each condition that a model holds fixed.

    Parameters
    ----------
    given : in place of `WIDTHS`; 0 where a condition is known. "all" stands for all not named.
    errors : number of independent errors of calibration.

    Raises
    ------
    InputError : a name that is not a condition, or a negative width.
    """
    given = dict(given or {})
    check_systematics(given)
    common = given.pop(ALL, None)
    of_calibration = given.pop(CALIBRATION, 1.0 if common is None else common)
    found = {name: width if common is None else common for name, width in WIDTHS.items()} | given
    found |= {f"{CALIBRATION}_{k + 1}": of_calibration for k in range(errors)}
    return {name: width for name, width in found.items() if width and name not in model.conditions}


def calibrations_of(throws: Sequence[PreparedThrow], *, jointly: bool = False) -> Floats:
    """Independent errors of the calibration of each throw, in the problems' coordinates, shape
    (throws, errors, 3, 3), with zeros where a throw does not have one.

    Throws that are fitted `jointly` share the errors of a calibration, and each of several
    calibrations has its own.
    """
    known = [one.throw.calibration for one in throws]
    distinct: list[Floats] = []
    for one in known if jointly else ():
        if one is not None and not any(np.array_equal(one, other) for other in distinct):
            distinct.append(one)
    most = max((len(one) for one in known if one is not None), default=0)
    found = np.zeros((len(throws), most * max(len(distinct), 1), 3, 3))
    for row, (throw, one) in enumerate(zip(throws, known, strict=True)):
        if one is not None:
            first = most * next((k for k, d in enumerate(distinct) if np.array_equal(one, d)), 0)
            found[row, first : first + len(one)] = throw.calibration
    return found


def residual_changes(
    model: Model,
    problems: Problem,
    values: Floats,
    paths: Floats,
    widths: Mapping[str, float],
    loss: str,
    batch: int,
    calibrations: Floats | None = None,
) -> dict[str, Floats]:
    """Change of the weighted residuals of many throws for one width of each condition.

    Parameters
    ----------
    values : of the parameters, shape (throws, parameters), and their `paths`, (throws, 5, n).
    widths : from `widths_of`. calibrations : from `calibrations_of`.

    Returns
    -------
    By condition, each of the shape of the residuals, (throws, channels, n).
    """
    channels = problems.observed.shape[1]
    found = {}
    for name, width in widths.items():
        if name.startswith(CALIBRATION):
            assert calibrations is not None
            error = calibrations[:, int(name.removeprefix(f"{CALIBRATION}_")) - 1, None]
            change = np.zeros_like(paths)
            change[:, :2] = -width * displacements(error, paths[:, 0], paths[:, 1])[:, 0]
        elif name == "length_scale":
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
    """Problems with a condition changed by `by`; the calibration does not change the motion."""
    if name.startswith(CALIBRATION):
        return problems
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
