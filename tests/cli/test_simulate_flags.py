"""`curlfit simulate`: conditions, starts on a line, and throws of a saved fit."""

from __future__ import annotations

import numpy as np
import pytest
from independent_motion import G

import curlfit
from curlfit.sheet import LINES

ROWS = ("--until", 20, "--dt", 1)
STRAIGHT = ("--law", "coulomb", "--set", "mu=0.01", "--omega0", 0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("simulate")
    law = curlfit.law_with("coulomb", {"mu": 0.0085})
    stone = curlfit.Stone(R=0.06, m=19.0)
    synthetic = curlfit.synthetic_throw(
        law,
        stone,
        v0=2.1,
        omega0=1.5,
        heading=0.05,
        x0=0.4,
        y0=9.0,
        phi0=0.3,
        dt=1,
        environment=curlfit.environment.Environment(slope_x=1e-3),
    )
    t = synthetic.t
    sigma = {"x": 0.001, "y": 0.001, "phi": 0.001}
    throw = curlfit.Throw.from_arrays(
        t + 5.0, synthetic.x, synthetic.y, synthetic.phi, sigma=sigma, name="a"
    )
    fit = curlfit.fit(
        throw, "coulomb", stone=stone, free=["slope_x"], systematics={"all": 0}
    )
    (folder / "fit").mkdir()
    fit.save(folder / "fit" / "fit.json")
    return folder


def rows(text):
    body = text[text.index("t,x,y,phi\n") :].splitlines()[1:]
    return np.array([line.split(",") for line in body], float).T


def test_conditions_and_a_line_by_closed_form(typed, folder):
    text = typed(
        "simulate",
        *STRAIGHT,
        *ROWS,
        "--v0",
        2.4,
        "--line",
        "hog",
        "--slope-y=-0.001",
        "--sweep",
        "4:8=0.5",
    )
    t, x, y, _ = rows(text)
    # uphill by 1 mm/m, with half the friction from 4 to 8 s: three
    # constant decelerations
    slow = G * 0.011
    swept = G * 0.006
    v = (
        2.4
        - slow * np.minimum(t, 4)
        - swept * np.clip(t - 4, 0, 4)
        - slow * np.clip(t - 8, 0, 99)
    )
    assert v[-1] > 0
    parts = [
        (np.minimum(t, 4), 2.4, slow),
        (np.clip(t - 4, 0, 4), 2.4 - 4 * slow, swept),
        (np.clip(t - 8, 0, 99), 2.4 - 4 * slow - 4 * swept, slow),
    ]
    distance = sum(speed * time - a * time**2 / 2 for time, speed, a in parts)
    np.testing.assert_allclose(y, LINES["hog"] + distance, atol=2e-8)
    assert np.ptp(x) == 0
    assert '# axes = "from-hack"' in text
    assert "# reference.values.slope_y = -0.001" in text
    (folder / "made.csv").write_text(text)
    throw = curlfit.load_throw(folder / "made.csv")
    assert throw.y[0] == pytest.approx(LINES["hog"])
    assert throw.reference.values == {"mu": 0.01, "slope_y": -0.001, "sweep": 0.5}


def test_drag_by_closed_form(typed):
    t, _, y, _ = rows(typed("simulate", *STRAIGHT, *ROWS, "--v0", 2.4, "--drag", 0.8))
    # dv/dt = -a - k v^2 is solved by a tangent
    a = 0.01 * G
    k = 0.5 * 1.27 * 0.914 / np.pi * 0.114 * 0.8 / 20
    phase = np.arctan(2.4 * np.sqrt(k / a))
    distance = np.log(np.cos(phase - np.sqrt(k * a) * t) / np.cos(phase)) / k
    np.testing.assert_allclose(y, distance, atol=2e-8)


def test_a_fit_is_simulated_as_it_was_fitted(typed, folder):
    fit = curlfit.load_fit(folder / "fit")
    assert fit.fitted_law == curlfit.law_with("coulomb", {"mu": fit["mu"].value})
    text = typed("simulate", "--fit", "fit", "--dt", 1)
    t, *channels = rows(text)
    np.testing.assert_allclose(t, fit.observed["t"] - 5.0, atol=1e-9)
    np.testing.assert_allclose(
        channels, [fit.fitted[n] for n in ("x", "y", "phi")], atol=1e-7
    )
    assert "# stone.R = 0.06\n" in text
    assert "# reference.values.slope_x = 0.00" in text


def test_flags_go_before_the_fit(typed):
    text = typed(
        "simulate",
        "--fit",
        "fit",
        *ROWS,
        "--set",
        "mu=0.02",
        "--stone",
        "R=0.05",
        "--line",
        "tee",
        "--x0",
        0,
        "--heading",
        0,
        "--v0",
        1,
        "--omega0",
        0,
        "--slope-x",
        0,
    )
    t, x, y, _ = rows(text)
    stop = 1 / (0.02 * G)
    time = np.minimum(t, stop)
    np.testing.assert_allclose(y - LINES["tee"], time - 0.01 * G * time**2, atol=2e-8)
    assert np.ptp(x) == 0
    assert "# stone.R = 0.05\n# stone.rho = 0.1\n" in text
    assert "# stone.m = 19\n" in text
