"""Sliders of a fit: curves that follow them without the model, against an integration
that shares nothing with the program."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from conftest import DATA
from independent_motion import Reference, front_back

import curlfit
from curlfit.errors import InputError
from curlfit.html_report.slider_curves import HALF, WHOLE, SliderCurves, nodes_between

EVENING = DATA.parent / "evening.csv"
START = ("x0", "y0", "heading", "v0", "phi0", "omega0")
COEFFICIENTS = ("mu1_xi", "mu2_xi", "mu1_eta", "mu2_eta")


@pytest.fixture(scope="module")
def fit(eq12):
    return curlfit.fit(eq12)


@pytest.fixture(scope="module")
def curves(fit):
    return SliderCurves(fit)


@pytest.fixture(scope="module")
def explorer(fit):
    return curlfit.explore(fit)


def residuals(fit, curves, steps):
    """Measured minus computed by channel with sliders at steps, by the reference."""
    values = {name: estimate.value for name, estimate in fit.parameters.items()}
    for slider, step in zip(curves.sliders, steps, strict=True):
        for name, weight in slider.direction.items():
            values[name] += weight * step
    law = front_back(*(values[name] for name in COEFFICIENTS))
    start = curlfit.InitialState(*(values[name] for name in START))
    rows = curves.layout.rows
    path = Reference(law, R=fit.stone.R, rho=fit.stone.rho).path(
        start, fit.observed["t"][rows]
    )
    return {
        name: fit.observed[name][rows] - path[row]
        for row, name in enumerate(("x", "y", "phi"))
    }


def shown(curves, steps):
    """The same, as the sliders have them."""
    total = curves.base + curves.changes(steps)
    return {name: total[part] for name, part in curves.layout.residuals.items()}


def test_there_is_a_slider_for_each_parameter_and_direction(fit, curves):
    names = [tuple(slider.direction) for slider in curves.sliders]
    assert names == [(name,) for name in fit.parameters] + [("mu1_eta", "mu2_eta")]


def test_one_slider_alone_shows_the_model(fit, curves):
    for number in (0, 1, 4, 7, 9, 10):
        for share in (-0.93, 0.37):
            steps = np.zeros(len(curves.sliders))
            end = curves.sliders[number].ends[int(share > 0)]
            steps[number] = abs(share) * end
            expected = residuals(fit, curves, steps)
            for name, values in shown(curves, steps).items():
                np.testing.assert_allclose(values, expected[name], atol=1e-6)


@pytest.mark.parametrize(("reach", "most"), [(HALF, 0.5e-3), (WHOLE, 2e-3)])
def test_several_sliders_are_as_near_to_the_model_as_is_said(
    fit, curves, reach, most, explorer
):
    ends = np.array([slider.ends for slider in curves.sliders])
    random = np.random.default_rng(5)
    for _ in range(3):
        sides = random.integers(2, size=len(ends))
        steps = reach * ends[np.arange(len(ends)), sides]
        expected = residuals(fit, curves, steps)
        for name, values in shown(curves, steps).items():
            off = np.abs(values - expected[name]).max()
            assert off < 1.5 * explorer.errors[reach][name]  # largest of a few
    for name in ("x", "y"):
        assert explorer.errors[reach][name] < most


def test_without_pairs_the_curves_are_far_off(fit):
    alone = SliderCurves(fit)
    together = alone.errors(WHOLE)
    alone.pairs.clear()
    for name, size in alone.errors(WHOLE).items():
        assert size > 5 * together[name]


def test_the_ends_of_sliders_are_bounds_or_a_change_that_is_seen(fit, curves):
    lower = [fit[slider].lower for slider in COEFFICIENTS]
    backward = [slider.ends[0] for slider in curves.sliders[:4]]
    assert fit["mu1_xi"].value + backward[0] == lower[0]
    assert fit["mu2_xi"].value + backward[1] > lower[1]
    for slider in curves.sliders[1:10]:
        for change in slider.end_changes:
            sizes = curves.layout.largest(change)
            shares = [sizes["x"] / 0.3, sizes["y"] / 0.3, sizes["phi"]]
            assert 0.5 < max(shares) <= 1


def test_a_parameter_at_its_bound_moves_to_one_side(fit):
    assert nodes_between(0.0, 0.0).tolist() == [0.0]
    squares = [-25.0, -16.0, -9.0, -4.0, -1.0, 0.0]
    assert nodes_between(-25.0, 0.0) == pytest.approx(squares)
    estimate = replace(fit["mu1_xi"], value=0.0, stderr=None, verdict="at bound")
    at_bound = replace(fit, parameters=fit.parameters | {"mu1_xi": estimate})
    slider = SliderCurves(at_bound).sliders[0]
    assert slider.ends[0] == 0
    assert slider.ends[1] > 0
    page = curlfit.explore(at_bound).page
    assert '<input id="sliders-0" type="range" min="0" max="250"' in page


def test_the_page_has_numbers_of_the_record_and_needs_nothing_else(fit, explorer):
    data = json.loads(re.search('id="data">(.*?)</script>', explorer.page)[1])
    assert data["sliders"]["names"] == list(fit.parameters)
    assert data["sliders"]["chi_squared"] == fit.chi_squared
    assert data["sliders"]["base"].count(None) == np.isnan(fit.observed["x"]).sum()
    assert "http://" not in explorer.page.replace("http://www.w3.org", "")
    assert "https://" not in explorer.page
    assert "src=" not in explorer.page
    assert len(explorer.page) < 400_000
    assert repr(explorer) == (
        f"Explorer of a fit of the front-back law to {fit.data.file}"
    )


def test_a_hostile_file_name_is_text(fit):
    name = '"></iframe><script>alert(1)</script>.csv'
    explorer = curlfit.explore(replace(fit, data=replace(fit.data, file=name)))
    assert explorer.page.count("<script") == 2
    shown = explorer._repr_html_()
    assert shown.count("<") == 2
    assert "alert(1)</script>" not in shown


def test_a_fit_without_a_path_is_refused():
    throw = curlfit.load_throws(EVENING)[0]
    assert throw.events
    fit = curlfit.fit(throw, "coulomb", details=False)
    with pytest.raises(InputError, match="timed events alone has no path"):
        curlfit.explore(fit)


def test_ends_without_a_motion_are_said_and_a_fit_that_cannot_move_is_refused(
    fit, monkeypatch
):
    def nowhere(curves, reach):
        return dict.fromkeys(curves.layout.residuals, np.nan)

    monkeypatch.setattr(SliderCurves, "errors", nowhere)
    page = curlfit.explore(fit).page
    assert "at their ends in places where the law admits no motion" in page
    held = {
        name: replace(estimate, lower=estimate.value, upper=estimate.value)
        for name, estimate in fit.parameters.items()
    }
    fixed = replace(
        fit,
        parameters=held,
        identifiability=replace(fit.identifiability, null_directions=()),
    )
    with pytest.raises(InputError, match="no parameter of this fit can be moved"):
        curlfit.explore(fixed)


def test_speeds_without_positions_are_drawn_against_time():
    times = np.linspace(0, 18, 60)
    law = curlfit.law_with("coulomb", {"mu": 0.009})
    path = curlfit.simulate(
        law, curlfit.Stone(), curlfit.InitialState(v=2.0, omega=1.0), times
    )
    noise = 0.005 * np.random.default_rng(1).standard_normal(60)
    speed = np.hypot(path.vx, path.vy) + noise
    explorer = curlfit.explore(
        curlfit.fit(curlfit.Throw.from_arrays(times, speed=speed), law="coulomb")
    )
    assert list(explorer.errors[WHOLE]) == ["speed"]
    assert explorer.errors[WHOLE]["speed"] < 2e-3
    assert "speed (m/s) against t (s)" in explorer.page
    assert "where the curves have moved by 50 mm/s in speed. One" in explorer.page
