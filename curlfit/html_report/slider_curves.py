"""Curves of a fit that follow sliders without its model: a table along each slider, and
what each pair of sliders does beyond the sum.

With u and w the shares of their ends that two sliders have gone, the pair adds u w
times what it adds where both are at their ends. What three sliders do beyond their
pairs is of third order and left out; `SliderCurves.errors` measures what that does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from curlfit.html_report.direction import Ends, ends_along
from curlfit.inference.fit.curves import CurveModel, Curves
from curlfit.inference.fit.result import FitResult
from curlfit.numerics.arrays import Floats
from curlfit.output.figures import some_rows

INTERVALS = 5  # of the table along a slider, on either side of the fit
_INSTANTS = 41  # times of the path, and rows of the residuals
# m, rad, m/s and rad/s: by so much a slider changes a measured channel at its ends.
# Twice as far, the errors of all sliders together are eight times as large.
REACH = {"x": 0.3, "y": 0.3, "phi": 1.0, "speed": 0.05, "omega": 0.1}
_ATTEMPTS = 12  # to find an end within this reach
TRIALS = 8  # ways of moving all sliders at which errors are measured
HALF = 0.5
WHOLE = 1.0
"""Shares of the way to the ends at which errors are said."""


class Layout:
    """Where the curves of a fit are in one vector: the path that is drawn, then the
    residuals.

    Attributes
    ----------
    has_path : whether x and y were measured, so that the path is drawn from above.
    sides : of the drawing: y and x or, without a path, the time and one channel.
    t, instants : times of the path (s), and the rows of those that are drawn.
    rows : those of the data whose residuals are shown.
    path, residuals : parts of the vector, by drawn and by measured channel.
    """

    def __init__(self, fit: FitResult, model: CurveModel) -> None:
        measured = list(fit.rms)
        self.has_path = {"x", "y"} <= fit.rms.keys()
        self.sides = ["y", "x"] if self.has_path else ["t", measured[0]]
        self.t = model.at(fit.values).t
        self.instants = some_rows(len(self.t), _INSTANTS)
        self.rows = some_rows(len(fit.observed["t"]), _INSTANTS)
        self.path: dict[str, slice] = {}
        self.residuals: dict[str, slice] = {}
        end = 0
        for name in self.sides:
            if name != "t":
                self.path[name] = slice(end, end + len(self.instants))
                end += len(self.instants)
        for name in measured:
            self.residuals[name] = slice(end, end + len(self.rows))
            end += len(self.rows)

    def vector(self, curves: Curves) -> Floats:
        """The curves as one vector."""
        path = [curves.path[name][self.instants] for name in self.path]
        residuals = [curves.residuals[name][self.rows] for name in self.residuals]
        return np.concatenate(path + residuals)

    def largest(self, change: Floats) -> dict[str, float]:
        """Largest change of the residuals by measured channel; a gap in the
        data has none."""
        return {
            name: float(np.abs(change[part]).max())
            for name, part in self.residuals.items()
        }


@dataclass(frozen=True)
class Slider:
    """A direction in which parameters are changed, one of them or several.

    Attributes
    ----------
    direction : weights by name of the parameter.
    steps : along it from the fit, from one end to the other, with 0.
    changes : of the curves at these steps, shape (steps, values).
    chi_squared : of the data at these steps.
    """

    direction: Mapping[str, float]
    steps: Floats
    changes: Floats
    chi_squared: Floats

    @property
    def ends(self) -> Ends:
        """The first and the last step."""
        return Ends(float(self.steps[0]), float(self.steps[-1]))

    @property
    def end_changes(self) -> Floats:
        """Changes of the curves at the first and the last step."""
        return self.changes[[0, -1]]

    def change_at(self, step: float) -> Floats:
        """Change of the curves at any step, by the cubic through the four
        steps around it."""
        first = int(np.searchsorted(self.steps, step)) - 2
        first = min(max(first, 0), len(self.steps) - 4)
        nodes = self.steps[first : first + 4]
        # Lagrange's weights: 1 at a node of its own, 0 at the others
        weights = np.ones(len(nodes))
        for index, node in enumerate(nodes):
            other_nodes = np.delete(nodes, index)
            weights[index] = np.prod((step - other_nodes) / (node - other_nodes))
        return weights @ self.changes[first : first + 4]

    def share(self, step: float) -> float:
        """How much of the way to the end on its side a step goes, 0 to 1."""
        return step / self.ends.toward(step) if step else 0.0


def nodes_between(backward: float, forward: float) -> Floats:
    """Steps of a table along a slider, as many on either side of the fit however far
    its end is; none on a side without room.

    They are dense near the fit, where residuals are of the size of the noise: chi
    squared rises to a million times that of the fit towards the ends.
    """
    shares = (np.arange(INTERVALS + 1) / INTERVALS) ** 2
    steps = np.zeros(1)
    if backward < 0:
        steps = backward * shares[::-1] + 0.0  # no -0.0
    if forward > 0:
        steps = np.append(steps, forward * shares[1:])
    return steps


class SliderCurves:
    """The curves of a fit as a function of sliders: one for each parameter that can be
    changed, and one along each direction that the data do not determine.

    Attributes
    ----------
    base : curves of the fit, as a vector; NaN in gaps of the data.
    sliders : those of parameters first.
    pairs : by the numbers of two sliders, what they do beyond the sum where both are at
        their ends, shape (2, 2, values). Pairs that do nothing are left out.
    """

    def __init__(self, fit: FitResult) -> None:
        self.fit = fit
        self._model = CurveModel(fit)
        self.layout = Layout(fit, self._model)
        self.base = self.layout.vector(self._model.at(fit.values))
        directions = [{name: 1.0} for name in fit.parameters]
        directions += [
            dict(direction) for direction in fit.identifiability.null_directions
        ]
        sliders = [self._slider(direction) for direction in directions]
        self.sliders = [slider for slider in sliders if slider is not None]
        self.pairs: dict[tuple[int, int], Floats] = {}
        for pair in combinations(range(len(self.sliders)), 2):
            beyond = self._beyond_sum(*pair)
            if beyond.any():
                self.pairs[pair] = beyond

    def changes(self, steps: Floats) -> Floats:
        """Change of the curves with each slider at a step."""
        total = np.zeros_like(self.base)
        for slider, step in zip(self.sliders, steps, strict=True):
            total += slider.change_at(step)
        for (first, second), beyond in self.pairs.items():
            share = self.sliders[first].share(steps[first])
            other_share = self.sliders[second].share(steps[second])
            side = int(steps[first] > 0)
            other_side = int(steps[second] > 0)
            total += share * other_share * beyond[side, other_side]
        return total

    def errors(self, reach: float) -> dict[str, float]:
        """Largest errors by measured channel with all sliders at once moved by a share
        of the way to their ends, some to one side and some to the other."""
        random = np.random.default_rng(0)
        ends = np.array([slider.ends for slider in self.sliders])
        errors = dict.fromkeys(self.layout.residuals, 0.0)
        for _ in range(TRIALS):
            sides = random.integers(2, size=len(ends))
            steps = reach * ends[np.arange(len(ends)), sides]
            error = self.changes(steps) - self._computed(steps)
            for name, size in self.layout.largest(error).items():
                errors[name] = float(np.maximum(errors[name], size))
        return errors

    def _at(self, steps: Mapping[int, float]) -> Curves:
        """Curves of the model, with sliders at steps by their numbers."""
        moves = [
            (self.sliders[number].direction, step) for number, step in steps.items()
        ]
        return self._model.at(self._values(moves))

    def _values(self, moves: list[tuple[Mapping[str, float], float]]) -> Floats:
        """Parameters after steps along directions from the fit."""
        names = list(self.fit.parameters)
        values = self.fit.values
        for direction, step in moves:
            for name, weight in direction.items():
                values[names.index(name)] += weight * step
        return values

    def _change(self, curves: Curves) -> Floats:
        """From the curves of the fit; 0 in gaps of the data, NaN without a motion."""
        change = self.layout.vector(curves) - self.base
        return np.where(np.isnan(self.base), 0.0, change)

    def _computed(self, steps: Floats) -> Floats:
        """Change of the curves of the model with each slider at a step."""
        return self._change(self._at(dict(enumerate(steps))))

    def _slider(self, direction: Mapping[str, float]) -> Slider | None:
        """A slider along a direction; None where the bounds leave no room, or the law
        admits no motion."""
        weights = {name: weight for name, weight in direction.items() if weight}
        bounds = ends_along(self.fit, weights)
        backward = self._end(weights, bounds.backward)
        forward = self._end(weights, bounds.forward)
        steps = nodes_between(backward, forward)
        if len(steps) == 1:
            return None
        moved = [self._model.at(self._values([(weights, step)])) for step in steps]
        changes = np.array([self._change(curves) for curves in moved])
        if not np.isfinite(changes).all():
            return None
        chi_squared = np.array([curves.chi_squared for curves in moved])
        return Slider(weights, steps, changes, chi_squared)

    def _end(self, direction: Mapping[str, float], step: float) -> float:
        """The farthest step, up to one to a bound, by which measured channels change by
        `REACH` at most; 0 where none is found."""
        for _ in range(_ATTEMPTS):
            change = self._change(self._model.at(self._values([(direction, step)])))
            sizes = self.layout.largest(change)
            excess = max(size / REACH[name] for name, size in sizes.items())
            if excess <= 1:
                return step
            # as if changes grew with the step; halved where there is no motion
            step *= 0.95 / excess if np.isfinite(excess) else 0.5
        return 0.0

    def _beyond_sum(self, first: int, second: int) -> Floats:
        """What two sliders do beyond the sum, at each pair of their ends; 0 where the
        law admits no motion."""
        beyond = np.zeros((2, 2, len(self.base)))
        for side, other_side in product((0, 1), (0, 1)):
            step = self.sliders[first].ends[side]
            other_step = self.sliders[second].ends[other_side]
            if step == 0 or other_step == 0:
                continue
            together = self._change(self._at({first: step, second: other_step}))
            alone = self.sliders[first].end_changes[side]
            other_alone = self.sliders[second].end_changes[other_side]
            beyond[side, other_side] = together - alone - other_alone
        return np.where(np.isfinite(beyond), beyond, 0.0)
