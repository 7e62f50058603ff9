"""The angle from two points of a stone, against paths on which it is known."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import parts_in
from sample_files import COLUMNS, PHI, T, X, Y, note_on, table

from curlfit import DataError, InputError, load_throw

ARM = 0.12  # m
NOISE = 0.002  # m
FINE = np.arange(0, 14.75, 0.05)


def path(t=T):
    """x, y, phi of a slowing, curling stone at some times."""
    return [np.interp(t, T, values) for values in (X, Y, PHI)]


def marked(t=T, noise=0.0, seed=0, arm=ARM):
    """Places of stone and handle, and the angle of the latter."""
    x, y, phi = path(t)
    random = np.random.default_rng(seed)
    columns = [x, y, x + arm * np.cos(phi), y + arm * np.sin(phi)]
    return [column + noise * random.standard_normal(len(t)) for column in columns], phi


def export(places, t=T, unit="m", factor=1.0):
    """A Tracker export with stone and handle side by side, each with its own clock."""
    head = (
        "stone\t\t\thandle\t\t\n"
        + "\t".join([f"t (s)\tx ({unit})\ty ({unit})"] * 2)
        + "\n"
    )
    columns = [
        t,
        *(factor * p for p in places[:2]),
        t,
        *(factor * p for p in places[2:]),
    ]
    rows = zip(*columns, strict=True)
    return head + "".join(
        "\t".join("" if np.isnan(v) else f"{v:.12g}" for v in r) + "\n" for r in rows
    )


@pytest.mark.parametrize(("unit", "factor"), [("m", 1.0), ("cm", 100.0)])
def test_the_direction_of_the_handle_is_the_angle(write, unit, factor):
    coordinates, phi = marked()
    file = write(export(coordinates, unit=unit, factor=factor))
    throw = load_throw(file, handle=2)
    assert [part.stone_index for part in parts_in(file, handle=2)] == [1]  # of a batch
    turns = 2 * np.pi * np.round((throw.phi[0] - phi[0]) / (2 * np.pi))
    np.testing.assert_allclose(throw.phi - turns, phi, atol=1e-6)
    np.testing.assert_allclose(throw.x, X, atol=1e-8)
    note = note_on(throw, "angle-of-mark-and-scatter")
    assert note.numbers["millimetres"] == pytest.approx(120, rel=1e-4)


@pytest.mark.parametrize(
    "words", ["x-along", "x-left", "y-back,counter-clockwise", "clockwise"]
)
def test_the_angle_is_counter_clockwise_in_any_axes(write, words):
    coordinates, phi = marked()
    right = np.array(coordinates[::2])
    along = np.array(coordinates[1::2])
    x, y = {
        "x-along": (along, -right),
        "x-left": (-right, along),
        "clockwise": (right, along),
        "y-back,counter-clockwise": (right, -along),
    }[words]
    throw = load_throw(write(export([x[0], y[0], x[1], y[1]])), axes=words, handle=2)
    np.testing.assert_allclose(throw.phi - throw.phi[0], phi - phi[0], atol=1e-6)


def test_noise_of_both_marks_is_that_of_the_angle(write):
    """sigma_phi = sqrt(2) sigma / arm to first order; the errors have that size."""
    coordinates, phi = marked(FINE, NOISE)
    throw = load_throw(write(export(coordinates, FINE)), handle=2)
    expected = np.sqrt(2) * NOISE / ARM
    assert throw.sigma["phi"] == pytest.approx(expected, rel=0.15)
    error = throw.phi - phi
    error -= 2 * np.pi * np.round(error.mean() / (2 * np.pi))
    # of 295 values, the standard deviation of a standard deviation is 4 %
    assert error.std() == pytest.approx(expected, rel=0.12)
    assert abs(error.mean()) < 4 * expected / np.sqrt(len(FINE))


def test_given_sigmas_are_propagated(write):
    coordinates, phi = marked(noise=0.0)
    sigma_x = 0.001
    sigma_y = 0.004
    columns = dict(
        zip(("x", "y", "x_handle", "y_handle"), coordinates, strict=True)
    ) | {"t": T}
    columns |= {
        "sigma_x": np.full_like(T, sigma_x),
        "sigma_y": np.full_like(T, sigma_y),
    }
    throw = load_throw(write(table(columns)))
    # the gradient of atan2(dy, dx), by differences
    step = 1e-6
    dx = coordinates[2] - coordinates[0]
    dy = coordinates[3] - coordinates[1]
    by_x = (np.arctan2(dy, dx + step) - np.arctan2(dy, dx - step)) / (2 * step)
    by_y = (np.arctan2(dy + step, dx) - np.arctan2(dy - step, dx)) / (2 * step)
    keep = (np.abs(by_x) < 20) & (np.abs(by_y) < 20)  # where atan2 does not jump
    expected = np.sqrt(2) * np.hypot(by_x * sigma_x, by_y * sigma_y)
    assert keep.sum() > 50
    np.testing.assert_allclose(throw.sigma["phi"][keep], expected[keep], rtol=1e-6)
    np.testing.assert_allclose(np.diff(throw.phi), np.diff(phi), atol=1e-9)


def test_gaps_of_either_mark_are_gaps_of_the_angle(write):
    coordinates, _ = marked()
    coordinates[2][5:8] = coordinates[3][5:8] = np.nan
    throw = load_throw(write(export(coordinates)), handle=2)
    assert np.flatnonzero(np.isnan(throw.phi)).tolist() == [5, 6, 7]
    assert np.isfinite(throw.x).all()


def test_marks_that_are_none(write):
    coordinates, _ = marked()
    file = write(export(coordinates))
    with pytest.raises(
        InputError, match="--handle 1 is the stone itself; expected another object"
    ):
        load_throw(file, handle=1)
    with pytest.raises(
        InputError, match="--handle 3: there is no such object; expected one of 1"
    ):
        load_throw(file, handle=3)
    with pytest.raises(
        DataError, match="the mark is 2 m from the stone, and a stone's diam"
    ):
        load_throw(write(export(marked(arm=2.0)[0])), handle=2)
    plain = write(table({"t": T, "x": X, "y": Y}), "plain.csv")
    with pytest.raises(
        InputError, match=r"--handle: .*plain.csv is a table file and holds no obj"
    ):
        load_throw(plain, handle=1)
    columns = COLUMNS | {"x_mark": X + 0.1, "y_mark": Y}
    with pytest.raises(DataError, match="an angle and a second mark are both given"):
        load_throw(write(table(columns)))
