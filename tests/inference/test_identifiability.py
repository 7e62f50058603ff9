"""Directions that the data see, on matrices whose answer is known."""

from __future__ import annotations

import re

import numpy as np
import pytest
from conftest import NOISE, TIMES, filmed, finding_of

import curlfit
from curlfit.inference.information.bounds import Bounded
from curlfit.inference.information.combinations import expression
from curlfit.inference.information.directions import wide_errors
from curlfit.inference.information.identifiability import Identifiability
from curlfit.inference.information.information import Information
from curlfit.inference.information.thresholds import UNKNOWN, WIDE


def determined_by(jacobian, names, values, typical, lower=-np.inf, upper=np.inf):
    """What residuals with this Jacobian determine."""
    bounds = np.broadcast_to(lower, len(names)), np.broadcast_to(upper, len(names))
    jacobian = np.asarray(jacobian, float)
    residual = np.zeros(len(jacobian))
    information = Information.of(
        names, Bounded(values, *bounds), typical, jacobian, residual
    )
    return Identifiability.of(information)


def _analysed(jacobian, names, typical=None):
    p = len(names)
    typical = np.ones(p) if typical is None else np.asarray(typical)
    return determined_by(jacobian, names, np.arange(1.0, p + 1), typical)


def test_a_sum_is_found_with_its_error():
    random = np.random.default_rng(1)
    column = random.standard_normal((40, 2)) * 30
    jacobian = np.stack([column[:, 0], column[:, 1], column[:, 1]], 1)
    identifiability = _analysed(jacobian, ["a", "b", "c"], [1.0, 0.01, 0.01])
    assert identifiability.rank == 2
    assert identifiability.null_directions == ({"b": 1.0, "c": -1.0},)
    (combination,) = identifiability.combinations
    assert combination.expression == "b + c"
    assert combination.value == 5.0
    exact = np.linalg.inv(column.T @ column)
    assert combination.stderr == pytest.approx(np.sqrt(exact[1, 1]), rel=1e-9)
    np.testing.assert_array_equal(identifiability.unseen, [False, True, True])
    assert identifiability.covariance[0, 0] == pytest.approx(exact[0, 0], rel=1e-9)


def test_weights_follow_the_parameters_not_their_scaling():
    column = np.random.default_rng(2).standard_normal(20) * 1e4
    jacobian = np.stack([column, 3 * column], 1)  # only a + 3 b is seen
    for typical in ([1, 1], [1, 0.01], [0.3, 5]):
        identifiability = _analysed(jacobian, ["a", "b"], typical)
        (combination,) = identifiability.combinations
        assert combination.weights["b"] / combination.weights["a"] == pytest.approx(
            3, rel=1e-9
        )
        (null,) = identifiability.null_directions
        assert null["a"] / null["b"] == pytest.approx(-3, rel=1e-9)


def test_two_null_directions_leave_two_sums():
    base = np.random.default_rng(3).standard_normal((50, 2)) * 100
    jacobian = np.stack([base[:, 0], base[:, 1], base[:, 0], base[:, 1]], 1)
    identifiability = _analysed(jacobian, ["a", "b", "c", "d"])
    assert identifiability.rank == 2
    assert {combination.expression for combination in identifiability.combinations} == {
        "a + c",
        "b + d",
    }


@pytest.mark.parametrize(("share", "known"), [(0.0, True), (0.05, True), (0.2, False)])
def test_a_null_direction_moves_a_sum_by_what_its_parameters_may(share, known):
    """Only a - share b is measured: a is known as well as b is, of size 1."""
    error = 0.01
    slopes = np.array([[1.0, -share]]) / error
    (wide_error,) = wide_errors(slopes, np.array([[1.0, 0.0]]))
    if known:
        assert wide_error == pytest.approx(np.hypot(error, UNKNOWN * share), rel=0.01)
        assert wide_error < WIDE
    else:
        assert wide_error == np.inf


@pytest.mark.parametrize(
    ("weights", "text"),
    [
        ({"a": 1.0, "b": 1.0}, "a + b"),
        ({"a": 1.0, "b": -2.0}, "a - 2 b"),
        ({"a": -1.0, "b": 0.5}, "1/2 b - a"),
        ({"a": 1.0, "b": 0.3217}, "a + 0.3217 b"),
    ],
)
def test_expressions(weights, text):
    assert expression(weights) == text


