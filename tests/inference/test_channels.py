"""Throws of which some channels were not measured: what they determine, and what they do not."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import curlfit
from curlfit import LAWS, InitialState, Stone, simulate
from curlfit.errors import DataError

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
        assert any("v0 sits at its bound; the data hardly tell" in text for text in result.warnings)
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


SIGMA_T = 0.05
# back line, hog lines (m from the hack); the stone begins on the back line
LINES = (1.829, 10.059, 32.004)


@pytest.fixture(scope="module")
def watched():
    """The path, and when it crosses the lines and comes to rest."""
    t = np.arange(0, 40, 0.001)
    path = simulate(LAW, STONE, InitialState(y=LINES[0], v=2.55, omega=1.2), t).to_numpy()
    return path, np.append(np.interp(LINES, path.y, t), t[np.argmax(path.speed == 0)])


def timed(file, times, **more):
    """A stop-watch's file of the four times, read."""
    back, hog, far, rest = times
    lines = {"back_to_hog": hog - back, "hog_to_hog": far - hog, "hog_to_rest": rest - far}
    lines |= {"sigma_t": SIGMA_T} | more
    file.write_text("".join(f"{name} = {value:.4f}\n" for name, value in lines.items()))
    return curlfit.load_throw(file)


def test_a_stop_watch_knows_the_braking_and_says_what_it_does_not(tmp_path):
    # hack at y = 0, hog lines 10.059 and 32.004 m, as the reader has them
    t = np.arange(0, 40, 0.001)
    path = simulate(LAW, STONE, InitialState(v=2.55, omega=1.2), t).to_numpy()
    y = np.asarray(path.y) + 1.829
    back, hog, far = (t[np.searchsorted(y, line)] for line in (1.8291, 10.059, 32.004))
    rest = t[np.searchsorted(y, y[-1] - 1e-4)]
    (tmp_path / "watch.txt").write_text(
        f"back_to_hog = {hog - back:.2f}\nhog_to_hog = {far - hog:.2f}\n"
        f"hog_to_rest = {rest - far:.2f}\ncurl = {path.x[-1]:.2f}\nsigma_t = 0.05\n"
    )
    result = curlfit.fit(curlfit.load_throw(tmp_path / "watch.txt"), "front-back", stone=STONE)
    assert result.converged
    total = known(result)["mu1_eta + mu2_eta"]
    assert abs(total.value - TRUE["mu1_eta + mu2_eta"]) < 0.02 * total.value
    for name in ("mu1_xi", "mu2_xi", "omega0"):
        assert result.parameters[name].verdict in ("not identifiable", "weak", "at bound")


def test_a_throw_timed_without_error_gives_the_braking_back(tmp_path, watched):
    path, times = watched
    throw = timed(tmp_path / "watch.txt", times, curl=path.x[-1])
    assert throw.stops
    result = curlfit.fit(throw, "front-back", stone=STONE)
    assert result.converged
    total = sum(result.parameters[name].value for name in ("mu1_eta", "mu2_eta"))
    assert total == pytest.approx(TRUE["mu1_eta + mu2_eta"], rel=0.01)
    assert result.fitted["y"][-1] == pytest.approx(path.y[-1], abs=0.01)
    assert result.rms["y"] < 1e-3


def test_counted_turns_need_no_sigma(tmp_path, watched):
    path, times = watched
    throw = timed(
        tmp_path / "watch.txt", times, curl=path.x[-1], rest=path.y[-1] - 38.405,
        turns=np.interp(times[-1] - times[1], path.t, path.phi) / (2 * np.pi),
    )  # fmt: skip
    assert throw.sigma["phi"][-1] == pytest.approx(0.1 * 2 * np.pi)
    assert curlfit.fit(throw, "coulomb", stone=STONE).converged


def test_errors_of_timed_throws_are_what_repetition_shows(tmp_path):
    # a stone that stops too early is as far off as one that stops too late
    mu, v = 0.0092, 2.55
    a = 9.81 * mu
    crossed = [(v - np.sqrt(v**2 - 2 * a * (line - LINES[0]))) / a for line in LINES]
    random = np.random.default_rng(5)
    off = []
    for _ in range(60):
        times = np.append(crossed, v / a) + SIGMA_T * random.standard_normal(4)
        rest = LINES[0] + v**2 / (2 * a) - 38.405 + 0.05 * random.standard_normal()
        throw = timed(tmp_path / "watch.txt", times, rest=rest)
        result = curlfit.fit(throw, "coulomb", stone=STONE, fix={"omega0": 0.0})
        assert result.converged
        found = result.parameters["mu"]
        off.append((found.value - mu) / found.stderr)
    assert np.mean(off) == pytest.approx(0, abs=3 / np.sqrt(60))
    assert np.std(off) == pytest.approx(1, abs=3 / np.sqrt(120))


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


def test_only_one_speed_of_zero_in_the_last_row_is_a_time_of_rest():
    t = np.arange(5.0)
    nan = np.nan
    for speed, stops in (
        ([nan, nan, nan, nan, 0.0], True), ([nan, nan, nan, 0.0, 0.0], False),
        ([nan, nan, nan, 0.0, nan], False), ([nan, nan, nan, nan, 0.1], False),
        ([2.0, nan, nan, nan, 0.0], False),
    ):  # fmt: skip
        throw = curlfit.Throw.from_arrays(t, y=t, speed=speed, sigma={"y": 0.1, "speed": 0.1})
        assert throw.stops == stops
        assert not curlfit.Throw.from_arrays(t, y=t, speed=speed).stops
    assert not throw.select_rows(until=2).stops
