"""Throws seen by a camera: noise in pixels, and what the error of the
calibration does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import curlfit
from curlfit import LAWS, InitialState, Stone, load_fit, load_throw, simulate
from curlfit.inference.fit.fit import fit_throws
from curlfit.inference.fit.problems import problem_of
from curlfit.inference.fit.quantities import quantities_of
from tests.sample_files import project, table

LAW = LAWS["front-back"](mu1_xi=0.004, mu2_xi=0.05, mu1_eta=0.009, mu2_eta=0.009)
STONE = Stone(R=0.065, rho=0.1)
START = InitialState(x=0.0, y=0.0, heading=0.0, v=2.25, phi=0.0, omega=1.4)
# fewer than 256, so that a program serves it that others need
TIMES = np.arange(0.0, 26.0, 0.12)
PATH = simulate(LAW, STONE, START, TIMES).to_numpy()
SHEET = np.array([[-2.2, 2.2, 0.0] * 4, np.repeat([-1.0, 10.0, 20.0, 30.0], 3)])
TRUE = {"mu2_xi": 0.05, "x0": 0.0, "curl": float(PATH.x[-1])}
ONLY_CALIBRATION = {"all": 0.0, "calibration": 1.0}


@pytest.fixture
def seen(tmp_path):
    """A throw as a camera saw it, with noise in px of the rows and of the
    known points."""

    def load(seed, rows=0.2, points=0.3, off=()):
        chance = np.random.default_rng(seed)
        u, v = project(PATH.x, PATH.y) + rows * chance.normal(size=(2, len(TIMES)))
        for row, by in off:
            v[row] += by
        phi = PATH.phi + 0.03 * chance.normal(size=len(TIMES))
        clicked = project(*SHEET) + points * chance.normal(size=SHEET.shape)
        known_points = dict(zip("uvxy", [*clicked, *SHEET], strict=True))
        (tmp_path / "points.csv").write_text(table(known_points))
        (tmp_path / "rows.csv").write_text(
            table({"t": TIMES, "u": u, "v": v, "phi_rad": phi})
        )
        return load_throw(tmp_path / "rows.csv", reference=tmp_path / "points.csv")

    return load


def with_systematic(fit, name):
    """Value, standard error and systematic error of a parameter or a quantity."""
    estimate = quantities_of(fit)["curl"] if name == "curl" else fit[name]
    return (
        estimate.value,
        estimate.stderr,
        fit.systematics.errors.get(name) or estimate.systematic,
    )


def test_errors_cover_the_truth(seen):
    options = {"stone": STONE, "systematics": ONLY_CALIBRATION}
    # of 12 at a time, whose program other tests need too
    fits = [
        fit
        for first in (0, 12)
        for fit in fit_throws(
            [seen(seed) for seed in range(first, first + 12)], **options
        )
    ]
    assert not any(fit.outliers or fit.warnings for fit in fits)
    for name, true in TRUE.items():
        value, stderr, systematic = np.array(
            [with_systematic(fit, name) for fit in fits]
        ).T
        pulls = (value - true) / np.hypot(stderr, systematic)
        assert 0.7 < np.sqrt(np.mean(pulls**2)) < 1.35, name
        if name == "x0":
            assert np.sqrt(np.mean(((value - true) / stderr) ** 2)) > 2


def test_an_error_of_the_calibration_shifts_the_estimates_as_the_systematic_error_says(
    seen,
):
    throw = seen(1)
    fit = curlfit.fit(throw, stone=STONE, systematics=ONLY_CALIBRATION)
    assert set(fit.systematics.widths) == {f"calibration_{k + 1}" for k in range(8)}
    for k, error in enumerate(throw.calibration):
        x, y, w = (np.eye(3) + error) @ np.stack(
            [throw.x, throw.y, np.ones(len(throw))]
        )
        true = curlfit.fit(replace(throw, x=x / w, y=y / w), stone=STONE, details=False)
        for name, shifts in fit.systematics.shifts.items():
            shift = shifts[f"calibration_{k + 1}"]
            tolerance = 0.05 * abs(shift) + 0.02 * fit[name].stderr
            assert true[name].value - fit[name].value == pytest.approx(
                shift, abs=tolerance
            ), name


def test_the_noise_is_one_number_of_pixels(seen, tmp_path):
    throw = seen(2)
    fit = curlfit.fit(throw, stone=STONE)
    for name in "xy":
        sigma = fit.observed[f"sigma_{name}"]
        assert sigma.min() == pytest.approx(fit.sigma[name])
        np.testing.assert_allclose(sigma / throw.relative_sigma[name], 0.2, rtol=0.12)
        assert fit.data.sigma[name] == "estimated"
    fit.save(tmp_path / "fit.json")
    saved = load_fit(tmp_path / "fit.json")
    problem = problem_of(fit)
    again = problem_of(saved)
    np.testing.assert_allclose(again.weight, problem.weight)
    np.testing.assert_allclose(problem.weight[1, :9], 1 / fit.observed["sigma_y"][:9])


def test_outliers_are_judged_by_the_pixels(seen):
    # 1.8 px, nine sigma, are 0.1 m here; rows at the far end scatter by 0.04 m
    fit = curlfit.fit(seen(3, off=[(10, 1.8)]), stone=STONE)
    assert {outlier["t"] for outlier in fit.outliers} == {TIMES[10]}


def test_given_pixels_of_noise_are_known(seen):
    throw = seen(4)
    fit = curlfit.fit(throw.with_sigma({"x": 0.01}), stone=STONE)
    assert fit.data.sigma["x"] == "given"
    np.testing.assert_array_equal(fit.observed["sigma_x"], 0.01)


def test_throws_of_one_camera_share_its_error(seen):
    first = seen(5)
    second = seen(6)
    names = ("mu1_xi", "mu2_xi", "mu1_eta + mu2_eta")
    options = {"stone": STONE, "systematics": ONLY_CALIBRATION}
    apart = curlfit.fit_together([first, second], **options)
    together = curlfit.fit_together(
        [first, replace(second, calibration=first.calibration)], **options
    )
    assert len(apart.systematics.widths) == 16
    assert len(together.systematics.widths) == 8
    for name in names:
        assert apart.systematics.errors[name] < together.systematics.errors[name]


def test_the_calibration_can_be_taken_as_exact(seen):
    fit = curlfit.fit(seen(7), stone=STONE, systematics={"calibration": 0.0})
    assert "calibration_1" not in fit.systematics.widths
    assert not any(fit.systematics.of_calibration.values())
