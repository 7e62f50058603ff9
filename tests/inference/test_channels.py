"""Throws of which some channels were not measured: what they determine, and what they do not."""

from __future__ import annotations

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import curlfit
from curlfit import LAWS, InitialState, Stone, simulate
from curlfit.errors import DataError
from curlfit.inference.fit.fit import fit_throws

STONE = Stone()
LAW = LAWS["front-back"]()
T = np.arange(0, 20, 0.1)


@pytest.fixture(scope="module")
def seen():
    path = simulate(LAW, STONE, InitialState(v=2.1, omega=-1.3, heading=0.05), T).to_numpy()
    random = np.random.default_rng(0)
    noise = {"x": 0.005, "y": 0.005, "phi": 0.01, "speed": 0.01, "omega": 0.01}
    return {
        name: getattr(path, name) + sigma * random.standard_normal(len(T))
        for name, sigma in noise.items()
    }


def fitted(seen, *names):
    throw = curlfit.Throw.from_arrays(T, **{name: seen[name] for name in names})
    return curlfit.fit(throw, "front-back", stone=STONE)


def known(result):
    return {item.expression: item for item in result.combinations}


TRUE = {
    "mu1_eta + mu2_eta": LAW.mu1_eta + LAW.mu2_eta,
    "mu1_xi + mu2_xi": LAW.mu1_xi + LAW.mu2_xi,
}


def test_spin_in_place_of_angle_does_as_well(seen):
    with_angle, with_spin = fitted(seen, "x", "y", "phi"), fitted(seen, "x", "y", "omega")
    for result in (with_angle, with_spin):
        for name in ("mu1_xi", "mu2_xi"):
            item = result.parameters[name]
            assert abs(item.value - getattr(LAW, name)) < 4 * item.stderr
    assert with_spin.parameters["phi0"].verdict == "fixed"
    assert with_spin.rms.keys() == {"x", "y", "omega"}


def test_radar_and_gyroscope_know_the_sums_and_not_the_curl(seen):
    result = fitted(seen, "speed", "omega")
    for name in ("mu1_xi", "mu2_xi", "mu1_eta", "mu2_eta"):
        assert result.parameters[name].verdict == "not identifiable"
    for expression, true in TRUE.items():
        item = known(result)[expression]
        assert abs(item.value - true) < 4 * item.stderr
    assert {name for name, item in result.parameters.items() if item.verdict == "fixed"} == {
        "x0", "y0", "heading", "phi0",
    }  # fmt: skip


def test_a_gyroscope_alone_knows_no_speed_and_says_so(seen):
    # v0 and all coefficients may grow together: a valley that is long, bent and without an end
    result = fitted(seen, "omega")
    v0 = result.parameters["v0"]
    # the last of the way gains less than rounding
    assert v0.value == pytest.approx(10, rel=1e-4)
    # which of both depends on how much of the push is left over rounding
    assert v0.verdict in ("at bound", "not identifiable")
    if v0.verdict == "at bound":
        assert any("v0 is at its bound; the data hardly" in text for text in result.warnings)
    for name in ("mu1_xi", "mu2_xi", "mu1_eta", "mu2_eta"):
        assert result.parameters[name].verdict == "not identifiable"
    throw = curlfit.Throw.from_arrays(T, omega=seen["omega"])
    held = curlfit.fit(throw, "front-back", stone=STONE, fix={"v0": 2.1})
    assert held.converged
    assert held.parameters["omega0"].value == pytest.approx(-1.3, abs=0.02)
    for expression, true in TRUE.items():
        item = known(held)[expression]
        assert abs(item.value - true) < 4 * item.stderr


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("name", ["omega", "phi"])
def test_no_turning_alone_is_said_to_determine_the_speed(seed, name):
    path = simulate(LAW, STONE, InitialState(v=2.1, omega=-1.3), T).to_numpy()
    noise = 0.01 * np.random.default_rng(seed).standard_normal(len(T))
    throw = curlfit.Throw.from_arrays(T, **{name: getattr(path, name) + noise})
    v0 = curlfit.fit(throw, "front-back", stone=STONE).parameters["v0"]
    assert v0.verdict in ("at bound", "weak", "not identifiable")


