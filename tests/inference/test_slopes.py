"""Whether sheets change alike along an evening: an evening with known truth, and how
often evenings whose sheets do change alike are said not to."""

from pathlib import Path

import numpy as np
import pytest
from conftest import invoke
from scipy.special import stdtr

import curlfit
from curlfit import InputError, load_joint
from curlfit.errors import Option
from curlfit.inference.together.effects import (
    SLOPES_DIFFER,
    Covariates,
    with_own_slopes,
)
from curlfit.numerics.mixed_model import MixedFit, MixedModel
from curlfit.prediction.result import Call
from curlfit.reports.joint import document

EVENING = Path(__file__).parent / "evenings" / "e12.csv"
"""Sheet 2 rises by 5 % an hour, sheet 1 not: 13.45 and 12.75 s at the end."""
AT_THE_END = {"1": 13.45, "2": 12.75}


def fitted(**choices):
    throws = curlfit.load_throws(EVENING)
    return curlfit.fit_together(
        throws, by="sheet", trend="start", systematics={"all": 0.0}, **choices
    )


def require_slopes(joint):
    """Those of the friction of both sheets are right."""
    friction = {
        effect.group: effect
        for effect in joint.slopes
        if effect.parameter == "friction"
    }
    (mean,) = (
        effect
        for effect in joint.groups
        if effect.parameter == "friction" and not effect.by
    )
    for sheet, slope in {"1": 0.0, "2": 0.05}.items():
        of_sheet = friction[sheet]
        assert (
            abs(of_sheet.value / mean.value - slope) < 2 * of_sheet.stderr / mean.value
        )
        assert of_sheet.stderr / mean.value < 0.012


def test_slopes_that_differ_are_said_and_not_switched_on():
    joint = fitted()
    (warning,) = joint.warnings
    assert warning.code == "slopes-differ"
    (difference,) = warning.numbers["differences"]
    assert (difference["parameter"], difference["group"]) == ("friction", "2")
    (remedy,) = warning.remedies
    assert remedy.option == Option("trend-by", "sheet")
    assert str(warning) == (
        "the slopes by sheet differ: friction rises by 5.0(11) % an hour more on "
        "sheet 2 than on sheet 1 (p < 0.001); `--trend-by sheet` gives each its own"
    )
    assert joint.means.trend_by == ()
    assert not joint.slopes
    (of_friction,) = (
        effect for effect in joint.slope_differences if effect.parameter == "friction"
    )
    assert (of_friction.by, of_friction.along) == ("sheet", "start")
    assert (of_friction.group, of_friction.against) == ("2", "1")
    assert "Caution: the slopes by sheet differ." in str(document(joint))


def test_each_sheet_may_have_its_own_slope():
    joint = fitted(trend_by="sheet")
    assert not joint.warnings
    require_slopes(joint)
    text = " ".join(str(document(joint)).split())
    assert "Per h of start on sheet 2: friction 4.7" in text
    for sheet, time in AT_THE_END.items():
        predicted = curlfit.predict(
            joint, call=Call({"sheet": sheet}), target=(0.0, 0.0), draws=200
        )
        hog_to_hog = predicted.quantities["hog_to_hog"]
        assert abs(hog_to_hog.value - time) < 2 * hog_to_hog.parameter_sd
        assert hog_to_hog.parameter_sd < 0.2


def test_a_season_tests_slopes_too(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = invoke(["batch", str(EVENING), "--workers", "1", "--out", "season.csv"])
    assert run.exit_code == 0, run.exception
    words = "--by sheet --trend start --no-sample --no-figures"
    run = invoke(["fit", "season.csv", *words.split()])
    assert run.exit_code == 0, run.exception
    text = " ".join(run.stdout.split())
    assert "Caution: the slopes by sheet differ." in text
    assert "`--trend-by sheet` gives each its own" in text
    (warning,) = load_joint("season-fit").warnings
    assert (warning.code, warning.numbers["label"]) == ("slopes-differ", "sheet")
    run = invoke(["fit", "season.csv", *words.split(), "--trend-by", "sheet"])
    assert run.exit_code == 0, run.exception
    season = load_joint("season-fit")
    assert season.means.trend_by == ("sheet",)
    assert not season.warnings
    require_slopes(season)


def test_a_slope_of_each_group_is_that_of_a_regression_of_the_group():
    """Each sheet by itself gives the same line, where throws are equally exact."""
    random = np.random.default_rng(2)
    labels = [
        ("draw", {"sheet": f"{row % 3}", "start": f"{random.uniform(0, 3)}"})
        for row in range(18)
    ]
    covariates = Covariates.of(labels, "sheet", "start", "sheet")
    values = random.standard_normal(18)
    model = MixedModel.of(
        np.ones((18, 1, 1)), values[:, None], np.ones((1, 1)), covariates.values
    )
    fit = MixedFit(model, np.zeros(1), np.full(1, -np.inf), np.full(1, np.inf))
    times = np.array([float(of["start"]) for _, of in labels])
    sheets = np.array([of["sheet"] for _, of in labels])
    slopes = [np.polyfit(times[sheets == k], values[sheets == k], 1)[0] for k in "012"]
    differences = fit.estimate[-2:]
    assert differences == pytest.approx(np.array(slopes[1:]) - slopes[0], rel=1e-8)


def chance_of_alike_slopes(throws, groups, spread, random):
    """Of an evening whose groups all change at the same rate, as throws differ by
    errors of one and by a spread, by Bonferroni for the groups."""
    labels = [
        ("draw", {"sheet": f"{row % groups}", "start": f"{row / 8}"})
        for row in range(throws)
    ]
    covariates = Covariates.of(labels, "sheet", "start")
    values = random.standard_normal(throws) * np.hypot(1.0, spread)
    model = MixedModel.of(
        np.ones((throws, 1, 1)), values[:, None], np.ones((1, 1)), covariates.values
    )
    anywhere = np.full(1, np.inf)
    fit = MixedFit(model, model.variances(np.array([0.1])), -anywhere, anywhere)
    own_slopes = with_own_slopes(fit, covariates, "sheet")
    columns = own_slopes.covariates.values.shape[1]
    estimate = own_slopes.fit.estimate[1 - groups :]
    errors = np.sqrt(np.diagonal(own_slopes.fit.covariance)[1 - groups :])
    p = 2 * stdtr(throws - 1 - columns, -np.abs(estimate / errors))
    return (groups - 1) * p.min()


def test_slopes_that_do_not_differ_are_rarely_said_to():
    random = np.random.default_rng(7)
    evenings = [(12, 2, 1.0), (16, 2, 3.0), (20, 4, 3.0)]
    chances = np.array(
        [
            chance_of_alike_slopes(*evening, random)
            for evening in evenings
            for _ in range(200)
        ]
    )
    assert np.mean(chances < SLOPES_DIFFER) < 1.7 * SLOPES_DIFFER
    assert 0.02 < np.mean(chances < 0.05) < 0.07


def test_groups_without_a_trend_have_no_slope():
    with pytest.raises(InputError, match="trend-by sheet: expected a trend too"):
        Covariates.of(
            [("a", {"sheet": "1"}), ("b", {"sheet": "2"})], "sheet", (), "sheet"
        )
    with pytest.raises(InputError, match="trend-by sheet: expected a label of groups"):
        Covariates.of(
            [("a", {"start": "1"}), ("b", {"start": "2"})], (), "start", "sheet"
        )
