"""Pages in Chromium: what moves, by mouse and keyboard, on screens of two widths
and on paper."""

from __future__ import annotations

import re
import time

import numpy as np
import pytest
import report_records
from conftest import wait_for

import curlfit

pytestmark = pytest.mark.browser
PAGES = ("fit", "prediction")


@pytest.fixture(scope="module")
def addresses(tmp_path_factory, eq12):
    folder = tmp_path_factory.mktemp("pages")
    records = report_records.of_fit(eq12)
    curlfit.write_report(records["fit"], folder / "fit.html", chain=records["chain"])
    curlfit.write_report(records["prediction"], folder / "prediction.html")
    return {name: (folder / f"{name}.html").as_uri() for name in PAGES}


@pytest.fixture
def shown(browser, addresses):
    """A page, at a width and with what the reader prefers."""

    def show(name, width=1280, media="", **preferred):
        features = [
            {"name": f"prefers-{key}".replace("_", "-"), "value": value}
            for key, value in preferred.items()
        ]
        browser.execute_cdp_cmd(
            "Emulation.setEmulatedMedia", {"media": media, "features": features}
        )
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        browser.get(addresses[name])
        return browser

    return show


def part(browser, id, name):
    return browser.find_element("css selector", f'#{id} [data-part="{name}"]')


def place(browser, id):
    """Where the stone is, m."""
    text = part(browser, id, "stone").get_attribute("transform")
    return np.array([float(number) for number in re.findall(r"-?[\d.]+", text)])


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.parametrize("width", [1280, 400])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_page_fits_the_screen_and_complains_of_nothing(shown, name, width, scheme):
    browser = shown(name, width, color_scheme=scheme)
    assert browser.get_log("browser") == []
    script = "return [document.documentElement.scrollWidth, innerWidth]"
    scrolled, inner = browser.execute_script(script)
    assert scrolled <= inner == width
    assert (
        browser.execute_script("return performance.getEntriesByType('resource').length")
        == 0
    )
    script = (
        "return [document.body, document.querySelector('.card'), "
        "document.querySelector('p')]"
        ".map(one => [getComputedStyle(one).backgroundColor, "
        "getComputedStyle(one).color])"
    )
    (body, _), (card, _), (_, text) = browser.execute_script(script)
    assert card == "rgb(255, 255, 255)"
    brightness = {
        key: sum(map(int, re.findall(r"\d+", value)[:3])) / 3
        for key, value in {"body": body, "text": text}.items()
    }
    assert (brightness["body"] > brightness["text"] + 100) == (scheme == "light")
    assert abs(brightness["body"] - brightness["text"]) > 100


def test_a_page_is_ready_within_a_second(shown):
    script = (
        "return performance.getEntriesByType('navigation')[0].domContentLoadedEventEnd"
    )
    assert min(shown("fit").execute_script(script) for _ in range(3)) < 1000


def test_play_moves_the_stone_and_pause_stops_it(shown):
    browser = shown("fit")
    end = place(browser, "replay-0")
    button = part(browser, "replay-0", "play")
    button.click()
    assert button.text == "Pause"
    wait_for(lambda: place(browser, "replay-0")[1] < end[1] - 5)  # from the start again
    first = place(browser, "replay-0")
    wait_for(lambda: place(browser, "replay-0")[1] > first[1] + 0.1)
    button.click()
    assert button.text == "Play"
    stopped = place(browser, "replay-0")
    time.sleep(0.2)
    assert (place(browser, "replay-0") == stopped).all()
    now = float(part(browser, "replay-0", "now").text)
    status = part(browser, "replay-0", "status").text
    time_told, place_told = map(
        float, re.match(r"([\d.]+) s: ([\d.]+) m from the hack", status).groups()
    )
    assert time_told == pytest.approx(now, abs=0.06)
    assert place_told == pytest.approx(stopped[1], abs=0.006)
    cursor = part(browser, "replay-0", "cursor").get_attribute("transform")
    assert float(re.search(r"\(([\d.]+)", cursor)[1]) == pytest.approx(
        now / 20, abs=1e-3
    )


