"""Profile likelihoods: against scipy, closed forms, symmetry, and counting."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import invoke
from rich.console import Console
from scipy.optimize import least_squares
from scipy.stats import chi2

import curlfit
from curlfit import InputError, UnusableFitError
from curlfit.inference.fit.estimates import Estimate
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.likelihood import whitened_residuals_of_many
from curlfit.inference.model.problem import build_problem
from curlfit.inference.sampling.sampler import sample
from curlfit.losses import LOSSES
from curlfit.numerics.batches import stacked
from curlfit.profile_likelihood.profile import _warnings
from curlfit.profile_likelihood.refit import Refit
from curlfit.profile_likelihood.report import document

STONE = curlfit.Stone(R=0.065)
TRUE = {"mu1_xi": 0.005, "mu2_xi": 0.05, "mu1_eta": 0.009, "mu2_eta": 0.009}
NOISE = {"x": 0.005, "y": 0.005, "phi": 0.01}


def thrown(seed=1, sigma=True, **start):
    throw = curlfit.synthetic_throw(
        curlfit.law_with("front-back", TRUE),
        STONE,
        noise_xy=NOISE["x"],
        noise_phi=NOISE["phi"],
        seed=seed,
        **{"v0": 2.1, "omega0": 1.2, "heading": 0.02} | start,
    )
    return throw.with_sigma(NOISE) if sigma else throw


@pytest.fixture(scope="module")
def fit():
    return curlfit.fit(thrown())


@pytest.fixture(scope="module")
def sharp(fit):
    return curlfit.profile(fit, "mu1_xi")


@pytest.fixture(scope="module")
def flat(eq12_fit):
    return curlfit.profile(eq12_fit, "mu1_eta")


@pytest.fixture(scope="module")
def sloping(eq12):
    """The split under consistent load, with noise of the same size in all places."""
    return curlfit.profile(curlfit.fit(eq12, load="consistent"), "mu1_eta", points=11)


def printed(profile):
    console = Console(
        width=110, record=True, file=None, quiet=False, force_terminal=False
    )
    with console.capture() as found:
        curlfit.print_profile(profile, console)
    return " ".join(found.get().split())


def scipy_minimum(fit, held):
    """Least chi squared with some parameters held, by scipy on the residuals
    of the model."""
    throw = fit.throw
    parameters = fit.parameter_set
    problem = build_problem(throw, fit.stone, fit.sigma, LOSSES[fit.loss])
    values = fit.values.copy()
    for name, value in held.items():
        values[parameters.index(name)] = value
    free = parameters.free & [name not in held for name in parameters.names]
    low = parameters.lower[free]
    high = parameters.upper[free]

    def residual(some):
        trial = values.copy()
        trial[free] = some
        arguments = trial[None], stacked([problem])
        return whitened_residuals_of_many(fit.model, *arguments, batch=1).ravel()

    optimum = least_squares(
        residual,
        values[free],
        bounds=(low, high),
        x_scale=parameters.typical[free] / 100,
        jac="3-point",
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-12,
    )
    return 2 * optimum.cost


# --- numbers --------------------------------------------------------------------------


def test_the_profile_is_what_scipy_finds_with_the_parameter_held(fit, sharp):
    assert sharp.chi_squared == pytest.approx(scipy_minimum(fit, {}), abs=1e-6)
    for point in (3, 35):
        least = scipy_minimum(fit, {"mu1_xi": float(sharp.at[point])})
        assert sharp.delta[point] == pytest.approx(least - sharp.chi_squared, abs=2e-5)
        assert sharp.delta[point] > 0.3


def test_of_two_parameters_too(fit, tmp_path):
    pair = curlfit.profile(fit, ["mu1_xi", "v0"], points=7)
    assert_the_same_when_saved(pair, tmp_path)
    # and none near the best fit
    for drawn in (pair, replace(pair, delta=pair.delta + 50)):
        assert "mu1_xi" in curlfit.profile_figure(drawn).axes[0].get_xlabel()
    assert pair.delta.shape == (7, 7)
    held = {"mu1_xi": float(pair.first[1, 2]), "v0": float(pair.second[1, 2])}
    least = scipy_minimum(fit, held)
    assert pair.delta[1, 2] == pytest.approx(least - pair.each[0].chi_squared, abs=1e-4)
    assert pair.delta[1, 2] > 1
    # the bottom of the valley is the profile of one
    bottom = np.interp(pair.first[:, 3], pair.each[0].at, pair.each[0].delta)
    np.testing.assert_allclose(pair.delta[:, 3], bottom, atol=1e-3)
    assert pair.ellipse is not None
    assert pair.ellipse < 0.2
    assert pair.across < fit.parameters["v0"].stderr  # less than with the first free
    # a region of two spans sqrt(2.30) of what an interval of one does
    interval = pair.each[1].intervals[0]
    region = pair.extent["68 %"][1]
    assert (region.high - region.low) / (interval.high - interval.low) == pytest.approx(
        np.sqrt(2.30), rel=0.01
    )


@pytest.fixture(scope="module")
def blind():
    """A fit without an angle: the spin is known only by the curl, of which
    friction makes less."""
    throw = thrown()
    sigma = {name: throw.sigma[name] for name in ("x", "y")}
    return curlfit.fit(replace(throw, phi=np.full(len(throw), np.nan), sigma=sigma))


def test_limits_far_from_those_of_the_covariance_are_right(blind):
    profile = curlfit.profile(blind, "omega0", points=5)
    least = scipy_minimum(blind, {"omega0": float(profile.at[-2])})
    assert profile.delta[-2] == pytest.approx(least - profile.chi_squared, abs=0.01)
    assert profile.delta[-2] > 3
    assert max(profile.departure.values()) > 0.5
    assert "Use the profile" in printed(profile)


def test_a_parameter_that_only_moves_the_path_has_its_parabola(fit):
    """With the rest fixed, chi squared is sum (x - x0)^2/sigma^2: a mean of n rows."""
    fixed = {
        name: estimate.value
        for name, estimate in fit.parameters.items()
        if name not in ("x0", "y0")
    }
    alone = curlfit.fit(thrown(), fix=fixed)
    profile = curlfit.profile(alone, "x0")
    sd = NOISE["x"] / np.sqrt(len(alone.throw))
    np.testing.assert_allclose(
        profile.delta, ((profile.at - profile.best) / sd) ** 2, atol=1e-7
    )
    np.testing.assert_allclose(
        (profile.at[0], profile.at[-1]), profile.best + sd * np.array([-4, 4])
    )
    for interval, rise in zip(profile.intervals, (1.0, chi2.ppf(0.95, 1)), strict=True):
        assert interval.high == pytest.approx(
            profile.best + np.sqrt(rise) * sd, abs=1e-4 * sd
        )
        assert interval.low == pytest.approx(
            profile.best - np.sqrt(rise) * sd, abs=1e-4 * sd
        )
        assert (interval.low_by, interval.high_by) == ("data", "data")
    assert profile.others.keys() == {"y0"}
    np.testing.assert_allclose(
        profile.others["y0"], alone.parameters["y0"].value, atol=1e-9
    )


def test_limits_are_where_chi_squared_is_higher_by_the_threshold(fit, sharp):
    low = sharp.intervals[1].low
    high = sharp.intervals[1].high
    again = curlfit.profile(fit, "mu1_xi", ranges={"mu1_xi": (low, high)}, points=5)
    np.testing.assert_allclose(again.delta[[0, -1]], chi2.ppf(0.95, 1), atol=1e-4)
    assert again.at[[0, -1]] == pytest.approx([low, high])
    assert max(sharp.departure.values()) < 0.1
    assert sharp.verdict == "limited"
    assert "agree" in printed(sharp)


# --- what is not determined -----------------------------------------------------------


def test_the_split_is_exactly_flat_under_uniform_load(flat, eq12_fit):
    (total,) = eq12_fit.combinations
    inside = (flat.at >= 0) & (flat.at <= total.value - 1e-9)
    assert inside.sum() > 35
    assert np.abs(flat.delta[inside]).max() < 1e-8
    # where the other is, is no matter of the solver's taste
    sums = flat.at + flat.others["mu2_eta"]
    np.testing.assert_allclose(sums[inside], total.value, atol=1e-10)
    assert flat.free[0] == 0
    assert flat.free[1] == pytest.approx(total.value, rel=1e-3)
    assert flat.stops == ((), ("mu2_eta",))
    assert flat.verdict == "flat"
    assert flat.rise < 1e-8
    # beyond, where the other is at zero, the sum alone is left: its parabola
    beyond = (flat.at > total.value) & (flat.delta < 9)
    assert beyond.sum() >= 3
    expected = ((flat.at[beyond] - total.value) / total.stderr) ** 2
    np.testing.assert_allclose(flat.delta[beyond], expected, rtol=0.01)
    text = printed(flat)
    assert "mu1_eta is not identifiable, its profile is flat" in text
    assert "Only mu1_eta + mu2_eta = 0.017573(16) is determined" in text
    assert "covariance" not in text
    assert "no noise is that smooth" in text  # the warning of the fit


@pytest.mark.slow
def test_under_consistent_load_it_slopes_and_how_much_is_said(sloping):
    inside = (sloping.at >= sloping.free[0]) & (sloping.at <= sloping.free[1])
    delta = sloping.delta[inside]
    assert delta.size > 8
    assert (np.diff(delta) > 0).all()
    assert 0.05 < sloping.rise < 0.2
    assert sloping.verdict == "hardly"
    # chi squared is proportional to the inverse square of the noise
    assert sloping.quieter(1.0) == pytest.approx(sloping.rise**-0.5)
    text = printed(sloping)
    assert "mu1_eta is weakly determined" in text
    assert (
        "noise would have to be 3.3 times smaller, or the rows 11 times as many" in text
    )


def test_a_pair_with_a_valley_follows_it(eq12_fit):
    pair = curlfit.profile(eq12_fit, ("mu1_eta", "mu2_eta"), points=7)
    (total,) = eq12_fit.combinations
    inside = np.isfinite(pair.delta)
    assert (pair.second[inside] >= 0).all()
    assert inside.sum() > 40
    away = (pair.first + pair.second - total.value)[inside] / total.stderr
    near = np.abs(away) < 4.5
    np.testing.assert_allclose(
        pair.delta[inside][near], away[near] ** 2, rtol=0.01, atol=1e-6
    )
    assert pair.covariance is None
    assert pair.ellipse is None
    text = printed(pair)
    assert "no ellipse" in text
    assert "mu1_eta - -" in text  # no error is printed for either


def test_a_range_that_is_too_narrow_says_so(fit):
    value = fit.parameters["v0"].value
    stderr = fit.parameters["v0"].stderr
    ends = {"v0": (value - stderr, value + stderr)}
    profile = curlfit.profile(fit, "v0", ranges=ends, points=5)
    assert profile.verdict == "narrow"
    assert profile.rise == pytest.approx(1, rel=0.05)
    assert "The range is too narrow" in printed(profile)


def test_a_better_fit_that_is_met_is_the_one_to_count_from(fit, sharp):
    """A fit that stopped short of its optimum."""
    v0 = fit.parameters["v0"]
    too_fast = replace(v0, value=v0.value + 2 * v0.stderr)
    short = replace(fit, parameters={**fit.parameters, "v0": too_fast})
    profile = curlfit.profile(short, "mu1_xi", points=9)
    assert profile.chi_squared == pytest.approx(sharp.chi_squared, abs=1e-5)
    assert np.nanmin(profile.delta) > -1e-6


def test_what_the_fits_of_a_profile_met_is_said(fit, sharp):
    refit = Refit(fit)
    refit.chi_squared_of_fit = refit.best.chi_squared + 5
    delta = sharp.delta.copy()
    delta[-1] = 0.5
    warnings = _warnings(refit, replace(sharp, delta=delta), unfinished=2, failed=1)
    better, unfinished, failed, second = warnings
    (remedy,) = better.remedies
    assert remedy.option.name == "start"
    start = dict(setting.split("=") for setting in remedy.option.value.split(","))
    assert {name: float(value) for name, value in start.items()} == pytest.approx(
        {name: coefficient.value for name, coefficient in fit.coefficients.items()},
        rel=1e-4,
    )
    assert str(better) == (
        "a better fit was found, its chi squared 5 lower, and the profile is relative "
        f"to it; fit again with `--start {remedy.option.value}`"
    )
    assert str(unfinished) == (
        f"2 of {len(sharp.at)} fits did not converge; chi squared there is at most "
        "the value shown"
    )
    assert (failed.code, failed.numbers["failed"]) == ("values-without-motion", 1)
    assert (second.code, second.numbers) == ("second-minimum", {"at": sharp.at[-1]})
    assert not [*_warnings(Refit(fit), sharp, unfinished=0, failed=0)]


def test_what_thresholds_and_chi_squared_mean_is_noted(sharp):
    at_bound = replace(sharp.estimate, verdict=Verdict.AT_BOUND)
    profile = replace(
        sharp, loss="huber", parameters=sharp.parameters | {"mu1_xi": at_bound}
    )
    assert not document(sharp).notes
    bound, loss = document(profile).notes
    assert bound.code == "limits-near-bound"
    assert (loss.code, loss.numbers) == ("chi-squared-of-loss", {"loss": "huber"})


# --- the posterior beside it ----------------------------------------------------------


def test_the_posterior_lies_on_the_profile(fit):
    sampled, chain = sample(fit, effective=1000)
    profile = curlfit.profile(sampled, "mu1_xi", chain=chain)
    beside = profile.posterior
    expected = np.interp(beside["at"], profile.at, profile.delta)
    low = expected < 4
    assert low.sum() > 6
    pull = ((beside["height"] - expected) / beside["error"])[low]
    assert np.abs(pull).max() < 5
    assert np.mean(pull**2) < 3
    assert profile.quantiles == sampled.posterior.quantiles["mu1_xi"]
    assert "posterior" in printed(profile)
    with pytest.raises(InputError, match="the chain is of another fit"):
        curlfit.profile(sampled, "mu1_xi", chain=replace(chain, names=("mu", "x0")))


# --- record and figure ----------------------------------------------------------------


def assert_the_same_when_saved(profile, folder):
    profile.save(folder / "profile.json")
    again = curlfit.load_profile(folder)
    assert again.to_json() == profile.to_json()
    assert again.warnings == profile.warnings
    np.testing.assert_array_equal(again.delta, profile.delta)
    assert printed(again) == printed(profile)
    return again


@pytest.mark.parametrize("which", ["sharp", "flat"])
def test_a_saved_profile_is_the_same_and_its_label_does_not_meet_the_legend(
    request, which, tmp_path
):
    profile = request.getfixturevalue(which)
    again = assert_the_same_when_saved(profile, tmp_path)
    assert isinstance(again.parameters["v0"], Estimate)
    assert again.intervals == profile.intervals
    figure = curlfit.profile_figure(again)
    figure.draw_without_rendering()
    label = figure.axes[1].xaxis.label.get_window_extent()
    assert label.height > 0
    assert not any(
        label.overlaps(legend.get_window_extent()) for legend in figure.legends
    )


# --- the command ----------------------------------------------------------------------


def test_the_command_writes_prints_and_is_shown_again(fit, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "throw-fit").mkdir()
    fit.save(tmp_path / "throw-fit" / "fit.json")
    words = ["profile", "throw-fit", "--param", "mu1_xi", "--points", "9"]
    run = invoke(words)
    assert run.exit_code == 0, run.exception
    folder = tmp_path / "throw-profile-mu1_xi"
    assert {file.name for file in folder.iterdir()} == {"profile.json", "profile.png"}
    report = run.stdout.rpartition("Written:")[0]
    assert "Profile and covariance agree" in report
    shown = invoke(["show", str(folder)])
    assert shown.stdout == report
    record = invoke(["show", "--json", str(folder / "profile.json")])
    assert '"verdict": "limited"' in record.stdout
    drawn = invoke(["plot", str(folder), "--format", "svg"])
    assert drawn.exit_code == 0
    assert (folder / "profile.svg").stat().st_size > 1000
    again = invoke([*words, "--no-figures", "--quiet"])
    assert (again.exit_code, again.stdout) == (0, "")
    assert {file.name for file in folder.iterdir()} == {
        "profile.json"
    }  # no figure of an earlier one


def test_python_refuses_the_same(fit):
    with pytest.raises(InputError, match="expected one of v0"):
        curlfit.profile(fit, "v0", ranges={"x0": (0, 1)})
    with pytest.raises(UnusableFitError, match="not usable"):
        curlfit.profile(replace(fit, converged=False, status="not converged"), "v0")


# --- counting -------------------------------------------------------------------------
