"""Systematic errors due to the conditions that a fit holds fixed, to first order.

If a condition c differs by d from its assumed value, the measured path differs by
(df/dc) d, and the least-squares estimates are shifted: by -(J^T J)^+ J^T W (df/dc) d
from the estimate to the true value, where W contains the weights 1/sigma and J = W
(df/dp) is the Jacobian of the weighted residuals (model - observed). Shifts due to
different conditions are independent and add in quadrature.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from curlfit.inference.model.conditions import (
    ALL,
    CALIBRATION,
    SPIN,
    UNKNOWN_SPIN,
    WIDTHS,
    check_systematics,
    is_calibration,
)
from curlfit.inference.model.likelihood import predict_many
from curlfit.inference.model.model import Model
from curlfit.inference.model.parameters import START_INDEX
from curlfit.inference.model.problem import Problem
from curlfit.inference.model.request import Request
from curlfit.inference.noise.whitening import whitened
from curlfit.losses import loss_at
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import unstacked
from curlfit.numerics.differences import slopes
from curlfit.stone import UNITS as STONE_UNITS
from curlfit.throws.events import EventArrays
from curlfit.throws.readers.homography import displacements

_STEP = 1e-2
"""Of a width, of differences: the path is accurate to 1e-7 of it."""


def widths_of(
    model: Model,
    given: Mapping[str, float] | None = None,
    requests: Sequence[Request] = (),
    *,
    jointly: bool = False,
) -> dict[str, float]:
    """Standard uncertainty of each condition that a model holds fixed.

    Parameters
    ----------
    given : in place of `WIDTHS`; 0 where a condition is known. "all" stands for
        all not named.
    requests : of the throws, which say whether a spin is assumed, and how many errors a
        calibration has.
    jointly : as in `_calibrations`.

    Raises
    ------
    InputError : a name that is not a condition, or a negative width.
    """
    given = dict(given or {})
    check_systematics(given)
    for_all = given.pop(ALL, None)
    widths = dict(WIDTHS)
    of_calibration = 1.0
    if for_all is not None:
        widths = dict.fromkeys(WIDTHS, for_all)
        of_calibration = for_all
    of_calibration = given.pop(CALIBRATION, of_calibration)
    widths.update(given)
    errors = _calibrations(requests, jointly=jointly).shape[1]
    for number in range(errors):
        widths[f"{CALIBRATION}_{number + 1}"] = of_calibration
    without_error = set(model.conditions)
    if not any(request.assumed_spin for request in requests):
        without_error.add(SPIN.name)
    if not any(request.spin_taken_for_zero for request in requests):
        without_error.add(UNKNOWN_SPIN.name)
    return {
        name: width
        for name, width in widths.items()
        if width and name not in without_error
    }


def _calibrations(requests: Sequence[Request], *, jointly: bool = False) -> Floats:
    """Independent errors of the calibration of each throw, shape (throws, errors, 3,
    3), with zeros where a throw does not have one.

    Throws that are fitted `jointly` share the errors of a calibration, and each of
    several calibrations has its own.
    """
    by_row: dict[int, Floats] = {}
    for row, request in enumerate(requests):
        if request.throw.calibration is not None:
            by_row[row] = request.throw.calibration
    distinct: list[Floats] = []
    numbers = {}  # of the calibration of each throw among the distinct ones
    for row, calibration in by_row.items():
        numbers[row] = 0
        if jointly:
            same = [np.array_equal(calibration, other) for other in distinct]
            if not any(same):
                distinct.append(calibration)
                same.append(True)
            numbers[row] = same.index(True)
    most = max(map(len, by_row.values()), default=0)
    errors = np.zeros((len(requests), most * max(len(distinct), 1), 3, 3))
    for row, calibration in by_row.items():
        first = most * numbers[row]
        errors[row, first : first + len(calibration)] = calibration
    return errors


def residual_changes(
    model: Model,
    problems: Problem,
    values: Floats,
    paths: Floats,
    widths: Mapping[str, float],
    batch: int,
    requests: Sequence[Request] = (),
    *,
    jointly: bool = False,
) -> dict[str, Floats]:
    """Change of the weighted residuals of many throws for one width of each condition.

    Parameters
    ----------
    values : of the parameters, shape (throws, parameters), and their `paths`,
        (throws, 5, n).
    widths : from `widths_of`, as are the other arguments.

    Returns
    -------
    By condition, each of the shape of the residuals, (throws, channels, n).
    """
    channels = problems.observed.shape[1]
    names = [name for name in widths if name != UNKNOWN_SPIN.name]
    calibrations = _calibrations(requests, jointly=jointly)
    assumed_spins = np.array([request.assumed_spin for request in requests])

    def measured(in_widths: Floats) -> Floats:
        """Channels where conditions are off by so many of their widths."""
        off = {
            name: number * widths[name]
            for name, number in zip(names, in_widths, strict=True)
            if number
        }
        moved = values.copy()
        if SPIN.name in off:
            moved[:, START_INDEX["omega0"]] += off.pop(SPIN.name) * assumed_spins
        return _measured(model, problems, moved, off, batch, calibrations)[:, :channels]

    changes = {}
    if names:
        by_width = slopes(
            measured, np.zeros(len(names)), _STEP, value=paths[:, :channels]
        )
        changes = dict(zip(names, np.moveaxis(by_width, -1, 0), strict=True))
    if UNKNOWN_SPIN.name in widths:
        # the whole change: it is even in the spin, and has no slope where there is none
        is_zero = np.array([request.spin_taken_for_zero for request in requests])
        moved = values.copy()
        moved[:, START_INDEX["omega0"]] += widths[UNKNOWN_SPIN.name] * is_zero
        turning = _measured(model, problems, moved, {}, batch, calibrations)
        changes[UNKNOWN_SPIN.name] = (turning - paths)[:, :channels]
    residual = (paths[:, :channels] - problems.observed) * problems.weight
    root_slope = loss_at(problems.loss.max()).root_slope(residual)
    return {
        name: _whitened(change * problems.weight, problems) * root_slope
        for name, change in changes.items()
    }


def _whitened(weighted: Floats, problems: Problem) -> Floats:
    """Weighted changes of many throws, whitened where their noise is correlated."""
    if problems.whitener is None:
        return weighted
    whiteners = unstacked(problems.whitener)
    return np.array(
        [
            whitened(of_throw, whitener)
            for of_throw, whitener in zip(weighted, whiteners, strict=True)
        ]
    )


def _measured(
    model: Model,
    problems: Problem,
    values: Floats,
    off: Mapping[str, float],
    batch: int,
    calibrations: Floats,
) -> Floats:
    """The channels of many throws as they are measured where conditions are
    off by so much."""
    scale: float = 1 + off.get("length_scale", 0.0)
    events: EventArrays | None = problems.events
    first = len(model.law.coefficients()) + len(model.conditions)
    start = values[:, first : first + 2, None]
    if events is not None and scale != 1:
        problems = problems._replace(events=events.with_lengths(scale, start[:, 1]))
    for name, by in off.items():
        problems = with_condition_off(problems, name, by)
    paths = predict_many(model, values, problems, batch).copy()
    paths[:, :2] = start + scale * (paths[:, :2] - start)
    if events is not None:
        of_places = events.sums_of_places() @ start
        paths[:, -1, : of_places.shape[1]] += (1 - scale) * of_places[..., 0]
    for name in off.keys() - WIDTHS.keys():
        error = calibrations[:, int(name.removeprefix(f"{CALIBRATION}_")) - 1, None]
        paths[:, :2] -= off[name] * displacements(error, paths[:, 0], paths[:, 1])[:, 0]
    return paths


def with_condition_off(problems: Problem, name: str, by: float) -> Problem:
    """Problems with a condition changed by `by`; lengths and their calibration do not
    change the motion."""
    if name == "length_scale" or is_calibration(name):
        return problems
    if name == "time_scale":
        events = problems.events
        events = None if events is None else events.with_clock(1 + by)
        return problems._replace(times=problems.times / (1 + by), events=events)
    group = "stone" if name in STONE_UNITS else "environment"
    record = getattr(problems, group)
    changed = replace(record, **{name: getattr(record, name) + by})
    return problems._replace(**{group: changed})
