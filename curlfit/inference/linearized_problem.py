"""An optimum as the linear problem it is close by: bounds, what is left to go, verdicts."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from curlfit.inference.identifiability import Identifiability, slack, visible
from curlfit.numerics.arrays import Booleans, Floats

_LOOSE = 0.1  # typical sizes a parameter may be inside its bound before it counts as held by it
_NEAR = 1e-6  # typical sizes from its bound within which a parameter is at it
_PUSHED = 10.0  # times the slope along those inside that a parameter at a bound is pushed with ...
_LEAST_PUSH, _CLEAR_PUSH = 1e-6, 1e-3  # ... within these limits, half chi squared a typical size


class LinearizedProblem(NamedTuple):
    """An optimum of one throw or of several, as the linear problem it is close by.

    Or many such optima, along the first axis of each field.
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
        """Free parameters at a bound that the data push against it, however little.

        Along a valley that falls without end the push may be tiny. It is told from the end of an
        exact ridge, which is none, by what is left of the slope along the other parameters.
        """
        push, low, high = self._pushes()
        rest = np.abs(push * (self.free & ~low & ~high)).max(-1, keepdims=True)
        least = np.clip(_PUSHED * rest, _LEAST_PUSH, _CLEAR_PUSH)
        return low & (push > least) | high & (push < -least)

    def movable(self) -> Booleans:
        """Free parameters but those that only a bound keeps from moving on, however little."""
        push, low, high = self._pushes()
        return self.free & ~(low & (push > 0)) & ~(high & (push < 0))

    def _pushes(self) -> tuple[Floats, Booleans, Booleans]:
        """The push against lower bounds, and which parameters are at a lower, an upper bound."""
        near = _NEAR * self.typical
        return (
            (self.residual[..., None, :] @ self.jacobian)[..., 0, :] * self.typical,
            self.free & (self.values <= self.lower + near),
            self.free & (self.values >= self.upper - near),
        )

    def open(self, at_bound: Booleans) -> tuple[Booleans, Floats]:
        """The parameters of one optimum that can move, and what those held at a bound add to their
        spread.

        A parameter that the data hardly push against its bound is not held by it: it is at the
        end of a ridge, and counts as open.
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
        """Length of the Gauss-Newton step that is left, in sigmas, along what is seen.

        A direction that counts as unseen would have to be followed over a thousand typical sizes.
        """
        jacobian = self.jacobian * (self.typical * where)[..., None, :]
        left, singular, _ = np.linalg.svd(jacobian, full_matrices=False)
        along = (self.residual[..., None, :] @ left)[..., 0, :]
        return np.linalg.norm(along * visible(singular), axis=-1)


def classify(
    typical: float, at_bound: bool, known: Identifiability, place: int
) -> tuple[float | None, str]:
    """Standard error, where there is one, and verdict of a free parameter; its place in `known`.

    A weak parameter is known to no better than its typical size.
    """
    if at_bound:
        return None, "at bound"
    if known.unseen[place]:
        return None, "not identifiable"
    stderr = float(np.sqrt(known.covariance[place, place]))
    return stderr, "determined" if stderr < typical else "weak"