def test_the_player_obeys_the_keyboard(shown):
    browser = shown("fit")
    player = browser.find_element("id", "replay-0")
    slider = part(browser, "replay-0", "time")
    button = part(browser, "replay-0", "play")
    slider.send_keys("\ue011")  # Home
    start = place(browser, "replay-0")
    assert start[:2] == pytest.approx([0.0, 10.059], abs=1e-3)
    slider.send_keys("\ue014")  # arrow to the right
    assert place(browser, "replay-0")[1] > start[1]
    assert " m from the hack, on the centre line, " in slider.get_attribute(
        "aria-valuetext"
    )
    browser.execute_script("arguments[0].focus()", player)
    before = place(browser, "replay-0")
    player.send_keys("\ue014")
    assert place(browser, "replay-0")[1] > before[1]
    player.send_keys(" ")
    assert button.text == "Pause"
    player.send_keys(" ")
    assert button.text == "Play"
    button.send_keys(" ")  # once, not twice
    assert button.text == "Pause"
    script = "arguments[0].focus(); return getComputedStyle(arguments[0]).outlineStyle"
    assert browser.execute_script(script, slider) == "solid"


def points(path):
    return np.array(re.findall(r"-?[\d.]+", path.get_attribute("d")), float).reshape(
        -1, 2
    )


def test_along_a_null_direction_bars_move_and_the_path_stands_still(shown):
    browser = shown("fit")
    slider = part(browser, "direction-0", "at")
    path = part(browser, "direction-0", "path")
    other = part(browser, "direction-0", "other")
    bars = browser.find_elements("css selector", "#direction-0 .bar span")
    numbers = browser.find_elements("css selector", "#direction-0 output")
    before = points(path)
    widths = []
    for key in ("\ue011", "\ue010", "\ue012"):  # Home, End, arrow to the left
        slider.send_keys(key)
        drawn = points(path)
        assert drawn.shape == before.shape
        assert np.abs(drawn - before).max() < 0.01  # pixels
        assert np.abs(points(other) - before).max() > 20
        widths.append([float(bar.value_of_css_property("width")[:-2]) for bar in bars])
        assert sum(float(number.text) for number in numbers) == pytest.approx(
            0.017573, abs=2e-6
        )
    assert widths[0][0] < 1 < 100 < widths[0][1]
    assert widths[1][1] < 1 < 100 < widths[1][0]
    assert 1 < widths[2][1] < 30
    assert "less than 0.0001 mm" in part(browser, "direction-0", "status").text
    part(browser, "direction-0", "back").click()
    assert slider.get_attribute("aria-valuetext").startswith("mu1_eta = 0.008786")


def test_draws_come_to_rest_one_by_one(shown):
    browser = shown("prediction")
    dots = part(browser, "rests", "dots")
    slider = part(browser, "rests", "shown")
    assert dots.get_attribute("d").count("M") == 60
    part(browser, "rests", "next").click()
    wait_for(lambda: part(browser, "rests", "trail").get_attribute("d"))
    wait_for(lambda: part(browser, "rests", "play").text == "Play")
    assert dots.get_attribute("d").count("M") == 1
    assert part(browser, "rests", "status").text.startswith("Throw 1 of 60 rests ")
    slider.send_keys("\ue014")
    assert dots.get_attribute("d").count("M") == 2
    end = np.array(
        re.findall(r"-?[\d.]+", dots.get_attribute("d").split("M")[2])[:2], float
    )
    stone = place(browser, "rests")
    assert stone[:2] - end == pytest.approx([0, 38.405], abs=1e-3)
    browser.execute_script("arguments[0].focus()", browser.find_element("id", "rests"))
    browser.find_element("id", "rests").send_keys(" ")
    wait_for(lambda: dots.get_attribute("d").count("M") == 3)


def test_with_reduced_motion_the_stone_goes_in_steps(shown):
    browser = shown("fit", reduced_motion="reduce")
    slider = part(browser, "replay-0", "time")
    slider.send_keys("\ue011")
    part(browser, "replay-0", "play").click()
    positions = set()
    end = time.monotonic() + 2.5
    while time.monotonic() < end:
        positions.add(tuple(place(browser, "replay-0")))
        time.sleep(0.02)
    assert 2 <= len(positions) <= 4


def test_on_paper_there_are_no_controls_and_all_has_come_to_its_end(shown):
    browser = shown("prediction", media="print")
    controls = browser.find_elements("css selector", ".controls, nav, .status")
    assert controls
    assert not any(control.is_displayed() for control in controls)
    slider = part(browser, "rests", "shown")
    script = "arguments[0].value = 3; arguments[0].dispatchEvent(new Event('input'))"
    browser.execute_script(script, slider)
    dots = part(browser, "rests", "dots")
    for event, count in (("", 3), ("beforeprint", 60), ("afterprint", 3)):
        if event:
            browser.execute_script(f"dispatchEvent(new Event('{event}'))")
        assert dots.get_attribute("d").count("M") == count
