"""Angles with bad values: no other row is moved by a turn."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from curlfit import DataError, load_throw
from curlfit.errors import Option
from curlfit.throws.readers.unwrapping import unwrap
from tests.sample_files import COLUMNS, PHI, T, note_on, table

TURN = 2 * np.pi


@st.composite
def tracked(draw):
    """Times, an angle of a stone that slows down, and bad rows in it, with what
    a tracker says there."""
    rate = draw(st.sampled_from([10, 25, 30, 60]))
    spin = draw(st.floats(0.4, 2.0)) * draw(st.sampled_from([-1, 1]))
    seed = draw(st.integers(0, 2**32 - 1))
    chance = np.random.default_rng(seed)
    t = np.arange(0, 18, 1 / rate)
    angle = draw(st.floats(-3, 3)) + spin * (t - 0.02 * t**2)
    angle += draw(st.sampled_from([0.0, 0.005, 0.02])) * chance.normal(size=len(t))
    given_angle = angle.copy()
    bad = np.zeros(len(t), bool)
    # one or a few rows, a second and a half apart
    for begin in np.flatnonzero(chance.random(11) < 0.3):
        first = int((1.5 * begin + 1.0) * rate)
        rows = slice(first, first + draw(st.integers(1, 3)))
        if draw(st.booleans()):  # it stands still
            given_angle[rows] = angle[first] + chance.uniform(-20, 20)
        else:
            given_angle[rows] += chance.uniform(-20, 20, rows.stop - rows.start)
        bad[rows] = True
    return t, angle, given_angle, bad


@given(throw=tracked())
@settings(max_examples=200, deadline=None)
def test_bad_values_move_no_angle_that_counts_on(throw):
    t, angle, given_angle, bad = throw
    np.testing.assert_array_equal(unwrap(t, given_angle).angle[~bad], angle[~bad])


@given(throw=tracked(), low=st.floats(-4, 0))
@settings(max_examples=200, deadline=None)
def test_bad_values_move_no_wrapped_angle(throw, low):
    t, angle, given_angle, bad = throw
    wrapped = np.remainder(given_angle - low, TURN) + low
    off = unwrap(t, wrapped).angle[~bad] - angle[~bad]
    np.testing.assert_allclose(off, off[0], atol=1e-9)
    assert off[0] / TURN == pytest.approx(round(off[0] / TURN))


@pytest.mark.parametrize("period", [TURN, TURN / 2])
@pytest.mark.parametrize("part", [0.3, 0.5, 0.7])
def test_a_bad_value_of_a_wrapped_angle_is_off_course_alone(period, part):
    wrapped = np.remainder(PHI, period)
    wrapped[20] += part * period
    unwrapped = unwrap(T, wrapped)
    assert unwrapped.period == period
    assert np.flatnonzero(unwrapped.off_course).tolist() == [20]
    off = np.delete(unwrapped.angle - PHI, 20)
    np.testing.assert_allclose(off, off[0], atol=1e-9)


def test_an_angle_that_stands_still_while_the_stone_turns_is_a_gap():
    t = np.arange(0, 18, 0.1)
    angle = 1.5 * t
    wrapped = np.remainder(angle, TURN)
    wrapped[60:85] = wrapped[60]  # 3.6 rad
    unwrapped = unwrap(t, wrapped)
    np.testing.assert_allclose(unwrapped.angle[:61], angle[:61], atol=1e-9)
    np.testing.assert_allclose(unwrapped.angle[85:], angle[85:], atol=1e-9)


FROZEN = [23, 24, 25]


def frozen(high):
    """The angle of three rows stands still, by so much too high."""
    phi = PHI.copy()
    phi[FROZEN] = PHI[FROZEN[0]] + high
    return phi


@pytest.mark.parametrize("high", [5.45, -9.0, 40.0])
def test_bad_rows_are_named_with_the_option_that_leaves_them_out(write, high):
    throw = load_throw(write(table(COLUMNS | {"phi": frozen(high)})))
    np.testing.assert_array_equal(np.delete(throw.phi, FROZEN), np.delete(PHI, FROZEN))
    np.testing.assert_allclose(throw.phi[FROZEN], PHI[FROZEN[0]] + high)
    note = note_on(throw, "angles-off-course")
    assert str(note) == (
        "phi: 3 values contradict those before and after, line 25 to line 27; kept; "
        "`--exclude 5.625:6.375` leaves the rows out"
    )
    assert note.remedies[0].option == Option("exclude", "5.625:6.375")
    rest = throw.select_rows(exclude=[(5.625, 6.375)])
    np.testing.assert_array_equal(rest.phi, np.delete(PHI, FROZEN))


def test_many_bad_rows_of_a_wrapped_angle_are_refused_by_name(write):
    phi = np.remainder(PHI, TURN)
    phi[::2] = np.random.default_rng(1).uniform(0, TURN, len(phi[::2]))
    with pytest.raises(DataError, match="of 60 values contradict the others") as caught:
        load_throw(write(table(COLUMNS | {"phi": phi}), "many.csv"))
    assert caught.value.line is not None
    assert caught.value.column == "phi"


def test_one_bad_value_does_not_make_degrees_of_radians(write):
    columns = COLUMNS | {"phi": PHI.copy()}
    columns["phi"][30] = -999.0
    columns["theta"] = columns.pop("phi")
    throw = load_throw(write(table(columns)))
    np.testing.assert_array_equal(np.delete(throw.phi, 30), np.delete(PHI, 30))
