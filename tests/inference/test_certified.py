"""Fits against the certified solutions of tests/certified, which share no code with the program."""

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

# Digits of all values, where they are fewer than 8, and of all standard errors, where they are not
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


def fitted(name):
    case = CERTIFIED[name]
    throw = curlfit.load_throw(FOLDER / case["file"]).with_sigma(case["sigma"])
    return curlfit.fit(
        throw,
        case["law"],
        load=case["load"],
        stone=curlfit.Stone(**case["stone"]),
        fix=case["fix"],
        details=False,
    )


def compared(name, result):
    """Relative errors of values and standard errors, and the first in standard errors."""
    found = {key: (item.value, item.stderr) for key, item in result.parameters.items()}
    found |= {item.expression: (item.value, item.stderr) for item in result.combinations}
    case = CERTIFIED[name]
    ours = np.array([found[key] for key in case["values"]], float)
    exact = np.array([list(case["values"].values()), list(case["stderr"].values())]).T
    relative = np.abs(ours / exact - 1)
    return relative[:, 0], relative[:, 1], np.abs(ours - exact)[:, 0] / exact[:, 1]


@pytest.mark.numerical
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow if name == "power" else ()) for name in CERTIFIED],
)
def test_fit_has_the_certified_digits(name):
    case = CERTIFIED[name]
    result = fitted(name)
    assert result.converged
    assert result.n_observations == 3 * case["rows"]
    values, errors, sigmas = compared(name, result)
    digits, digits_of_errors = FEWER.get(name, (8, 6))
    assert -np.log10(values.max()) > digits
    assert -np.log10(errors.max()) > digits_of_errors
    assert sigmas.max() < 3e-5
    for channel in CHANNELS:
        residual = np.subtract(result.observed[channel], result.fitted[channel])
        squares = case["sum_of_squares"][channel]
        assert (residual**2).sum() == pytest.approx(squares, rel=2e-5)
        assert result.rms[channel] == pytest.approx(case["rms"][channel], rel=1e-5)


@pytest.mark.parametrize("name", CERTIFIED)
def test_certified_values_are_where_the_misfit_is_least(name):
    # By DOP853 in double precision, where the values come from an extrapolation in extended one
    program = certify
    case, record = program.CASES[name], CERTIFIED[name]
    data = program.read(case.file or FOLDER / f"{name}.csv")
    data = data[:, data[0] <= case.until]
    values = np.array(case.values)
    values[case.free] = list(record["values"].values())
    assert list(record["values"]) == [case.label(place) for place in case.free]
    p = np.tile(values[:, None], 1 + len(case.free)).astype(complex)
    p[case.free, np.arange(1, p.shape[1])] += 1j * program.TINY
    path = program.by_runge_kutta(case, p, data[0])
    sigma = np.array([case.sigma[channel] for channel in CHANNELS])[:, None]
    residual = path[..., 0].real - data[1:]
    np.testing.assert_allclose(
        (residual**2).sum(1), list(record["sum_of_squares"].values()), rtol=1e-8
    )
    jacobian = path[..., 1:].imag / program.TINY / sigma[..., None]
    q, _ = np.linalg.qr(jacobian.reshape(-1, len(case.free)).astype(float))
    left = q.T @ (residual / sigma).ravel().astype(float)
    assert np.linalg.norm(left) < 2e-7  # standard errors
    assert np.linalg.norm(residual / sigma) > 5


def test_ring_sums_of_the_independent_program_are_elliptic_integrals():
    assert certify.check_forces() < 1e-14


@pytest.mark.slow
@pytest.mark.parametrize("name", ["front_back_clip", "semi_empirical", "eq12"])
def test_certified_values_come_out_again(name):
    program = certify
    again = program.certify(name, program.CASES[name])
    for part in ("values", "stderr", "sum_of_squares", "rms"):
        assert again[part] == pytest.approx(CERTIFIED[name][part], rel=1e-11)
