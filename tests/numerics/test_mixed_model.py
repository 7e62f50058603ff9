"""Mixed models against dense matrices, and their coverage."""

import numpy as np
import pytest
from scipy.optimize import LinearConstraint, approx_fprime, minimize
from scipy.stats import multivariate_normal

from curlfit.numerics.mixed_model import MixedFit, MixedModel, within

MEAN = np.array([1.0, 2.0, 0.3])
EFFECTS = np.array([[0.5, -0.2]])
SPREADS = np.array([0.3, 0.6])
DIRECTIONS = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.5]])


def simulated(blocks, seed, spreads=SPREADS):
    random = np.random.default_rng(seed)
    covariates = (np.arange(blocks) % 2 - 0.5)[:, None]
    rows = random.normal(size=(blocks, 3, 3)) * [5, 5, 1]
    deviations = spreads * random.normal(size=(blocks, 2))
    vectors = MEAN + (covariates @ EFFECTS + deviations) @ DIRECTIONS.T
    target = (rows @ vectors[..., None])[..., 0] + random.normal(size=(blocks, 3))
    return rows, target, covariates, vectors


def dense(rows, target, covariates, variances):
    """-2 log restricted likelihood, the estimate and its covariance, block by block."""
    deviance = 0.0
    normal = 0.0
    right = 0.0
    for block, z, x in zip(rows, target, covariates, strict=True):
        along = block @ DIRECTIONS
        matrix = np.eye(3) + along @ np.diag(variances) @ along.T
        design = np.concatenate([block, along * x], 1)
        normal = normal + design.T @ np.linalg.solve(matrix, design)
        right = right + design.T @ np.linalg.solve(matrix, z)
        deviance += -2 * multivariate_normal.logpdf(
            z, np.zeros(3), matrix
        ) - 3 * np.log(2 * np.pi)
    best = np.linalg.solve(normal, right)
    return (
        deviance + np.linalg.slogdet(normal)[1] - right @ best,
        best,
        np.linalg.inv(normal),
    )


def test_the_estimate_is_that_of_the_dense_likelihood():
    rows, target, covariates, _ = simulated(40, 1)
    model = MixedModel.of(rows, target, DIRECTIONS, covariates)
    assert model.criterion(SPREADS**2) == pytest.approx(
        dense(rows, target, covariates, SPREADS**2)[0], abs=1e-5
    )
    fit = model.fitted(np.full(2, 0.1), np.full(3, -np.inf), np.full(3, np.inf))
    peer = minimize(
        lambda v: dense(rows, target, covariates, np.exp(v))[0],
        np.log([0.1, 0.1]),
        method="Nelder-Mead",
        options={"xatol": 1e-6, "fatol": 1e-9},
    )
    assert np.log(fit.variances) == pytest.approx(peer.x, abs=1e-3)
    _, best, covariance = dense(rows, target, covariates, fit.variances)
    assert fit.estimate == pytest.approx(best, abs=1e-6)
    assert fit.covariance == pytest.approx(covariance, abs=1e-6)


def test_the_slopes_of_the_criterion_are_those_of_the_dense_likelihood():
    rows, target, covariates, _ = simulated(12, 6)
    model = MixedModel.of(rows, target, DIRECTIONS, covariates)
    variances = np.array([0.05, 0.8])
    expected = approx_fprime(
        variances, lambda v: dense(rows, target, covariates, v)[0], 1e-6
    )
    assert model.criterion_slopes(variances) == pytest.approx(expected, rel=1e-4)


def test_the_search_for_variances_does_not_depend_on_where_it_begins():
    rows, target, covariates, _ = simulated(40, 7)
    model = MixedModel.of(rows, target, DIRECTIONS, covariates)
    first = model.variances(np.full(2, 0.1))
    second = model.variances(np.array([0.003, 2.0]))
    assert first == pytest.approx(second, rel=1e-6)


def test_further_covariates_are_as_if_they_had_been_there():
    rows, target, covariates, _ = simulated(30, 4)
    further = np.random.default_rng(5).normal(size=(30, 2))
    prior = np.eye(3)[1:], np.array([2.0, 0.5])
    at_once = MixedModel.of(
        rows, target, DIRECTIONS, np.column_stack([covariates, further]), prior
    )
    added = MixedModel.of(rows, target, DIRECTIONS, covariates, prior).with_covariates(
        further
    )
    assert added.covariates == pytest.approx(at_once.covariates)
    assert added.products == pytest.approx(at_once.products)
    assert added.prior == pytest.approx(at_once.prior)


