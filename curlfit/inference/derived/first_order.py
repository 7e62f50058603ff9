"""What a fit says of its parameters on the tangent, to first order."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from curlfit.inference.derived.expression import parse
from curlfit.inference.information.combinations import Combination
from curlfit.inference.information.named_matrix import NamedMatrix
from curlfit.inference.information.thresholds import NO_PART
from curlfit.numerics.arrays import Floats

_ROUNDING = 1e-9  # singular value over the largest


class FirstOrder(NamedTuple):
    """What a fit says about its parameters, to first order."""

    parameters: Mapping[str, Any]
    """an `Estimate` each (`curlfit.inference.fit.estimates`)"""
    covariance: NamedMatrix
    """of the parameters that can move"""
    null_directions: Sequence[Mapping[str, float]]
    combinations: Sequence[Combination]
    widths: Mapping[str, float]
    """standard uncertainties of the conditions that the fit holds fixed"""
    shifts: Mapping[str, Mapping[str, float]]
    """by determined parameter, combination or product, and by condition"""
    stone: Mapping[str, float]
    ridge: Sequence[Any] = ()
    """a `RidgePoint` each (`curlfit.inference.fit.estimates`)"""
    products: Sequence[str] = ()
    """expressions of products that are determined along the ridge"""

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that can move."""
        return self.covariance.names

    @property
    def values(self) -> dict[str, float]:
        """The estimates of all parameters."""
        return {name: estimate.value for name, estimate in self.parameters.items()}

    @property
    def points(self) -> list[dict[str, float]]:
        """Values of all parameters along the ridge."""
        return [
            dict(zip(self.parameters, point.values, strict=True))
            for point in self.ridge
        ]

    def vector(self, weights: Mapping[str, float]) -> Floats:
        """Weights in the order of the parameters that can move."""
        return np.array([weights.get(name, 0.0) for name in self.names])

    def stderr(self, gradient: Mapping[str, float]) -> float:
        """Standard error of a quantity with this gradient; null directions
        are ignored."""
        row = self.vector(gradient)
        return math.sqrt(max(float(row @ self.covariance.matrix @ row), 0.0))

    def size(self, gradient: Mapping[str, float]) -> float:
        """The change of a quantity that typical sizes of the parameters imply."""
        typical = [
            slope * self.parameters[name].typical for name, slope in gradient.items()
        ]
        return math.hypot(*typical)

    def null_space(self) -> Floats:
        """Orthonormal null directions in typical sizes, shape
        (directions, parameters)."""
        directions = [
            self.vector(direction) / self._typical for direction in self.null_directions
        ]
        directions = [direction for direction in directions if direction.any()]
        if not directions:
            return np.zeros((0, len(self.names)))
        _, singular, axes = np.linalg.svd(np.array(directions), full_matrices=False)
        return np.asarray(axes[singular > _ROUNDING * singular[0]])

    @property
    def _typical(self) -> Floats:
        """Typical sizes of the parameters that can move."""
        return np.array([self.parameters[name].typical for name in self.names])

    def sees(self, gradient: Mapping[str, float]) -> bool:
        """Whether the data determine a quantity with this gradient."""
        row = self.vector(gradient) * self._typical
        along_null = np.linalg.norm(self.null_space() @ row)
        # a quantity whose gradient is not finite counts as determined
        return not along_null > NO_PART * float(np.linalg.norm(row))

    def follow(self, name: str) -> Floats:
        """Changes of the parameters for a unit change of one of them, to first order:
        along the null direction in which it takes part, or as the others are refitted;
        zeros where it does not move."""
        index = self.names.index(name)
        space = self.null_space()
        if np.linalg.norm(space[:, index]) > NO_PART:
            change = (space[:, index] @ space) * self._typical
        else:
            change = self.covariance.matrix[:, index]
        if change[index] == 0.0:
            return np.zeros(len(change))
        return np.asarray(change / change[index])

    def holding(self, name: str) -> FirstOrder:
        """What the fit says while a parameter is held at its estimate."""
        if name not in self.names:
            return self
        index = self.names.index(name)
        hold = np.eye(len(self.names))
        hold[:, index] -= self.follow(name)
        matrix = hold @ self.covariance.matrix @ hold.T
        space = self.null_space()
        parts = space[:, index]
        if np.linalg.norm(parts) > NO_PART:
            # turned so that the parameter takes part in the first direction alone
            _, _, turn = np.linalg.svd(parts[None])
            space = turn[1:] @ space
        null_directions = [
            dict(zip(self.names, (row * self._typical).tolist(), strict=True))
            for row in space
        ]
        covariance = NamedMatrix(self.names, matrix)
        return self._replace(covariance=covariance, null_directions=null_directions)

    def across(self, gradient: Mapping[str, float], shift: Floats) -> float:
        """The part across the ridge of the change of a quantity with this gradient, for
        a shift of the parameters that can move: while that parameter is held which
        leaves the least error."""
        row = self.vector(gradient)
        errors = {}
        for name in {point.held for point in self.ridge} & set(self.names):
            while_held = self.holding(name)
            if while_held.sees(gradient):
                errors[name] = while_held.stderr(gradient)
        if errors:
            held = min(errors, key=lambda name: errors[name])
            shift = shift - self.follow(held) * shift[self.names.index(held)]
        return float(row @ shift)

    def _sums(self) -> dict[str, Mapping[str, float]]:
        """Combinations and products whose shifts are known, to first order, with their
        weights."""
        sums: dict[str, Mapping[str, float]] = {
            combination.expression: combination.weights
            for combination in self.combinations
        }
        for product in self.products:
            sums[product] = self.gradient_of(product)
        return {text: row for text, row in sums.items() if text in self.shifts}

    def _shifted(self) -> Floats:
        """Which parameters have shifts of their own, and not those of products alone,
        shape (parameters,)."""
        in_products: set[str] = set()
        for product in self.products:
            in_products.update(self.gradient_of(product))
        return np.array(
            [name in self.shifts and name not in in_products for name in self.names]
        )

    def shift(self, condition: str) -> Floats:
        """Shift from the estimates to the true values if a condition is off by
        one width, along the determined directions, in the order of the parameters
        that can move."""
        shifts = {
            text: by_condition.get(condition, 0.0)
            for text, by_condition in self.shifts.items()
        }
        is_shifted = self._shifted()
        shift = is_shifted * self.vector(shifts)
        sums = self._sums()
        # of the other parameters, what the shifts of sums and products tell
        hidden = np.logical_not(is_shifted)
        if hidden.any() and sums:
            rows = np.array([self.vector(weights) for weights in sums.values()])
            rest = np.array([shifts[text] for text in sums]) - rows @ shift
            shift[hidden] = np.linalg.lstsq(rows[:, hidden], rest, rcond=None)[0]
        return shift

    def knows_shift(self, gradient: Mapping[str, float]) -> bool:
        """Whether a quantity depends on parameters without shifts of their own only as
        combinations and products do."""
        hidden = np.logical_not(self._shifted())
        scaled = self._typical * hidden
        row = self.vector(gradient) * scaled
        rows = [self.vector(weights) * scaled for weights in self._sums().values()]
        if not rows:
            return not row.any()
        along, *_ = np.linalg.lstsq(np.array(rows).T, row, rcond=None)
        rest = row - along @ np.array(rows)
        return not np.linalg.norm(rest) > NO_PART * np.linalg.norm(row)

    def gradient_of(self, product: str) -> dict[str, float]:
        """The gradient of a product of parameters at the estimates, by their names."""
        return parse(product, [*self.values], {}).gradient(self.values)
