"""Throws that decide between laws: against fits, brute force and simulated
linear models."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np
import pytest
from conftest import command, invoke

import curlfit
from curlfit.optimal_design.discriminate import _extended
from curlfit.optimal_design.discrimination import DECISIVE, Pair, Ranks

COARSE = {"x": 1.0, "y": 1.0, "phi": 2.0}
PLAN = {
    "v0": [1.8, 2.2],
    "omega0": [1.0, 2.0],
    "rate": 10.0,
    "until": 15.0,
    "sigma": COARSE,
}
EXACT = {"all": 0.0}
LAWS = ["front-back", "coulomb"]


@pytest.fixture(scope="module")
def between():
    """Throws that decide together only, on ice that may slope to a side."""
    widths = {"all": 0.0, "slope_x": 1e-3}
    return curlfit.discriminate(LAWS, throws=2, systematics=widths, **PLAN)


def throw_of(between, law, v0, omega0):
    """All rows of a throw of a law as assumed, without noise."""
    law = curlfit.law_with(law, between.laws[law])
    t = np.arange(int(between.until * between.rate) + 1) / between.rate
    start = curlfit.InitialState(v=v0, omega=omega0)
    path = curlfit.simulate(law, between.stone, start, t).to_numpy()
    return curlfit.Throw.from_arrays(
        t, path.x, path.y, path.phi, sigma=between.sigma, defaults={"as_given": True}
    )


def left_by(fit):
    """Chi squared of a fit with the prior of `slope_x`, of which it is a part."""
    slope = fit["slope_x"].value
    fits = getattr(fit, "throws", (fit,))
    return sum(fit.chi_squared for fit in fits) + (slope / 1e-3) ** 2


def test_both_laws_describe_the_same_draw(between):
    assert list(between.laws) == LAWS
    draw = throw_of(between, "front-back", 2.0, 1.0)
    fit = curlfit.fit(draw, "coulomb", details=False)
    assert between.laws["coulomb"]["mu"] == pytest.approx(fit["mu"].value, rel=1e-2)


def test_one_throw_leaves_what_a_fit_of_it_leaves(between):
    """The slope that the fit takes is linear in the design."""
    pair = between.pairs[0]
    candidate = between.candidates[2]
    throw = throw_of(between, pair.truth, candidate.v0, candidate.omega0)
    fit = curlfit.fit(throw, pair.rival, details=False, priors={"slope_x": "0+-0.001"})
    n = fit.n_observations
    expected = Pair.of("", "", left_by(fit), Ranks(3, 1), n).log_odds
    assert candidate.log_odds[0] == pytest.approx(expected, rel=0.03)


def test_chosen_throws_leave_what_a_fit_of_them_together_leaves(between):
    assert {pair.truth for pair in between.pairs} == {*between.laws}
    chosen = [between.candidates[index] for index in between.throws]
    starts = [(throw.v0, throw.omega0) for throw in chosen]
    # a slope bends the paths of both to one side
    assert starts == [(1.8, 2.0), (1.8, -2.0)]
    pair = between.worst
    assert pair == between.pairs[0]
    throws = [throw_of(between, pair.truth, *start) for start in starts]
    fit = curlfit.fit_together(
        throws,
        pair.rival,
        share="all",
        priors={"slope_x": "0+-0.001"},
        systematics=EXACT,
    )
    assert fit.converged
    assert pair.chi_squared == pytest.approx(left_by(fit), rel=0.05)
    n = sum(throw.n_observations for throw in fit.throws)
    assert pair.relative == pytest.approx(np.sqrt(pair.chi_squared / n), rel=0.01)


def test_both_senses_of_spin_tell_the_same_alone(between):
    odds_by_start = {
        (throw.v0, throw.omega0): throw.log_odds for throw in between.candidates
    }
    assert len(odds_by_start) == 8
    for (v0, omega0), odds in odds_by_start.items():
        assert odds == pytest.approx(odds_by_start[v0, -omega0], rel=1e-2)


@pytest.mark.parametrize(("true", "rival"), [(2, 2), (1, 3), (3, 1)])
def test_log_odds_are_those_of_simulated_linear_models(true, rival):
    """Two models with two columns in common, where the true one is beside the other."""
    random = np.random.default_rng(1)
    n = 200
    common = random.standard_normal((n, 2))
    columns_of_truth = np.hstack([common, random.standard_normal((n, true))])
    columns_of_rival = np.hstack([common, random.standard_normal((n, rival))])
    values = np.append(np.zeros(2), np.full(true, 5.5 / np.sqrt(n * true)))
    mean = columns_of_truth @ values
    basis_of_truth = np.linalg.qr(columns_of_truth)[0]
    basis_of_rival = np.linalg.qr(columns_of_rival)[0]
    y = mean + random.standard_normal((20_000, n))

    def left(values, basis):
        return (values**2).sum(-1) - ((values @ basis) ** 2).sum(-1)

    def bic(basis):
        return left(y, basis) + basis.shape[1] * np.log(n)

    odds = (bic(basis_of_rival) - bic(basis_of_truth)) / 2
    pair = Pair.of("", "", left(mean, basis_of_rival), Ranks(true, rival), n)
    assert odds.mean() == pytest.approx(pair.log_odds, abs=0.2)
    assert odds.std() == pytest.approx(pair.sd, rel=0.03)
    decided = (odds > DECISIVE).mean()
    assert pair.decides > 0.85
    assert pair.decides - 0.01 < decided < pair.decides + 0.05


class Additive:
    """A pair of laws whose chi squared is that of vectors in a plane, at
    the best angle."""

    def __init__(self, rows):
        self.rows = rows

    def promise(self, throws):
        matrix = np.concatenate([self.rows[k] for k in throws])
        left = np.linalg.svd(matrix, compute_uv=False)[-1] ** 2
        return Pair.of("", "", left, Ranks(2, 2), 100)


def test_the_exchange_finds_the_best_of_all_choices_for_the_worst_pair():
    random = np.random.default_rng(4)
    pairs = [Additive(3 * random.standard_normal((7, 1, 2))) for _ in range(3)]
    plan = []
    for size in (1, 2, 3, 4):
        plan = _extended(pairs, plan)

        def margin(throws):
            return min(pair.promise(throws).margin() for pair in pairs)

        best = max(combinations_with_replacement(range(7), size), key=margin)
        assert margin(plan) == pytest.approx(margin(best)), size


def test_a_law_that_can_be_the_other_is_not_decided():
    """With equal coefficients front-back is Coulomb's law."""
    once = {"v0": [2.0], "omega0": [1.0], "rate": 5.0, "until": 15.0}
    between = curlfit.discriminate(LAWS, throws=2, **once)
    assert not between.decided
    assert (between.worst.truth, between.worst.rival) == ("coulomb", "front-back")
    assert between.worst.chi_squared < 1e-3
    text = " ".join(repr(between).split())
    assert "2 throws of this precision do not decide" in text
    assert "front-back follows these throws of coulomb to within the noise" in text
    text = " ".join(repr(replace(between, asked=None)).split())
    assert "cannot be decided by tracks of this precision" in text


