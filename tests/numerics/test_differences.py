"""Derivatives by differences against exact ones."""

from __future__ import annotations

import numpy as np
import pytest

from curlfit.numerics.differences import slopes

AT = np.array([0.5, 2.0, 0.0])


def function(x):
    """Two rows of values, with kinks where x is beyond its bounds."""
    a, b, c = x
    return np.array([[a * b, np.exp(a)], [b**3, np.abs(c)]])


EXACT = np.array([[[2.0, 0.5, 0], [np.exp(0.5), 0, 0]], [[0, 12.0, 0], [0, 0, 1.0]]])


def test_central_differences_and_one_sided_ones_at_a_bound():
    step = np.array([1e-4, 1e-4, 1e-3])
    derivatives = slopes(
        function, AT, step, lower=[-np.inf, -np.inf, 0.0], upper=[np.inf, 9.0, 9.0]
    )
    assert derivatives.shape == (2, 2, 3)
    np.testing.assert_allclose(derivatives, EXACT, rtol=1e-8, atol=1e-12)
    without = slopes(function, AT, step)
    assert without[1, 1, 2] == 0.0
    # nothing is evaluated outside the bounds
    slopes(lambda x: x if x.min() >= 0 else pytest.fail("outside"), AT, 1.0, lower=0.0)


def test_some_arguments_alone_and_one_sided_differences_from_a_known_value():
    calls = []

    def counted(x):
        calls.append(x)
        return function(x)

    some = slopes(counted, AT, 1e-6, [1, 0], value=function(AT))
    assert len(calls) == 2
    np.testing.assert_allclose(some, EXACT[..., [1, 0]], rtol=1e-5, atol=1e-12)
    mask = slopes(function, AT, 1e-4, np.array([True, False, False]))
    np.testing.assert_allclose(mask, EXACT[..., :1], rtol=1e-8, atol=1e-12)
