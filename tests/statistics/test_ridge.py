"""The arithmetic of `ridge.py` and `held_spin.py`, on made-up answers and posteriors
in closed form."""

from __future__ import annotations

from types import SimpleNamespace

import held_spin
import numpy as np
import pytest
from held_spin import (
    Problem,
    posterior_sample,
    problem_of_track,
    student_log_density,
    weighted_quantiles,
)
from ridge import (
    BANDS,
    FIT,
    LAWS_BY_SET,
    OF_ONE_THROW,
    PLAUSIBLE,
    POSTERIOR,
    PRODUCT,
    TO_TEE,
    Case,
    Held,
    Planned,
    Quantity,
    curls_of,
    drawn_from_prior,
    end_of_draw,
    of_estimate,
    quantities_of,
    random_of,
    row_of_many,
    rows_of_throws,
    true_curl,
    true_rest,
    within,
)
from scipy.stats import multivariate_t
from simulator import simulated
from tables import HERE, head, merged, row
from verdicts import Answer, Statement, Truth

import curlfit
from curlfit.sheet import LINES, TEE

QUANTILES = {"2.5": -2.0, "16": -1.0, "50": 0.0, "84": 1.0, "97.5": 2.0}
TRANSVERSE = {"c": 0.008, "k": -0.5, "b": 0.05}
TIMES = np.linspace(0.0, 18.0, 46)


# Throws


@pytest.mark.parametrize("kind", OF_ONE_THROW)
def test_truths_are_drawn_from_the_bounds_of_their_fit(kind):
    for law in LAWS_BY_SET[kind]:
        case = Case(law, kind)
        coefficients = curlfit.LAWS[law].coefficients()
        limits = {
            coefficient.name: (coefficient.lower, coefficient.upper)
            for coefficient in coefficients
        }
        assert list(case.box) == list(limits)
        for name, (low, high) in case.box.items():
            lower, upper = limits[name]
            assert lower <= low < high <= upper
        truth, throw = drawn_from_prior(case, random_of(case, 1, 0))
        for name, (low, high) in case.bounds.items():
            assert low <= truth.parameters[name] <= high
        assert (kind == "no-spin") == ("phi" in throw.seen)


def test_each_throw_has_random_numbers_of_its_own():
    case = Case("power+transverse", "no-angle")
    truths = [drawn_from_prior(case, random_of(case, 0, k))[0] for k in (0, 1, 0)]
    assert truths[0] == truths[2]
    assert truths[0] != truths[1]


def test_another_throw_rests_where_curlfit_says():
    other = Planned(v0=2.1, omega0=-1.3)
    law = curlfit.LAWS["power+transverse"](**TRANSVERSE)
    start = curlfit.InitialState(y=LINES["hog"], v=other.v0, omega=other.omega0)
    times = np.array([0.0, 100.0])
    path = curlfit.simulate(law, curlfit.Stone(), start, times).to_numpy()
    truth = Truth(TRANSVERSE, v0=2.3, omega0=0.4)
    rest = true_rest("power+transverse", truth, other)
    assert rest["rest_x"] == pytest.approx(path.x[-1], abs=1e-4)
    assert rest["rest_y"] == pytest.approx(path.y[-1] - TEE, abs=1e-4)
    before = curlfit.simulate(
        law, curlfit.Stone(), start, np.array([0.0, rest["time"] - 0.1])
    ).to_numpy()
    assert 0 < before.speed[-1] < 0.05


def test_a_draw_ends_at_the_tee_having_turned_by_the_angle():
    angle = 14.0
    curl = true_curl("power+transverse", TRANSVERSE, angle)

    def end(v0: float, omega0: float) -> np.ndarray:
        until = np.array([0.0, 100.0])
        return simulated("power+transverse", TRANSVERSE, v0, omega0, until)[:, -1]

    # by bisection: the speed first, which hardly depends on the spin
    slow = 1.5
    fast = 3.0
    for _ in range(40):
        v0 = (slow + fast) / 2
        slow, fast = (v0, fast) if end(v0, 0.6)[1] < TO_TEE else (slow, v0)
    low = 0.1
    high = 3.0
    for _ in range(40):
        omega0 = (low + high) / 2
        low, high = (omega0, high) if end(v0, omega0)[2] < angle else (low, omega0)
    assert curl > 0.1
    assert curl == pytest.approx(-end(v0, omega0)[0], abs=2e-3)


# Counts


