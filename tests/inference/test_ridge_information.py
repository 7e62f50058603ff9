"""What the ridge leaves of the information about an optimum, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from curlfit.inference.information.bounds import Bounded
from curlfit.inference.information.information import Information
from curlfit.inference.information.ridge_information import information_along
from curlfit.inference.information.thresholds import LITTLE


def information_of(rows: np.ndarray, step: np.ndarray | None = None) -> Information:
    """Rows about zero, in typical sizes of one, whose optimum is a step away."""
    count = rows.shape[1]
    step = np.zeros(count) if step is None else step
    about = Bounded.none(np.zeros(count))
    return Information.of("abc"[:count], about, np.ones(count), rows, -rows @ step)


def squares(information: Information) -> np.ndarray:
    return information.scaled.T @ information.scaled


def test_nothing_is_taken_out_of_a_quadratic():
    random = np.random.default_rng(1)
    root = random.standard_normal((6, 3))
    moves = 2 * random.standard_normal((40, 3))
    rises = ((moves @ root.T) ** 2).sum(1)
    information = information_along(information_of(root), moves, rises)
    assert information.stretched.scaled.shape == (0, 3)
    assert squares(information.kept) == pytest.approx(root.T @ root)


def test_points_along_a_null_direction_are_no_contradiction():
    """chi squared = ((a + b)/s)^2: a and b differ without limit."""
    rows = np.array([[100.0, 100.0]])
    far = np.linspace(-50, 50, 11)
    moves = np.outer(far, [1, -1])
    information = information_along(information_of(rows), moves, np.zeros(11))
    assert information.stretched.scaled.shape == (0, 2)
    assert squares(information.kept) == pytest.approx(rows.T @ rows)


def hyperbola(spin_error: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows, moves and rises about (1, 1, 0) of chi squared = ((b omega - 1)/s)^2
    + ((omega - 1)/spin_error)^2 + (c/s)^2, s = 0.01, along b = 1/omega."""
    rows = np.array(
        [[100.0, 100.0, 0.0], [0.0, 1 / spin_error, 0.0], [0.0, 0.0, 100.0]]
    )
    omega = 1 + spin_error * np.linspace(-3.2, 3.2, 33)
    omega = omega[omega > 0.05]
    moves = np.column_stack([1 / omega - 1, omega - 1, 0 * omega])
    return rows, moves, ((omega - 1) / spin_error) ** 2


def test_a_product_is_taken_out_and_the_rest_is_kept():
    rows, moves, rises = hyperbola(0.3)
    information = information_along(information_of(rows), moves, rises)
    all_rows = np.vstack([information.kept.scaled, information.stretched.scaled])
    errors = np.sqrt(np.diagonal(np.linalg.inv(all_rows.T @ all_rows)))
    # c is as well known as before
    assert errors[2] == pytest.approx(0.01)
    unit = np.array([0.0, 0.0, 1.0])
    assert np.linalg.norm(information.kept.scaled @ unit) == pytest.approx(100.0)
    # all points are as far as chi squared has risen, b among them
    expected = np.sqrt(np.maximum(rises, 1.0))
    distances = np.linalg.norm(moves @ all_rows.T, axis=1)
    assert (distances <= LITTLE * expected * (1 + 1e-9)).all()
    assert (np.abs(moves[:, 0]) <= LITTLE * errors[0] * expected * (1 + 1e-9)).all()
    first_order = np.sqrt(np.diagonal(np.linalg.inv(rows.T @ rows)))
    assert errors[0] > 10 * first_order[0]


def test_a_short_stretch_of_a_product_is_straight():
    """With the spin known to 0.002, b is told as the quadratic says."""
    rows, moves, rises = hyperbola(0.002)
    information = information_along(information_of(rows), moves, rises)
    assert information.stretched.scaled.shape == (0, 3)
    assert squares(information.kept) == pytest.approx(rows.T @ rows)


def test_what_is_told_of_some_parameters_whatever_the_others():
    """Of b and c, with the spin eliminated: both parts together are the Schur
    complement, and give what they give at the optimum."""
    rows, moves, rises = hyperbola(0.3)
    step = np.array([0.1, 0.2, 0.3])
    information = information_along(information_of(rows, step), moves, rises)
    columns = np.array([True, False, True])
    parts = information.marginal(columns)
    matrix = squares(information.kept) + squares(information.stretched)
    schur = (
        matrix[np.ix_(columns, columns)]
        - np.outer(matrix[columns, 1], matrix[1, columns]) / matrix[1, 1]
    )
    of_both = squares(parts.kept) + squares(parts.stretched)
    assert of_both == pytest.approx(schur, rel=1e-6, abs=1e-6)
    together = parts.kept + parts.stretched
    assert together.step_to_optimum() == pytest.approx([0.1, 0.3])
    assert parts.kept.scaled[:, 0] == pytest.approx(0.0, abs=1e-6)
    assert len(parts.stretched.rows) == 1
