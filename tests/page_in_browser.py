"""The page of `curlfit app` as tests drive it: its process, its requests, its elements
in a browser."""

from __future__ import annotations

import os
import re
import subprocess
import urllib.error
import urllib.request

import pytest
from conftest import started, wait_for

FIRST = ".drop input[type=file]"
LONG = 300.0  # s, of a first fit on a machine with other work


class Served:
    """The page's process, and the folder in which it was started."""

    def __init__(self, folder, **settings):
        # NiceGUI does not tidy up where it finds itself in a test
        usual = {
            name: value
            for name, value in os.environ.items()
            if not name.startswith("PYTEST")
        }
        words = ("app",) if "BROWSER" in settings else ("app", "--no-browser")
        self.folder = folder
        self.process = started(
            *words, cwd=folder, stderr=subprocess.STDOUT, env=usual | settings
        )
        self.address = self.next_address()

    def next_address(self):
        """The address for one visit that the command prints next."""
        return re.search(r"http://\S+/", self.process.stdout.readline())[0]

    def enter(self, browser):
        """Let a browser in; the address of the page."""
        browser.get(self.address)
        self.address = self.next_address()
        wait_for(lambda: browser.find_elements("css selector", FIRST))
        return browser.current_url

    def end(self):
        """End it so that it leaves nothing."""
        self.process.terminate()
        self.process.communicate(timeout=60)


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    pytest.importorskip("nicegui", reason="NiceGUI is not installed")
    served = Served(tmp_path_factory.mktemp("served"))
    yield served
    served.end()


@pytest.fixture(scope="module")
def entered(browser, served):
    """The address of the page for the browser."""
    return served.enter(browser)


@pytest.fixture
def page(browser, entered):
    """The page with nothing on it that a test may have left."""
    browser.get(entered)
    wait_for(lambda: browser.find_elements("css selector", FIRST))
    yield browser
    button(browser, "Stop", "button && button.click()")
    assert browser.get_log("browser") == []


def drop(browser, *files, onto=".drop"):
    """Drop files, and wait until nothing is shown that was there before them."""
    before = (
        "document.querySelectorAll('main section')"
        ".forEach(one => one.classList.add('before'))"
    )
    browser.execute_script(before)
    area = browser.find_element("css selector", f"{onto} input[type=file]")
    area.send_keys("\n".join(map(str, files)))
    wait_for(lambda: not browser.find_elements("css selector", ".before"))


def said(browser):
    return browser.find_element("css selector", "body").text


def button(browser, label, act):
    """What a script makes of the `button` with a label; found and used at once, since
    the page changes."""
    find = (
        "[...document.querySelectorAll('button')]"
        ".find(one => one.innerText == arguments[0])"
    )
    return browser.execute_script(f"const button = {find}; return {act}", label)


def press(browser, label):
    wait_for(
        lambda: button(
            browser, label, "!!button && !button.disabled && !button.click()"
        )
    )


LINE = "Further options, as on the command line"


def write(browser, text, field=LINE):
    """Write into a field, whatever the command then looks like."""
    script = (
        "const field = document.querySelector(`[aria-label='${arguments[0]}']`);"
        "field.value = arguments[1]; field.dispatchEvent(new Event('change'))"
    )
    browser.execute_script(script, field, text)


def written(browser, field=LINE):
    """What a field holds."""
    script = "return document.querySelector(`[aria-label='${arguments[0]}']`).value"
    return browser.execute_script(script, field)


def put(browser, options):
    """Add options to the line."""
    write(browser, f"{written(browser)} {options}".strip())
    wait_for(lambda: options in shown_command(browser))


def shown_command(browser):
    script = "return document.querySelector('section .command').innerText"
    return " ".join(browser.execute_script(script).split())


def fitted(browser, verb="Fit"):
    press(browser, verb)
    wait_for(lambda: browser.find_elements("css selector", ".result"), LONG)


def in_report(browser, script):
    frame = browser.find_element("css selector", "iframe")
    browser.switch_to.frame(frame)
    try:
        return browser.execute_script(script)
    finally:
        browser.switch_to.default_content()


def save(browser, name):
    field = browser.find_element("css selector", ".result .repeat input")
    field.clear()
    field.send_keys(name)
    press(browser, "Save")


def answer(address, data=None, headers=None):
    """Status, headers and text of an answer."""
    request = urllib.request.Request(address, data, headers or {})
    try:
        with urllib.request.urlopen(request) as reply:
            return reply.status, reply.headers, reply.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.headers, ""


def status(address, data=None, headers=None):
    return answer(address, data, headers)[0]


def let_in(address):
    """The cookie that an address gives, and the page to which it leads."""
    code, headers, text = answer(address)
    assert code == 200
    cookie, path, *attributes = headers["Set-Cookie"].split("; ")
    assert attributes == ["HttpOnly", "SameSite=Strict"]
    path = path.removeprefix("Path=")
    assert f"url={path}" in text
    return cookie, address.rsplit("/", 2)[0] + path
