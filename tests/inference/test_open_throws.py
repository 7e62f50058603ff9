"""Throws whose data hold fewer numbers than the law has parameters.

The files were made by a simulation that shares no code with curlfit: 18 s at 10 Hz,
released with 2.1 m/s and 1.1 rad/s (0 in `no_spin_...`; 2.12 m/s and -1.44 rad/s in
`no_angle_sutor.csv`), noise of 5 mm and 10 mrad.
"""

import re
from functools import cache
from pathlib import Path

import pytest
from conftest import codes_of, finding_of

import curlfit
from curlfit.inference.fit.fit import fit_throws

FOLDER = Path(__file__).parent / "open_throws"
NOISE = {"x": 0.005, "y": 0.005}
NOT_KNOWN = ("weak", "not identifiable")


def alone(file: str, law: str, **choices) -> curlfit.FitResult:
    """The fit of a throw as `curlfit fit` makes it."""
    throw = curlfit.load_throw(FOLDER / file)
    return curlfit.fit(throw, law, details=False, **choices)


def beside_others(file: str, law: str, **choices) -> curlfit.FitResult:
    """The fit of a throw as `curlfit batch` makes it."""
    (fit,) = fit_throws([curlfit.load_throw(FOLDER / file)], law, **choices)
    return fit


@cache
def fit_of(file: str, law: str) -> curlfit.FitResult:
    """The fit of a throw whose place was measured."""
    return alone(file, law, sigma=NOISE)


def fits_of(file: str, law: str) -> list[curlfit.FitResult]:
    """The fit of a throw as `curlfit fit` and as `curlfit batch` make it."""
    return [fit_of(file, law), beside_others(file, law, sigma=NOISE)]


ALONE_OR_BESIDE = pytest.mark.parametrize(
    "fitted", [alone, pytest.param(beside_others, marks=pytest.mark.slow)]
)


def curve_warning(fit: curlfit.FitResult) -> str:
    """The warning that the values that fit lie on a curve."""
    return str(finding_of(fit, "curve"))


def test_without_the_angle_nothing_tells_the_force_from_the_spin():
    """Only b omega0 enters: 0.05 times 1.1."""
    for fit in fits_of("no_angle_transverse.csv", "power+transverse"):
        assert {fit["b"].verdict, fit["omega0"].verdict} <= {*NOT_KNOWN}
        assert not fit.combinations
        assert fit["c"].verdict == "determined"
        assert fit["c"].value == pytest.approx(0.008, abs=2 * fit["c"].stderr)
        assert fit["k"].value == pytest.approx(-0.5, abs=2 * fit["k"].stderr)
        warning = curve_warning(fit)
        assert re.search(r"; omega0 = 1.* \+- 0.05 rad/s would determine b to", warning)


def test_a_known_spin_determines_what_the_warning_says():
    law = "power+transverse"
    open_ = fit_of("no_angle_transverse.csv", law)
    throw = curlfit.load_throw(FOLDER / "no_angle_transverse.csv")
    with_spin = curlfit.fit(
        throw, law, sigma=NOISE, priors={"omega0": "1.1+-0.05"}, details=False
    )
    promised = curve_warning(open_).partition("determine b to ")[2].split()[0]
    # which is at another spin: the error of b falls with its square
    assert with_spin["b"].stderr == pytest.approx(float(promised), rel=0.3)
    assert with_spin["b"].value == pytest.approx(0.05, abs=2 * with_spin["b"].stderr)


def test_the_forward_friction_is_determined_without_the_angle():
    for fit in fits_of("no_angle_front_back.csv", "front-back"):
        assert fit["mu1_xi"].verdict in NOT_KNOWN
        assert fit["mu2_xi"].verdict in NOT_KNOWN
        assert fit["omega0"].verdict in NOT_KNOWN
        (forward,) = fit.combinations
        assert forward.expression == "mu1_eta + mu2_eta"
        assert forward.value == pytest.approx(0.018, abs=2 * forward.stderr)


def test_the_forward_friction_is_determined_beside_a_sideways_force():
    """The sum moves by a few percent along the ridge, which bends."""
    throw = curlfit.load_throw(FOLDER / "no_angle_sideways.csv")
    (fit,) = fit_throws([throw], "front-back+sideways", sigma=NOISE, curves=False)
    (forward,) = fit.combinations
    assert forward.expression == "mu1_eta + mu2_eta"
    assert forward.stderr < 0.1 * forward.value
    assert forward.value == pytest.approx(0.018, abs=2 * forward.stderr)


