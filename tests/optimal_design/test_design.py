"""Expected errors and optimal designs: against fits, finite differences and
known optima."""

from __future__ import annotations

import json

import numpy as np
import pytest
from conftest import command, invoke

import curlfit
from curlfit import LAWS, InitialState, Stone
from curlfit.errors import Option
from curlfit.inference.information.directions import standard_error
from curlfit.inference.noise.accelerations import Responses
from curlfit.optimal_design.departures import expected_departures
from curlfit.optimal_design.design import design
from curlfit.optimal_design.information import (
    Assumptions,
    PlannedThrow,
    record_information,
)
from curlfit.optimal_design.selection import (
    CandidateSet,
    combined,
    d_criterion,
    error_criterion,
    select_design,
)

LAW = LAWS["front-back"]
STONE = Stone()
TRUE = np.array([0.005, 0.05, 0.009, 0.009])
TYPICAL = np.full(4, 0.01)
DEFAULTS = np.array([0.008, -0.5, 0.3])
"""c, k and f0 of `power-angular`."""
NOISE = {"x": 0.005, "y": 0.005, "phi": 0.01}
SUM = "mu1_eta + mu2_eta"
DIFFERENCE = np.array([0.0, 0.0, 0.01, -0.01])  # by typical sizes


def factor_of(throws, load="uniform", until=None, sigma=NOISE):
    """Of the information of some throws together."""
    return combined(Assumptions(LAW, load, TRUE, sigma, until).factors(throws))


@pytest.fixture(scope="module")
def plain():
    """As the command does without any option."""
    return design()


@pytest.fixture(scope="module")
def single():
    """One throw of one kind, 201 rows."""
    return design(v0=[2.0], omega0=[1.5], rate=10, until=20.0, throws=1)


def test_a_discrepancy_enters_as_its_covariance():
    """Dense, with derivatives by differences; the difference of the eta
    coefficients is held."""
    size = 0.05
    t = np.linspace(0.0, 15.0, 76)
    # the sum alone, whose column is that of mu1_eta
    jacobian = in_noise(
        np.delete(jacobian_by_differences("uniform", 2.0, 1.5, t), 3, 2)
    )
    path = curlfit.simulate(
        LAW(*TRUE), STONE, InitialState(v=2.0, omega=1.5), t
    ).to_numpy()
    motion = np.array([path.x, path.y, path.phi, path.speed, path.omega])
    responses = Responses.of(t, motion, STONE)
    lacking = size * np.concatenate(
        [responses.at(t, row) / sigma for row, sigma in enumerate(NOISE.values())]
    )
    covariance = np.eye(3 * len(t)) + lacking @ lacking.T
    errors = np.sqrt(
        np.diag(np.linalg.inv(jacobian.T @ np.linalg.solve(covariance, jacobian)))
    )
    options = {"v0": [2.0], "omega0": [1.5], "rate": 5, "until": 15.0, "throws": 1}
    values = dict(zip(("mu1_xi", "mu2_xi", "mu1_eta", "mu2_eta"), TRUE, strict=True))
    plan = design(coefficients=values, discrepancy=size, **options)
    exact = design(coefficients=values, **options)
    for name, error in zip(("mu1_xi", "mu2_xi", SUM), errors, strict=False):
        assert plan.candidates[0].stderr[name] == pytest.approx(error, rel=0.03)
        assert plan.candidates[0].stderr[name] > 2 * exact.candidates[0].stderr[name]
    (note,) = plan.notes
    assert (note.code, note.numbers) == ("design-with-discrepancy", {"percent": 5.0})
    assert "of 5 % of what friction does" in str(note)


def throw_of(v0, omega0, stone=STONE, load="uniform", seed=None, until=20.0, rate=10.0):
    noise = (0.0, 0.0) if seed is None else (NOISE["x"], NOISE["phi"])
    throw = curlfit.synthetic_throw(
        LAW(),
        stone,
        load=load,
        v0=v0,
        omega0=omega0,
        until=until,
        dt=1 / rate,
        noise_xy=noise[0],
        noise_phi=noise[1],
        seed=seed or 0,
    )
    return throw.with_sigma(NOISE)


def reported(fit):
    errors = {
        name: value.stderr for name, value in fit.coefficients.items() if value.stderr
    }
    return errors | {sum_.expression: sum_.stderr for sum_ in fit.combinations}


