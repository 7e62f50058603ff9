"""Least squares: the paper's numbers, invariance, bounds, gaps, recovery."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import jax
import numpy as np
import pytest
from conftest import NOISE, codes_of, filmed, finding_of, shown
from scipy.integrate import cumulative_simpson
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

import curlfit
from curlfit import DataError, InputError, Stone, Throw, fit, law_with, synthetic_throw
from curlfit.inference.fit.residuals import residual_sigma
from curlfit.inference.model.problem import LEVEL_AND_STILL, Problem
from curlfit.inference.solve.least_squares import Solution

NAMES = ("mu1_xi", "mu2_xi")


def coefficients(result):
    sums = {
        combination.expression: combination.value for combination in result.combinations
    }
    return np.array(
        [*(result.parameters[n].value for n in NAMES), sums["mu1_eta + mu2_eta"]]
    )


def test_eq_28_as_checked(eq12_fit):
    estimates = coefficients(eq12_fit)
    np.testing.assert_array_less(
        np.abs(estimates - [0.0004, 0.0555, 0.0173]), [0.0002, 0.0006, 0.0004]
    )
    assert eq12_fit.converged
    assert eq12_fit.rms["x"] < 0.0015
    assert eq12_fit.rms["y"] < 0.025
    assert eq12_fit.rms["phi"] < 0.005
    (remedy,) = finding_of(eq12_fit, "correlated").remedies
    assert remedy.code == "no-noise-so-smooth"


def test_the_larger_ring_needs_a_negative_coefficient(eq12):
    bounded = fit(eq12, stone=Stone(R=0.065, rho=0.1))
    assert bounded.parameters["mu1_xi"].verdict == "at bound"
    assert bounded.parameters["mu1_xi"].stderr is None
    assert bounded.parameters["mu1_xi"].value == 0.0
    assert finding_of(bounded, "at-bound").numbers["name"] == "mu1_xi"
    free = fit(eq12, stone=Stone(R=0.065, rho=0.1), unbounded=True)
    assert free.parameters["mu1_xi"].value == pytest.approx(-0.0036, abs=4e-4)


def test_rounding_decides_neither_where_a_fit_ends_nor_when(eq12):
    rng = np.random.default_rng(1)
    scatter = [0.0, 1e-14, 1e-13, 1e-12]  # m, of rows printed to 1e-6
    fits = [
        fit(replace(eq12, y=eq12.y + s * rng.normal(size=len(eq12)))) for s in scatter
    ]
    steps = {int(re.search(r"\((\d+) steps", result.status)[1]) for result in fits}
    assert len(steps) == 1
    assert max(steps) < 10
    for name, estimate in fits[0].parameters.items():
        if estimate.stderr is not None:
            away = [
                abs(other.parameters[name].value - estimate.value) for other in fits
            ]
            assert max(away) < 1e-8 * estimate.stderr


def test_a_start_ten_times_off_leads_to_the_same_place(eq12, eq12_fit):
    for factor in (10.0, 0.1):
        start = {
            name: factor * eq12_fit.parameters[name].value
            for name in eq12_fit.coefficients
        }
        start["v0"] = factor * eq12_fit.parameters["v0"].value
        again = fit(eq12, start=start)
        np.testing.assert_allclose(
            coefficients(again), coefficients(eq12_fit), atol=1e-6
        )


def test_mirrored_and_shifted_throws_give_the_same_coefficients(eq12, eq12_fit):
    mirrored = fit(replace(eq12, x=-eq12.x, phi=-eq12.phi))
    np.testing.assert_allclose(
        coefficients(mirrored), coefficients(eq12_fit), atol=1e-9
    )
    spin = eq12_fit.parameters["omega0"].value
    assert mirrored.parameters["omega0"].value == pytest.approx(-spin, rel=1e-9)
    moved = replace(eq12, t=eq12.t + 100, x=eq12.x + 3, y=eq12.y - 7, phi=eq12.phi + 40)
    shifted = fit(moved, until=120.0)
    np.testing.assert_allclose(coefficients(shifted), coefficients(eq12_fit), atol=1e-6)
    for name, by in (("x0", 3), ("y0", -7), ("phi0", 40)):
        gap = shifted.parameters[name].value - eq12_fit.parameters[name].value
        assert gap == pytest.approx(by, abs=1e-5)


def test_a_map_grid_and_the_clock_of_a_computer_cost_no_precision():
    throw = filmed(seed=1)
    east = 5e5
    north = 5.4e6
    now = 1.7e9
    turned = 2e3
    far = replace(
        throw,
        t=throw.t + now,
        x=throw.x + east,
        y=throw.y + north,
        phi=throw.phi + turned,
    )
    near = fit(throw)
    moved = fit(far)
    by = {"x0": east, "y0": north, "phi0": turned}
    for name, expected in near.parameters.items():
        estimate = moved.parameters[name]
        assert estimate.verdict == expected.verdict
        gap = estimate.value - expected.value - by.get(name, 0.0)
        error = expected.stderr or expected.typical
        assert abs(gap) < 1e-3 * error
        if expected.stderr is not None:
            assert estimate.stderr == pytest.approx(expected.stderr, rel=1e-4)
    for name in ("x", "y", "phi"):
        assert moved.rms[name] == pytest.approx(near.rms[name], rel=1e-4)
    assert moved.quantities["turns"].value == pytest.approx(
        near.quantities["turns"].value, abs=1e-8
    )


def test_gaps():
    throw = filmed(seed=1)
    x = throw.x.copy()
    phi = throw.phi.copy()
    x[40:90] = np.nan
    phi[::3] = np.nan
    gappy = fit(replace(throw, x=x, phi=phi))
    assert gappy.converged
    for name, true in zip(NAMES, (0.005, 0.05), strict=True):
        estimate = gappy.parameters[name]
        assert abs(estimate.value - true) < 4 * estimate.stderr


def test_noise_free_throws_come_back_to_the_precision_of_the_path():
    law = law_with("front-back", {"mu1_xi": 0.02})
    result = fit(synthetic_throw(law, Stone(R=0.054, rho=0.1)))
    np.testing.assert_allclose(coefficients(result), [0.02, 0.05, 0.018], atol=1e-8)


@pytest.mark.parametrize(("times", "told"), [(1.0, 0), (0.5, 0), (3.0, 3)])
def test_residuals_far_larger_than_the_sigma_given_are_told(times, told):
    noise = {name: times * size for name, size in NOISE.items()}
    throw = filmed(law_with("coulomb", {"mu": 0.01}), seed=3, noise=noise)
    result = fit(throw.with_sigma(NOISE), "coulomb")
    channels = finding_of(result, "sigma-too-small").numbers["channels"] if told else []
    ratios = [channel["times"] for channel in channels]
    assert len(ratios) == told
    for ratio in ratios:
        assert float(ratio) == pytest.approx(times, rel=0.1)
    # sigma that the fit estimates is never too small by its own measure
    assert "sigma-too-small" not in codes_of(fit(throw, "coulomb"))


def test_one_far_value_does_not_make_all_sigma_too_small():
    throw = filmed(law_with("coulomb", {"mu": 0.01}), seed=3)
    x = throw.x.copy()
    x[50] += 0.5
    result = fit(replace(throw, x=x).with_sigma(NOISE), "coulomb")
    assert len(result.outliers) == 1
    assert "sigma-too-small" not in codes_of(result)


def test_what_cannot_be_fitted_is_refused(eq12):
    with pytest.raises(DataError, match="4 rows for 10 parameters"):
        fit(eq12.select_rows(until=0.3))
    still = Throw.from_arrays(np.arange(30.0), np.ones(30), np.ones(30))
    with pytest.raises(DataError, match="never moves"):
        fit(still)
    random = np.random.default_rng(0)
    shaky = Throw.from_arrays(np.arange(99.0), *random.normal(0, 0.01, (2, 99)))
    with pytest.raises(DataError, match="never moves"):
        fit(shaky)
    with pytest.raises(InputError, match="no parameter 'mu'"):
        fit(eq12, fix={"mu": 1})
    with pytest.raises(InputError, match="unknown law"):
        fit(eq12, "ice")
    with pytest.raises(InputError, match="is empty"):
        fit(eq12, bounds={"mu1_xi": (1, 0)})


def test_public_names_are_there():
    for name in curlfit.__all__:
        assert getattr(curlfit, name) is not None
    assert jax.config.jax_enable_x64


def test_what_no_row_shows_pays_for_no_residual():
    """Sigma counts a row less for each direction that is seen, wherever its
    unit puts it."""
    t = np.arange(6.0)
    for columns, paid in (([t, 1e-10 * t**2], 1), ([t, 2 * t], 1), ([t, t**2], 2)):
        jacobian = np.stack(columns, -1)[None, None]
        solution = Solution(np.zeros((1, 2)), np.ones((1, 1, 6)), jacobian, 1, True)
        ones = np.ones((1, 1, 6))
        problem = Problem(t[None], ones, ones, Stone(), LEVEL_AND_STILL)
        (sigma,) = residual_sigma(solution, problem, np.ones((1, 2), bool))
        assert sigma[0] == pytest.approx(np.sqrt(6 / (6 - paid)), rel=1e-12)


def test_a_reference_with_a_rounded_stone_is_reproduced_with_its_own(eq12, eq12_fit):
    """CHECKED values of rho = 0.1025 m: 0.00184, 0.05705, 0.01757; eq. 28 to its
    printed digits."""
    with_rho, with_radius = eq12_fit.reference_fits
    assert (with_rho["stone"], with_radius["stone"]) == ({"rho": 0.1025}, {"R": 0.0545})
    again = curlfit.fit(eq12, stone=eq12_fit.stone.with_values({"rho": 0.1025}))
    assert again.reference_fits == ()
    names = ("mu1_xi", "mu2_xi")
    estimates = [again.parameters[name].value for name in names]
    np.testing.assert_allclose(
        [with_rho["values"][name] for name in names], estimates, rtol=1e-6
    )
    total = with_rho["values"]["mu1_eta + mu2_eta"]
    np.testing.assert_allclose(
        [*estimates, total], [0.00184, 0.05705, 0.01757], atol=6e-6
    )
    # the curl goes with R (mu1_xi - mu2_xi), the torque with R^2 (mu1_xi +
    # mu2_xi)/rho^2 (eq. 27)
    fitted = {name: eq12_fit.parameters[name].value for name in names}
    for other, scale in ((with_rho, 0.1025 / 0.1), (with_radius, 0.054 / 0.0545)):
        values = other["values"]
        radius = other["stone"].get("R", 0.054)
        total = (values["mu1_xi"] + values["mu2_xi"]) / (
            fitted["mu1_xi"] + fitted["mu2_xi"]
        )
        assert total == pytest.approx(scale**2, rel=2e-3)
        difference = (values["mu1_xi"] - values["mu2_xi"]) / (
            fitted["mu1_xi"] - fitted["mu2_xi"]
        )
        assert difference == pytest.approx(0.054 / radius, rel=2e-3)
    sentence = (
        "`--stone rho=0.1025` gives 0.0018, 0.0570 and 0.0176, which agree with eq. 28"
    )
    assert sentence in shown(eq12_fit)
    away = replace(
        eq12_fit.reference, values=eq12_fit.reference.values | {"mu2_xi": 0.068}
    )
    assert "do not all agree with eq. 28" in shown(replace(eq12_fit, reference=away))


def game_throw(every=60, step=0.002):
    """A throw of a game up to rest, without noise: constant friction and loss of
    spin, in frames, and a curl that grows toward rest faster than a constant
    transverse force does."""
    v = 1.95
    omega = 2.75
    rows = []
    x = y = phi = heading = 0.0
    frame = 0
    while v > 0:
        if frame % every == 0:
            rows.append((frame * step, x, y, phi))
        x, y = x + v * math.sin(heading) * step, y + v * math.cos(heading) * step
        phi += omega * step
        heading -= 0.0084 * max(v, 1e-3) ** -1.3 * step
        omega -= 0.027 * step
        v -= 0.082 * step
        frame += 1
    return Throw.from_arrays(*np.array(rows).T)


def test_an_angle_that_is_fitted_exactly_up_to_rest_does_not_stop_the_search():
    """The angle is exact if the stone rests no earlier than at the last row. There the
    fit ends; the optimum of x and y, with the rest there, is that of scipy."""
    throw = game_throw()
    result = fit(throw, "semi-empirical", details=False)
    t = result.observed["t"]
    rest = result.observed["t"][-1]
    u = 1 - (1 - np.linspace(0, 1, 4001)) ** 2  # dense toward rest

    def path(values):
        a, p, x0, y0, heading, v0 = values
        k = 1 / (1 - p)
        v = v0 * (1 - u) ** k
        h = heading - a * rest / v0 * (1 - (1 - u) ** (1 - k)) / (1 - k)
        rates = np.nan_to_num(v * np.array([np.sin(h), np.cos(h)]))
        moved = cumulative_simpson(rates, x=u * rest, initial=0)
        return np.array([[x0], [y0]]) + CubicSpline(u * rest, moved, axis=1)(t)

    observed = np.array([result.observed[name] for name in "xy"])
    sigma = np.array([[result.sigma[name]] for name in "xy"])
    best = least_squares(
        lambda values: ((path(values) - observed) / sigma).ravel(),
        [0.008, -0.01, 0.0, 0.0, 0.0, 1.95],
        x_scale=[0.01, 0.1, 0.1, 0.1, 0.01, 1.0],
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-12,
    )
    x, y = np.sqrt(((path(best.x) - observed) ** 2).mean(1))
    assert result.converged, result.status
    assert [result.rms["x"], result.rms["y"]] == pytest.approx([x, y], rel=1e-3)