def test_a_saved_record_is_the_same(between, tmp_path):
    between.save(tmp_path / "discrimination.json")
    assert curlfit.load_discrimination(tmp_path).to_json() == between.to_json()
    assert between.to_frame().shape == (8, 6)


def test_the_command(tmp_path):
    words = (
        "design",
        "--between",
        "front-back,coulomb",
        "--v0",
        "2",
        "--omega0",
        "1,20",
    )
    run = command(*words, cwd=tmp_path)
    assert (run.returncode, run.stderr) == (0, "")
    text = " ".join(run.stdout.split())
    for part in (
        "front-back and coulomb, uniform load",
        "30 Hz until the stone is at rest",
        "1 throw decides: 1 x (2 m/s, ",
        "with a probability of at least 92.3 %",
        "odds of 100 to 1 are 4.6",
        "leaves the sheet or a law cannot be fitted to it: 2 m/s with 20 rad/s",
    ):
        assert part in text, part
    folder = tmp_path / "design"
    assert sorted(f.name for f in folder.iterdir()) == [
        "discrimination.json",
        "discrimination.png",
    ]
    assert (
        invoke(["show", str(folder)]).stdout
        == run.stdout[: run.stdout.index("Written:")]
    )
    assert invoke(["plot", str(folder), "--format", "svg"]).exit_code == 0
    saved = curlfit.load_discrimination(folder)
    assert "--between=front-back,coulomb" in saved.command


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--between", "coulomb"], "expected two or more laws"),
        (["--between", "coulomb,coulomb"], "expected different laws"),
        (["--between", "coulomb,nothing"], "unknown law"),
        (
            ["--between", "pivot,power+pivot"],
            "power+pivot, power+pivot; expected different laws",
        ),
        (
            ["--between", "coulomb,power", "--law", "power"],
            "--law is not an option with --between",
        ),
        (["--between", "coulomb,power", "--throws", "65"], "expected at most 64"),
        (
            ["--between", "front-back,coulomb", "--v0", "9", "--until", "3"],
            "no such throw stays",
        ),
    ],
)
def test_what_cannot_be_decided_is_refused(words, says):
    run = invoke(["design", *words, "--no-figures", "-q"])
    assert run.exit_code == 2
    assert says in str(run.exception)
