"""The simulator beside that of curlfit; `verdicts.py` makes the table of many fits."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from simulator import simulated
from tables import HERE
from verdicts import FAR, TIMES, Truth, counts_of, drawn, form, of_group, statements_of

import curlfit

FARTHEST = 1e-5  # m and rad


@pytest.mark.slow
@pytest.mark.parametrize("law", [*curlfit.LAWS])
@pytest.mark.parametrize("sense", [1, -1, 0])
def test_paths_are_those_of_curlfit(law, sense):
    random = np.random.default_rng(sense + 1)
    coefficients, v0, omega0 = drawn(law, "angle", random)
    omega0 = sense * abs(omega0)
    start = curlfit.InitialState(v=v0, omega=omega0)
    stone = curlfit.Stone()
    path = curlfit.simulate(curlfit.LAWS[law](**coefficients), stone, start, TIMES)
    motion = np.stack([path.x, path.y, path.phi])
    peer = simulated(law, coefficients, v0, omega0, TIMES)
    assert np.abs(motion - peer).max() < FARTHEST


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("mu1_eta + mu2_eta", "mu1_eta + mu2_eta"),
        ("mu4 - 1/2 mu1", "mu4 - 1/2 mu1"),
        ("c - 0.005096 v0", "c - w v0"),
        ("1.2e-05 f_min + 3e+02 alpha", "w f_min + w alpha"),
    ],
)
def test_weights_that_differ_from_throw_to_throw_have_one_name(expression, expected):
    assert form(expression) == expected


def estimate(value: float, **others: object) -> SimpleNamespace:
    """An estimate with a standard error of 1."""
    interval = (value - 1.96, value + 1.96)
    return SimpleNamespace(
        value=value, stderr=1.0, interval=lambda level: interval, **others
    )


def test_what_is_called_determined_is_beside_its_true_value():
    truth = Truth({"mu1": 1.0, "mu2": 2.0}, v0=2.1, omega0=-1.0)
    estimates = {
        "mu1": estimate(2.9, verdict="determined"),
        "mu2": estimate(50.0, verdict="weak"),
        "omega0": estimate(1.1, verdict="determined"),
    }
    weights = {"mu1": 1.0, "mu2": -0.25}
    combination = estimate(0.6 + FAR, expression="mu1 - 0.25 mu2", weights=weights)
    statements = statements_of(estimates, [combination], truth, {})
    assert [statement.name for statement in statements] == [
        "mu1",
        "omega0",
        "mu1 - w mu2",
    ]
    assert counts_of(of_group(statements, "coefficients")) == [1, "100.0 %", ""]
    assert counts_of(of_group(statements, "initial state")) == [1, "0.0 %", ""]
    assert counts_of(of_group(statements, "combinations")) == [1, "0.0 %", 1]
    assert statements[-1].pull == pytest.approx(FAR + 0.1)


def test_the_readme_has_a_place_for_both_tables():
    text = (HERE / "README.md").read_text()
    for name in ("verdicts", "verdicts-design"):
        assert text.count(f"<!-- {name} -->\n") == 2
