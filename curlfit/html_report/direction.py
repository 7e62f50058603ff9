"""A direction in parameter space that leaves the path unchanged, with the
paths along it.

Every path is computed from the model at its own parameter values: that the paths
coincide is a result, not an assumption.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from curlfit.html_report.blocks import InteractiveBlock
from curlfit.html_report.replay import Numbers, Point, rounded
from curlfit.inference.fit.curves import CurveModel, Curves
from curlfit.inference.fit.result import FitResult
from curlfit.numerics.arrays import Floats
from curlfit.output.figures import some_rows
from curlfit.throws.channels import UNITS
from curlfit.wording import compact, join_words

_POSITIONS = 33  # along a direction
_INSTANTS = 49  # times of a path
_POINTS = 200  # of the data
_REACH = 3.0  # multiple of the value or typical size, where there is no bound
_PRECISION = 1e-7  # of the computed path, m and rad
_MEASURES = {
    "position": ("x", "y"),
    "angle": ("phi",),
    "speed": ("speed",),
    "spin": ("omega",),
}
"""Channels by what is said to change; the size of a change is that of the vector."""
WIDTH = 640.0
HEIGHT = 200.0
MARGIN = 16.0
"""Of a drawing, in its own units."""


@dataclass(frozen=True)
class Change:
    """The largest change of what was measured, over all throws.

    Attributes
    ----------
    size : of the measure that changes most, in its SI unit.
    text : of all measures, as "0.2 mm in position and 1 mrad in angle".
    """

    size: float
    text: str


@dataclass(frozen=True)
class DirectionData:
    """What `direction.js` reads: lists by position of the slider, from end to end.

    Attributes
    ----------
    what : changes, in words.
    names : of the parameters. values : of each, by position. sizes : the largest.
    origin, scale, margin : of the `Drawing`.
    paths, alone : along the two sides of the drawing, at the times `t` (s), with all
        parameters moved and with the first one alone.
    changes, apart : from the fit, of all and of the first one alone; None where the law
        admits no motion.
    chi_squared : of all throws.
    start : the position of the fit.
    """

    what: str
    names: list[str]
    values: list[Numbers]
    sizes: list[float]
    origin: list[float]
    scale: list[float]
    margin: float
    paths: list[list[Numbers]]
    alone: list[list[Numbers]]
    changes: list[Change | None]
    apart: list[Change | None]
    chi_squared: Numbers
    start: int
    t: Numbers


@dataclass(frozen=True)
class Direction(InteractiveBlock):
    """A direction that leaves the path unchanged, with a slider along it.

    Attributes
    ----------
    joined : its parameters in words.
    shares : of each parameter at the fit, in percent of its largest value.
    constant : what stays constant, with its value; empty for nothing.
    largest, largest_alone : changes along the whole slider in words, of all parameters
        and of the first one alone; empty where there is no motion.
    axes : what the drawing shows.
    points, path : of the data and of the fit, in the drawing.
    """

    template = "direction"
    data: DirectionData
    joined: str
    shares: list[float]
    constant: str
    largest: str
    largest_alone: str
    axes: str
    points: list[Point]
    path: list[Point]
    width: float = WIDTH
    height: float = HEIGHT


class Ends(NamedTuple):
    """Steps along a direction from the fit to its two ends, the first one negative."""

    backward: float
    forward: float

    def toward(self, step: float) -> float:
        """The end on the side of a step."""
        return self.forward if step > 0 else self.backward


def directions_of(
    fits: Sequence[FitResult], directions: Sequence[Mapping[str, float]], id: str
) -> list[Direction]:
    """Directions of parameters that throws have in common, where the bounds leave room.

    The path of the first throw is drawn; the changes are the largest over all throws.
    """
    models = [CurveModel(fit) for fit in fits if fit.fitted and fit.rms]
    if not models:
        return []
    blocks = [
        _direction(models, direction, f"{id}-{number}")
        for number, direction in enumerate(directions)
    ]
    return [block for block in blocks if block is not None]


def ends_along(fit: FitResult, direction: Mapping[str, float]) -> Ends:
    """Steps along a direction from the fit, up to which all parameters are within their
    bounds, or within a few times their size where they have none."""
    backward = -math.inf
    forward = math.inf
    for name, weight in direction.items():
        parameter = fit.parameters[name]
        value = parameter.value
        farthest = _REACH * max(abs(value), parameter.typical)
        low = max(parameter.lower, value - farthest) - value
        high = min(parameter.upper, value + farthest) - value
        # a negative weight exchanges the ends
        first, last = sorted((low / weight, high / weight))
        backward = max(backward, first)
        forward = min(forward, last)
    return Ends(backward, forward)


def positions_along(fit: FitResult, direction: Mapping[str, float]) -> Floats:
    """Steps along a direction between its ends, including 0."""
    steps = np.linspace(*ends_along(fit, direction), _POSITIONS)
    steps[np.argmin(np.abs(steps))] = 0.0  # the fit itself
    return steps


@dataclass(frozen=True)
class Drawing:
    """Where points along two axes are drawn: from their origin, enlarged by
    their scale."""

    origin: list[float]
    scale: list[float]
    margin: float = MARGIN

    @classmethod
    def of(cls, low: Floats, high: Floats, *, from_above: bool) -> Drawing:
        """One that shows what lies between two corners; seen `from_above`, thrown to
        the right, left of the throw is up."""
        size = np.where(high > low, high - low, 1.0)
        along = (WIDTH - 2 * MARGIN) / size[0]
        across = (HEIGHT - 2 * MARGIN) / size[1]
        if from_above:
            return cls([float(low[0]), float(high[1])], [along, -across])
        return cls(low.tolist(), [along, across])

    def at(self, points: Floats) -> list[Point]:
        """Points in the drawing, of values along the axes, shape (2, n)."""
        across = MARGIN + (points[0] - self.origin[0]) * self.scale[0]
        down = HEIGHT - MARGIN - (points[1] - self.origin[1]) * self.scale[1]
        drawn = zip(across.tolist(), down.tolist(), strict=True)
        return [(u, v) for u, v in drawn if math.isfinite(u) and math.isfinite(v)]


def _direction(
    models: list[CurveModel], direction: Mapping[str, float], id: str
) -> Direction | None:
    """The part of a page about one direction; None where the bounds leave no room.
    Beside the paths along it are those with its first parameter changed alone.
    """
    fit = models[0].fit
    weights = {name: weight for name, weight in direction.items() if weight}
    names = list(weights)
    steps = positions_along(fit, weights)
    if not np.isfinite(steps).all() or not np.ptp(steps) > 0:
        return None
    start = int(np.flatnonzero(steps == 0)[0])  # the fit itself

    # parameters of the direction, shape (positions, names)
    moves = np.outer(steps, list(weights.values()))
    values = np.array([fit.parameters[name].value for name in names]) + moves
    sizes = np.abs(values).max(0)
    sizes = np.where(sizes > 0, sizes, 1.0)

    # curves of all throws at each position, and how far they are from the fit
    curves = _curves(models, names, moves)
    curves_alone = _curves(models, names[:1], moves[:, :1])
    best = curves[start]
    changes = [_change(moved, best, models) for moved in curves]
    changes_alone = [_change(moved, best, models) for moved in curves_alone]
    chi_squared = [sum(throw.chi_squared for throw in moved) for moved in curves]

    # the path of the first throw, from above; without x and y, a channel over time
    has_path = {"x", "y"} <= fit.rms.keys()
    sides = ("y", "x") if has_path else ("t", next(iter(fit.rms)))
    t = best[0].t
    instants = some_rows(len(t), _INSTANTS)
    paths = [_sides_of(moved[0], sides, instants) for moved in curves]
    paths_alone = [_sides_of(moved[0], sides, instants) for moved in curves_alone]
    low = np.nanmin(np.array(paths + paths_alone), axis=(0, 2))
    high = np.nanmax(np.array(paths + paths_alone), axis=(0, 2))
    drawing = Drawing.of(low, high, from_above=has_path)
    rows = some_rows(len(fit.observed["t"]), _POINTS)
    measured = np.array([fit.observed[side][rows] for side in sides])

    return Direction(
        id=id,
        data=DirectionData(
            what="the path" if has_path else "what was measured",
            names=names,
            values=[rounded(row, 9) for row in values],
            sizes=sizes.tolist(),
            origin=drawing.origin,
            scale=drawing.scale,
            margin=drawing.margin,
            paths=[[rounded(side, 8) for side in path] for path in paths],
            alone=[[rounded(side, 4) for side in path] for path in paths_alone],
            changes=changes,
            apart=changes_alone,
            chi_squared=[_eight_digits(value) for value in chi_squared],
            start=start,
            t=rounded(t[instants], 6),
        ),
        joined=join_words(names),
        shares=(100 * np.abs(values[start]) / sizes).tolist(),
        constant=_constant(fit, names),
        largest=_largest(changes),
        largest_alone=_largest(changes_alone),
        axes=_axes(fit, sides, low, high, len(models)),
        points=drawing.at(measured),
        path=drawing.at(np.array(paths[start])),
    )


def _sides_of(
    curves: Curves, sides: tuple[str, str], instants: NDArray[np.intp]
) -> list[Floats]:
    """A path along the two sides of the drawing, at some of its times."""
    series = {"t": curves.t, **curves.path}
    return [series[side][instants] for side in sides]


def _curves(
    models: list[CurveModel], names: list[str], moves: Floats
) -> list[list[Curves]]:
    """Curves by position of the slider and by model, with the parameters of these names
    moved; moves have shape (positions, names)."""
    columns = [list(models[0].fit.parameters).index(name) for name in names]
    curves = []
    for move in moves:
        curves_of_move = []
        for model in models:
            values = model.fit.values
            values[columns] += move
            # the step to a bound ends on it up to rounding
            bounds = model.fit.parameter_set
            values = np.clip(values, bounds.lower, bounds.upper)
            curves_of_move.append(model.at(values))
        curves.append(curves_of_move)
    return curves


def _largest(changes: list[Change | None]) -> str:
    """The largest of changes in words; empty where no path exists."""
    existing = [change for change in changes if change is not None]
    if not existing:
        return ""
    return max(existing, key=lambda change: change.size).text


def _constant(fit: FitResult, names: list[str]) -> str:
    """The combinations that stay constant, with their values."""
    combinations = [
        f"{combination.expression} = {compact(combination.value, combination.stderr)}"
        for combination in fit.combinations
        if set(combination.weights) <= set(names)
    ]
    return join_words(combinations) if combinations else ""


def _axes(
    fit: FitResult, sides: tuple[str, str], low: Floats, high: Floats, throws: int
) -> str:
    """What the drawing shows, in words: "x (-0.02 .. 0.71 m) against y (...)"."""
    ranges = []
    for side, first, last in zip(sides, low, high, strict=True):
        begin = first.round(2) + 0.0  # -0.0 becomes 0.0
        end = last.round(2) + 0.0
        ranges.append(f"{side} ({begin:.2f} .. {end:.2f} {UNITS[side]})")
    axes = f"{ranges[1]} against {ranges[0]}"
    if throws == 1:
        return axes
    return f"{axes} of {Path(fit.data.file).name}, one of {throws} throws"


def _change(
    curves: list[Curves], best: list[Curves], models: list[CurveModel]
) -> Change | None:
    """The largest changes of the measured channels of all throws from the best fit, in
    words; None where a path does not exist."""
    sizes: dict[str, float] = {}
    for moved, fitted, model in zip(curves, best, models, strict=True):
        for name, channels in _MEASURES.items():
            measured = [channel for channel in channels if channel in model.fit.rms]
            if not measured:
                continue
            squares = sum(
                (moved.path[channel] - fitted.path[channel]) ** 2
                for channel in measured
            )
            largest = float(np.max(np.sqrt(squares)))
            # a NaN, where there is no motion, stays
            sizes[name] = float(np.maximum(sizes.get(name, 0.0), largest))
    if not all(map(math.isfinite, sizes.values())):
        return None
    words = [
        f"{size_in_words(size, _MEASURES[name][0])} in {name}"
        for name, size in sizes.items()
    ]
    return Change(max(sizes.values()), join_words(words))


def size_in_words(value: float, channel: str) -> str:
    """A size to two digits, in thousandths unless it is large."""
    unit = UNITS[channel]
    if value >= 1:
        return f"{value:.2g} {unit}" if value < 10 else f"{value:.0f} {unit}"
    if value < _PRECISION:
        return f"less than {1e3 * _PRECISION:.4f} m{unit}"
    return f"{float(f'{1e3 * value:.2g}'):.10g} m{unit}"


def _eight_digits(value: float) -> float | None:
    """A number of the page to eight digits; None where it is not finite."""
    return float(f"{value:.8g}") if math.isfinite(value) else None