@pytest.mark.parametrize(("seed", "tolerance"), [(None, 1e-6), (4, 0.03)])
def test_errors_are_those_that_a_fit_of_such_a_throw_reports(single, seed, tolerance):
    fit = curlfit.fit(throw_of(2.0, 1.5, seed=seed))
    expected = {
        name: error
        for name, error in single.best["D"].stderr.items()
        if error is not None
    }
    assert set(expected) == {"mu1_xi", "mu2_xi", SUM}
    assert reported(fit) == pytest.approx(expected, rel=tolerance)
    verdicts = {name: value.verdict for name, value in fit.coefficients.items()}
    assert single.best["D"].verdicts == verdicts
    assert single.candidates[0].rows == len(fit.throw)


PLACE = {"x": 0.005, "y": 0.005}


def without_angle(law, throws=1, **options):
    """A design of throws of 18 s whose angle is not measured."""
    grid = {"v0": [2.15], "omega0": [1.2], "rate": 10, "until": 18.0}
    return design(law, sigma=PLACE, throws=throws, **(grid | options))


@pytest.mark.parametrize(
    ("law", "turning"),
    [
        ("power-angular", "f0"),
        pytest.param("power+pivot", "q", marks=pytest.mark.slow),
    ],
)
def test_without_the_angle_a_design_says_what_fits_of_the_throw_say(law, turning):
    """Only the product of what turns the path and the spin enters."""
    expected = without_angle(law).best["D"]
    fits = []
    for seed in range(3):
        motion = {"v0": 2.15, "omega0": 1.2, "until": 18.0, "dt": 0.1}
        throw = curlfit.synthetic_throw(
            LAWS[law](), STONE, **motion, noise_xy=0.005, seed=seed
        )
        columns = {"x": throw.x, "y": throw.y}
        path = curlfit.Throw.from_arrays(throw.t, **columns, sigma=PLACE)
        fits.append(curlfit.fit(path, law, details=False))
    assert expected.verdicts[turning] in ("weak", "not identifiable")
    for name, verdict in expected.verdicts.items():
        verdicts = {fit.coefficients[name].verdict for fit in fits}
        if name != turning:
            errors = [fit.coefficients[name].stderr for fit in fits]
            assert verdicts == {"determined"} == {verdict}
            assert 0.3 < expected.stderr[name] / np.median(errors) < 3
        else:
            assert verdicts & {"weak", "not identifiable"}


def test_no_error_is_wider_than_the_bounds():
    """f0 lies from -1 to 1; to first order its error is 18."""
    assumed = Assumptions(LAWS["power-angular"], "uniform", DEFAULTS, PLACE, 18.0)
    throw = PlannedThrow(2.15, 1.2, 10.0, STONE)
    factor = combined(assumed.factors([throw]))
    to_first_order = standard_error(factor, assumed.weights({"f0": 1.0}))
    assert to_first_order > 5
    plan = without_angle("power-angular")
    assert plan.candidates[0].stderr["f0"] is None
    assert plan.best["D"].stderr["f0"] is None


def test_a_throw_made_four_times_is_one_with_half_the_noise():
    assumed = Assumptions(LAWS["power-angular"], "uniform", DEFAULTS, PLACE, 18.0)
    throw = PlannedThrow(2.15, 1.2, 10.0, STONE)
    halved = assumed.noisier(PLACE, 0.5)
    (four,) = expected_departures(assumed, [[throw] * 4])
    (precise,) = expected_departures(halved, [[throw]])
    assert four.stretched
    assert four.stretched == pytest.approx(precise.stretched, rel=1e-2)
    assert four.lost == precise.lost


def test_throws_of_one_spin_determine_no_force_together():
    """At each spin f0 may be anything: so it may be for both throws together."""
    plan = without_angle("power-angular", throws=2, v0=[2.0, 2.2])
    assert len(set(plan.best["D"].throws)) > 1
    for expected in plan.best.values():
        assert expected.stderr["f0"] is None
        assert expected.verdicts["c"] == "determined"


def series_of(values, load, times):
    """x, y, phi of coefficients and an initial state."""
    x, y, heading, v, phi, omega = values[4:]
    start = InitialState(x, y, heading, v, phi, omega)
    path = curlfit.simulate(LAW(*values[:4]), STONE, start, times, load=load).to_numpy()
    return np.stack([path.x, path.y, path.phi])