def test_a_block_before_its_own_observations_is_as_without_it():
    rows, target, covariates, _ = simulated(12, 2)
    fit = MixedModel.of(rows, target, DIRECTIONS, covariates).fitted(
        np.full(2, 0.1), np.full(3, -np.inf), np.full(3, np.inf)
    )
    mean, matrix = fit.predicted_by_others()
    _, best, covariance = dense(rows[1:], target[1:], covariates[1:], fit.variances)
    to = fit.at(covariates[:1])[0]
    assert mean[0] == pytest.approx(to @ best, abs=1e-6)
    between = DIRECTIONS * fit.variances @ DIRECTIONS.T
    assert matrix[0] == pytest.approx(to @ covariance @ to.T + between, abs=1e-6)


def test_what_is_cut_keeps_its_variance_and_the_others_follow_it():
    """The estimate is that with the third number held at 0.5, and its uncertainty of
    0.2 moves the others as they follow it."""
    rows, target, covariates, _ = simulated(30, 8)
    held = np.array([[0.0, 0.0, 1e3]]), np.array([0.5e3])
    model = MixedModel.of(rows, target, DIRECTIONS, covariates, held)
    anywhere = np.full(3, np.inf)
    cut = np.array([0.0, 0.0, 0.2**2])
    fit = MixedFit(model, SPREADS**2, -anywhere, anywhere, cut)
    _, best, covariance = dense(rows, target, covariates, SPREADS**2)

    def where_the_third_is(value):
        return best + covariance[:, 2] / covariance[2, 2] * (value - best[2])

    moved = where_the_third_is(0.7) - where_the_third_is(0.5)
    given_the_third = (
        covariance - np.outer(covariance[2], covariance[2]) / covariance[2, 2]
    )
    assert fit.estimate == pytest.approx(where_the_third_is(0.5), abs=1e-4)
    expected = given_the_third + np.outer(moved, moved)
    assert fit.covariance == pytest.approx(expected, abs=1e-4)
    assert fit.unbounded[1] == pytest.approx(expected, abs=1e-4)


def test_without_deviations_their_size_is_zero_in_half_of_the_cases():
    zero = 0
    for seed in range(20):
        rows, target, covariates, _ = simulated(10, seed, spreads=np.zeros(2))
        model = MixedModel.of(rows, target, DIRECTIONS, covariates)
        fit = model.fitted(np.full(2, 1e-3), np.full(3, -np.inf), np.full(3, np.inf))
        zero += int((fit.variances == 0).sum())
    assert 10 <= zero <= 32


def test_a_mean_outside_its_bounds_stays_at_them():
    rows, target, covariates, _ = simulated(40, 3)
    model = MixedModel.of(rows, target, DIRECTIONS, covariates[:, :0])
    fit = model.fitted(np.full(2, 0.1), np.array([1.2, -9.0, -9.0]), np.full(3, 9.0))
    assert fit.estimate[0] == pytest.approx(1.2, abs=1e-12)
    assert fit.covariance[0, 0] == pytest.approx(0.0, abs=1e-12)
    free, _ = fit.unbounded
    assert free[0] < 1.2
    assert fit.estimate[1] != pytest.approx(free[1], abs=1e-9)


def test_the_minimum_within_bounds_is_that_of_a_general_solver():
    random = np.random.default_rng(5)
    for _ in range(5):
        root = random.normal(size=(5, 4))
        right = random.normal(size=4)
        normal = root.T @ root + 0.1 * np.eye(4)
        sides = random.normal(size=(6, 4))
        limits = -0.1
        length = np.linalg.cholesky(normal).T
        free = np.linalg.solve(normal, right)
        minimum, held = within(free, length, sides, np.full(6, limits))
        peer = minimize(
            lambda x, normal=normal, right=right: x @ normal @ x / 2 - right @ x,
            np.zeros(4),
            jac=lambda x, normal=normal, right=right: normal @ x - right,
            method="SLSQP",
            constraints=LinearConstraint(sides, limits),
            options={"ftol": 1e-14},
        )
        assert minimum == pytest.approx(peer.x, abs=1e-5)
        assert held @ minimum == pytest.approx(np.full(len(held), limits), abs=1e-9)
        assert len(held)


def test_means_of_groups_stay_within_bounds():
    rows, target, covariates, _ = simulated(40, 6)
    model = MixedModel.of(rows, target, DIRECTIONS, covariates)
    least = np.array([1.0, -np.inf, -np.inf])
    fit = model.fitted(np.full(2, 0.1), least, np.full(3, np.inf))
    groups = fit.at(np.unique(covariates, axis=0)) @ fit.estimate
    assert groups[0, 0] == pytest.approx(1.0, abs=1e-9)
    assert groups[1, 0] > 1.1
    held = fit.at(np.unique(covariates, axis=0))[0, 0]
    assert held @ fit.covariance @ held == pytest.approx(0.0, abs=1e-12)