def test_a_value_is_within_the_quantiles_or_not():
    assert within(QUANTILES, 0.5) == Held(narrow=True, wide=True)
    assert within(QUANTILES, -1.5) == Held(narrow=False, wide=True)
    assert within(QUANTILES, 2.5) == Held(narrow=False, wide=False)


def test_only_what_is_called_determined_has_intervals():
    reach = {0.68: 1.0, 0.95: 2.0}
    estimate = SimpleNamespace(
        verdict="determined", interval=lambda level: (-reach[level], reach[level])
    )
    assert of_estimate(estimate, 1.5) == Held(narrow=False, wide=True)
    weak = SimpleNamespace(verdict="weak", interval=lambda level: None)
    assert of_estimate(weak, 1.5) == "weak"


def test_rows_count_what_has_intervals_and_say_why_others_have_none():
    case = Case("power+transverse", "no-angle")
    quantities = quantities_of(case)
    assert Quantity(PRODUCT, FIT) in quantities
    assert Quantity("omega0", POSTERIOR) in quantities
    inside = dict.fromkeys(quantities, Held(narrow=False, wide=True))
    answers = [inside] * 9 + [dict.fromkeys(quantities, "not converged")]
    answers[0] = inside | {Quantity("rest_x", BANDS): Held(narrow=True, wide=False)}
    rows = {(cells[2], cells[3]): cells[4:] for cells in rows_of_throws(case, answers)}
    assert len(rows) == len(quantities)
    assert rows["`b`", POSTERIOR] == [
        9,
        "0.0 % (!)",
        "100.0 %",
        "not converged 1",
    ]
    assert rows["rest across", BANDS][:3] == [9, "11.1 % (!)", "88.9 %"]


def test_times_of_a_law_that_does_not_curl_have_no_place_across():
    names = {quantity.name for quantity in quantities_of(Case("power", "times"))}
    assert names == {"c", "k", "v0", "rest_y", "time"}


def test_seasons_are_counted_by_what_they_call_determined():
    far = Statement("b", "coefficients", -18.9, inside=False)
    near = Statement("c", "coefficients", 0.4, inside=True)
    curl = Statement("curl of a draw", "curl", 7.0, inside=False)
    answers = [Answer((far, near, curl)), Answer((near,)), Answer((), "InputError")]
    cells = row_of_many(Case("power+transverse", "season"), answers)
    assert cells[2:4] == [2, "InputError 1"]
    assert cells[4:7] == [3, "66.7 %", 1]
    assert cells[10:13] == [1, "0.0 %", 1]
    assert cells[13:] == ["18.9, `b`", "`c` 2 of 2, `b` 0 of 1"]


def test_the_curl_of_a_draw_is_beside_that_of_the_true_coefficients():
    truths = [Truth(TRANSVERSE, v0=2.2, omega0=spin) for spin in (0.9, -1.1, 1.5)]
    _, turned = end_of_draw("power+transverse", TRANSVERSE, -1.1)
    angle = abs(turned)
    curl = true_curl("power+transverse", TRANSVERSE, angle)

    def effect(parameter: str, value: float) -> SimpleNamespace:
        interval = (value - 0.02, value + 0.02)
        return SimpleNamespace(
            parameter=parameter, value=value, stderr=0.01, interval=lambda _: interval
        )

    groups = [effect("friction", 0.01), effect("curl", curl + 0.03)]
    (statement,) = curls_of("power+transverse", SimpleNamespace(groups=groups), truths)
    assert statement.pull == pytest.approx(3.0)
    assert not statement.inside
    without = SimpleNamespace(groups=groups[:1])
    assert curls_of("power+transverse", without, truths) == []


# Tables


def test_rows_take_the_places_of_those_of_the_same_law_and_set():
    order = [("a", "one"), ("b", "one"), ("a", "two")]
    present = [*head("law", "set", ""), row(["`a`", "two", 1]), row(["`a`", "one", 2])]
    table = [*head("law", "set", "new"), *(row(["`a`", "two", k]) for k in (3, 4))]
    table.append(row(["`b`", "one", 5]))
    lines = merged("\n".join(present), table, order)
    assert lines[:2] == table[:2]
    assert lines[2:] == [
        row(["`a`", "one", 2]),
        row(["`b`", "one", 5]),
        row(["`a`", "two", 3]),
        row(["`a`", "two", 4]),
    ]
    assert merged("", table, order)[2:] == [table[4], table[2], table[3]]