def jacobian_by_differences(load, v0, omega0, times):
    """Of coefficients and initial state, shape (3, rows, 10)."""
    base = np.array([*TRUE, 0.0, 0.0, 0.0, v0, 0.0, omega0])
    columns = [
        (series_of(base + step, load, times) - series_of(base - step, load, times))
        / 2e-5
        for step in 1e-5 * np.eye(10)
    ]
    return np.stack(columns, -1)


def in_noise(jacobian):
    """By channel and row, over sigma, as a matrix."""
    return np.concatenate(
        [rows / sigma for rows, sigma in zip(jacobian, NOISE.values(), strict=True)]
    )


def covariance_of(jacobian):
    """Of the whole matrix inverted: no Schur complement, no QR of parts."""
    weighted = in_noise(jacobian)
    scale = np.linalg.norm(weighted, axis=0)
    inverse = np.linalg.inv((weighted / scale).T @ (weighted / scale))
    return inverse / np.outer(scale, scale)


@pytest.mark.parametrize("load", ["uniform", "consistent"])
def test_information_is_that_of_finite_differences(load):
    omega0, tolerance = (1.5, 1e-4) if load == "uniform" else (10.0, 1e-2)
    jacobian = jacobian_by_differences(load, 2.0, omega0, np.arange(121) / 10)
    weights = {"mu1_xi": [1, 0, 0, 0], "sum": [0, 0, 1, 1]}
    if load == "uniform":  # the sum alone, whose column is that of mu1_eta
        jacobian = np.delete(jacobian, 3, 2)
    else:
        weights["difference"] = [0, 0, 1, -1]
    covariance = covariance_of(jacobian)
    factor = factor_of([PlannedThrow(2.0, omega0, 10.0, STONE)], load, until=12.0)
    k = 3 if load == "uniform" else 4
    for name, vector in weights.items():
        short = np.array(vector)[:k]
        expected = np.sqrt(short @ covariance[:k, :k] @ short)
        error = standard_error(factor, 0.01 * np.array(vector))
        assert error == pytest.approx(expected, rel=tolerance), name


def test_a_record_until_rest_has_the_row_of_coming_to_rest(plain):
    for throw in plain.candidates[::7]:
        path = curlfit.simulate(
            LAW(),
            STONE,
            InitialState(v=throw.v0, omega=throw.omega0),
            np.array([0.0, 100.0]),
        ).to_numpy()
        assert throw.rest == pytest.approx(float(path.rest), rel=1e-6)
        assert throw.distance == pytest.approx(
            float(np.hypot(path.x[-1], path.y[-1])), rel=1e-6
        )
        assert throw.last <= throw.rest < throw.last + 1 / throw.rate + 1e-9
        assert throw.rows == round(throw.last * throw.rate) + 1


def test_the_parts_of_a_long_record_make_the_whole():
    """601 rows, in three parts: the rows at whole multiples, and those between."""
    throw = PlannedThrow(2.0, 1.5, 30.0, STONE)
    (record,) = record_information(
        Assumptions(LAW, "uniform", TRUE, NOISE, 20.0), [throw]
    )
    assert record.rows == 601

    slopes = jacobian_by_differences("uniform", 2.0, 1.5, np.arange(601) / 30.0)
    information = np.einsum("cij,cik->cjk", record.factors, record.factors)
    for index in (0, 1, 7, 9):
        slope = slopes[..., index] * (0.01 if index < 4 else 1.0)
        np.testing.assert_allclose(
            information[:, index, index], (slope**2).sum(1), rtol=1e-5
        )


# Which throws to make, where that is known.


def line(abscissas):
    """Roots of the information of observations of a + b x."""
    return [np.array([[1.0, x], [0.0, 0.0]]) for x in abscissas]


def least_errors(candidates, weights, throws):
    return select_design(
        candidates, error_criterion(candidates, np.array(weights)), throws
    )


