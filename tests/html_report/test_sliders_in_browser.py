"""Sliders of a fit in Chromium: as a page, and in the frame that a notebook shows."""

from __future__ import annotations

import re

import numpy as np
import pytest
from independent_motion import Reference, front_back

import curlfit

pytestmark = pytest.mark.browser

START = ("x0", "y0", "heading", "v0", "phi0", "omega0")
COEFFICIENTS = ("mu1_xi", "mu2_xi", "mu1_eta", "mu2_eta")
MARGIN = 16.0  # of a drawing
MOVE = """
const [number, position] = arguments;
const slider = document.getElementById(`sliders-${number}`);
slider.value = position;
slider.dispatchEvent(new Event("input"));
"""


@pytest.fixture(scope="module")
def fit(eq12):
    return curlfit.fit(eq12)


@pytest.fixture(scope="module")
def addresses(tmp_path_factory, fit):
    folder = tmp_path_factory.mktemp("sliders")
    explorer = curlfit.explore(fit)
    (folder / "page.html").write_text(explorer.page)
    notebook = f"<!doctype html><html><body>{explorer._repr_html_()}</body></html>"
    (folder / "notebook.html").write_text(notebook)
    return {name: (folder / f"{name}.html").as_uri() for name in ("page", "notebook")}


def drawn(browser):
    """The path that is drawn, in m: along the sheet, and to the right."""
    data = browser.execute_script(
        "return JSON.parse(document.getElementById('data').textContent).sliders"
    )
    path = browser.find_element("css selector", '[data-part="path"]')
    numbers = re.findall(r"-?[\d.]+", path.get_attribute("d"))
    across, down = np.array(numbers, float).reshape(-1, 2).T
    along = (across - MARGIN) / data["scale"][0] + data["origin"][0]
    right = (200 - MARGIN - down) / data["scale"][1] + data["origin"][1]
    return np.array(data["instants"]), along, right


def values_shown(browser, fit):
    """The parameters as shown, where the last slider is along mu1_eta - mu2_eta."""
    texts = [output.text for output in browser.find_elements("css selector", "output")]
    return dict(zip(fit.parameters, map(float, texts[:-1]), strict=True))


def expected(fit, values, times):
    law = front_back(*(values[name] for name in COEFFICIENTS))
    start = curlfit.InitialState(*(values[name] for name in START))
    return Reference(law, R=fit.stone.R, rho=fit.stone.rho).path(start, times)


@pytest.mark.parametrize(
    ("moved", "off"),
    [
        ({}, 1e-4),  # the sixth digit of v0, over 23 s
        ({1: -180}, 1e-4),
        ({10: 250}, 1e-4),
        ({0: 120, 1: -150, 6: 90, 7: -60, 10: -200}, 5e-4),
    ],
)
def test_the_path_is_that_of_the_values_beside_the_sliders(
    browser, addresses, fit, moved, off
):
    browser.get(addresses["page"])
    for number, position in moved.items():
        browser.execute_script(MOVE, number, position)
    times, along, right = drawn(browser)
    x, y, *_ = expected(fit, values_shown(browser, fit), times)
    np.testing.assert_allclose(along, y, atol=off)
    np.testing.assert_allclose(right, x, atol=off)
    assert browser.get_log("browser") == []


def test_chi_squared_is_said_of_one_slider_and_the_fit_comes_back(
    browser, addresses, fit
):
    browser.get(addresses["page"])
    status = browser.find_element("css selector", '[data-part="status"]')
    total = f"{fit.chi_squared:.6g}"
    assert f"chi squared {total}, of the fit {total}" in status.text
    slider = browser.find_element("id", "sliders-1")
    slider.send_keys("\ue014")  # arrow to the right: near the fit, by small steps
    chi_squared = float(re.search(r"chi squared ([\d.]+),", status.text)[1])
    assert fit.chi_squared < chi_squared < fit.chi_squared + 1
    browser.execute_script(MOVE, 0, 30)
    assert "chi squared" not in status.text
    assert re.search(r"Residuals of [\d.]+ mm in x, [\d.]+ mm in y, ", status.text)
    browser.execute_script(MOVE, 10, 250)
    browser.execute_script(MOVE, 3, -250)
    assert "Beyond its bounds: mu2_eta" in status.text
    browser.find_element("css selector", '[data-part="back"]').click()
    assert f"chi squared {total}, of the fit {total}" in status.text
    assert "Beyond" not in status.text


@pytest.mark.parametrize("width", [1280, 400])
def test_the_frame_in_a_notebook_works_and_reaches_nothing(browser, addresses, width):
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.get(addresses["notebook"])
    browser.switch_to.frame(browser.find_element("css selector", "iframe"))
    try:
        before = drawn(browser)
        browser.execute_script(MOVE, 1, -200)
        assert np.abs(np.array(before) - drawn(browser)).max() > 0.05
        assert browser.execute_script("return window.origin") == "null"
        script = "return [document.documentElement.scrollWidth, innerWidth]"
        scrolled, inner = browser.execute_script(script)
        assert scrolled <= inner
    finally:
        browser.switch_to.default_content()
    script = "return performance.getEntriesByType('resource').length"
    assert browser.execute_script(script) == 0
    assert browser.get_log("browser") == []
