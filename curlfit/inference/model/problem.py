"""A throw as arrays for the compiled model, `Problem`.

Places and angles are those of the data, and so are the parameters: those of a map
grid, of some 10^6 m, are still told to a nanometre. Only the clock begins with the
first row, since that of a computer, of some 10^9 s, would cost a tenth of a
microsecond, or as many micrometres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from curlfit.environment import Environment
from curlfit.inference.model.spin_at_rest import MeasuredSpins
from curlfit.losses import LINEAR, Loss, place_of
from curlfit.stone import Stone
from curlfit.throws.channels import CHANNELS
from curlfit.throws.events import EventArrays, event_arrays
from curlfit.throws.throw import Throw

ROWS_OF_DATA = (*CHANNELS, "event")
"""Quantities in the rows of a problem's arrays."""
_EVENT = len(CHANNELS)  # the last of them
# data are padded to powers of two from here on, so that few shapes are compiled
_SHORTEST = 256


LEVEL_AND_STILL = Environment(*map(np.asarray, vars(Environment()).values()))
"""Level, uniform, unswept ice and still air, as arrays."""


class Problem(NamedTuple):
    """A throw as arrays for the compiled model; n is the padded number of rows.

    Or many throws, along the first axis of each array.
    """

    times: Any
    """s since the first row, shape (n,); None where friction was
    measured and no path"""
    observed: Any
    """x, y, phi, zero where not observed, shape (3, n); with speed and omega, where
    these were measured, (5, n); with events, (6, n), the last row with one event per
    column, whose times are since the first row"""
    weight: Any
    """1/sigma, 0 where not observed, of the same shape"""
    stone: Stone
    environment: Environment
    loss: Any = 0
    """place of the loss in `LOSSES`"""
    events: EventArrays | None = None
    """definitions of the events in the last row"""
    whitener: Any = None
    """makes correlated noise independent, see `curlfit.inference.noise.whitening`"""
    states: Any = None
    """speed and spin at which friction was measured, as the last row of the data, shape
    (2, n); a speed of 0 where there is another observation"""
    spins: MeasuredSpins | None = None
    """what was measured of the spin; None without its channel"""


def build_problem(
    throw: Throw,
    stone: Stone,
    sigma: dict[str, float],
    loss: Loss = LINEAR,
    swept: Sequence[float] | None = None,
    shape: tuple[int, int] | None = None,
) -> Problem:
    """The problem of a throw, padded.

    Parameters
    ----------
    sigma : of the channels for which the throw gives none.
    swept : times at which sweeping began and ended, see `environment_of`; None without.
    shape : of the data, channels and rows; the smallest possible if None.
    """
    n = len(throw)
    channels, rows = shape or problem_shape(throw)
    path_channels = min(channels, len(CHANNELS))
    finite = throw.finite[:path_channels]
    first_time = float(throw.t[0])
    times = np.full(rows, throw.t[-1] - first_time)
    times[:n] = throw.t - first_time
    observed = np.zeros((channels, rows))
    weight = np.zeros((channels, rows))
    observed[:path_channels, :n] = np.where(finite, throw.observed[:path_channels], 0.0)
    for row, name in enumerate(CHANNELS[:channels]):
        weight[row, :n] = np.where(finite[row], 1 / _sigma_of(throw, sigma, name), 0.0)
    events = None
    if channels > _EVENT:
        events = event_arrays(throw.events)
        for column, event in enumerate(throw.events):
            on_clock = event.quantity == "time" and event.since is None
            value = event.value - first_time if on_clock else event.value
            observed[_EVENT, column] = value
            weight[_EVENT, column] = 1 / event.sigma
    return Problem(
        times=times,
        observed=observed,
        weight=weight,
        stone=Stone(*map(np.asarray, vars(stone).values())),  # type: ignore[arg-type]
        environment=environment_of(swept, first_time),
        loss=np.asarray(place_of(loss)),
        events=events,
        spins=MeasuredSpins.of(throw, rows) if channels >= len(CHANNELS) else None,
    )


def problem_shape(throw: Throw) -> tuple[int, int]:
    """Shape of the data of a throw's problem: channels and padded rows."""
    channels = 5 if {"speed", "omega"} & set(throw.seen) else 3
    channels = len(ROWS_OF_DATA) if throw.events else channels
    return channels, max(_SHORTEST, 1 << (len(throw) - 1).bit_length())


def shape_of_all(shapes: Sequence[tuple[int, int]]) -> tuple[int, int]:
    """The smallest shape that holds the data of several problems."""
    channels = max(channels for channels, _ in shapes)
    rows = max(rows for _, rows in shapes)
    return channels, rows


def environment_of(swept: Sequence[float] | None, t0: float) -> Environment:
    """The assumed environment of a throw, as arrays.

    Parameters
    ----------
    swept : times at which sweeping began and ended, on the clock of the data in s;
        None without.
    t0 : the first time of the data.
    """
    if swept is None:
        return LEVEL_AND_STILL
    begin, end = (np.asarray(time - t0) for time in swept)
    return replace(LEVEL_AND_STILL, swept_from=begin, swept_to=end)


def _sigma_of(throw: Throw, sigma: dict[str, float], name: str) -> Any:
    """Sigma of a channel by row; positive where a value was not observed."""
    given_sigma = throw.sigma.get(name)
    if given_sigma is None:
        return sigma.get(name, 1.0) * throw.sigma_over_smallest(name)
    return np.where(given_sigma > 0, given_sigma, 1.0)
