"""Throws that vary: groups, trends, predictions of another throw, and the
command line."""

import json
from dataclasses import replace
from io import StringIO

import emcee
import numpy as np
import pytest
from conftest import command
from rich.console import Console
from scipy.optimize import brentq
from scipy.stats import norm

import curlfit
from curlfit import InputError, UnusableFitError, sheet
from curlfit.inference.together.population import _moves
from curlfit.inference.together.posterior import sampled
from curlfit.inference.together.result import folder_names
from curlfit.numerics.mixed_model import MixedModel
from curlfit.prediction.result import Call, Prediction
from curlfit.throws.events import Event

STONE = curlfit.Stone(R=0.065)
LAW = curlfit.law_with("front-back", {"mu1_xi": 0.004, "mu2_xi": 0.05})
TIMES = np.append(np.linspace(0.0, 40.0, 201), 300.0)
HOG = sheet.LINES["hog"]
FAR = sheet.LINES["far-hog"]


def path_of(law, v, omega):
    start = curlfit.InitialState(y=HOG, v=v, omega=omega)
    return curlfit.simulate(law, STONE, start, TIMES).to_numpy()


def crossing(path):
    return float(np.interp(FAR, path.y[:-1], path.t[:-1]))


def evening(count=12, apart=0.05, rising=0.02, spread=0.01, seed=1, law=LAW):
    """Draws on two sheets in turn, timed exactly as far as errors of 0.05 s
    and 5 cm go."""
    random = np.random.default_rng(seed)
    throws = []
    for draw in range(count):
        sheet_number = draw % 2 + 1
        factor = (
            1
            + apart * (sheet_number - 1.5)
            + rising * draw / 10
            + spread * random.standard_normal()
        )
        varied_law = replace(law, mu1_eta=0.009 * factor, mu2_eta=0.009 * factor)
        side = 1 if draw // 2 % 2 else -1
        path = path_of(varied_law, random.uniform(2.19, 2.29), side * 1.3)
        hog = crossing(path)
        off = 0.05 * random.standard_normal(5)
        throw = curlfit.Throw.from_events(
            [
                Event("hog_to_hog", "time", hog + off[0], 0.05, FAR, HOG),
                Event(
                    "hog_to_rest",
                    "time",
                    float(path.rest) - hog + off[1],
                    0.05,
                    None,
                    FAR,
                ),
                Event("rest", "y", path.y[-1] + off[2], 0.05),
                Event("curl", "x", path.x[-1] + side * off[3], 0.05, since=HOG),
                Event(
                    "turns",
                    "phi",
                    path.phi[-1] + side * 2 * np.pi * off[4],
                    0.3,
                    since=HOG,
                ),
            ]
        )
        labels = {"sheet": f"{sheet_number}", "start": f"{draw / 10}"}
        throws.append(replace(throw, labels=labels))
    return throws


@pytest.fixture(scope="module")
def joint():
    return curlfit.fit_together(
        evening(), "front-back", stone=STONE, by="sheet", trend="start", seed=3
    )


def one_of(effects, parameter, **about):
    (effect,) = (
        effect
        for effect in effects
        if effect.parameter == parameter
        and all(getattr(effect, k) == v for k, v in about.items())
    )
    return effect


def test_groups_and_trend_are_found(joint):
    assert joint.converged
    total = "mu1_eta + mu2_eta"
    difference = one_of(joint.differences, total)
    trend = one_of(joint.trend, total)
    assert abs(difference.value - 0.05 * 0.018) < 2.5 * difference.stderr
    assert difference.stderr < 0.3 * difference.value
    assert abs(trend.value - 0.02 * 0.018) < 2.5 * trend.stderr
    assert difference.p < 0.001
    assert difference.dof == trend.dof == 9
    first_sheet, second_sheet = (
        one_of(joint.groups, total, group=name) for name in ("1", "2")
    )
    assert second_sheet.value - first_sheet.value == pytest.approx(
        difference.value, rel=1e-9
    )
    assert joint.means is not None
    assert not joint.warnings


