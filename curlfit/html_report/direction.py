"""A direction in parameter space that leaves the path unchanged, with the
paths along it.

Every path is computed from the model at its own parameter values: that the paths
coincide is a result, not an assumption.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from curlfit.html_report.blocks import Block
from curlfit.html_report.replay import rounded
from curlfit.inference.fit.curves import CurveModel, Curves
from curlfit.inference.fit.result import FitResult
from curlfit.numerics.arrays import Floats
from curlfit.output.figures import some_rows
from curlfit.output.text import compact, join_words
from curlfit.throws.throw import UNITS

_POSITIONS = 33  # along a direction
_INSTANTS = 49  # times of a path
_REACH = 3.0  # multiple of the value or typical size, where there is no bound
_PRECISION = 1e-7  # of the computed path, m and rad
_MEASURES = {
    "position": ("x", "y"),
    "angle": ("phi",),
    "speed": ("speed",),
    "spin": ("omega",),
}
WIDTH = 640.0
HEIGHT = 200.0
MARGIN = 16.0
"""Of a drawing, in its own units."""


def directions_of(
    fits: Sequence[FitResult], directions: Sequence[dict[str, float]], id: str
) -> list[tuple[Block, dict[str, Any]]]:
    """Directions of parameters that throws have in common, where the bounds leave room.

    The path of the first throw is drawn; the changes are the largest over all throws.
    """
    models = [CurveModel(fit) for fit in fits if fit.fitted and fit.rms]
    if not models:
        return []
    found = [
        _direction(models, direction, f"{id}-{place}")
        for place, direction in enumerate(directions)
    ]
    return [item for item in found if item is not None]


def ends_along(fit: FitResult, direction: Mapping[str, float]) -> tuple[float, float]:
    """Steps along a direction from the fit, up to which all parameters are within their
    bounds, or within a few times their size where they have none."""
    backward = -math.inf
    forward = math.inf
    for name, weight in direction.items():
        item = fit.parameters[name]
        far = _REACH * max(abs(item.value), item.typical)
        low = max(item.lower, item.value - far) - item.value
        high = min(item.upper, item.value + far) - item.value
        first, last = sorted((low / weight, high / weight))
        backward = max(backward, first)
        forward = min(forward, last)
    return backward, forward


def positions_along(fit: FitResult, direction: dict[str, float]) -> Floats:
    """Steps along a direction between its ends, including 0."""
    backward, forward = ends_along(fit, direction)
    steps = np.linspace(backward, forward, _POSITIONS)
    steps[np.argmin(np.abs(steps))] = 0.0  # the fit itself
    return steps


class Drawing(NamedTuple):
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

    def at(self, points: Floats) -> list[tuple[float, float]]:
        """Points in the drawing, of values along the axes, shape (2, n)."""
        across = MARGIN + (points[0] - self.origin[0]) * self.scale[0]
        down = HEIGHT - MARGIN - (points[1] - self.origin[1]) * self.scale[1]
        found = zip(across.tolist(), down.tolist(), strict=True)
        return [(u, v) for u, v in found if math.isfinite(u) and math.isfinite(v)]


def _direction(
    models: list[CurveModel], direction: dict[str, float], id: str
) -> tuple[Block, dict[str, Any]] | None:
    fit, names = models[0].fit, [name for name, weight in direction.items() if weight]
    steps = positions_along(fit, {name: direction[name] for name in names})
    if not np.isfinite(steps).all() or not np.ptp(steps) > 0:
        return None
    moves = np.outer(steps, [direction[name] for name in names])
    values = np.array([fit.parameters[name].value for name in names]) + moves
    sizes, start = np.abs(values).max(0), int(np.flatnonzero(steps == 0)[0])
    whole = [_curves(models, names[:count], moves) for count in (len(names), 1)]
    best = whole[0][start]
    changes, apart = (
        [_change(curves, best, models) for curves in one] for one in whole
    )
    sides = ("y", "x") if {"x", "y"} <= fit.rms.keys() else ("t", next(iter(fit.rms)))
    some = some_rows(len(best[0].t), _INSTANTS)
    paths, alone = (
        [
            [(one.t if name == "t" else one.path[name])[some] for name in sides]
            for one, *_ in each
        ]
        for each in whole
    )
    low, high = (
        side(np.array(paths + alone), axis=(0, 2)) for side in (np.nanmin, np.nanmax)
    )
    drawing = Drawing.of(low, high, from_above=sides[1] == "x")
    data: dict[str, Any] = {
        "kind": "direction",
        "what": "the path" if sides[0] == "y" else "what was measured",
        "names": names,
        "values": [rounded(row, 9) for row in values],
        "sizes": np.where(sizes > 0, sizes, 1.0).tolist(),
        **drawing._asdict(),
        "paths": [[rounded(values, 8) for values in one] for one in paths],
        "alone": [[rounded(values, 4) for values in one] for one in alone],
        "changes": changes,
        "apart": apart,
        "chi_squared": [
            _number(sum(one.chi_squared for one in each)) for each in whole[0]
        ],
        "start": start,
        "t": rounded(best[0].t[some], 6),
    }
    measured = some_rows(len(fit.observed["t"]), 200)
    shows = {
        **data,
        "id": id,
        "last": len(steps) - 1,
        "joined": join_words(names),
        "shares": (100 * np.abs(values[start]) / data["sizes"]).tolist(),
        "sum": _constant(fit, names),
        "largest": _largest(changes),
        "apart": _largest(apart),
        "width": WIDTH,
        "height": HEIGHT,
        "axes": _axes(fit, sides, low, high, len(models)),
        "points": drawing.at(
            np.array([fit.observed[name][measured] for name in sides])
        ),
        "path": drawing.at(np.array(paths[start])),
    }
    return Block("direction", shows), data


def _curves(
    models: list[CurveModel], names: list[str], moves: Floats
) -> list[list[Curves]]:
    """The curves of all models at each of some moves of the parameters of
    these names."""
    fit = models[0].fit
    places = [list(fit.parameters).index(name) for name in names]

    def at(model: CurveModel, move: Floats) -> Curves:
        values = model.fit.values
        values[places] += move[: len(places)]
        # The step to a bound ends on it up to rounding.
        return model.at(
            np.clip(values, fit.parameter_set.lower, fit.parameter_set.upper)
        )

    return [[at(model, move) for model in models] for move in moves]


def _largest(changes: list[dict[str, Any] | None]) -> str:
    """The largest of changes in words; empty where no path exists."""
    found = max(
        filter(None, changes), key=lambda one: one["size"], default={"text": ""}
    )
    return str(found["text"])


def _constant(fit: FitResult, names: list[str]) -> str:
    """The combinations that stay constant, with their values."""
    said = [
        f"{item.expression} = {compact(item.value, item.stderr)}"
        for item in fit.combinations
        if set(item.weights) <= set(names)
    ]
    return join_words(said) if said else ""


def _axes(
    fit: FitResult, sides: tuple[str, str], low: Floats, high: Floats, throws: int
) -> str:
    """What the drawing shows, in words."""
    units = {"t": "s"} | UNITS
    along, across = (
        f"{name} ({a:.2f} .. {b:.2f} {units[name]})"
        for name, a, b in zip(
            sides, low.round(2) + 0.0, high.round(2) + 0.0, strict=True
        )
    )
    name = Path(fit.data["file"]).name
    return f"{across} against {along}" + (
        f" of {name}, one of {throws} throws" * (throws > 1)
    )


def _change(
    curves: list[Curves], best: list[Curves], models: list[CurveModel]
) -> dict[str, Any] | None:
    """The largest changes of the measured channels of the paths, in words; None where a
    path does not exist."""
    sizes: dict[str, float] = {}
    for one, other, model in zip(curves, best, models, strict=True):
        for name, channels in _MEASURES.items():
            seen = [channel for channel in channels if channel in model.fit.rms]
            if seen:
                squares = sum((one.path[item] - other.path[item]) ** 2 for item in seen)
                largest = float(np.max(np.sqrt(squares)))
                sizes[name] = float(np.maximum(sizes.get(name, 0.0), largest))
    if not all(map(math.isfinite, sizes.values())):
        return None
    said = [
        f"{size_in_words(size, _MEASURES[name][0])} in {name}"
        for name, size in sizes.items()
    ]
    return {"size": max(sizes.values()), "text": join_words(said)}


def size_in_words(value: float, channel: str) -> str:
    """A size to two digits, in thousandths unless it is large."""
    unit = UNITS[channel]
    if value >= 1:
        return f"{value:.2g} {unit}" if value < 10 else f"{value:.0f} {unit}"
    if value < _PRECISION:
        return f"less than {1e3 * _PRECISION:.4f} m{unit}"
    return f"{float(f'{1e3 * value:.2g}'):.10g} m{unit}"


def _number(value: float) -> float | None:
    return float(f"{value:.8g}") if math.isfinite(value) else None
