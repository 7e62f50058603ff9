"""Several data sets under one set of coefficients: throws in a table and
measured friction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import NOISE, filmed
from independent_motion import G
from scipy.optimize import least_squares
from scipy.stats import chi2

import curlfit
from curlfit import InputError, sheet
from curlfit.throws.events import Event

HOG = sheet.LINES["hog"]
C = 0.008
K = -0.3
LAWS = ["coulomb", "power"]  # which have one program


def speeds_of_rest(c, k, length):
    """Initial speed of a stone without spin that rests after a length: dv/ds = -c
    g v^(k - 1)."""
    return ((2 - k) * c * G * np.asarray(length)) ** (1 / (2 - k))


def throws(c=C, k=K, seed=1):
    """Six throws of a law of powers in closed form, by speed and resting place."""
    random = np.random.default_rng(seed)
    six_throws = []
    for row, length in enumerate(np.linspace(15.0, 30.0, 6), 1):
        events = (
            Event(
                "speed",
                "speed",
                speeds_of_rest(c, k, length) + random.normal(0, 0.01),
                0.01,
                HOG,
            ),
            Event("spin", "omega", 0.0, 0.001, HOG),
            Event("rest", "y", HOG + length + random.normal(0, 0.05), 0.05),
        )
        six_throws.append(
            curlfit.Throw.from_events(events, name=f"curls.csv row {row}")
        )
    return six_throws


def table(c=C, k=K, seed=2, sigma=2e-4):
    speed = np.array([0.3, 0.5, 0.8, 1.2, 1.8, 2.5])
    mu = c * speed**k + np.random.default_rng(seed).normal(0, sigma, 6)
    return curlfit.FrictionTable("mu.csv", speed, mu, np.zeros(6), np.full(6, sigma))


def peer(data, measured, start=(0.008, -0.3)):
    """Residuals of both data sets, written anew; the resting place is that of the
    fitted speed."""
    values = np.array([[event.value for event in throw.events] for throw in data])

    def residual(p):
        c, k, *v = p
        v = np.array(v)
        rest = HOG + v ** (2 - k) / ((2 - k) * c * G)
        return np.concatenate(
            [
                (v - values[:, 0]) / 0.01,
                (rest - values[:, 2]) / 0.05,
                (c * measured.speed**k - measured.mu) / measured.sigma,
            ]
        )

    return least_squares(
        residual, [*start, *values[:, 0]], x_scale=[0.01, 1, *[2] * 6], xtol=1e-14
    )


@pytest.fixture(scope="module")
def agreeing():
    return curlfit.compare([*throws(), table()], LAWS)


def test_the_common_optimum_is_that_of_scipy(agreeing):
    best = agreeing.of("power")
    expected = peer(throws(), table())
    covariance = np.linalg.inv(expected.jac.T @ expected.jac)
    for index, name in enumerate(("c", "k")):
        coefficient = best.coefficients[name]
        assert coefficient["value"] == pytest.approx(expected.x[index], rel=1e-4)
        assert coefficient["stderr"] == pytest.approx(
            covariance[index, index] ** 0.5, rel=1e-3
        )
    assert sum(on.chi_squared for on in best.sets) == pytest.approx(
        2 * expected.cost, rel=1e-4
    )
    assert sum(on.dof for on in best.sets) == pytest.approx(
        6 * 3 + 6 - (2 + 2 * 6), rel=1e-6
    )
    assert best.bic == pytest.approx(
        2 * expected.cost + (2 + 12) * np.log(24), rel=1e-4
    )


def test_the_law_of_both_data_sets_is_first(agreeing):
    first, other = agreeing.candidates
    assert (first.law, first.follows, first.rank) == ("power", True, 1)
    assert other.delta_bic > 10
    assert not other.follows
    assert not other.sets[1].follows
    # the friction at low speed speaks most against a constant one
    assert other.sets[1].largest[0][0] == "mu at 0.3 m/s"
    assert [data_set.kind for data_set in agreeing.sets] == ["throws", "friction"]
    assert [data_set.values for data_set in agreeing.sets] == [18, 6]


def test_the_friction_table_alone_is_as_scipy_fits_it(agreeing):
    measured = table()
    alone = least_squares(
        lambda p: (p[0] * measured.speed ** p[1] - measured.mu) / measured.sigma,
        (C, K),
        x_scale=[0.01, 1],
        xtol=1e-14,
    )
    on = agreeing.of("power").sets[1]
    assert on.own_chi_squared == pytest.approx(2 * alone.cost, rel=1e-4)
    assert (on.own_dof, on.determined) == (pytest.approx(4.0), ("c", "k"))


@pytest.fixture(scope="module")
def apart():
    return curlfit.compare([*throws(), table(c=0.0095, k=0.4)], LAWS)


def test_a_law_of_each_data_set_but_not_of_both(apart):
    candidate = apart.of("power")
    assert all(on.own_follows for on in candidate.sets)
    assert not candidate.follows
    rise = sum(on.chi_squared - on.own_chi_squared for on in candidate.sets)
    assert candidate.p_together == pytest.approx(chi2.sf(rise, 2), rel=1e-6)
    assert candidate.p_together < 1e-3


def test_what_is_said_saved_and_drawn(agreeing, apart, tmp_path):
    text = str(agreeing)
    assert "power, uniform load ranks first" in text
    assert "Laws that follow all data sets with the same coefficients: power" in text
    agreeing.save(tmp_path / "compare.json")
    again = curlfit.load_comparison(tmp_path)
    assert str(again) == text
    assert again.candidates[0].sets == agreeing.candidates[0].sets
    curlfit.comparison_figure(again).savefig(tmp_path / "compare.png")
    assert "each data set alone, but not all with the same coefficients: power" in str(
        apart._document().as_text("Comparison", "")
    ) + "".join(map(str, apart._document().sections[-1].parts))


@pytest.mark.parametrize(
    ("items", "choices", "words"),
    [
        ([], {}, "no data to compare laws with"),
        (["a.csv"], {}, "expected throws and tables of friction"),
        ([table()], {"loss": "huber"}, "loss: expected it with one track"),
        ([table()], {"noise": ["ar1"]}, "noise: expected it with one track"),
    ],
)
def test_what_cannot_be_compared(items, choices, words):
    with pytest.raises(InputError, match=words):
        curlfit.compare(items, "power", **choices)


def test_what_the_laws_miss_of_a_path_is_not_its_noise():
    """What they leave is smooth: 2 mm and 2 mrad under the best, as of a formula
    without noise."""
    exact = filmed(noise=dict.fromkeys(NOISE, 0.0))
    wave = 0.003 * np.sin(exact.t)
    path = replace(exact, x=exact.x + wave, y=exact.y + wave, phi=exact.phi + wave)
    comparison = curlfit.compare([path, table()], ["front-back", "coulomb"])
    assert comparison.sets[0].sigma == NOISE
    assert comparison.sets[0].effective == comparison.sets[0].values
    of_path = {candidate.law: candidate.sets[0] for candidate in comparison.candidates}
    assert of_path["front-back"].own_follows
    assert not of_path["coulomb"].own_follows
    alone = curlfit.fit(path, "coulomb", sigma=comparison.sets[0].sigma, details=False)
    assert of_path["coulomb"].own_chi_squared == pytest.approx(
        alone.chi_squared, rel=1e-4
    )


def test_tracks_alone_are_one_data_set_each():
    """Without events and tables."""
    tracks = [filmed(omega=spin).with_sigma(NOISE) for spin in (1.2, -1.5)]
    best = curlfit.compare(tracks, "front-back").best
    together = curlfit.fit_together(tracks, "front-back", share="all")
    assert (best.law, len(best.sets)) == ("front-back", 2)
    expected = sum(throw.chi_squared for throw in together.throws)
    assert sum(on.chi_squared for on in best.sets) == pytest.approx(expected, rel=1e-4)
