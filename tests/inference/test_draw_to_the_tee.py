"""The draw to the tee: closed forms, and a motion by none of curlfit's code."""

import numpy as np
import pytest
from independent_laws import reference
from independent_motion import Start
from numpy.testing import assert_allclose

import curlfit
from curlfit.inference.model.model import Model
from curlfit.inference.together.draw import Draw
from curlfit.sheet import HOG_TO_HOG, LINES, TEE
from curlfit.stone import GRAVITY, Stone

LENGTH = TEE - LINES["hog"]
STONE = Stone()
FRICTION = np.array([0.007, 0.0085, 0.012])


def draw_under(law: str) -> Draw:
    return Draw(Model(curlfit.LAWS[law], "uniform"), STONE)


def test_a_stone_without_spin_under_constant_friction() -> None:
    quantities = draw_under("coulomb").quantities(FRICTION[:, None], 0.0)
    friction, curl, hog_to_hog = quantities.T

    assert_allclose(friction, FRICTION, rtol=3e-5)
    assert_allclose(curl, 0.0, atol=1e-12)
    v = np.sqrt(2 * FRICTION * GRAVITY * LENGTH)
    v_at_far_hog = np.sqrt(v**2 - 2 * FRICTION * GRAVITY * HOG_TO_HOG)
    expected = (v - v_at_far_hog) / (FRICTION * GRAVITY)
    assert_allclose(hog_to_hog, expected, rtol=1e-4)


def test_speeds_of_a_time_between_the_hog_lines() -> None:
    times = np.array([13.0, 14.5, 12.0])

    speeds = draw_under("coulomb").speeds(FRICTION[:, None], 0.0, times)

    expected = HOG_TO_HOG / times + FRICTION * GRAVITY * times / 2
    assert_allclose(speeds, expected, rtol=1e-4)


@pytest.mark.parametrize("k", [-0.5, 0.3])
def test_friction_that_is_a_power_of_speed(k: float) -> None:
    c = np.array([0.006, 0.008, 0.012])
    coefficients = np.column_stack([c, np.full(3, k)])

    friction = draw_under("power").quantities(coefficients, 0.0)[:, 0]

    v = ((2 - k) * GRAVITY * c * LENGTH) ** (1 / (2 - k))
    assert_allclose(friction, v**2 / (2 * GRAVITY * LENGTH), rtol=3e-5)


@pytest.mark.parametrize("angle", [9.0, -15.0])
def test_draws_turn_by_the_angle_and_rest_at_the_tee(angle: float) -> None:
    law = "front-back"
    coefficients = np.array([[0.004, 0.05, 0.009, 0.009], [0.001, 0.02, 0.012, 0.007]])
    draw = draw_under(law)

    spins = draw.spin(coefficients, angle)
    friction, curl, _ = draw.quantities(coefficients, angle).T

    speeds = np.sqrt(2 * GRAVITY * LENGTH * friction)
    for row, values in enumerate(coefficients):
        start = Start(v=speeds[row], omega=spins[row])
        motion = reference(law, tuple(values), "uniform", STONE, 24).motion(start, 60.0)
        x, y, phi = motion.at(np.array([motion.end]))[:, 0]
        assert_allclose([y, phi], [LENGTH, angle], rtol=3e-5)
        assert_allclose(-np.sign(angle) * x, curl[row], rtol=1e-4)


def test_the_usual_angle_is_that_of_stones_that_are_known_to_turn() -> None:
    draw = draw_under("front-back")
    coefficients = np.tile([0.004, 0.05, 0.009, 0.009], (5, 1))
    spins = np.array([0.0, 1.1, -1.2, 0.0, 0.0])

    angle = draw.usual_angle(coefficients, spins)

    of_turning = draw.spin(coefficients[:1], angle)[0]
    assert 1.1 < of_turning < 1.2
    assert draw.usual_angle(coefficients, np.zeros(5)) == 0.0


def test_a_time_that_no_stone_takes() -> None:
    with pytest.raises(curlfit.InputError, match="it stops before the far hog line"):
        draw_under("coulomb").speeds(FRICTION[:, None], 0.0, 40.0)
