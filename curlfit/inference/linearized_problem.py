"""The linearized problem at an optimum: parameters at bounds, remaining step, verdicts."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from curlfit.inference.identifiability import WEAK_ERROR, Identifiability, slack, visible
from curlfit.numerics.arrays import Booleans, Floats

_LOOSE = 0.1  # typical sizes inside its bound from which a parameter is not held by it
_NEAR = 1e-6  # typical sizes from a bound within which a parameter is at the bound
_PUSHED = 10.0  # least push against a bound over the slopes by the parameters inside theirs ...
_LEAST_PUSH, _CLEAR_PUSH = 1e-6, 1e-3  # ... within these limits, half chi squared per typical size


class LinearizedProblem(NamedTuple):
    """The problem of one throw or of several, linearized at its optimum.

    Or many such problems, along the first axis of each field.
    """

    residual: Floats
    """over its sigma, shape (rows,)"""
    jacobian: Floats
    """shape (rows, parameters)"""
    values: Floats
    lower: Floats
    upper: Floats
    typical: Floats
    free: Booleans

    def at_bound(self) -> Booleans:
        """Free parameters at a bound that the data push against it, however weakly.

        Along a valley that descends without end the push may be tiny. It is distinguished from the
        end of an exact ridge, where there is none, by the remaining slope along the other
        parameters.
        """
        push, low, high = self._pushes()
        rest = np.abs(push * (self.free & ~low & ~high)).max(-1, keepdims=True)
        least = np.clip(_PUSHED * rest, _LEAST_PUSH, _CLEAR_PUSH)
        return low & (push > least) | high & (push < -least)

    def movable(self) -> Booleans:
        """Free parameters except those that only a bound keeps from moving, however weakly."""
        push, low, high = self._pushes()
        return self.free & ~(low & (push > 0)) & ~(high & (push < 0))

    def _pushes(self) -> tuple[Floats, Booleans, Booleans]:
        """The push toward lower bounds, and which parameters are at a lower, at an upper bound."""
        near = _NEAR * self.typical
        return (
            (self.residual[..., None, :] @ self.jacobian)[..., 0, :] * self.typical,
            self.free & (self.values <= self.lower + near),
            self.free & (self.values >= self.upper - near),
        )

    def open(self, at_bound: Booleans) -> tuple[Booleans, Floats]:
        """The parameters of one optimum that can move, and the contribution of those held at a
        bound to their spread.

        A parameter that the data hardly push against its bound is not held by it: it is at the
        end of a ridge and counts as open.
        """
        if not at_bound.any():
            return self.free, np.zeros((int(self.free.sum()), 0))
        push = np.abs(self.residual @ self.jacobian)
        room = self.upper - self.lower
        held = at_bound.copy()
        for _ in range(2):
            open_ = self.free & ~held
            found = slack(
                self.jacobian[:, open_], self.jacobian[:, held], push[held], self.typical[held],
                room[held],
            )  # fmt: skip
            loose = found.distance > _LOOSE * self.typical[held]
            if not loose.any():
                break
            held[held] = ~loose
        return open_, found.columns

    def newton_decrement(self, where: Booleans) -> Floats:
        """Length of the remaining Gauss-Newton step, in sigmas, along determined directions.

        A null direction would have to be followed over a thousand typical sizes.
        """
        jacobian = self.jacobian * (self.typical * where)[..., None, :]
        left, singular, _ = np.linalg.svd(jacobian, full_matrices=False)
        along = (self.residual[..., None, :] @ left)[..., 0, :]
        return np.linalg.norm(along * visible(singular), axis=-1)

    def distance(self, count: Any, whole: LinearizedProblem) -> Any:
        """Distance to the optimum in standard errors, over the noise where `count` values scatter
        by more than their sigma.

        `whole` is the problem with the directions that only the bounds determine. A step along them
        would leave the bounds; without them, parameters at a bound may seem free to move. Both are
        upper limits.
        """
        reduced = (self.residual**2).sum(-1) / np.maximum(count, 1)
        steps = (one.newton_decrement(one.movable()) for one in (self, whole))
        return np.minimum(*steps) / np.sqrt(np.maximum(reduced, 1.0))


def classify(
    typical: float, at_bound: bool, known: Identifiability, place: int
) -> tuple[float | None, str]:
    """Standard error, where there is one, and verdict of a free parameter.

    The 95 % interval of a weakly determined parameter reaches its typical size to either side.
    `place` is the index of the parameter in `known`.
    """
    if at_bound:
        return None, "at bound"
    if known.unseen[place]:
        return None, "not identifiable"
    stderr = float(np.sqrt(known.covariance[place, place]))
    return stderr, "determined" if stderr < WEAK_ERROR * typical else "weak"