def test_a_draw_to_the_tee_is_that_of_the_mean_law(joint):
    """Against a root of the simulated distance."""
    values = {
        name: coefficient.value for name, coefficient in joint.coefficients.items()
    }
    law = curlfit.law_with("front-back", values)

    def weight(spin):
        return brentq(lambda v: path_of(law, v, spin).y[-1] - sheet.TEE, 1.8, 2.8)

    spin = brentq(
        lambda spin: path_of(law, weight(spin), spin).phi[-1] - joint.means.angle,
        0.8,
        2.0,
    )
    v = weight(spin)
    path = path_of(law, v, spin)
    friction, curl, hog = (
        one_of(joint.groups, name, by="") for name in ("friction", "curl", "hog_to_hog")
    )
    assert friction.value == pytest.approx(
        v**2 / (2 * 9.81 * (sheet.TEE - HOG)), rel=2e-4
    )
    assert curl.value == pytest.approx(-path.x[-1], abs=1e-3)
    assert hog.value == pytest.approx(crossing(path), abs=2e-3)
    assert joint.means.angle == pytest.approx(path_of(LAW, 2.24, 1.3).phi[-1], rel=0.05)
    assert curl.stderr < 0.04


def test_a_coefficient_at_its_bound_stays_there_in_every_throw():
    throws = evening(law=replace(LAW, mu1_xi=0.0, mu2_xi=0.04), seed=5)
    joint = curlfit.fit_together(
        throws, "front-back", stone=STONE, by="sheet", trend="start"
    )
    assert joint.converged
    assert joint.coefficients["mu1_xi"].verdict == "at bound"
    assert {fit.parameters["mu1_xi"].value for fit in joint.throws} == {0.0}


def test_a_spin_that_is_not_given_turns_the_stone_as_measured(joint):
    call = Call({"sheet": "2"}, hog_to_hog=13.4, turn="in")
    prediction = curlfit.predict(joint, call=call, draws=400)
    turns = prediction.quantities["turns"]
    assert turns.value < 0
    assert turns.sd < 0.02 * abs(turns.value)
    assert prediction.start["omega0"]["origin"] == "call"
    with_spin = curlfit.predict(
        joint, call=call, start={"omega0": prediction.start["omega0"]["value"]}
    )
    assert with_spin.quantities["turns"].sd > 3 * turns.sd


def test_both_turns_are_mirror_images(joint):
    call = Call({"sheet": "2"}, hog_to_hog=13.4, broom=-1.0, turn="both")
    in_turn = curlfit.predict(joint, call=call, draws=400)
    out_turn = in_turn.other
    assert (in_turn.call.turn, out_turn.call.turn, out_turn.call.broom) == (
        "in",
        "out",
        1.0,
    )
    np.testing.assert_allclose(out_turn.series["x"], -in_turn.series["x"], atol=1e-9)
    np.testing.assert_allclose(
        out_turn.series["phi"], -in_turn.series["phi"], atol=1e-9
    )
    rest = [
        prediction.quantities["rest_x"].quantiles for prediction in (in_turn, out_turn)
    ]
    assert rest[1]["16"] == pytest.approx(-rest[0]["84"], abs=0.03)
    on_it = np.hypot(in_turn.sample["x"][:, -1], in_turn.sample["y"][:, -1] - sheet.TEE)
    share = np.mean(on_it < sheet.CIRCLES[-1] + sheet.STONE_RADIUS)
    assert in_turn.chances["on the button"] == pytest.approx(
        share, abs=4 * (0.25 / len(on_it)) ** 0.5
    )
    curlfit.print_prediction(in_turn, Console(file=(text := StringIO()), width=200))
    assert "Out-turn: sheet 2" in text.getvalue()
    assert Prediction.from_json(in_turn.to_json()).other.call == out_turn.call
    (ax_sheet, house, *_) = curlfit.prediction_figure(in_turn).axes
    assert "out-turn" in house.get_legend_handles_labels()[1]
    assert len(ax_sheet.patches) > len(
        curlfit.prediction_figure(out_turn).axes[0].patches
    )


