"""What a law lacks, against throws of another law."""

from io import StringIO

import numpy as np
import pytest
from rich.console import Console

import curlfit
from curlfit.comparison.lacking import lacking
from curlfit.comparison.result import Comparison
from curlfit.dynamics.contact import accelerations
from curlfit.friction.front_back import FrontBack
from curlfit.numerics.penalized_spline import PenalizedSpline

STONE = curlfit.Stone(R=0.065)
COEFFICIENTS = {"mu1_xi": 0.004, "mu2_xi": 0.05, "mu1_eta": 0.009, "mu2_eta": 0.009}


class Falling(FrontBack):
    """Front-back friction that falls with the speed of the stone."""

    name = ""  # none of curlfit

    def traction(self, point):
        xi, eta = super().traction(point)
        return xi * point.v**-0.25, eta * point.v**-0.25


def thrown(law, seed):
    random = np.random.default_rng(seed)
    return curlfit.synthetic_throw(
        law,
        STONE,
        v0=random.uniform(2, 2.3),
        omega0=random.uniform(1, 2),
        dt=0.08,
        noise_xy=0.005,
        noise_phi=0.01,
        seed=seed,
    )


def test_a_spline_has_the_derivatives_of_what_it_smooths():
    t = np.linspace(0.0, 6.0, 200)
    random = np.random.default_rng(2)
    inside = []
    for _ in range(20):
        spline = PenalizedSpline.of(
            t, np.sin(t) + 0.05 * random.standard_normal(len(t))
        )
        second_derivative, error = spline.at(t, 2)
        inside.append(np.mean(np.abs(second_derivative + np.sin(t)) < 1.96 * error))
        assert np.median(error) < 0.3
    assert np.mean(inside) > 0.88
    line = PenalizedSpline.of(t, 3 * t**2 + 1e-9 * random.standard_normal(len(t)))
    assert line.at(t, 2)[0] == pytest.approx(6.0, rel=1e-5)


def test_the_bands_have_what_the_law_lacks():
    inside = []
    significance = []
    for seed in range(4):
        throw = thrown(Falling(**COEFFICIENTS), seed)
        missing = lacking(
            "front-back",
            curlfit.fit(throw, "front-back", stone=STONE, details=False),
            {},
            None,
        )
        true_accelerations = np.array(
            accelerations(
                Falling(**COEFFICIENTS), STONE, "uniform", missing.speed, missing.omega
            )
        )
        off = (missing.lacks - (true_accelerations - missing.of_law)) / missing.stderr
        inside.append(np.mean(np.abs(off) < 1.96, axis=1))
        significance.append(np.abs(missing.significance()[1]).max())
    assert (np.mean(inside, axis=0) > 0.85).all()
    assert min(significance) > 5


def test_what_is_lacking_is_what_the_right_law_adds():
    throw = thrown(curlfit.law_with("front-back", COEFFICIENTS), 3)
    alone, right = (
        curlfit.fit(throw, law, stone=STONE, details=False)
        for law in ("coulomb", "front-back")
    )
    missing = lacking("coulomb", alone, {"front-back": right}, None)
    assert missing.nearest == "front-back"
    assert missing.size() > 20
    assert missing.size("front-back") < 2.5
    # across, to the left, where the stone turns counter-clockwise
    assert missing.lacks[0].max() < 0


def test_a_law_that_lacks_nothing_is_told_so():
    throw = thrown(curlfit.law_with("front-back", COEFFICIENTS), 1)
    comparison = curlfit.compare(throw, ["front-back", "coulomb"], stone=STONE)
    curlfit.print_comparison(comparison, Console(file=(text := StringIO()), width=200))
    assert (
        "The path shows nothing that front-back, uniform load lacks" in text.getvalue()
    )
    again = Comparison.from_json(comparison.to_json()).lacking
    np.testing.assert_allclose(again.lacks, comparison.lacking.lacks)
    assert again.others.keys() == {"coulomb, uniform load"}
    figure = curlfit.comparison_figure(comparison)
    assert any("in the spin" in axes.get_ylabel() for axes in figure.axes)
    with_slope = curlfit.fit(
        throw, "coulomb", stone=STONE, free=["slope_x"], details=False
    )
    assert lacking("coulomb", with_slope, {}, None) is None
