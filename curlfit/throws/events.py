"""Timed events of a throw: when or where the stone crosses a line or comes to rest.

Such a measurement is not a row of a path. A time between two lines is the difference
of two crossing times, with the error of a stopwatch; the resting position is measured
with a tape.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from curlfit.errors import InputError
from curlfit.foreign import counted, quoted
from curlfit.numerics.arrays import Floats

QUANTITIES = {
    "time": "s",
    "x": "m",
    "y": "m",
    "phi": "rad",
    "speed": "m/s",
    "omega": "rad/s",
}
"""Quantities measured at an event, with their units."""
RATES = ("speed", "omega")
"""Quantities of the motion at a line."""
SIGMA_TIME = 0.1
"""Standard deviation in s of a hand-timed interval between two events. Each press of
the button scatters by 0.07 s about a delay common to both, as 4304 reaction times of
timekeepers show (Manual timing in physics experiments: error and uncertainty, Am. J.
Phys. 87 (2019) 110)."""
MOST_LINES = 6
MOST_EVENTS = 9
# The columns of the weights in `EventArrays`: those of a quantity at the lines begin at
# its place, and at rest there is one of each.
_AT_LINES = {
    "time": 0,
    "x": MOST_LINES,
    "phi": 2 * MOST_LINES,
    "speed": 3 * MOST_LINES + 4,
    "omega": 4 * MOST_LINES + 4,
}
_AT_REST = {
    "time": 3 * MOST_LINES,
    "x": 3 * MOST_LINES + 1,
    "y": 3 * MOST_LINES + 2,
    "phi": 3 * MOST_LINES + 3,
}
_COLUMNS = 5 * MOST_LINES + 4
_TIMES = [*range(MOST_LINES), _AT_REST["time"]]
_X = [*range(_AT_LINES["x"], _AT_LINES["x"] + MOST_LINES), _AT_REST["x"]]
_Y = [_AT_REST["y"]]
_FARTHEST = 200.0  # m; largest distance to rest in the search for a first motion
_ROWS = 200  # number of times of a throw without a path
_LONGER = 1.25  # ratio of the last of these times to the expected time to rest
_TYPICAL_TIME = 25.0  # s to rest, where it was not measured
_TYPICAL_LENGTH = 28.0  # m to rest, likewise
# standard deviation of the logarithm of the distance, where no measurement tells it
_LENGTHS_APART = 0.3


@dataclass(frozen=True)
class Event:
    """One measured time, position or angle at a line or at rest, or the
    motion at a line.

    Attributes
    ----------
    name : name of the measurement, such as "hog_to_hog".
    quantity : "time" (s), "x", "y" (m) or "phi" (rad); "y" only at rest; "speed" (m/s)
        or "omega" (the spin, rad/s), only at a line.
    value, sigma : measured value and standard deviation of its error, SI.
    at : y of the line that the stone's centre crosses, m; None at rest.
    since : y of an earlier line, m, relative to which a time, x or an angle is
        measured. If None, times are on the throw's clock, x and angles in its axes.

    Raises
    ------
    InputError : an unknown quantity, a y at a line, or an impossible value or sigma.
    """

    name: str
    quantity: str
    value: float
    sigma: float
    at: float | None = None
    since: float | None = None

    def __post_init__(self) -> None:
        if self.quantity not in QUANTITIES:
            raise self._error(
                f"{quoted(self.quantity)} found, expected one of "
                f"{', '.join(QUANTITIES)}"
            )
        if self.quantity == "y" and self.since is not None:
            raise self._error(
                "`since` is given, expected none: y is measured from the hack"
            )
        if self.quantity == "y" and self.at is not None:
            raise self._error("`at` is given, expected none: y is measured at rest")
        if self.quantity in RATES and (self.at is None or self.since is not None):
            raise self._error(
                "expected `at` and no `since`: speed and spin are those at a line"
            )
        if not math.isfinite(self.value):
            raise self._error(f"{self.value} found, expected a finite number")
        if not 0 < self.sigma < math.inf:
            raise self._error(f"sigma = {self.sigma:g}, expected a positive number")

    def _error(self, fault: str) -> InputError:
        return InputError(f"event {self.name}: {fault}")

    @property
    def unit(self) -> str:
        """SI unit of value and sigma."""
        return QUANTITIES[self.quantity]


class EventArrays(NamedTuple):
    """Events as weighted sums of predictions at lines and at rest, for the
    compiled model.

    With many throws, the first axis of each array is that of the throws.
    """

    lines: Any
    """y of the lines crossed, m, ascending, shape (lines,)"""
    weights: Any
    """shape (events, 5 lines + 4): weights of the times of crossing, of x and of
    phi there, then of the time, x, y and phi at rest, then of the speed and the
    spin at the lines"""

    def with_clock(self, rate: float) -> EventArrays:
        """The events with all measured times longer by a factor."""
        weights = self.weights.copy()
        weights[..., _TIMES] *= rate
        return self._replace(weights=weights)

    def with_lengths(self, scale: float, y0: Any) -> EventArrays:
        """The events with all measured lengths longer by a factor, about y0 and
        x = 0."""
        weights = self.weights.copy()
        weights[..., _X + _Y] *= scale
        return EventArrays(y0 + (self.lines - y0) / scale, weights)

    def sums_of_places(self) -> Floats:
        """The sums of the weights of x and of y, shape (..., events, 2)."""
        of_x = self.weights[..., _X].sum(-1)
        of_y = self.weights[..., _Y].sum(-1)
        return np.stack([of_x, of_y], -1)


def lines_of(events: Sequence[Event]) -> list[float]:
    """y of the lines that events refer to, m, ascending."""
    return sorted(
        {y for event in events for y in (event.at, event.since) if y is not None}
    )


def event_arrays(events: Sequence[Event]) -> EventArrays:
    """The events as padded arrays.

    Raises
    ------
    InputError : too many events or lines.
    """
    lines = lines_of(events)
    if len(events) > MOST_EVENTS or len(lines) > MOST_LINES:
        raise InputError(
            f"{counted(len(events), 'event')} at {counted(len(lines), 'line')}; "
            f"expected at most {MOST_EVENTS} at {MOST_LINES}"
        )
    weights = np.zeros((MOST_EVENTS, _COLUMNS))
    for row, event in enumerate(events):
        if event.at is None:
            column = _AT_REST[event.quantity]
        else:
            column = _AT_LINES[event.quantity] + lines.index(event.at)
        weights[row, column] += 1
        if event.since is not None:
            earlier = _AT_LINES[event.quantity] + lines.index(event.since)
            weights[row, earlier] -= 1
    padded = np.full(MOST_LINES, lines[-1] if lines else 0.0)
    padded[: len(lines)] = lines
    return EventArrays(padded, weights)


def along_path(
    events: Sequence[Event],
    t: Floats,
    x: Floats,
    y: Floats,
    phi: Floats,
    speed: Floats,
    omega: Floats,
) -> Floats:
    """Values of events on a path, from its rows up to rest; shape (events,).

    Rows are interpolated linearly; the time of rest is extrapolated at constant
    deceleration from the first row below a tenth of the initial speed.
    """
    slow = int(np.argmax(speed < speed[0] / 10)) or len(t) - 1
    way_to_rest = math.hypot(x[-1] - x[slow], y[-1] - y[slow])
    rest = t[slow] + 2 * way_to_rest / max(speed[slow], 1e-9)
    series = {
        "time": np.append(t[:-1], rest),
        "x": x,
        "y": y,
        "phi": phi,
        "speed": speed,
        "omega": omega,
    }

    def value_at(line: float | None, quantity: str) -> float:
        if line is None:
            return float(series[quantity][-1])
        time = float(np.interp(line, y, t))
        if quantity == "time":
            return time
        return float(np.interp(time, t, series[quantity]))

    values = []
    for event in events:
        value = value_at(event.at, event.quantity)
        if event.since is not None:
            value -= value_at(event.since, event.quantity)
        values.append(value)
    return np.array(values)


def _even_motion(
    events: Sequence[Event], assumed: Mapping[str, float]
) -> tuple[float, float, float]:
    """The constant deceleration from the first line to rest that best fits measured
    times, speeds and the resting position: y of that line (m), distance (m) and time
    (s) to rest.

    If the stone comes to rest after a distance s in a time T, it crosses a line at a
    distance d at T (1 - sqrt(1 - d/s)): all times are proportional to T, which is found
    in closed form for each s of a fine grid. A speed v there says that T is 2 s
    sqrt(1 - d/s)/v.
    """
    lines = lines_of(events)
    y0 = min(lines, default=assumed.get("y0", 0.0))
    s = np.geomspace(max(max(lines, default=y0) - y0, 0.1) * 1.001, _FARTHEST, 2000)

    def share_until(y: float | None) -> Floats:
        """Time of crossing a line over T, for each s; 1 at rest."""
        if y is None:
            return np.ones_like(s)
        return 1 - np.sqrt(1 - (y - y0) / s)

    chi_squared = np.zeros_like(s)
    for event in events:
        if event.quantity == "y":
            chi_squared = chi_squared + ((y0 + s - event.value) / event.sigma) ** 2
    # What is measured of T, for each s: a time is a share of it.
    shares = []
    times = []
    sigmas = []
    for event in events:
        if event.quantity == "time":
            share = share_until(event.at)
            if event.since is not None:
                share = share - share_until(event.since)
            shares.append(share)
            times.append(np.full_like(s, event.value))
            sigmas.append(np.full_like(s, event.sigma))
    for event in events:
        if event.quantity == "speed":
            time = 2 * s * (1 - share_until(event.at)) / event.value
            shares.append(np.ones_like(s))
            times.append(time)
            sigmas.append(time * event.sigma / event.value)
    t = np.full_like(s, _TYPICAL_TIME)
    if shares:
        share = np.stack(shares)
        time = np.stack(times)
        sigma = np.stack(sigmas)
        weighted = (share * time / sigma**2).sum(0) / (share**2 / sigma**2).sum(0)
        t = np.maximum(weighted, 1e-3)
        chi_squared = chi_squared + (((t * share - time) / sigma) ** 2).sum(0)
    # One time alone says nothing of the distance: the shortest ones, of which many
    # times as much friction follows, are then as good as any.
    chi_squared = chi_squared + (np.log(s / _TYPICAL_LENGTH) / _LENGTHS_APART) ** 2
    best = int(np.argmin(chi_squared))
    return y0, float(s[best]), float(t[best])


def sketch(
    events: Sequence[Event], assumed: Mapping[str, float]
) -> tuple[Floats, dict[str, Floats]]:
    """Times that cover the motion to rest, with a rough x, y, phi there as a
    first guess.

    `assumed` is as in `Throw`.
    """
    y0, length, time = _even_motion(events, assumed)
    t = np.linspace(0.0, _LONGER * time, _ROWS)
    share = 1 - np.clip(1 - t / time, 0.0, 1.0) ** 2
    rest = {event.quantity: event.value for event in events if event.at is None}
    x = rest.get("x", 0.0) * np.minimum(t / time, 1.0) ** 2
    # The spin, too, decreases linearly.
    spins = [event.value for event in events if event.quantity == "omega"]
    spin = spins[0] if spins else assumed.get("omega0", 0.0)
    phi = rest.get("phi", spin * time / 2) * share
    return t, {"x": x, "y": y0 + length * share, "phi": phi}