def test_another_throw_takes_its_given_time_and_has_the_spread(joint):
    call = Call({"sheet": "2", "start": "1.3"}, hog_to_hog=13.4)
    prediction = curlfit.predict(joint, call=call, start={"omega0": 1.3}, draws=400)
    hog = prediction.quantities["hog_to_hog"]
    assert hog.value == pytest.approx(13.4, abs=0.01)
    assert hog.sd < 0.01
    law = replace(LAW, mu1_eta=0.009 * 1.051, mu2_eta=0.009 * 1.051)
    v = brentq(lambda v: crossing(path_of(law, v, 1.3)) - 13.4, 1.9, 2.8)
    rest = prediction.quantities["rest_y"]
    assert (
        rest.quantiles["2.5"]
        < path_of(law, v, 1.3).y[-1] - sheet.TEE
        < rest.quantiles["97.5"]
    )
    scattered = curlfit.predict(
        joint, call=replace(call, thrower=(0.15, 0.1)), start={"omega0": 1.3}, draws=400
    )
    assert scattered.quantities["hog_to_hog"].sd == pytest.approx(0.15, rel=0.15)
    assert scattered.quantities["rest_y"].sd > 2 * rest.sd
    for labels, message in (
        ({"sheet": "3"}, "expected 1 or 2"),
        ({"ice": "1"}, "no throws by"),
    ):
        with pytest.raises(InputError, match=message):
            curlfit.predict(joint, call=Call(labels), start={"v0": 2.2})


def test_forecasts_hold_what_nothing_determines(joint):
    """The friction of front and back each, of which only the sum is known."""
    columns = [joint.means.names.index(name) for name in ("mu1_eta", "mu2_eta")]
    front, back = joint.means.drawn[:, columns].T
    assert np.std(front + back) > 1e-5
    assert np.ptp(front - back) < 1e-12


def test_a_stone_thrown_as_the_table_of_weights_says_rests_where_it_says(joint):
    call = Call({"sheet": "2"}, hog_to_hog=13.4)
    prediction = curlfit.predict(joint, call=call, start={"omega0": -1.3}, draws=100)
    assert [weight.rests for weight in prediction.weights][2] == "tee"
    assert prediction.weights[2].hog_to_tee is None
    columns = joint.means.columns({"sheet": "2"})
    coefficients = dict(
        zip(
            joint.means.names,
            joint.means.at(columns) @ joint.means.estimate,
            strict=True,
        )
    )
    law = replace(LAW, **coefficients)
    for weight in prediction.weights:
        v = brentq(
            lambda v, hog=weight.hog_to_hog: crossing(path_of(law, v, -1.3)) - hog,
            1.7,
            2.9,
        )
        path = path_of(law, v, -1.3)
        # along the line to the broom, from the near hog line
        angle = np.arctan2(weight.brooms[0], sheet.TEE - HOG)
        along = path.y[-1] - HOG
        aside = path.x[-1]
        assert along * np.cos(angle) - aside * np.sin(angle) == pytest.approx(
            sheet.TEE + weight.y - HOG, abs=0.03
        )
        assert along * np.sin(angle) + aside * np.cos(angle) == pytest.approx(
            0.0, abs=0.02
        )
        assert weight.brooms[1] == pytest.approx(-weight.brooms[0])
        if weight.hog_to_tee is not None:
            tee = np.interp(sheet.TEE, path.y[:-1], path.t[:-1])
            assert weight.hog_to_tee == pytest.approx(tee, abs=0.1)


@pytest.mark.parametrize(
    ("labels", "words", "message"),
    [
        ([{"sheet": "1"}, {"sheet": "2"}, {}], {"by": "sheet"}, "no label 'sheet'"),
        ([{"sheet": "1"}] * 3, {"by": "sheet"}, "all throws have '1'"),
        ([{"start": "late"}] * 3, {"trend": "start"}, "expected numbers, times"),
        (
            [{"a": "1", "b": "3"}, {"a": "2", "b": "4"}, {"a": "2", "b": "4"}],
            {"by": ["a", "b"]},
            "do not distinguish",
        ),
    ],
)
def test_labels_that_give_no_effects_are_refused(labels, words, message):
    throws = [
        replace(throw, labels=throw_labels)
        for throw, throw_labels in zip(evening(3), labels, strict=True)
    ]
    with pytest.raises(InputError, match=message):
        curlfit.fit_together(throws, "coulomb", **words)


def test_a_clock_may_pass_midnight():
    from curlfit.inference.together.effects import Covariates

    starts = [("a", {"start": text}) for text in ("23:30", "23:45", "0:15")]
    covariates = Covariates.of(starts, [], ["start"])
    assert np.diff(covariates.values[:, 0]) == pytest.approx([0.25, 0.5])
    assert covariates.trends == {"start": "h"}
    days = [("a", {"day": text}) for text in ("2026-02-27", "2026-02-28", "2026-03-02")]
    covariates = Covariates.of(days, [], ["day"])
    assert np.diff(covariates.values[:, 0]) == pytest.approx([1.0, 2.0])
    assert covariates.trends == {"day": "day"}