@pytest.mark.parametrize("throws", [4, 60])
def test_a_straight_line_is_best_seen_from_its_ends(throws):
    candidates = CandidateSet.from_factors(line(np.linspace(-1, 1, 9)))
    half = (0,) * (throws // 2) + (8,) * (throws // 2)
    assert select_design(candidates, d_criterion, throws) == half
    assert least_errors(candidates, np.eye(2), throws) == half
    assert least_errors(candidates, [0.0, 1.0], throws) == half


def test_the_mean_error_asks_for_more_of_what_tells_less():
    """a is seen with information 1, b with 9: errors 1/n + 1/(9 m) are least
    for n = 3 m."""
    candidates = CandidateSet.from_factors([np.diag([1.0, 0.0]), np.diag([0.0, 3.0])])
    assert least_errors(candidates, np.eye(2), 8) == (0,) * 6 + (1,) * 2
    assert select_design(candidates, d_criterion, 8) == (0,) * 4 + (1,) * 4


def test_the_best_of_the_plan_is_the_best_of_all_choices(plain):
    assert len(plain.candidates) == 15
    assert plain.rank == 3
    assert plain.free == 4
    factors = [
        factor_of([PlannedThrow(c.v0, c.omega0, c.rate, STONE)])
        for c in plain.candidates
    ]
    sums = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 0.5], [0, 0, 0.5]])
    information = np.stack([(factor @ sums).T @ (factor @ sums) for factor in factors])
    best = max(
        ((a, b, c) for a in range(15) for b in range(a, 15) for c in range(b, 15)),
        key=lambda indices: np.linalg.det(information[list(indices)].sum(0)),
    )
    assert plain.best["D"].throws == best


def test_each_criterion_is_the_best_of_all_choices():
    plan = design(load="consistent", v0=[2.0], rate=10, throws=2)
    factors = [
        factor_of([PlannedThrow(2.0, c.omega0, 10.0, STONE)], "consistent")
        for c in plan.candidates
    ]
    information = np.stack([factor.T @ factor for factor in factors])
    pairs = [(a, b) for a in range(5) for b in range(a, 5)]
    total = {pair: information[list(pair)].sum(0) for pair in pairs}
    volume = max(pairs, key=lambda pair: np.linalg.slogdet(total[pair])[1])
    mean = min(pairs, key=lambda pair: np.trace(np.linalg.inv(total[pair])))
    errors = {
        pair: np.sqrt(DIFFERENCE @ np.linalg.inv(total[pair]) @ DIFFERENCE)
        for pair in pairs
    }
    separating = min(pairs, key=errors.get)
    assert volume != mean
    assert plan.best["D"].throws == volume
    assert plan.best["A"].throws == mean
    # what uniform load would hide is looked at without being asked for
    assert plan.separation.pair == ("mu1_eta", "mu2_eta")
    assert plan.best["C"].throws == separating
    for criterion, pair in (("D", volume), ("A", mean), ("C", separating)):
        stderr = plan.best[criterion].stderr["mu1_eta - mu2_eta"]
        assert stderr == pytest.approx(errors[pair], rel=1e-3)


# The question of the paper.


def test_throws_under_consistent_load_alone_separate_front_and_back(plain):
    separation = plain.separation
    assert separation.pair == ("mu1_eta", "mu2_eta")
    assert separation.scenario("uniform").throws is None
    assert separation.scenario("uniform").stderr is None
    assert "C" not in plain.best
    scenario = separation.scenario("consistent")
    spins = [plain.candidates[index].omega0 for index in scenario.throws]
    assert max(spins) == 10.0
    throws = [
        PlannedThrow(start.v0, start.omega0, start.rate, STONE)
        for start in (plain.candidates[index] for index in scenario.throws)
    ]
    factor = factor_of(throws, "consistent")
    assert scenario.stderr == pytest.approx(
        standard_error(factor, DIFFERENCE), rel=1e-6
    )
    note, other = plain.notes
    assert note.code == "other-load-separates"
    assert note.remedies[0].option == Option("load", "consistent")
    assert note.numbers["stderr"] == scenario.stderr
    assert sum(throw["count"] for throw in note.numbers["throws"]) == plain.throws
    assert other.code == "design-without-discrepancy"
    assert other.remedies[0].option == Option("discrepancy", "0.05")


def test_the_error_of_a_difference_is_that_of_a_fit():
    grid = {"v0": [2.0], "omega0": [1.5], "rate": 10, "until": 20.0, "throws": 1}
    plan = design(**grid, separate=["mu2_xi", "mu1_xi"])
    fit = curlfit.fit(throw_of(2.0, 1.5, seed=2), derive=["mu2_xi - mu1_xi"])
    (derived,) = fit.derived
    stderr = plan.best["C"].stderr["mu2_xi - mu1_xi"]
    assert stderr == pytest.approx(derived.stderr, rel=0.03)


def test_no_difference_has_an_error_wider_than_its_bounds():
    """c lies from 0 to 1, f0 from -1 to 1; without the angle f0 is not determined."""
    plan = without_angle("power-angular", separate=["c", "f0"])
    assert plan.candidates[0].stderr["c - f0"] is None
    assert plan.separation.scenario("uniform").throws is None


