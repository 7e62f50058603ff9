"""Principal axes of a symmetric matrix, and their signs."""

import numpy as np
import pytest

from curlfit.numerics.principal_axes import principal_axes


def test_they_rebuild_the_matrix():
    random = np.random.default_rng(0)
    matrix = np.cov(random.standard_normal((5, 40)))
    values, rows = principal_axes(matrix)
    assert (np.diff(values) < 0).all()
    assert rows.T * values @ rows == pytest.approx(matrix, abs=1e-13)


def test_rounding_does_not_choose_their_signs():
    random = np.random.default_rng(1)
    # symmetric under reversal: half the eigenvectors are odd, with two equal
    # greatest components
    distance = np.abs(np.subtract.outer(np.arange(9), np.arange(9)))
    matrix = np.exp(-distance / 3)
    _, expected = principal_axes(matrix)
    assert np.abs(expected[1::2] + expected[1::2, ::-1]).max() < 1e-12
    for _ in range(50):
        noise = 1e-15 * random.standard_normal(matrix.shape)
        assert principal_axes(matrix + noise + noise.T)[1] == pytest.approx(
            expected, abs=1e-12
        )