def test_on_the_command_line(joint, tmp_path):
    table = [
        "sheet,start,hog to hog,hog to rest,rest,curl,turns,sigma_time,sigma_turns"
    ]
    for throw in evening():
        hog, to_rest, rest, curl, turns = (event.value for event in throw.events)
        numbers = (
            hog,
            to_rest,
            rest - sheet.TEE,
            curl,
            turns / 2 / np.pi,
            0.05,
            0.3 / 2 / np.pi,
        )
        table.append(
            ",".join(
                [*throw.labels.values(), *(f"{number:+.9f}" for number in numbers)]
            )
        )
    (tmp_path / "evening.csv").write_text("\n".join(table))
    words = "--by", "sheet", "--trend", "start", "--stone", "R=0.065", "--out", "out"
    words += "--law", "front-back"
    done = command(
        "fit", "evening.csv", *words, "--no-figures", "--no-sample", cwd=tmp_path
    )
    assert "Sheet 2 against 1: friction" in done.stdout, done
    saved = json.loads((tmp_path / "out" / "joint.json").read_text())
    assert len(saved["differences"]) == len(joint.differences) > 1
    for saved_difference, difference in zip(
        saved["differences"], joint.differences, strict=True
    ):
        for name in ("parameter", "group", "against"):
            assert saved_difference[name] == getattr(difference, name), name
        for name in ("value", "stderr", "p"):
            assert saved_difference[name] == pytest.approx(
                getattr(difference, name), rel=1e-4
            ), name
    words = (
        "predict",
        "out",
        "--sheet",
        "2",
        "--hog-to-hog",
        "13.4",
        "--broom",
        "4 ft left",
    )
    words += ("--turn", "in", "--omega0", "1.3", "--draws", "100", "--no-figures")
    done = command(*words, cwd=tmp_path)
    output = " ".join(done.stdout.split())
    # 1.3 m to the left in 21.9 m, with the curl: longer by 1.8 thousandths
    assert "Sheet 2, 13.42 s hog to hog, broom 4 ft 0 in to the left" in output
    for wrong, message in (
        (("predict", "out"), "a joint fit predicts another throw"),
        (("predict", "out", "--v0", "2.2", "--broom", "4 ft"), "to which side?"),
    ):
        refused = command(*wrong, cwd=tmp_path)
        assert refused.returncode == 2
        assert message in refused.stderr, refused


def test_a_throw_that_is_told_some_coefficients_exactly_moves_in_the_others():
    """Where throws do not vary, the others say a coefficient to 1e-8 of what
    a throw says."""
    rows_of_throw = np.array([[30.0, 20.0], [0.0, 25.0]])
    left = np.array([3.0, -5.0])
    rows_of_others = np.array([[1e8, 1e8], [0.7, -0.7]])
    rows = np.column_stack(
        [np.concatenate([rows_of_throw, rows_of_others]), [*left, 0.0, 0.0]]
    )
    wide = np.full((1, 2), 9.0)
    (move,) = _moves(rows[None], np.zeros((2, 0)), -wide, wide)
    # along (1, -1), the only direction left
    along = np.concatenate([rows_of_throw, rows_of_others[1:]]) @ [1.0, -1.0]
    step = -(along @ [*left, 0.0]) / (along @ along)
    assert move == pytest.approx([step, -step], rel=1e-6)
    (held,) = _moves(rows[None], np.zeros((2, 0)), -wide, np.full((1, 2), -step / 2))
    assert held == pytest.approx(np.array([step, -step]) / 2, rel=1e-6)