def test_the_readme_has_a_place_for_each_table():
    text = (HERE / "README.md").read_text()
    for name in ("ridge", "ridge-together", "ridge-sampler"):
        assert text.count(f"<!-- {name} -->\n") == 2


# Importance sampling


def test_weighted_quantiles_are_those_of_repeated_draws():
    random = np.random.default_rng(0)
    draws = random.standard_normal(200)
    times = random.integers(1, 40, 200)
    shares = (0.025, 0.16, 0.5, 0.84, 0.975)
    expected = np.quantile(np.repeat(draws, times), shares)
    weights = times / times.sum()
    np.testing.assert_allclose(
        weighted_quantiles(draws, weights, shares), expected, atol=0.03
    )


def test_the_density_of_draws_is_that_of_scipy():
    offsets = np.array([0.3, -2.0, 5.0])
    expected = multivariate_t(np.zeros(3), np.eye(3), held_spin.DEGREES)
    assert student_log_density(offsets) == pytest.approx(expected.logpdf(offsets))


def product_is_measured(highest: float, error: float = 0.001) -> Problem:
    """Of b and a second parameter: b omega0 is 0.06 within an error, d + b is 1.0(1),
    and b is between 0 and `highest`."""

    def residuals(spin: float, values: np.ndarray) -> np.ndarray:
        b, d = values
        return np.array([(b * spin - 0.06) / error, (d + b - 1.0) / 0.1])

    return Problem(
        residuals,
        np.array([0.0, -np.inf]),
        np.array([highest, np.inf]),
        np.array([1e-5, 1e-4]),
        np.array([highest / 2, 0.0]),
        fastest=4.0,
    )


def test_importance_sampling_of_a_curve_gives_quantiles_in_closed_form():
    # b is 0.06/omega0 with an error of 0.001/omega0: integrated over b, the density of
    # the spin falls as 1/omega0, from 0.06/highest to 4.
    highest = 0.3
    sample = posterior_sample(product_is_measured(highest), 3000)
    shares = np.array([0.16, 0.5, 0.84])
    expected = 0.2 * (4.0 / 0.2) ** shares
    spins = weighted_quantiles(sample.spins, sample.weights, shares)
    np.testing.assert_allclose(np.log(spins / expected), 0.0, atol=0.1)
    b, d = sample.values.T
    of_b = weighted_quantiles(b, sample.weights, shares)
    np.testing.assert_allclose(np.log(of_b * expected[::-1] / 0.06), 0.0, atol=0.1)
    assert sample.effective > 1500
    assert sample.spins[sample.weights > 1e-6].min() > 0
    assert np.sum(sample.weights * (d + b)) == pytest.approx(1.0, abs=0.01)


def test_intervals_of_the_spin_are_halved_until_the_curve_is_straight():
    error = 1e-4  # of 0.06: neighbours a tenth apart are 0.75 errors off the curve
    cells = held_spin.cells_of(product_is_measured(0.3, error))
    for cell, share in zip(cells, held_spin.shares_of(cells), strict=True):
        if share > held_spin.COUNTS:
            first, last = np.abs(cell.spins)
            middle = np.sqrt(first * last)
            on_line = (0.06 / first + 0.06 / last) / 2
            # at a bound, b does not follow the curve
            if 0.06 / last < 0.3:
                assert abs(on_line * middle - 0.06) / error < held_spin.MOST_BENT + 0.01


def test_a_track_is_where_the_simulator_says():
    truth = (*TRANSVERSE.values(), 0.2, -0.1, 0.03, 2.1)
    path = simulated("power+transverse", TRANSVERSE, 2.1, 1.2, TIMES)
    turned = np.array([[np.cos(0.03), np.sin(0.03)], [-np.sin(0.03), np.cos(0.03)]])
    track = turned @ path[:2] + np.array([[0.2], [-0.1]])
    box = PLAUSIBLE["power+transverse"]
    problem = problem_of_track("power+transverse", TIMES, track, 0.005, box, 4.0)
    assert np.abs(problem.residuals(1.2, np.array(truth))).max() < 1e-9
    optimum = held_spin.optimum_at(problem, 1.2, problem.guess)
    np.testing.assert_allclose(optimum.values, truth, atol=2e-3)
    errors = np.sqrt(np.diag(optimum.spread @ optimum.spread.T))
    assert (np.abs(optimum.values - truth) < 0.2 * errors).all()
    assert problem.log_density(1.2, np.array((0.02, *truth[1:]))) == -np.inf