def test_well_measured_throws_have_honest_parabolas(seen):
    assert not any("not quadratic" in text for text in fitted(seen, "x", "y", "phi").warnings)
    angle = fitted(seen, "phi")
    assert any("not quadratic" in text and "v0" in text for text in angle.warnings)
    v0 = angle.parameters["v0"]
    assert (v0.verdict, v0.reason) == (
        "weak", "chi squared is far from quadratic within its standard error",
    )  # fmt: skip


def test_places_along_the_sheet_alone(seen):
    result = fitted(seen, "y")
    assert result.parameters["v0"].value == pytest.approx(2.1, abs=0.02)
    assert result.parameters["heading"].verdict == "fixed"
    assert result.parameters["mu1_xi"].verdict != "determined"


def test_all_channels_at_once_are_better_than_three(seen):
    three, five = fitted(seen, "x", "y", "phi"), fitted(seen, *seen)
    for name in ("mu1_xi", "mu2_xi", "v0", "omega0"):
        assert five.parameters[name].stderr < three.parameters[name].stderr
    assert five.n_observations == 5 * len(T)
    assert curlfit.fit_figure(five).axes


def test_a_fit_of_spin_is_saved_loaded_and_sampled(seen, tmp_path):
    result = fitted(seen, "x", "y", "omega")
    result.save(tmp_path / "fit.json")
    again = curlfit.load_fit(tmp_path)
    assert again.throw.seen == ("x", "y", "omega")
    sampled, _ = curlfit.sample(again, effective=500)
    assert sampled.posterior.sd["mu2_xi"] == pytest.approx(
        result.parameters["mu2_xi"].stderr, rel=0.15
    )


def test_a_table_of_spin_is_read(tmp_path, seen):
    rows = [f"{t:.3f},{57.29577951308232 * w:.9f}" for t, w in zip(T, seen["omega"], strict=True)]
    (tmp_path / "gyro.csv").write_text("time_s,gyro_z_dps\n" + "\n".join(rows))
    throw = curlfit.load_throw(tmp_path / "gyro.csv")
    assert throw.seen == ("omega",)
    np.testing.assert_allclose(throw.omega, seen["omega"], atol=1e-9)


def test_nothing_measured_is_refused():
    with pytest.raises(DataError, match="expected some of x, y, phi, speed, omega"):
        curlfit.Throw.from_arrays([0.0, 1.0, 2.0])


def test_the_time_of_rest_and_its_derivatives():
    # under Coulomb friction without spin, v/(mu g) after the start
    def rest(v, mu, last):
        law = LAWS["coulomb"](mu=mu)
        start = InitialState(v=v, omega=0.0)
        return simulate(law, STONE, start, jnp.array([3.0, last]), t0=3.0).rest

    for last in (60.0, 10.0):  # the stone comes to rest before it, or does not
        assert rest(2.0, 0.01, last) == pytest.approx(3 + 2.0 / (0.01 * 9.81), abs=1e-6)
        slopes = jax.jacfwd(rest, (0, 1))(2.0, 0.01, last)
        np.testing.assert_allclose(slopes, (1 / 0.0981, -2.0 / (0.01**2 * 9.81)), rtol=1e-6)


def _repeated(**noise):
    """A throw of other noise, with the channels named."""
    times, start = np.linspace(0, 20, 201), InitialState(v=2.1, omega=1.2)
    path = simulate(LAWS["front-back"](), Stone(), start, times).to_numpy()
    random = np.random.default_rng(24 if "x" in noise else 7)
    return curlfit.Throw.from_arrays(
        times, **{name: getattr(path, name) + sd * random.standard_normal(201)
                  for name, sd in noise.items()},
    )  # fmt: skip