@pytest.mark.parametrize("lower", [-np.inf, 0.8])
def test_the_posterior_is_that_of_quadrature(lower):
    """Of eight throws that measure one coefficient, whose spread is the only other
    unknown; a bound takes a share of the draws."""
    random = np.random.default_rng(2)
    number = 8
    error = random.uniform(0.2, 0.6, number)
    measured = (
        1
        + 0.5 * random.standard_normal(number)
        + error * random.standard_normal(number)
    )
    model = MixedModel.of(
        (1 / error)[:, None, None],
        (measured / error)[:, None],
        np.eye(1),
        np.zeros((number, 0)),
    )
    fit = model.fitted(np.array([0.25]), np.array([lower]), np.array([np.inf]))
    posterior = sampled(fit, np.array([0.5]), seed=1)
    assert posterior.r_hat < 1.02
    spreads = np.linspace(1e-4, 20.0, 20001)
    weight = (error[:, None] ** 2 + spreads**2) ** -1
    mean = (weight * measured[:, None]).sum(0) / weight.sum(0)
    square = (weight * (measured[:, None] - mean) ** 2).sum(0)
    log = np.log(weight).sum(0) / 2 - np.log(weight.sum(0)) / 2 - square / 2
    above = norm.sf(lower, mean, weight.sum(0) ** -0.5)
    density = np.exp(log - log.max()) * above
    density /= density.sum()
    for level in (0.025, 0.16, 0.5, 0.84, 0.975):
        # the probability below each quantile, within three Monte Carlo errors
        # of 1,000 draws
        reach = 3 * np.sqrt(level * (1 - level) / 1000)
        spread, middle = (
            np.quantile(draws[:, 0], level)
            for draws in (posterior.spreads, posterior.estimate)
        )
        assert density[spreads < spread].sum() == pytest.approx(level, abs=reach)
        beyond = norm.sf(middle, mean, weight.sum(0) ** -0.5)
        below = density @ (1 - beyond / above)
        assert below == pytest.approx(level, abs=reach)
    assert sampled(fit, np.array([0.5]), seed=None) is None


@pytest.mark.parametrize("speed", [None, (2.2, 0.1)])
def test_the_posterior_of_timed_draws_is_that_of_quadrature(speed):
    """Nine throws without spin, timed to 0.1 s, as with a stopwatch,
    against quadrature over their mean and spread, without and with a prior of the speed
    of each."""
    timed = [
        (13.2, 0.4),
        (13.9, -1.0),
        (12.9, 1.5),
        (13.5, -0.6),
        (14.1, 0.8),
        (12.6, -0.2),
        (14.3, 1.1),
        (13.0, -1.4),
        (13.7, 0.3),
    ]
    error = 0.1
    throws = []
    for hog, rest in timed:
        events = [
            Event("hog_to_hog", "time", hog, error, FAR, HOG),
            Event("rest", "y", sheet.TEE + rest, 0.5),
        ]
        throws.append(curlfit.Throw.from_events(events, assumed={"omega0": 0.0}))
    priors = speed and {"v0": "{}+-{}".format(*speed)}
    # the deceleration over g is half of what the halves of the ring have together
    fix = dict.fromkeys(("mu1_xi", "mu2_xi", "mu1_eta"), 0.0)
    joint = curlfit.fit_together(throws, "front-back", seed=1, priors=priors, fix=fix)
    total = np.linspace(0.008, 0.044, 361)
    spreads = np.linspace(2e-4, 0.04, 100)[:, None, None]
    kernel = np.exp(-0.5 * ((total[:, None] - total) / spreads) ** 2) / spreads
    density = 1.0
    deceleration = 9.81 * total[:, None] / 2
    v = np.sqrt(2 * deceleration * (FAR - HOG)) + np.geomspace(1e-4, 4.0, 3000)
    time = (v - np.sqrt(v**2 - 2 * deceleration * (FAR - HOG))) / deceleration
    for hog, rest in timed:
        y = HOG + v**2 / (2 * deceleration)
        rise = ((time - hog) / error) ** 2 + ((y - sheet.TEE - rest) / 0.5) ** 2
        if speed:
            rise = rise + ((v - speed[0]) / speed[1]) ** 2
        density = density * (kernel @ np.exp(-0.5 * rise.min(1)))
    (quantiles,) = (
        effect.quantiles for effect in joint.groups if effect.parameter == "mu2_eta"
    )
    density = density.sum(0) / density.sum()
    below = np.interp(list(quantiles.values()), total, density.cumsum() - density / 2)
    levels = np.array([float(level) for level in quantiles]) / 100
    # within three Monte Carlo errors of 1,000 draws
    assert below == pytest.approx(levels, abs=3 * np.sqrt(0.25 / 1000))
    assert abs(below - levels)[1:-1].max() < 0.05