@pytest.mark.parametrize(
    ("pair", "message"),
    [
        (["c", "c"], "two different coefficients"),
        (["c", "mu1_eta"], "law power-angular has no free coefficient 'mu1_eta'"),
    ],
)
def test_what_cannot_be_separated_is_refused(pair, message):
    with pytest.raises(curlfit.InputError, match=message):
        without_angle("power-angular", separate=pair)


# Record, text and pictures.


def test_a_saved_design_is_the_same(plain, tmp_path):
    plain.save(tmp_path / "design.json")
    again = curlfit.load_design(tmp_path)
    assert again.to_json() == plain.to_json()
    assert again.notes == plain.notes
    assert json.loads((tmp_path / "design.json").read_text())["schema"] == 1


def test_a_saved_design_without_noise_is_refused(plain, tmp_path):
    record = plain.to_json()
    record["sigma"]["x"] = 0.0
    (tmp_path / "design.json").write_text(json.dumps(record))
    with pytest.raises(curlfit.DataError, match="sigma: expected noise above 0"):
        curlfit.load_design(tmp_path)


def test_a_design_of_version_0_2_is_read(plain, tmp_path):
    record = plain.to_json()
    proof = {"states": 400, "by_difference": [0.0], "hidden": True, "because": ""}
    del record["findings"]
    record["separation"] |= {"size": 0.009, "of": "mean", "wanted": 0.2}
    record["separation"] |= {"proof": proof, "ordinary": 6, "changes": []}
    for scenario in record["separation"]["ways"]:
        scenario |= {"each": [None] * len(plain.candidates), "steady": None}
    (tmp_path / "design.json").write_text(json.dumps(record))
    read = curlfit.load_design(tmp_path)
    assert {note.code for note in read.notes} == {"text"}
    entries = read.to_json() | {"findings": plain.to_json()["findings"]}
    assert entries == plain.to_json()


def test_the_command(tmp_path):
    run = command(
        "design",
        "--v0",
        "2.0",
        "--omega0=-1,5",
        "--throws",
        "2",
        "--rate",
        "20",
        "--sigma-phi",
        "0.5deg",
        "--stone",
        "h=0.1",
        "--until",
        "15",
        cwd=tmp_path,
    )
    assert (run.returncode, run.stderr) == (0, "")
    text = " ".join(run.stdout.split())
    for words in (
        "expected errors of 2 throws selected from 2",
        "20 Hz for 15 s",
        "5 mm in x and y, 8.7 mrad in phi",
        "h = 0.1 m",
        "2 x (2 m/s, 5 rad/s)",
        "3 of 4 directions",
        "Under uniform load, none of these throws separate mu1_eta and mu2_eta.",
        "Note: under consistent load, 1 x (2 m/s, -1 rad/s) and 1 x (2 m/s, 5 rad/s) "
        "separate mu1_eta and mu2_eta best: standard error",
        "`--load consistent` designs for it.",
        "these errors hold if the law is correct",
    ):
        assert words in text, words
    folder = tmp_path / "design"
    files = ["design-errors.png", "design-map.png", "design.json"]
    assert sorted(file.name for file in folder.iterdir()) == files
    shown = invoke(["show", str(folder)])
    assert shown.stdout == run.stdout[: run.stdout.index("Written:")]
    assert invoke(["plot", str(folder), "--format", "svg"]).exit_code == 0
    assert (folder / "design-map.svg").stat().st_size > 10_000


def test_a_fit_is_what_is_taken_to_be_true(eq12_fit, tmp_path):
    eq12_fit.save(tmp_path / "fit.json")
    words = [
        "design",
        "--fit",
        str(tmp_path),
        "--v0",
        "2",
        "--omega0",
        "1",
        "--throws",
        "1",
        "--set",
        "mu1_xi=0.001",
        "--no-figures",
        "-q",
        "--out",
        str(tmp_path / "d"),
    ]
    assert invoke(words).exit_code == 0
    plan = curlfit.load_design(tmp_path / "d")
    assert plan.stone == eq12_fit.stone
    fitted = {name: value.value for name, value in eq12_fit.coefficients.items()}
    assert plan.coefficients == fitted | {"mu1_xi": 0.001}
    assert [file.name for file in (tmp_path / "d").iterdir()] == ["design.json"]
