"""Priors: their densities against scipy, and what they do to fits against
closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import NOISE, shown
from scipy import stats

import curlfit
from curlfit import (
    LAWS,
    DataError,
    InputError,
    Stone,
    load_fit,
    sample,
    synthetic_throw,
)
from curlfit.friction import Parameter
from curlfit.inference.model.priors import (
    HalfNormal,
    Lognormal,
    Normal,
    Uniform,
    parse_prior,
    parse_priors,
    penalty_of,
)

SPLIT = {"mu1_eta": 0.009}  # held, so that all others are determined


def thrown(**choices):
    throw = synthetic_throw(
        LAWS["front-back"](),
        Stone(),
        noise_xy=0.005,
        noise_phi=0.01,
        **{"v0": 2.1, "omega0": 1.2, "heading": 0.02, "seed": 1} | choices,
    )
    return throw.with_sigma(NOISE)


@pytest.fixture(scope="module")
def throw():
    return thrown()


@pytest.fixture(scope="module")
def without(throw):
    return curlfit.fit(throw, fix=SPLIT)


@pytest.mark.parametrize(
    ("text", "prior"),
    [
        ("0.1+-0.0025", Normal(0.1, 0.0025)),
        (" 0.1 +/- 2.5e-3 ", Normal(0.1, 0.0025)),
        ("-1e-4±2e-4", Normal(-1e-4, 2e-4)),
        ("normal: 0.1, 0.0025", Normal(0.1, 0.0025)),
        ("lognormal:0.05,0.3", Lognormal(0.05, 0.3)),
        ("half-normal:0.8", HalfNormal(0.8)),
        ("uniform:-1,2", Uniform(-1.0, 2.0)),
    ],
)
def test_a_prior_is_read_and_written(text, prior):
    assert parse_prior("rho", text) == prior
    assert parse_prior("rho", str(prior)) == prior
    assert parse_priors({"rho": text}) == {"rho": prior}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is no prior; expected MEAN"),
        ("gamma:1,2", "is no prior; expected MEAN"),
        ("lognormal:1", "lognormal:MEDIAN,SIGMA"),
        ("0.1+-0", "expected a positive width"),
        ("half-normal:inf", "expected finite numbers"),
        ("lognormal:0.05,-1", "expected a positive width"),
        ("lognormal:-0.05,1", "expected a positive median"),
        ("uniform:2,1", "is empty; expected LOW below HIGH"),
    ],
)
def test_what_is_no_prior_is_refused_by_the_parameter_s_name(text, said):
    with pytest.raises(InputError, match="prior of rho: ") as refused:
        parse_prior("rho", text)
    assert said in str(refused.value)


def test_priors_of_no_parameter_and_of_fixed_ones_are_refused(throw):
    for choices, message in (
        ({"priors": {"mu": "1+-1"}}, "no parameter 'mu'.*conditions are slope_x"),
        (
            {"priors": {"mu1_xi": "1+-1"}, "fix": {"mu1_xi": 0.1}},
            "mu1_xi is fixed and has a prior",
        ),
        ({"free": ["rho"], "fix": {"rho": 0.1}}, "rho is fixed and is free"),
        ({"priors": {"mu1_xi": "uniform:2,3"}}, "bound of mu1_xi: 2:1 is empty"),
    ):
        with pytest.raises(InputError, match=message):
            curlfit.fit(throw, **choices)


@pytest.mark.parametrize(
    ("text", "density"),
    [
        ("0.1+-0.0025", stats.norm(0.1, 0.0025)),
        ("lognormal:0.05,0.3", stats.lognorm(0.3, scale=0.05)),
        ("half-normal:0.8", stats.halfnorm(scale=0.8)),
        ("uniform:0.01,0.3", stats.uniform(0.01, 0.29)),
    ],
)
def test_penalties_are_twice_the_negative_log_densities_of_scipy(text, density):
    prior = parse_prior("a", text)
    parameters = [
        Parameter("a", "1", -1.0, 1.0, 1.0, "a", "a"),
        Parameter("b", "1", -1.0, 1.0, 1.0, "b", "b"),
    ]
    penalty = penalty_of(parameters, {"a": prior})
    assert not penalty_of(parameters, {}).informative
    at = np.linspace(0.02, 0.25, 7)
    values = np.stack([at, np.full(7, 0.3)], -1)
    chi_squared = penalty.chi_squared(values)
    exact = -2 * density.logpdf(at)
    np.testing.assert_allclose(
        np.diff(chi_squared), np.diff(exact), rtol=1e-10, atol=1e-10
    )
    if prior.kind != "uniform":
        # of the mode nothing is added, so that chi squared is comparable
        mode = values.copy()
        mode[:, 0] = prior.mode
        np.testing.assert_allclose(penalty.chi_squared(mode), 0, atol=1e-20)
    residual, slope = penalty.residual_and_slope(values)
    step = 1e-7 * np.array([1.0, 0.0])
    change = penalty.residual_and_slope(values + step)[0] - residual
    np.testing.assert_allclose(slope[:, 0], change[:, 0] / 1e-7, rtol=1e-5, atol=1e-6)
    low, high = prior.bounds(-1.0, 1.0)
    assert density.cdf(low) == pytest.approx(max(0.0, density.cdf(-1.0)), abs=1e-12)
    assert density.cdf(high) == pytest.approx(density.cdf(1.0), abs=1e-12)


def test_a_normal_prior_is_one_more_datum(throw, without):
    before = without.parameters["mu1_xi"]
    centre = before.value + 2 * before.stderr
    width = before.stderr
    fit = curlfit.fit(throw, fix=SPLIT, priors={"mu1_xi": f"{centre}+-{width}"})
    names = without.information.names
    matrix = without.information.matrix
    row = names.index("mu1_xi")
    more = matrix.copy()
    more[row, row] += 1 / width**2
    covariance = np.linalg.inv(more)
    shift = covariance[row] * (centre - before.value) / width**2
    assert shift[row] == pytest.approx(before.stderr, rel=1e-6)
    for position, name in enumerate(names):
        old = without.parameters[name]
        new = fit.parameters[name]
        assert new.stderr == pytest.approx(
            np.sqrt(covariance[position, position]), rel=2e-3
        )
        assert new.value - old.value == pytest.approx(
            shift[position], abs=1e-2 * old.stderr
        )
    estimate = fit.parameters["mu1_xi"]
    assert (estimate.verdict, estimate.prior) == (
        "determined",
        f"{centre:.10g}+-{width:.10g}",
    )
    # the prior is 1 sd off, and so are the data: 1 each
    assert fit.prior_chi_squared == pytest.approx(1.0, rel=0.02)
    assert fit.chi_squared == pytest.approx(without.chi_squared + 1.0, abs=0.02)
    # the information that is kept has the prior in it, and vanishes at the optimum
    np.testing.assert_allclose(
        fit.information.matrix, more, rtol=0.05, atol=1e-3 * more.max()
    )
    error = np.sqrt(np.diag(covariance))
    assert np.abs(fit.information.gradient * error).max() < 1e-2


def test_a_uniform_prior_is_its_bounds(throw, without):
    high = without.parameters["mu2_xi"].value - without.parameters["mu2_xi"].stderr
    by_prior = curlfit.fit(
        throw, fix=SPLIT, priors={"mu2_xi": f"uniform:0.04,{high!r}"}
    )
    by_bounds = curlfit.fit(throw, fix=SPLIT, bounds={"mu2_xi": (0.04, high)})
    assert by_prior.parameters["mu2_xi"].verdict == "at bound"
    assert by_prior.prior_chi_squared == 0
    for name, estimate in by_bounds.parameters.items():
        assert by_prior.parameters[name].value == pytest.approx(
            estimate.value, rel=1e-6, abs=1e-9
        )
        assert by_prior.parameters[name].verdict == estimate.verdict


@pytest.fixture(scope="module")
def split(throw):
    """The split of the longitudinal friction, which the path does not determine."""
    return curlfit.fit(throw, priors={"mu1_eta": "0.008+-0.001"})


def test_what_rests_on_a_prior_is_said_to(split, without, tmp_path):
    mu1_eta = split.parameters["mu1_eta"]
    mu2_eta = split.parameters["mu2_eta"]
    assert (mu1_eta.verdict, mu2_eta.verdict) == ("prior", "prior")
    assert mu1_eta.value == pytest.approx(0.008, abs=1e-7)
    assert mu1_eta.stderr == pytest.approx(0.001, rel=1e-4)
    total = SPLIT["mu1_eta"] + without.parameters["mu2_eta"].value
    assert mu1_eta.value + mu2_eta.value == pytest.approx(total, abs=1e-7)
    assert mu2_eta.stderr == pytest.approx(0.001, rel=1e-3)
    assert split.parameters["mu1_xi"].verdict == "determined"
    text = shown(split)
    assert "The path and the priors determine 10 of 10 parameters." in text
    assert (
        "mu1_eta and mu2_eta rest on the priors: the path alone does not determine them"
        in text
    )
    split.save(tmp_path / "fit.json")
    again = load_fit(tmp_path)
    assert again.parameter_set.priors == {"mu1_eta": Normal(0.008, 0.001)}
    assert again.to_json() == split.to_json()
    assert shown(again) == text
    assert (again.chi_squared, again.prior_chi_squared) == (
        split.chi_squared,
        split.prior_chi_squared,
    )


def test_the_posterior_has_the_prior_in_it_and_a_chain_of_another_is_refused(
    split, throw, tmp_path
):
    file = tmp_path / "chain.h5"
    sampled, _ = sample(split, effective=600, checkpoint=file, seed=3)
    for name in ("mu1_eta", "mu2_eta", "mu1_xi", "mu2_xi"):
        estimate = split.parameters[name]
        ess = sampled.posterior.ess[name]
        assert abs(
            sampled.posterior.mean[name] - estimate.value
        ) < 4.5 * estimate.stderr / np.sqrt(ess)
        assert sampled.posterior.sd[name] == pytest.approx(
            estimate.stderr, rel=4.5 / np.sqrt(2 * ess)
        )
    for priors, message in (
        (
            {"mu1_eta": "0.008+-0.002"},
            r"priors was mu1_eta 0.008\+-0.001, now mu1_eta 0.008\+-0.0",
        ),
        ({}, r"priors was mu1_eta 0.008\+-0.001, now none"),
    ):
        with pytest.raises(DataError, match=message):
            sample(
                curlfit.fit(throw, priors=priors), checkpoint=file, resume=True, seed=3
            )


@pytest.mark.slow
def test_throws_together_count_the_prior_of_what_they_share_once(throw):
    throws = [throw, thrown(omega0=-1.5, seed=2)]
    joint = curlfit.fit_together(throws, fix=SPLIT).coefficients["mu1_xi"]
    prior = f"{joint.value + 2 * joint.stderr!r}+-{joint.stderr!r}"
    with_prior = curlfit.fit_together(throws, fix=SPLIT, priors={"mu1_xi": prior})
    estimate = with_prior.coefficients["mu1_xi"]
    assert estimate.stderr == pytest.approx(joint.stderr / np.sqrt(2), rel=5e-3)
    assert estimate.value - joint.value == pytest.approx(joint.stderr, rel=0.02)
    assert estimate.verdict == "determined"
    rests = curlfit.fit_together(throws, priors={"mu1_eta": "0.008+-0.001"})
    assert rests.coefficients["mu2_eta"].verdict == "prior"
    assert rests.coefficients["mu1_eta"].stderr == pytest.approx(0.001, rel=1e-3)


def test_a_prior_does_not_make_the_estimated_noise_larger(throw):
    """The first fit weights 1 m like 1 rad: there the prior would outweigh the data."""
    throw = replace(throw, sigma={})
    without = curlfit.fit(throw, fix=SPLIT)
    fit = curlfit.fit(throw, fix=SPLIT, priors={"mu2_xi": "0.06+-0.002"})
    assert fit.sigma == pytest.approx(without.sigma, rel=1e-4)
    with_prior = fit.parameters["mu2_xi"]
    without_prior = without.parameters["mu2_xi"]
    weight = 1 / (1 + (without_prior.stderr / 0.002) ** 2)
    expected = weight * without_prior.value + (1 - weight) * 0.06
    assert with_prior.value == pytest.approx(expected, abs=0.01 * without_prior.stderr)
    assert fit.prior_chi_squared == pytest.approx(25, rel=0.1)


def test_what_a_throw_fixes_counts_when_nothing_is_left_to_fit(throw):
    """The angle of a throw without one is no parameter that could be left."""
    without_angle = curlfit.Throw.from_arrays(throw.t, throw.x, throw.y)
    start = {"x0": 0.0, "y0": 0.0, "heading": 0.0, "v0": 2.0, "omega0": 1.0}
    with pytest.raises(InputError, match="nothing is left to fit"):
        curlfit.fit(without_angle, "coulomb", fix={"mu": 0.01, **start})