def test_a_coefficient_at_its_bound_by_chance_determines_no_other():
    """The speed v_b is 1.87 m/s, r 2.3; with r at its upper bound it is 1.50 m/s."""
    fit = fit_of("no_angle_sutor.csv", "sutor")
    assert {fit["r"].verdict, fit["v_b"].verdict} <= {*NOT_KNOWN}
    assert fit["v0"].verdict == "determined"


@ALONE_OR_BESIDE
def test_two_times_determine_no_exponent(fitted):
    """Each exponent from -0.7 to 1 has values that fit exactly."""
    fit = fitted("two_times.txt", "power")
    assert {fit[name].verdict for name in ("c", "k", "v0")} <= {*NOT_KNOWN}
    assert not fit.combinations
    assert "k from -0.7 to" in curve_warning(fit)


@ALONE_OR_BESIDE
def test_of_a_stone_that_may_not_have_spun_no_force_of_the_spin_is_known(fitted):
    """The force is 0.005 m/s^2 to either side; without spin there is none."""
    sigma = NOISE | {"phi": 0.01}
    fit = fitted("no_spin_semi_empirical.csv", "semi-empirical", sigma=sigma)
    assert fit["a"].verdict in NOT_KNOWN
    assert fit["c"].verdict == "determined"
    assert fit["c"].value == pytest.approx(0.085, abs=2 * fit["c"].stderr)


def test_a_table_of_friction_determines_no_scale_of_the_spin():
    """Under sutor's law only f_min (1 + e (I0(alpha) - 1)) enters."""
    fit = curlfit.fit_friction(FOLDER / "friction_table.csv", "sutor").fits[0]
    assert not fit.combinations
    for name in ("f_min", "alpha"):
        assert fit.coefficients[name].verdict in NOT_KNOWN
    assert "curve" in codes_of(fit)


@pytest.mark.parametrize(
    ("file", "law"),
    [
        ("no_angle_front_back.csv", "front-back"),
        ("no_angle_transverse.csv", "power+transverse"),
    ],
)
def test_the_posterior_does_not_contradict_a_verdict(file, law):
    """What is called determined is as narrow in the posterior as its error says."""
    fit, _ = curlfit.sample(fit_of(file, law), seed=1, effective=500)
    sd = fit.posterior.sd
    mean = fit.posterior.mean
    names = [name for name in fit.parameters if fit[name].verdict == "determined"]
    names += [combination.expression for combination in fit.combinations]
    assert {"v0", "heading"} <= {*names}
    for name in names:
        assert sd[name] < 1.5 * fit[name].stderr
        assert abs(mean[name] - fit[name].value) < 2 * fit[name].stderr


@pytest.mark.parametrize(
    ("file", "law"),
    [
        ("no_angle_transverse.csv", "power+transverse"),
        ("no_angle_front_back.csv", "front-back"),
    ],
)
def test_compare_says_of_a_throw_what_its_fit_says(file, law):
    throw = curlfit.load_throw(FOLDER / file)
    fit = fit_of(file, law)
    (candidate,) = curlfit.compare(throw, [law], sigma=NOISE).candidates
    verdicts = {
        name: coefficient["verdict"]
        for name, coefficient in candidate.coefficients.items()
    }
    assert verdicts == {
        name: coefficient.verdict for name, coefficient in fit.coefficients.items()
    }
    expressions = {combination["expression"] for combination in candidate.combinations}
    of_law = fit.coefficients.keys()
    sums = [
        combination
        for combination in fit.combinations
        if combination.weights.keys() & of_law
    ]
    assert expressions == {combination.expression for combination in sums}


def test_compare_of_several_tracks_says_of_no_force_that_it_is_at_its_bound():
    """Two tracks without an angle, of the same spin: f0 may be anything."""
    throws = []
    for seed, v0 in enumerate((2.0, 2.2)):
        law = curlfit.LAWS["power-angular"]()
        motion = {"v0": v0, "omega0": 1.1, "until": 18.0, "dt": 0.1}
        with_angle = curlfit.synthetic_throw(
            law, curlfit.Stone(), **motion, noise_xy=0.005, seed=seed
        )
        columns = {"x": with_angle.x, "y": with_angle.y}
        name = f"throw {seed}"
        throws.append(
            curlfit.Throw.from_arrays(with_angle.t, **columns, sigma=NOISE, name=name)
        )
    (candidate,) = curlfit.compare(throws, ["power-angular"]).candidates
    coefficients = candidate.coefficients
    assert coefficients["f0"]["verdict"] in NOT_KNOWN
    assert not candidate.at_bound
    assert coefficients["c"]["verdict"] == "determined"
    stderr = coefficients["c"]["stderr"]
    assert coefficients["c"]["value"] == pytest.approx(0.008, abs=2.5 * stderr)