def test_draws_are_saved_with_the_fit_and_drawn(joint, tmp_path):
    joint.save(tmp_path / "joint.json")
    (name,) = set(folder_names([fit.data.file for fit in joint.throws]))
    (tmp_path / name).mkdir()
    joint.throws[0].save(tmp_path / name / "fit.json")
    again = curlfit.load_joint(tmp_path)
    np.testing.assert_array_equal(again.chain.values, joint.chain.values)
    effects_by_name = {
        "mu1_eta + mu2_eta": joint.groups,
        "sheet 2 - 1: mu1_eta + mu2_eta": joint.differences,
    }
    for name, effects in effects_by_name.items():
        middle = np.median(again.chain.of({name: 1.0}))
        expected = one_of(
            effects, "mu1_eta + mu2_eta", group="2" if ":" in name else ""
        )
        assert middle == pytest.approx(expected.quantiles["50"], rel=1e-6)
    spread = again.chain.of({"spread of mu1_eta + mu2_eta": 1.0})
    (variation,) = (
        variation
        for variation in joint.variation
        if variation.expression == "mu1_eta + mu2_eta"
    )
    assert np.quantile(spread, 0.84) == pytest.approx(variation.quantiles["84"])
    backend = emcee.backends.HDFBackend(tmp_path / "chain.h5", read_only=True)
    assert backend.get_chain().shape == again.chain.values.shape
    figure = curlfit.corner_figure(again, again.chain)
    number = len(again.chain.names)
    assert len(figure.axes) == number * (number + 1) // 2
    # that of another fit is not taken for its own
    other = replace(joint.chain, subject={"means": "#"})
    other.save(tmp_path / "chain.h5")
    assert curlfit.load_joint(tmp_path).chain is None


def test_a_variation_without_an_optimum_is_refused(monkeypatch):
    """As where coefficients run along a valley until their normal
    equations overflow."""

    def singular(*_):
        raise np.linalg.LinAlgError("Matrix is not positive definite")

    monkeypatch.setattr(MixedModel, "variances", singular)
    with pytest.raises(UnusableFitError, match=r"cannot be estimated.*--share all"):
        curlfit.fit_together(evening(), "front-back", stone=STONE)


def test_too_few_throws_have_no_posterior():
    """With a flat prior the density of the spread falls as a power of one less than the
    degrees of freedom, and has no integral for one."""
    random = np.random.default_rng(1)
    columns = random.standard_normal((4, 2))
    ends = (np.array([-np.inf]), np.array([np.inf]))

    def posterior(covariates):
        measured = random.standard_normal((4, 1))
        model = MixedModel.of(np.ones((4, 1, 1)), measured, np.eye(1), covariates)
        return sampled(model.fitted(np.ones(1), *ends), np.ones(1), seed=1)

    assert posterior(columns - columns.mean(0)) is None
    assert posterior(columns[:, :1]).r_hat < 1.02


@pytest.mark.slow
def test_a_prior_is_of_the_mean_and_changes_nothing_that_it_does_not_know(joint):
    def fitted(**choices):
        return curlfit.fit_together(
            evening(), "front-back", stone=STONE, by="sheet", trend="start", **choices
        )

    # a very narrow prior is a fixed value
    narrow = fitted(priors={"mu1_xi": "0.004+-1e-7"})
    fixed = fitted(fix={"mu1_xi": 0.004})
    assert narrow.coefficients["mu1_xi"].value == pytest.approx(0.004, abs=1e-6)
    for name in ("mu2_xi", "mu1_eta + mu2_eta", "friction", "curl"):
        effect, expected = (
            one_of(fit.differences, name, by="sheet") for fit in (narrow, fixed)
        )
        assert effect.value == pytest.approx(expected.value, abs=0.02 * expected.stderr)
        assert effect.stderr == pytest.approx(expected.stderr, rel=0.02)
    # one of what the throws cannot say leaves the sum alone
    split = fitted(priors={"mu1_eta": "lognormal:0.008,0.01"})
    assert split.converged
    assert split.coefficients["mu1_eta"].verdict == "prior"
    assert split.coefficients["mu1_eta"].value == pytest.approx(0.008, rel=2e-3)
    effect, expected = (
        one_of(fit.differences, "mu1_eta + mu2_eta", by="sheet")
        for fit in (split, joint)
    )
    assert (effect.value, effect.stderr) == pytest.approx(
        (expected.value, expected.stderr), rel=0.01
    )
