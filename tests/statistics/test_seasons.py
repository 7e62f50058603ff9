"""Seasons and joint fits of tracks without an angle, by a simulator that shares no code
with curlfit."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from conftest import command
from ridge import season_on_disk
from simulator import simulated

import curlfit
from curlfit.inference.together import summary

TRANSVERSE = {"c": 0.008, "k": -0.5, "b": 0.05}
FRONT_BACK = {"mu1_xi": 0.004, "mu2_xi": 0.05, "mu1_eta": 0.009, "mu2_eta": 0.009}


@pytest.fixture(scope="module")
def season_without_angle(tmp_path_factory):
    """Eight tracks of power+transverse, of which only x and y were measured, by a
    simulator that shares no code with the package."""
    folder = tmp_path_factory.mktemp("without_angle")
    random = np.random.default_rng(3)
    times = np.linspace(0.0, 18.0, 91)
    (folder / "tracks").mkdir()
    for number in range(8):
        spin = random.uniform(0.7, 1.6) * (-1) ** number
        v0 = random.uniform(2.0, 2.3)
        path = simulated("power+transverse", TRANSVERSE, v0, spin, times)
        x, y = path[:2] + 0.005 * random.standard_normal((2, len(times)))
        np.savetxt(
            folder / "tracks" / f"t{number}.csv",
            np.column_stack([times, x, y]),
            delimiter=",",
            header="t,x,y",
            comments="",
        )
    words = ["--law", "power+transverse", "--sigma", "x=.005,y=.005"]
    command("batch", "tracks", *words, "--workers", "1", "--out", "s.csv", cwd=folder)
    return folder, command("fit", "s.csv", "--no-sample", cwd=folder)


def test_throws_without_an_angle_tell_no_coefficient_of_the_spin(season_without_angle):
    """Each is a hyperbola of b and the spin: as quadratics, 20 throws put b 11 to 27
    standard errors from the truth."""
    folder, ran = season_without_angle
    assert ran.returncode == 0
    season = curlfit.load_joint(folder / "s-fit")
    b = season.coefficients["b"]
    assert b.verdict in ("weak", "not identifiable")
    assert b.stderr is None or abs(b.value - TRANSVERSE["b"]) < 2 * b.stderr
    for name in ("c", "k"):
        coefficient = season.coefficients[name]
        assert coefficient.verdict == "determined"
        assert abs(coefficient.value - TRANSVERSE[name]) < 3 * coefficient.stderr
    (warning,) = season.warnings
    assert warning.code == "left-open"
    assert warning.numbers["left"] == [{"count": 8, "names": ["b"]}]
    assert str(warning).startswith("8 of 8 throws leave b open: values far apart")
    assert "`--fix omega0=...`" in str(warning)
    assert "8 of 8 throws leave b open" in ran.stdout
    # nor of the curl of a draw
    assert "curl" not in {effect.parameter for effect in season.groups}


def test_rows_say_what_their_ridge_leaves(season_without_angle):
    """Twice as many numbers: what is exact, and what is as wide as the ridge. What is
    exact holds for the truth."""
    folder, _ = season_without_angle
    truth = np.array([*TRANSVERSE.values()])
    pulls = []
    with (folder / "s.csv").open() as stream:
        for row in csv.DictReader(stream):
            assert row["left_open"] == "b"
            numbers = [
                float(cell) for cell in row["information"].strip("[]").split(",")
            ]
            rows = np.array(numbers).reshape(2, 3, 4)
            pulls.append(rows[..., :-1] @ truth - rows[..., -1])
    assert np.abs(pulls).max() < 4
    assert np.abs(np.array(pulls)[:, 1]).max() > 0


@pytest.fixture(scope="module")
def tracks_alike():
    """Four tracks of front-back, of which x and y were measured."""
    random = np.random.default_rng(4)
    times = np.linspace(0.0, 18.0, 91)
    throws = []
    for number in range(4):
        path = simulated("front-back", FRONT_BACK, 2.1, 1.2, times)
        x, y = path[:2] + 0.005 * random.standard_normal((2, len(times)))
        sigma = {"x": 0.005, "y": 0.005}
        name = f"t{number}.csv"
        throws.append(
            curlfit.Throw.from_arrays(times, x=x, y=y, sigma=sigma, name=name)
        )
    return throws


@pytest.fixture(scope="module")
def evening_without_angle(tracks_alike):
    """The tracks together."""
    return curlfit.fit_together(tracks_alike, law="front-back")


def test_no_curl_is_told_that_depends_on_an_open_coefficient(
    tracks_alike, tmp_path, monkeypatch
):
    """However small its error to first order: how far the throws turned is not known
    either."""
    monkeypatch.setattr(summary, "_ROUGH", np.inf)
    season = season_on_disk("front-back", tracks_alike, tmp_path)
    assert season.coefficients["mu1_xi"].verdict == "weak"
    quantities = {effect.parameter for effect in season.groups}
    assert "curl" not in quantities
    assert "hog_to_hog" in quantities


def test_what_is_told_of_several_throws_holds_along_their_ridge(evening_without_angle):
    """To first order about the optimum, sums with a thousandth of mu1_xi were known to
    2e-6, and 4 and 6 standard errors from the truth."""
    joint = evening_without_angle
    for name in ("mu1_xi", "mu2_xi"):
        assert joint.coefficients[name].verdict in ("weak", "at bound")
    assert joint.combinations
    for combination in joint.combinations:
        truth = sum(
            FRONT_BACK[name] * weight for name, weight in combination.weights.items()
        )
        assert abs(combination.value - truth) < 3 * combination.stderr
    assert any(
        {"mu1_eta", "mu2_eta"} <= combination.weights.keys()
        for combination in joint.combinations
    )


def test_each_alone_is_the_fit_of_the_throw(evening_without_angle):
    joint = evening_without_angle
    for variation in joint.variation:
        assert variation.p_value > 0.01
    mu1_variation = next(
        variation for variation in joint.variation if variation.expression == "mu1_xi"
    )
    for throw, alone in zip(joint.throws, mu1_variation.each, strict=True):
        fit = curlfit.fit(throw.throw, law="front-back")
        estimate = fit["mu1_xi"]
        assert alone is not None
        # a batch stops at another tolerance, and the ridge is flat
        assert alone[0] == pytest.approx(estimate.value, abs=0.2 * alone[1])
        assert alone[1] > 0.005
