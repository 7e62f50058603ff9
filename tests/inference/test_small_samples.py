"""Few rows and parameters at a bound: Student's t, outliers by chance, verdicts."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import NOISE as SIGMA, codes_of, filmed, finding_of, shown
from scipy.stats import binomtest, chi2, f, t

import curlfit
from curlfit.errors import Option
from curlfit.inference.fit.caveats import of_outliers
from curlfit.inference.fit.entries import Outlier
from curlfit.inference.fit.fit import fit_throws
from curlfit.inference.fit.fit_covariance import FitCovariance
from curlfit.inference.fit.residuals import outliers_of
from curlfit.inference.model.likelihood import SIGMA_FLOOR
from curlfit.losses import LINEAR
from curlfit.profile_likelihood.result import levels_of
from curlfit.reports.determined import sentences_on

TRUE = {"mu1_xi": 0.005, "mu2_xi": 0.05}
START = {"x0": 0.0, "y0": 0.0, "heading": 0.02, "v0": 2.1, "phi0": 0.0, "omega0": 1.3}


PATH = filmed(noise=dict.fromkeys(SIGMA, 0.0), heading=0.02, v=2.1, omega=1.3)


def thrown(seed, rows):
    """Of the path some rows, evenly, with noise."""
    chosen = np.linspace(0, 200, rows).round().astype(int)
    random = np.random.default_rng(seed)
    series = {
        name: getattr(PATH, name)[chosen] + sigma * random.standard_normal(rows)
        for name, sigma in SIGMA.items()
    }
    return curlfit.Throw.from_arrays(PATH.t[chosen], **series)


def test_the_interval_of_a_mean_is_student_s():
    """With all else held, x0 is the mean of n rows."""
    throw = thrown(0, 12)
    held = START | vars(curlfit.LAWS["front-back"]())
    fit = curlfit.fit(
        throw, fix={name: value for name, value in held.items() if name != "x0"}
    )
    estimate = fit.parameters["x0"]
    off = throw.x - PATH.x[np.isin(PATH.t, throw.t)]
    expected = t.interval(0.95, 11, off.mean(), off.std(ddof=1) / np.sqrt(12))
    assert estimate.dof == pytest.approx(11, abs=1e-6)
    np.testing.assert_allclose(estimate.interval(0.95), expected, atol=3 * SIGMA_FLOOR)


def test_degrees_of_freedom_are_welch_s():
    """The difference of two means whose variances are estimated apart (Welch 1947)."""
    squares = (4.0, 0.25)
    counts = (5, 9)
    parts = np.array([s / n for s, n in zip(squares, counts, strict=True)])
    effect = np.zeros((2, 1, 2))  # of one residual per channel
    effect[[0, 1], 0, [0, 1]] = np.sqrt(parts)
    covariance = SimpleNamespace(
        effect=effect,
        matrix=np.diag(parts),
        dof=np.array([4.0, 8.0]),
        has_priors=False,
        others=None,
    )
    expected = parts.sum() ** 2 / (parts**2 / (np.array(counts) - 1)).sum()
    weights = np.array([[1.0, -1.0]])
    assert FitCovariance.degrees_of_freedom(covariance, weights) == [
        pytest.approx(expected)
    ]
    covariance.dof = np.array([np.inf, np.inf])
    assert FitCovariance.degrees_of_freedom(covariance, weights) == [None]


@pytest.mark.parametrize("dof", [3.0, 12.5, 200.0, None])
def test_levels_are_quantiles_of_t_and_f(dof):
    for level, probability in zip(levels_of(dof), (0.682689492137, 0.95), strict=True):
        single = (
            chi2.ppf(probability, 1)
            if dof is None
            else t.ppf((1 + probability) / 2, dof) ** 2
        )
        pair = (
            chi2.ppf(probability, 2) if dof is None else 2 * f.ppf(probability, 2, dof)
        )
        assert level.delta_chi2 == pytest.approx(single, rel=1e-9)
        assert level.delta_chi2_pair == pytest.approx(pair, rel=1e-9)
        assert level.sigmas**2 == pytest.approx(level.delta_chi2)


def test_twelve_rows_hold_the_truth_as_often_as_they_say():
    """By 1.96 standard errors it is 92 %."""
    inside = gaussian = outliers = several = 0
    truth = START | TRUE
    # of 15 at a time, whose program other tests need too
    parts = (
        [thrown(seed, 12) for seed in range(at, at + 15)] for at in range(0, 150, 15)
    )
    for fit in chain.from_iterable(map(fit_throws, parts)):
        outliers += len(fit.outliers) > 0
        for name, true in truth.items():
            estimate = fit.parameters[name]
            if estimate.stderr is None:
                continue
            low, high = estimate.interval()
            inside += low <= true <= high
            gaussian += abs(estimate.value - true) <= 1.96 * estimate.stderr
            several += 1
    assert several >= 1190
    assert 0.935 < inside / several < 0.965
    assert gaussian / several < 0.93
    assert binomtest(outliers, 150, 0.001).pvalue > 0.01


@pytest.mark.parametrize(("rows", "sigmas"), [(12, 40.0), (24, 15.0), (150, 9.0)])
def test_a_gross_outlier_is_found_in_few_rows(rows, sigmas):
    throw = thrown(2, rows)
    row = rows // 2
    off = np.where(np.arange(rows) == row, sigmas * SIGMA["x"], 0.0)
    fit = curlfit.fit(replace(throw, x=throw.x + off))
    assert [(outlier["channel"], outlier["t"]) for outlier in fit.outliers] == [
        ("x", throw.t[row])
    ]
    outliers = finding_of(fit, "outliers")
    assert str(outliers).startswith("one outlier: x at")
    assert outliers.options == (Option("loss", "student"),)


def test_few_rows_have_their_interval_in_the_report():
    assert "an interval of 95 % (Student's t) extends up to" in shown(
        curlfit.fit(thrown(1, 12))
    )
    assert "Student" not in shown(curlfit.fit(thrown(1, 150)))


def with_little_on_one_side(seed):
    random = np.random.default_rng(seed)
    low = (0, 0.02, 0, 0.004)
    high = (0.002, 0.1, 0.015, 0.015)
    law = curlfit.LAWS["front-back"](
        *(random.uniform(*ends) for ends in zip(low, high, strict=True))
    )
    v = random.uniform(1.9, 2.3)
    omega = random.uniform(0.8, 1.6)
    return filmed(law, random, times=np.arange(0, 15.05, 0.1), v=v, omega=omega)


@pytest.mark.parametrize("seed", [29, 53, 65])
def test_a_coefficient_beside_one_at_its_bound_is_not_weak_for_that(seed):
    """What the bound leaves of freedom widens the error, and is no bend of
    chi squared."""
    fit = curlfit.fit(with_little_on_one_side(seed))
    assert fit.parameters["mu1_xi"].verdict == "at bound"
    estimate = fit.parameters["mu2_xi"]
    assert estimate.stderr < 0.01 * estimate.value
    assert (estimate.verdict, estimate.reason) == ("determined", "")
    assert "curve" not in codes_of(fit)


def test_a_weak_parameter_says_why():
    fit = curlfit.fit(filmed(noise={"x": 1e-3, "y": 1e-3}))
    weak = fit["omega0"]
    # as far as the same path of a stone that turns the other way
    assert weak.stderr == pytest.approx(2 * abs(weak.value), rel=0.05)
    assert weak.verdict == "weak"
    assert f"omega0 is weakly determined: {weak.reason}" in sentences_on(fit)
    # the same of two parameters
    reason = "its standard error is more than half its typical size, 1"
    weak = replace(weak, reason=reason)
    fit = replace(fit, parameters=fit.parameters | {"omega0": weak})
    text = sentences_on(replace(fit, parameters=fit.parameters | {"v0": weak}))
    assert (
        "are weakly determined: for each, its standard error is more than half" in text
    )


def test_outliers_are_named_where_they_draw_the_fit_aside():
    # a fit between three bad angles and the others leaves smooth residuals
    t = np.arange(180) / 10
    residual = np.zeros((5, 180))
    residual[2] = 0.15 * np.cos(t / 6) + 0.01 * np.random.default_rng(4).normal(
        size=180
    )
    throw = curlfit.Throw.from_arrays(t, phi=1.2 * t)

    def times(lag1):
        outliers = outliers_of(
            throw, residual, {"phi": lag1}, np.full(5, 175.0), 0 * residual, LINEAR
        )
        return sorted(
            outlier["t"] for outlier in outliers if outlier["channel"] == "phi"
        )

    assert times(0.99) == []
    residual[2, 60:63] += [5.3, 5.2, 5.1]
    assert times(0.7) == [6.0, 6.1, 6.2]
    assert times(0.2) == [6.0, 6.1, 6.2]
    # one side of a law that does not follow the path is no outlier
    residual[2, 140:] += np.linspace(0, 8, 40) ** 1.5
    assert times(0.99) == [6.0, 6.1, 6.2]


def test_outliers_in_the_first_rows_alone_have_a_flag_that_leaves_them_out():
    t = np.array([0.0, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0])
    early = [Outlier(name, 0.0, 2, 0.1, 60.0) for name in ("y", "phi")]
    since = Option("since", "0.5")
    assert since in of_outliers(tuple(early), t).options
    late = Outlier("y", 0.8, 6, 0.1, 50.0)
    assert of_outliers((*early, late), t).options == (Option("loss", "student"),)
    assert of_outliers((late,), t).options == (Option("loss", "student"),)
