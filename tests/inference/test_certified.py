"""Fits against the certified solutions of tests/certified, which share no code with
the program."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from certified import certify

import curlfit

FOLDER = Path(__file__).parents[1] / "certified"
CERTIFIED = json.loads((FOLDER / "certified.json").read_text())["cases"]
CHANNELS = ("x", "y", "phi")

# Digits of all values, where they are fewer than 8, and of all standard errors, where
# they are not
# 6. The path's steps leave no more; the folder's README has the figures.
FEWER = {
    "front_back": (7.7, 8.4),
    "front_back_rest": (7, 8),
    "front_back_low_spin": (7.4, 8),
    "front_back_consistent": (7.7, 8.4),
    "front_back_consistent_split": (7, 8),
    "coulomb": (8, 8),
    "eq12": (6.2, 8.2),
}


SLOW = pytest.mark.slow
OF_EACH_KIND = ("eq12", "front_back_consistent", "power", "semi_empirical")


@pytest.mark.numerical
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=SLOW if name == "power" else ()) for name in CERTIFIED],
)
def test_fit_has_the_certified_digits(name):
    case = CERTIFIED[name]
    throw = curlfit.load_throw(FOLDER / case["file"]).with_sigma(case["sigma"])
    result = curlfit.fit(
        throw,
        case["law"],
        load=case["load"],
        stone=curlfit.Stone(**case["stone"]),
        fix=case["fix"],
        details=False,
    )
    assert result.converged
    assert result.n_observations == 3 * case["rows"]
    ours = np.array([(result[key].value, result[key].stderr) for key in case["values"]])
    exact = np.array([list(case["values"].values()), list(case["stderr"].values())]).T
    digits = -np.log10(np.abs(ours / exact - 1).max(0))
    assert (digits > FEWER.get(name, (8, 6))).all()
    assert (np.abs(ours - exact)[:, 0] < 3e-5 * exact[:, 1]).all()
    for channel in CHANNELS:
        residual = np.subtract(result.observed[channel], result.fitted[channel])
        squares = case["sum_of_squares"][channel]
        assert (residual**2).sum() == pytest.approx(squares, rel=2e-5)
        assert result.rms[channel] == pytest.approx(case["rms"][channel], rel=1e-5)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in OF_EACH_KIND else SLOW)
        for name in CERTIFIED
    ],
)
def test_certified_values_are_where_the_misfit_is_least(name):
    # By DOP853 in double precision, where the values come from an extrapolation in
    # extended one
    case = certify.CASES[name]
    record = CERTIFIED[name]
    data = certify.read(case.file or FOLDER / f"{name}.csv")
    data = data[:, data[0] <= case.until]
    values = np.array(case.values)
    values[case.free] = list(record["values"].values())
    assert list(record["values"]) == [case.label(index) for index in case.free]
    p = np.tile(values[:, None], 1 + len(case.free)).astype(complex)
    p[case.free, np.arange(1, p.shape[1])] += 1j * certify.TINY
    path = certify.by_runge_kutta(case, p, data[0])
    sigma = np.array([case.sigma[channel] for channel in CHANNELS])[:, None]
    residual = path[..., 0].real - data[1:]
    np.testing.assert_allclose(
        (residual**2).sum(1), list(record["sum_of_squares"].values()), rtol=1e-8
    )
    jacobian = path[..., 1:].imag / certify.TINY / sigma[..., None]
    q, _ = np.linalg.qr(jacobian.reshape(-1, len(case.free)).astype(float))
    left = q.T @ (residual / sigma).ravel().astype(float)
    assert np.linalg.norm(left) < 2e-7  # standard errors
    assert np.linalg.norm(residual / sigma) > 5


def test_ring_sums_of_the_independent_program_are_elliptic_integrals():
    assert certify.check_forces() < 1e-14


@SLOW
@pytest.mark.parametrize("name", ["front_back_clip", "semi_empirical", "eq12"])
def test_certified_values_come_out_again(name):
    again = certify.certify(name, certify.CASES[name])
    for part in ("values", "stderr", "sum_of_squares", "rms"):
        assert again[part] == pytest.approx(CERTIFIED[name][part], rel=1e-11)
