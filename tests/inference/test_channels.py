"""Throws of which some channels were not measured: what they determine, and what
they do not."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import TIMES, codes_of, filmed, finding_of

import curlfit
from curlfit import LAWS
from curlfit.inference.fit.fit import fit_throws

LAW = LAWS["front-back"]()
TRUE = {
    "mu1_eta + mu2_eta": LAW.mu1_eta + LAW.mu2_eta,
    "mu1_xi + mu2_xi": LAW.mu1_xi + LAW.mu2_xi,
}


@pytest.fixture(scope="module")
def seen():
    noise = {"x": 0.005, "y": 0.005, "phi": 0.01, "speed": 0.01, "omega": 0.01}
    return filmed(noise=noise, omega=-1.3, heading=0.05)


def fitted(seen, *names, **choices):
    channels = {name: getattr(seen, name) for name in names}
    return curlfit.fit(curlfit.Throw.from_arrays(TIMES, **channels), **choices)


def assert_sums_known(result):
    """What is determined of the halves of the ring is what they have together."""
    for name in ("mu1_xi", "mu2_xi", "mu1_eta", "mu2_eta"):
        assert result.parameters[name].verdict == "not identifiable"
    sums = {combination.expression: combination for combination in result.combinations}
    for expression, true in TRUE.items():
        assert abs(sums[expression].value - true) < 4 * sums[expression].stderr


def test_spin_in_place_of_angle_does_as_well(seen):
    with_spin = fitted(seen, "x", "y", "omega")
    for result in (fitted(seen, "x", "y", "phi"), with_spin):
        for name in ("mu1_xi", "mu2_xi"):
            estimate = result.parameters[name]
            assert abs(estimate.value - getattr(LAW, name)) < 4 * estimate.stderr
    assert with_spin.parameters["phi0"].verdict == "fixed"
    assert with_spin.rms.keys() == {"x", "y", "omega"}


def test_radar_and_gyroscope_know_the_sums_and_not_the_curl(seen):
    result = fitted(seen, "speed", "omega")
    assert_sums_known(result)
    assert {
        name
        for name, estimate in result.parameters.items()
        if estimate.verdict == "fixed"
    } == {"x0", "y0", "heading", "phi0"}


def test_a_gyroscope_alone_knows_no_speed_and_says_so(seen):
    # v0 and all coefficients may grow together: a valley that is long, bent and
    # without an end
    result = fitted(seen, "omega")
    v0 = result.parameters["v0"]
    # the last of the way gains less than rounding
    assert v0.value == pytest.approx(10, rel=1e-4)
    # which of both depends on how much of the push is left over rounding
    assert v0.verdict in ("at bound", "not identifiable")
    if v0.verdict == "at bound":
        assert finding_of(result, "open-at-bound").numbers["name"] == "v0"
    for name in ("mu1_xi", "mu2_xi", "mu1_eta", "mu2_eta"):
        assert result.parameters[name].verdict == "not identifiable"
    held = fitted(seen, "omega", fix={"v0": 2.1})
    assert held.converged
    assert held.parameters["omega0"].value == pytest.approx(-1.3, abs=0.02)
    assert_sums_known(held)


def test_well_measured_throws_have_honest_parabolas(seen):
    assert "curve" not in codes_of(fitted(seen, "x", "y", "phi"))
    v0 = fitted(seen, "phi").parameters["v0"]
    assert v0.verdict in ("weak", "not identifiable")
    assert v0.reason.startswith("values from")


def test_all_channels_at_once_are_better_than_three_and_are_saved(seen, tmp_path):
    three = fitted(seen, "x", "y", "phi")
    five = curlfit.fit(seen)
    for name in ("mu1_xi", "mu2_xi", "v0", "omega0"):
        assert five.parameters[name].stderr < three.parameters[name].stderr
    assert five.n_observations == 5 * len(TIMES)
    assert curlfit.fit_figure(five).axes
    five.save(tmp_path / "fit.json")
    assert curlfit.load_fit(tmp_path).throw.seen == seen.seen


def test_positions_alone_leave_the_transverse_coefficients_weak():
    """Chi squared rises a thousandfold along the axis that makes up their errors."""
    fit = curlfit.fit(filmed(seed=24, noise={"x": 0.005, "y": 0.005}))
    for name in ("mu1_xi", "mu2_xi", "omega0"):
        assert fit[name].verdict == "weak"
        assert fit[name].reason.startswith("values from")
    (total,) = (
        combination
        for combination in fit.combinations
        if "omega0" not in combination.weights
    )
    assert total.expression == "mu1_eta + mu2_eta"
    assert total.value == pytest.approx(0.018, rel=0.02)


def test_a_speed_that_angles_alone_suggest_is_not_believed():
    fit = curlfit.fit(filmed(seed=7, noise={"omega": 0.02}))
    assert fit["v0"].value < 0.2  # of 2.1
    assert not fit.converged
    assert "friction" in fit.status
    assert "angles alone hardly determine the speed" in fit.status


def fit_of(throw, many):
    return fit_throws([throw])[0] if many else curlfit.fit(throw)


@pytest.mark.parametrize(("seed", "many"), [(0, False), (0, True), (1, False)])
def test_without_x_the_fit_does_not_end_at_a_saddle_point(seed, many):
    """There the transverse coefficients are equal; by symmetry nothing
    pulls them apart."""
    noise = {"y": 0.005, "phi": 0.01}
    throw = filmed(seed=seed, noise=noise).with_sigma(noise)
    fit = fit_of(throw, many)
    lowest = min(
        curlfit.fit(throw, fix={"mu1_xi": value}).chi_squared
        for value in np.linspace(0, 0.025, 4)
    )
    assert fit.chi_squared < lowest + 1e-6
    assert fit["mu2_xi"].value - fit["mu1_xi"].value > 0.01
    finding = finding_of(fit, "two-solutions")
    assert "measure x to distinguish" in str(finding)


@pytest.mark.parametrize(("omega", "many"), [(1.2, True), (-3.0, False)])
def test_without_an_angle_both_senses_of_spin_are_tried(omega, many):
    """Exchanged halves of the ring and the opposite spin give the same path."""
    noise = {"x": 5e-4, "y": 5e-4}
    throw = filmed(seed=1, noise=noise, omega=omega).with_sigma(noise)
    fit = fit_of(throw, many)
    # of equal solutions the one with the usual coefficients, in which mu2_xi
    # is the larger
    assert np.sign(fit["omega0"].value) == np.sign(omega)
    assert fit["mu2_xi"].value > fit["mu1_xi"].value
    mu1_xi, mu2_xi, spin = (fit[name].value for name in ("mu1_xi", "mu2_xi", "omega0"))
    held = {"mu1_xi": mu2_xi, "mu2_xi": mu1_xi, "omega0": -spin}
    assert curlfit.fit(throw, fix=held).chi_squared == pytest.approx(
        fit.chi_squared, abs=1e-3
    )
    assert fit["omega0"].verdict == "weak"
    finding = finding_of(fit, "two-solutions")
    values = {
        parameter["name"]: parameter["value"] for parameter in finding.numbers["values"]
    }
    assert values["omega0"] == pytest.approx(-spin, rel=0.01)
    assert finding.remedies[0].numbers == {"unmeasured": ["the angle"]}
