"""The map from pixels to metres: least squares in the image, and the errors
that it leaves."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from curlfit import load_throw
from curlfit.throws.readers.axes import parse_axes
from curlfit.throws.readers.camera import displacements, homography
from tests.sample_files import KNOWN, known_points, project, said, table

PLACES = np.array([[0.0, 1.0, -1.5], [5.0, 20.0, 27.0]])
T = np.linspace(0.0, 20.0, 60)
X, Y = 0.002 * T**2, 2.2 * T - 0.05 * T**2
ROWS = table(dict(zip("uv", project(X, Y), strict=True)) | {"t": T})


def clicked(seed=3, noise=1.0):
    return project(*KNOWN) + noise * np.random.default_rng(seed).normal(
        size=KNOWN.shape
    )


def by_scipy(pixels, metres):
    """The elements of the map from the sheet to the image (the last is 1), by
    least squares."""

    def image(elements, places):
        u, v, w = np.append(elements, 1.0).reshape(3, 3) @ np.stack(
            [*places, 1.0 + 0 * places[0]]
        )
        return np.stack([u, v]) / w

    start = np.linalg.inv(homography(project(*KNOWN), KNOWN).matrix)
    start = (start / start[2, 2]).ravel()[:8]
    return least_squares(
        lambda elements: (image(elements, metres) - pixels).ravel(),
        start,
        x_scale=np.abs(start),
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )


def test_the_errors_of_the_map_are_those_of_the_least_squares():
    found, other = homography(clicked(), KNOWN), by_scipy(clicked(), KNOWN)
    variance = (other.fun @ other.fun) / (2 * KNOWN.shape[1] - 8)
    covariance = np.linalg.inv(other.jac.T @ other.jac) * variance
    pixels = np.linalg.inv(found.matrix) @ np.stack([*PLACES, np.ones(3)])

    def places(elements):
        x, y, w = np.linalg.inv(np.append(elements, 1.0).reshape(3, 3)) @ pixels
        return np.stack([x, y]) / w

    steps = np.diag(1e-6 * np.abs(other.x))
    slope = [(places(other.x + h) - places(other.x - h)) / (2 * h.sum()) for h in steps]
    expected = np.einsum("icn,ij,jcn->cn", slope, covariance, slope)
    moved = displacements(found.errors, *PLACES)
    np.testing.assert_allclose((moved**2).sum(0), expected, rtol=1e-3)


def test_four_points_leave_the_errors_unknown(write):
    assert homography(project(*KNOWN[:, :4]), KNOWN[:, :4]).errors is None
    four = load_throw(write(ROWS), reference=write(known_points(4), "points.csv"))
    assert four.calibration is None
    assert said(four, "unknown and missing from the systematic errors")


def test_the_noise_of_a_row_is_that_of_one_pixel(write):
    throw = load_throw(
        write(ROWS), reference=write(known_points(noise=1.0), "points.csv")
    )
    assert not throw.sigma
    chance = np.random.default_rng(1).normal(size=(400, 2, len(T)))
    plane = homography(project(*KNOWN), KNOWN)
    shifted = np.array([plane(*(project(X, Y) + noise)) for noise in chance])
    for channel, name in enumerate("xy"):
        expected = shifted[:, channel].std(0)
        np.testing.assert_allclose(throw.relative_sigma[name], expected, rtol=0.2)
        assert throw.select_rows(until=5).sigma_over_smallest(name).min() == 1.0


def test_the_weight_of_a_row_does_not_depend_on_its_noise(write):
    noise = np.random.default_rng(2).normal(size=(2, len(T)))
    u, v = project(X, Y) + noise
    rows = write(table({"t": T, "u": u, "v": v}))
    throw = load_throw(rows, reference=write(known_points(), "points.csv"))
    changes = np.diff(np.log(throw.relative_sigma["y"]))
    assert abs(np.corrcoef(changes, np.diff(noise[1]))[0, 1]) < 0.3
    without = load_throw(write(ROWS), reference=write(known_points(), "points.csv"))
    exact = without.relative_sigma["y"]
    np.testing.assert_allclose(throw.relative_sigma["y"], exact, rtol=0.05)


@pytest.mark.parametrize(
    "axes", ["x-along,y-right", "x-back,y-left,from-tee", "y-back,x-left"]
)
def test_the_errors_follow_the_axes(write, axes):
    rows, points = write(ROWS), write(known_points(noise=1.0), "points.csv")
    plain = load_throw(rows, reference=points)
    turned = load_throw(rows, reference=points, axes=axes, as_given=True)
    to_sheet = parse_axes(axes).to_sheet
    dx, dy = displacements(plain.calibration, plain.x, plain.y).transpose(1, 0, 2)
    moved, here = to_sheet(plain.x + dx, plain.y + dy), to_sheet(plain.x, plain.y)
    expected = np.stack([a - b for a, b in zip(moved, here, strict=True)], 1)
    found = displacements(turned.calibration, turned.x, turned.y)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-12)