def test_positions_alone_leave_the_transverse_coefficients_weak():
    """Chi squared rises a thousandfold along the axis that makes up their errors."""
    found = curlfit.fit(_repeated(x=0.005, y=0.005))
    for name in ("mu1_xi", "mu2_xi", "omega0"):
        assert found[name].verdict == "weak"
        assert "far from quadratic" in found[name].reason
    (total,) = (item for item in found.combinations if "omega0" not in item.weights)
    assert total.expression == "mu1_eta + mu2_eta"
    assert total.value == pytest.approx(0.018, rel=0.02)


def test_a_speed_that_angles_alone_suggest_is_not_believed():
    found = curlfit.fit(_repeated(omega=0.02))
    assert found["v0"].value < 0.2  # of 2.1
    assert not found.converged
    assert "friction" in found.status
    assert "angles alone hardly determine the speed" in found.status


@pytest.mark.parametrize("many", [False, True])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_without_x_the_fit_does_not_end_at_a_saddle_point(seed, many):
    """There the transverse coefficients are equal; by symmetry nothing pulls them apart."""
    path = simulate(LAW, Stone(), InitialState(v=2.1, omega=1.2), T).to_numpy()
    random = np.random.default_rng(seed)
    y, phi = (
        path.y + 0.005 * random.standard_normal(200),
        path.phi + 0.01 * random.standard_normal(200),
    )
    throw = curlfit.Throw.from_arrays(T, y=y, phi=phi).with_sigma({"y": 0.005, "phi": 0.01})
    found = fit_throws([throw])[0] if many else curlfit.fit(throw)
    lowest = min(
        curlfit.fit(throw, fix={"mu1_xi": value}).chi_squared for value in np.linspace(0, 0.025, 6)
    )
    assert found.chi_squared < lowest + 1e-6
    assert found["mu2_xi"].value - found["mu1_xi"].value > 0.01
    (said,) = (text for text in found.warnings if "fit as well" in text)
    assert "measure x to distinguish" in said


@pytest.mark.parametrize("many", [False, True])
@pytest.mark.parametrize("omega", [1.2, -3.0])
def test_without_an_angle_both_senses_of_spin_are_tried(omega, many):
    """Exchanged halves of the ring and the opposite spin give the same path."""
    path = simulate(LAW, Stone(), InitialState(v=2.1, omega=omega), T).to_numpy()
    noise = 5e-4 * np.random.default_rng(1).standard_normal((2, 200))
    throw = curlfit.Throw.from_arrays(T, path.x + noise[0], path.y + noise[1])
    throw = throw.with_sigma({"x": 5e-4, "y": 5e-4})
    found = fit_throws([throw])[0] if many else curlfit.fit(throw)
    # of equal solutions the one with the usual coefficients, in which mu2_xi is the larger
    assert np.sign(found["omega0"].value) == np.sign(omega)
    assert found["mu2_xi"].value > found["mu1_xi"].value
    one, two, spin = (found[name].value for name in ("mu1_xi", "mu2_xi", "omega0"))
    held = {"mu1_xi": two, "mu2_xi": one, "omega0": -spin}
    assert curlfit.fit(throw, fix=held).chi_squared == pytest.approx(found.chi_squared, abs=1e-3)
    assert found["omega0"].verdict == "weak"
    (said,) = (text for text in found.warnings if "fit as well" in text)
    other = float(re.findall(r"omega0 = ([-.\d]+)", said)[0])
    assert other == pytest.approx(-spin, rel=0.01)
    assert "measure the angle to distinguish" in said


def test_an_error_of_nearly_a_typical_size_determines_nothing():
    path = simulate(LAW, Stone(), InitialState(v=2.1, omega=1.2), T).to_numpy()
    noise = 1e-3 * np.random.default_rng(0).standard_normal((2, 200))
    omega = curlfit.fit(curlfit.Throw.from_arrays(T, path.x + noise[0], path.y + noise[1]))[
        "omega0"
    ]
    assert 0.5 < omega.stderr < 1  # of about 1
    assert omega.verdict == "weak"
