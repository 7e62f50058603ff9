"""The map from pixels to metres: least squares in the image, and the errors
that it leaves."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from curlfit import load_throw
from curlfit.throws.readers.axes import parse_axes
from curlfit.throws.readers.homography import displacements, homography
from curlfit.throws.readers.known_points import odd_points
from tests.sample_files import KNOWN, has_note, known_points, note_on, project, table

PLACES = np.array([[0.0, 1.0, -1.5], [5.0, 20.0, 27.0]])
T = np.linspace(0.0, 20.0, 60)
X = 0.002 * T**2
Y = 2.2 * T - 0.05 * T**2
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
    fitted_map = homography(clicked(), KNOWN)
    optimum = by_scipy(clicked(), KNOWN)
    variance = (optimum.fun @ optimum.fun) / (2 * KNOWN.shape[1] - 8)
    covariance = np.linalg.inv(optimum.jac.T @ optimum.jac) * variance
    pixels = np.linalg.inv(fitted_map.matrix) @ np.stack([*PLACES, np.ones(3)])

    def places(elements):
        x, y, w = np.linalg.inv(np.append(elements, 1.0).reshape(3, 3)) @ pixels
        return np.stack([x, y]) / w

    steps = np.diag(1e-6 * np.abs(optimum.x))
    slope = [
        (places(optimum.x + h) - places(optimum.x - h)) / (2 * h.sum()) for h in steps
    ]
    expected = np.einsum("icn,ij,jcn->cn", slope, covariance, slope)
    moved = displacements(fitted_map.errors, *PLACES)
    np.testing.assert_allclose((moved**2).sum(0), expected, rtol=1e-3)


def test_four_points_leave_the_errors_unknown(write):
    assert homography(project(*KNOWN[:, :4]), KNOWN[:, :4]).errors is None
    four = load_throw(write(ROWS), reference=write(known_points(4), "points.csv"))
    assert four.calibration is None
    assert has_note(four, "pixels-to-metres-by-four-points")


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
    rows = write(ROWS)
    points = write(known_points(noise=1.0), "points.csv")
    plain = load_throw(rows, reference=points)
    turned = load_throw(rows, reference=points, axes=axes, as_given=True)
    to_sheet = parse_axes(axes).to_sheet
    dx, dy = displacements(plain.calibration, plain.x, plain.y).transpose(1, 0, 2)
    moved = to_sheet(plain.x + dx, plain.y + dy)
    unmoved = to_sheet(plain.x, plain.y)
    expected = np.stack([a - b for a, b in zip(moved, unmoved, strict=True)], 1)
    errors = displacements(turned.calibration, turned.x, turned.y)
    np.testing.assert_allclose(errors, expected, rtol=1e-6, atol=1e-12)


LINES = np.array([[x, y] for y in (0.0, 8.0, 17.0, 27.0) for x in (-2.1, 0.0, 2.1)]).T
"""Where lines of a sheet meet."""


def seen(seed, noise=1.0):
    """Pixels of these places, clicked with an error."""
    return project(*LINES) + noise * np.random.default_rng(seed).normal(
        size=LINES.shape
    )


def listed(pixels, places):
    return table(dict(zip("uvxy", [*pixels, *places], strict=True)))


def test_a_point_listed_twice_is_one(write):
    corners = [0, 2, 9, 11]
    for name, indices in (("once", corners), ("twice", [0, *corners])):
        points = write(listed(seen(1)[:, indices], LINES[:, indices]), f"{name}.csv")
        throw = load_throw(write(ROWS), reference=points)
        assert throw.calibration is None
        assert has_note(throw, "pixels-to-metres-by-four-points")
        assert has_note(throw, "points-listed-twice") == (name == "twice")


@pytest.mark.parametrize("away", [(72.0, 0.0), (-25.0, 25.0), (0.0, 500.0)])
def test_a_point_that_was_clicked_wrongly_is_named_and_left_out(write, away):
    pixels = seen(2)
    pixels[:, 7] += away
    points = write(listed(pixels, LINES), "points.csv")
    throw = load_throw(write(ROWS), reference=points)
    note = note_on(throw, "odd-points")
    assert "left out as odd: line 9 (x = 0 m, y = 17 m), " in str(note)
    assert str(note).endswith(" put it; `--as-given` uses it")
    (point,) = note.numbers["points"]
    assert point["off"] == pytest.approx(np.hypot(*away), abs=6)
    without = write(
        listed(np.delete(seen(2), 7, 1), np.delete(LINES, 7, 1)), "others.csv"
    )
    np.testing.assert_array_equal(throw.y, load_throw(write(ROWS), reference=without).y)


def test_odd_points_are_used_as_given(write):
    pixels = seen(2)
    pixels[0, 7] += 30.0
    points = write(listed(pixels, LINES), "points.csv")
    without = load_throw(write(ROWS), reference=points)
    assert note_on(without, "pixels-to-metres").numbers["points"] == 11
    throw = load_throw(write(ROWS), reference=points, as_given=True)
    assert note_on(throw, "pixels-to-metres").numbers["points"] == 12
    assert not has_note(throw, "odd-points")


def test_two_odd_points_do_not_hide_one_another():
    chance = np.random.default_rng(5)
    for seed in range(20):
        pixels = seen(seed)
        odd = chance.choice(12, 2, replace=False)
        pixels[:, odd] += 40.0
        assert set(odd_points(pixels, LINES)) == set(odd)


def test_points_are_seldom_odd_by_chance():
    """1 % of tables, nominally; of 200, by chance at most 8 in 99.8 %."""
    assert sum(bool(odd_points(seen(seed), LINES)) for seed in range(200)) <= 8


def test_where_more_than_one_in_five_contradict_none_is_left_out():
    pixels = seen(1)
    pixels[:, [1, 5, 9]] += [[60.0], [-50.0]]
    assert odd_points(pixels, LINES) == {}
    assert odd_points(pixels[:, :5], LINES[:, :5]) == {}


def test_a_lens_makes_no_point_odd():
    pixels = seen(3, noise=0.5)
    middle = pixels.mean(axis=1, keepdims=True)
    radius = np.hypot(*(pixels - middle)) / np.hypot(*(pixels - middle)).max()
    bent = middle + (pixels - middle) * (1 + 0.005 * radius**2)
    assert odd_points(bent, LINES) == {}
