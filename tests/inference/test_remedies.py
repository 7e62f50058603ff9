"""What else to measure: said of a throw, and true of it."""

from __future__ import annotations

from functools import partial

import pytest
from conftest import TIMES as T, filmed

import curlfit
from curlfit.inference.fit.advice import NOISE
from curlfit.inference.fit.entries import FurtherMeasurement
from curlfit.inference.fit.result import load_fit
from curlfit.reports.determined import sentences_on

TIMES = T[:151]
SPLIT = FurtherMeasurement(("mu1_eta", "mu2_eta"), (), all=False)


@pytest.fixture(scope="module")
def seen():
    """All channels of a throw, with noise."""
    return filmed(seed=4, noise=NOISE, times=TIMES, omega=1.3)


def fitted(seen, *channels, **choices):
    sigma = {name: NOISE[name] for name in channels}
    series = {name: getattr(seen, name) for name in channels}
    return curlfit.fit(
        curlfit.Throw.from_arrays(TIMES, **series, sigma=sigma), **choices
    )


@pytest.mark.parametrize(
    ("channels", "name", "known"),
    [
        (("x", "y"), "omega0", {}),
        (("y", "phi"), "mu2_xi", {}),
        (("phi",), "mu1_xi", {"v0": 2.1}),  # a speed that an angle hardly determines
    ],
)
def test_what_is_said_to_help_does_and_the_rest_does_not(seen, channels, name, known):
    with_known = partial(fitted, seen, fix=known)
    before = with_known(*channels)
    assert before.parameters[name].verdict in ("weak", "not identifiable")
    (remedy,) = (remedy for remedy in before.remedies if name in remedy.parameters)
    assert remedy.measure
    unmeasured = [other for other in NOISE if other not in channels]
    if remedy.all:
        more = remedy.measure
        assert with_known(*channels, *more).parameters[name].verdict == "determined"
        for left_out in more:
            fewer = [other for other in more if other != left_out]
            assert (
                with_known(*channels, *fewer).parameters[name].verdict != "determined"
            )
    else:
        for other in unmeasured:
            helps = (
                with_known(*channels, other).parameters[name].verdict == "determined"
            )
            assert helps == (other in remedy.measure), other


def test_nothing_tells_the_split_and_the_report_says_where_to_look(seen, tmp_path):
    fit = fitted(seen, "x", "y", "phi")
    assert fit.remedies == (SPLIT,)
    assert "curlfit design --separate mu1_eta,mu2_eta" in sentences_on(fit)
    fit.save(tmp_path / "fit.json")
    assert load_fit(tmp_path / "fit.json").remedies == fit.remedies


def test_nothing_is_said_to_help_under_correlated_noise_but_the_split_stays_hidden(
    seen,
):
    fit = fitted(seen, "x", "y", noise="ar1")
    assert fit.parameters["omega0"].verdict in ("weak", "not identifiable")
    assert fit.remedies == (SPLIT,)