def test_what_is_lost_in_rounding_beside_a_large_number_is_not_seen():
    base = np.linalg.qr(np.random.default_rng(4).standard_normal((30, 3)))[0]
    jacobian = np.stack(
        [1e12 * base[:, 0], 5 * (base[:, 1] + base[:, 2]), 5 * base[:, 1]], 1
    )
    identifiability = _analysed(jacobian, ["a", "b", "c"])
    assert identifiability.rank == 1
    np.testing.assert_array_equal(identifiability.unseen, [False, True, True])
    assert not identifiability.combinations


def test_a_direction_that_only_the_bounds_limit_is_not_determined():
    """The difference of two coefficients has a standard error of 50, their bounds
    a width of 1."""
    rotated = np.array([[10.0, 10.0], [0.02, -0.02]]) / np.sqrt(2)
    values = np.array([0.5, 0.5])
    about = (["a", "b"], values, np.ones(2))
    free = determined_by(rotated, *about)
    assert free.rank == 2
    assert free.covariance[0, 0] == pytest.approx((0.1**2 + 50**2) / 2)
    held = determined_by(rotated, *about, 0.0, 1.0)
    assert (held.rank, held.null_directions) == (1, ({"a": 1.0, "b": -1.0},))
    (total,) = held.combinations
    assert (total.expression, total.stderr) == (
        "a + b",
        pytest.approx(0.1 * np.sqrt(2)),
    )
    wider = determined_by(rotated, *about, values - 5, values + 5)
    assert wider.rank == 2  # a room of 0.28 standard errors


def test_the_singular_values_of_what_is_determined_come_first():
    """The bounds leave b a twentieth of its standard error; c, known less, has none."""
    jacobian = np.diag([10.0, 0.5, 0.02])
    lower = np.array([-9.0, 0.0, -1e6])
    upper = np.array([9.0, 0.1, 1e6])
    values = np.array([0.0, 0.05, 0.0])
    identifiability = determined_by(
        jacobian, ["a", "b", "c"], values, np.ones(3), lower, upper
    )
    assert identifiability.rank == 2
    assert identifiability.singular_values == pytest.approx([10.0, 0.02, 0.5])


def noisy(law, omega):
    return filmed(law, 2, v=2.0, omega=omega, times=TIMES[::2]).with_sigma(NOISE)


def test_a_parameter_at_its_bound_confines_no_direction_in_which_it_has_no_part():
    """But for rounding: two such parameters left no room to either side."""
    bounded = Bounded(
        np.array([3.9, 0.0, 0.01]), np.array([0.05, 0.0, 0.01]), np.full(3, 20.0)
    )
    (confined,) = bounded.alone_limit(
        np.array([[1.0, 1e-17, -1e-17]]), np.array([0.95]), np.ones(3)
    )
    assert not confined


def test_an_error_contains_the_values_where_another_coefficient_is_usual():
    """The drop of sutor's friction dies with spin, at a scale that one throw
    does not tell."""
    throw = noisy(curlfit.LAWS["sutor"](alpha=0.16), omega=0.7)
    fit = curlfit.fit(throw, "sutor", details=False)
    held = curlfit.fit(throw, "sutor", fix={"u0": 0.065}, details=False)
    assert fit["u0"].value > 5
    assert held.chi_squared < fit.chi_squared + 4
    assert fit["alpha"].verdict == "weak"
    assert fit["alpha"].stderr > abs(held["alpha"].value - fit["alpha"].value) > 0.05
    assert str(fit.warnings[0]).startswith("other values fit as well: alpha = ")


def test_no_sum_is_determined_where_what_fits_lies_on_a_curve():
    fit = curlfit.fit(noisy(curlfit.LAWS["sutor"](), omega=3.0), "sutor", details=False)
    words = str(finding_of(fit, "curve"))
    assert re.search(r"alpha from [.\d]+ to [.\d]+, u0 from", words)
    assert not fit.combinations


def test_a_sum_holds_that_hardly_changes_along_a_curve(eq12):
    """As friction goes from behind the centre to before it, under consistent load."""
    fit = curlfit.fit(eq12, load="consistent", details=False)
    (combination,) = fit.combinations
    ends = [
        curlfit.fit(eq12, load="consistent", fix=held, sigma=fit.sigma, details=False)
        for held in ({"mu1_eta": 0.0}, {"mu2_eta": 0.0})
    ]
    assert ends[1].chi_squared < ends[0].chi_squared + 1
    sums = [
        sum(w * end[name].value for name, w in combination.weights.items())
        for end in ends
    ]
    assert sums == pytest.approx([combination.value] * 2, abs=combination.stderr)
