"""The algebra of square-root information, against matrices that are inverted."""

from __future__ import annotations

import numpy as np
import pytest

from curlfit.inference.information.bounds import Bounded
from curlfit.inference.information.covariance import Covariance
from curlfit.inference.information.information import Information
from curlfit.inference.information.verdict import Verdict

NAMES = ("a", "b", "c")
TYPICAL = np.array([1.0, 0.01, 3.0])
VALUES = np.array([2.0, 0.02, -1.0])


def problem(seed, rows=20, values=VALUES):
    """Residuals over their sigma at some values, and their derivatives."""
    random = np.random.default_rng(seed)
    jacobian = 10 * random.standard_normal((rows, 3)) / TYPICAL
    at_zero = random.standard_normal(rows)
    return jacobian, at_zero + jacobian @ values


def information_of(seed, values=VALUES):
    return Information.of(
        NAMES, Bounded.none(values), TYPICAL, *problem(seed, values=values)
    )


def stack(count):
    """Throws about the same values, along the first axis."""
    problems = [problem(seed) for seed in range(count)]
    jacobians = np.stack([jacobian for jacobian, _ in problems])
    residuals = np.stack([residual for _, residual in problems])
    values = np.tile(VALUES, (count, 1))
    return Information.of(NAMES, Bounded.none(values), TYPICAL, jacobians, residuals)


def assert_same(one, other):
    """Rows are the same up to a rotation: their products are equal."""
    np.testing.assert_allclose(one.rows.mT @ one.rows, other.rows.mT @ other.rows)


def test_four_rows_are_all_that_the_residuals_say():
    jacobian, residual = problem(0)
    information = information_of(0)
    assert information.rows.shape == (4, 4)
    np.testing.assert_allclose(information.normal_matrix, jacobian.T @ jacobian)
    np.testing.assert_allclose(information.gradient, -residual @ jacobian)
    step = np.array([0.3, -0.002, 0.5])
    risen = ((residual + jacobian @ step) ** 2).sum() - (residual**2).sum()
    assert information.rise(step) == pytest.approx(risen)


def test_information_about_other_values_is_that_of_the_residuals_there():
    elsewhere = VALUES + np.array([0.5, 0.01, -1.0])
    assert_same(information_of(0).about(elsewhere), information_of(0, elsewhere))


def test_what_two_say_together_does_not_depend_on_where_each_is_linearized():
    first = problem(0)
    second = problem(1)
    jacobian = np.concatenate([first[0], second[0]])
    residual = np.concatenate([first[1], second[1]])
    stacked = Information.of(NAMES, Bounded.none(VALUES), TYPICAL, jacobian, residual)
    assert_same(information_of(0) + information_of(1, VALUES + 0.1), stacked)


def test_a_sum_takes_one_that_is_about_fewer_parameters():
    """c is measured besides: -1.5 with an error of 0.1."""
    measured = Information.of(
        ("c",),
        Bounded.none(np.array([-1.5])),
        np.array([1.0]),
        np.array([[1 / 0.1]]),
        np.zeros(1),
    )
    summed = information_of(0) + measured
    expected = information_of(0).normal_matrix
    expected[2, 2] += 1 / 0.1**2
    np.testing.assert_allclose(summed.normal_matrix, expected)
    expected_gradient = information_of(0).gradient
    expected_gradient[2] -= 0.5 / 0.1**2
    np.testing.assert_allclose(summed.gradient, expected_gradient)


def test_the_marginal_has_the_covariance_of_all():
    which = np.array([True, False, True])
    throws = stack(4)
    marginal = throws.marginal(which)
    for row in range(4):
        covariance = np.linalg.inv(throws.at(row).normal_matrix)
        of_common = np.linalg.inv(marginal.information.at(row).normal_matrix)
        np.testing.assert_allclose(of_common, covariance[np.ix_(which, which)])
    assert marginal.rank.tolist() == [1] * 4


def test_nuisance_parameters_follow_to_their_least_squares():
    throws = stack(1)
    follow = throws.marginal(np.array([True, False, True])).follow[0]
    jacobian, _ = problem(0)
    expected = -np.linalg.lstsq(jacobian[:, [1]], jacobian[:, [0, 2]])[0]
    np.testing.assert_allclose(follow[1], expected[0])
    np.testing.assert_array_equal(follow[[0, 2]], np.eye(2))


def test_a_nuisance_parameter_at_its_bound_does_not_follow():
    jacobian, _ = problem(0)
    residual = jacobian @ np.array([0.0, -1e-3, 0.0])
    bounded = Bounded(VALUES, np.full(3, -np.inf), np.array([9.0, VALUES[1], 9.0]))
    information = Information.of(NAMES, bounded, TYPICAL, jacobian, residual)
    assert information.at_bound().tolist() == [False, True, False]
    which = np.array([True, False, True])
    marginal = information.marginal(which)
    assert_same(marginal.information, information.only(which))
    assert Covariance.of(information).classified(1) == (None, Verdict.AT_BOUND, None)


def test_the_others_are_all_but_one():
    throws = stack(5)
    of_others = throws.of_others()
    for row in range(5):
        rest = [other for other in range(5) if other != row]
        assert_same(of_others.at(row), throws.at(rest).together())


def test_the_prior_decides_the_verdict_where_the_data_do_not():
    """Only a + b is measured; a prior knows b."""
    size = np.ones(2)
    values = Bounded.none(np.array([1.0, 2.0]))
    data = Information.of(
        ("a", "b"), values, size, np.array([[10.0, 10.0]]), np.zeros(1)
    )
    alone = Covariance.of(data)
    assert alone.classified(0) == (None, Verdict.NOT_IDENTIFIABLE, None)
    (total,) = alone.combinations
    assert (total.expression, total.value) == ("a + b", 3.0)
    assert total.stderr == pytest.approx(0.1)
    with_prior = data.with_rows(np.array([[0.0, 10.0, 0.0]]))
    stderr, verdict, _ = Covariance.of(with_prior, of_data=data).classified(0)
    assert (stderr, verdict) == (pytest.approx(np.hypot(0.1, 0.1)), Verdict.PRIOR)


def test_a_shift_is_the_least_squares_of_changed_residuals():
    jacobian, _ = problem(0)
    change = np.random.default_rng(9).standard_normal(len(jacobian))
    shift = information_of(0).response(jacobian.T @ change)
    np.testing.assert_allclose(shift, -np.linalg.lstsq(jacobian, change)[0])
