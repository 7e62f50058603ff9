"""Derivatives by finite differences, where no program for the exact ones is
compiled anyway: one of a path takes ten times as long to compile as the differences
to evaluate."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from curlfit.numerics.arrays import Floats


def slopes(
    function: Callable[[Floats], Any],
    at: Any,
    step: Any,
    where: Any = slice(None),
    *,
    lower: Any = -np.inf,
    upper: Any = np.inf,
    value: Any = None,
) -> Floats:
    """Derivatives of a function by its arguments, or by those at `where`.

    Central differences, one-sided at a bound. With steps h their error is h^2/6 times
    the third derivative (one-sided h/2 times the second), and the error of the
    function over h.

    Parameters
    ----------
    function : of an array of numbers; its value is an array of any shape.
    at, step, lower, upper : arguments, steps and bounds; arrays of one shape
        (p,), or numbers.
    where : mask or indices of arguments.
    value : of the function there; with it, differences are one-sided, at half the cost.

    Returns
    -------
    of the shape of the value and, last, the number of these arguments.
    """
    at = np.asarray(at, float)
    derivatives = []
    for along in np.diag(np.broadcast_to(step, at.shape))[where]:
        up = np.clip(at + along, lower, upper)
        if value is None:
            down = np.clip(at - along, lower, upper)
            value_down = function(down)
        else:
            down = at
            value_down = value
        difference = np.asarray(function(up)) - value_down
        derivatives.append(difference / (up - down).sum())
    return np.stack(derivatives, -1)
