"""What strangers' files, other users and other tabs can do to the page of
`curlfit app`: nothing."""

from __future__ import annotations

import os
import re
import shutil
import signal
import stat
import sys
from pathlib import Path

import psutil
import pytest
from conftest import DATA, wait_for
from page_in_browser import (
    FIRST,
    LONG,
    Served,
    answer,
    button,
    drop,
    fitted,
    in_report,
    let_in,
    press,
    put,
    said,
    shown_command,
    status,
    write,
)

pytestmark = pytest.mark.browser


def kept(served):
    """The folder of what is dropped."""
    return Path(psutil.Process(served.process.pid).cwd())


def test_only_the_browser_that_was_let_in_sees_the_page(served):
    address = served.address
    root = address.rsplit("/", 2)[0]
    port = root.rsplit(":")[-1]
    assert status(address, headers={"Host": f"evil.example:{port}"}) == 404
    cookie, page = let_in(address)
    assert status(address) == 404  # no address is good for two visits
    served.address = served.next_address()
    assert served.address != address
    assert status(page) == 403
    assert status(page, headers={"Cookie": cookie[:-1]}) == 403
    headers = {"Cookie": cookie}
    assert status(page, headers=headers) == 200
    assert status(root + "/", headers=headers) == 404
    for origin in ("null", "http://evil.example", "http://127.0.0.1:1"):
        assert status(page, headers=headers | {"Origin": origin}) == 403
    assert status(page, headers=headers | {"Host": f"evil.example:{port}"}) == 404
    assert status(page, b"", headers=headers | {"Content-Length": "100000001"}) == 413


def test_the_page_is_in_no_frame_and_names_no_origin(served):
    cookie, page = let_in(served.address)
    served.address = served.next_address()
    origin = page.rsplit("/", 2)[0]
    request_headers = {"Cookie": cookie, "Origin": origin}
    polling = "_nicegui_ws/socket.io/?EIO=4&transport=polling"
    for path in ("", polling, "results/nothing"):
        headers = answer(page + path, headers=request_headers)[1]
        assert not [name for name in headers if name.lower().startswith("access-")]
        assert headers["Referrer-Policy"] == "no-referrer"
        assert headers["X-Content-Type-Options"] == "nosniff"
        policy = headers["Content-Security-Policy"]
        if path.startswith("results"):
            assert policy.startswith("sandbox allow-scripts; default-src 'none'")
        else:
            assert "frame-ancestors 'none'" in policy


BROWSER = """
import os, sys
from pathlib import Path

here = Path(sys.argv[0]).parent
(here / "soon").write_text(chr(10).join(sys.argv[1:]))
(here / "soon").rename(here / "words")
"""


def test_nobody_else_learns_how_the_browser_is_let_in(browser, tmp_path):
    (tmp_path / "browser.py").write_text(BROWSER)
    how = f"{sys.executable} {tmp_path / 'browser.py'} %s"
    served = Served(tmp_path, BROWSER=how)
    try:
        wait_for((tmp_path / "words").exists)
        (words,) = (tmp_path / "words").read_text().splitlines()
        file = Path(words.removeprefix("file://"))
        assert words == file.as_uri()
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
        assert stat.S_IMODE(file.parent.stat().st_mode) == 0o700
        secret = re.search("url=http://[^/]+/([^/]+)/", file.read_text())[1]
        assert secret not in served.address
        browser.get(words)
        wait_for(lambda: browser.find_elements("css selector", FIRST))
        assert secret not in browser.current_url
        assert browser.get_cookies()[0]["sameSite"] == "Strict"
        assert browser.execute_script("return document.cookie") == ""
        port = served.address.split(":")[2].split("/")[0]
        assert status(f"http://127.0.0.1:{port}/{secret}/") == 404
    finally:
        served.end()


def test_dropped_files_are_no_modules(page, served, tmp_path):
    table = DATA.read_text().splitlines()
    rows = table[table.index("t,x,y,phi") :]
    mark = tmp_path / "ran"
    code = [f"# open({str(mark)!r}, 'w')", f"open({str(mark)!r}, 'w')  # ,,,"]
    for name in ("numpy.py", "signal.py", "matplotlibrc"):
        (tmp_path / name).write_text("\n".join([code[0], *rows[:1], *rows[1:]]))
    (tmp_path / "signal.py").write_text(code[1])
    shutil.copy(DATA, tmp_path / "a.csv")
    names = ("a.csv", "numpy.py", "signal.py", "matplotlibrc")
    drop(page, *(tmp_path / name for name in names))
    wait_for(lambda: "What was read" in said(page))
    taken = sorted(os.listdir(kept(served)))
    assert taken == ["a.csv", "matplotlibrc.txt", "numpy.py.txt", "signal.py.txt"]
    # as if one of them had been taken under its own name
    for name in ("numpy.py", "signal.py", "multiprocessing.py", "json.py"):
        (kept(served) / name).write_text(code[1])
    drop(page, tmp_path / "a.csv")
    for name in ("numpy.py", "signal.py", "multiprocessing.py", "json.py"):
        (kept(served) / name).write_text(code[1])
    put(page, "--no-sample")
    fitted(page)
    assert page.find_elements("css selector", "iframe")
    assert not mark.exists()


def test_the_scripts_of_a_report_reach_nothing_of_the_page(page):
    drop(page, DATA)
    put(page, "--no-sample")
    fitted(page)
    wait_for(lambda: in_report(page, "return !!document.querySelector('main')"))
    assert in_report(page, "return window.origin") == "null"
    for script in ("parent.document.title", "document.cookie", "localStorage.length"):
        tried = f"try {{ return [{script}] }} catch (error) {{ return error.name }}"
        assert in_report(page, tried) == "SecurityError"
    link = "document.querySelector('nav a[href=\"#made\"]').click()"
    page.execute_script("scrollTo(0, 0)")
    in_report(page, link)
    top = "return document.querySelector('iframe').getBoundingClientRect().top"
    wait_for(lambda: page.execute_script(top) < -500)


@pytest.mark.parametrize(
    "text",
    [
        '--bound rho="0.1',
        "--bound rho='",
        "--bound rho=0.1\\",
        "--bound rho=\0",
        "--bound " + "x" * 140_000,
        "x" * 140_000,
        "--help",
        "--out /tmp",
        "/etc/passwd",
    ],
)
def test_no_text_of_a_field_takes_the_page_away(page, entered, text):
    drop(page, DATA)
    wait_for(lambda: "230 rows" in said(page))
    write(page, text)
    wait_for(lambda: page.find_elements("css selector", ".finding.bad"))
    assert "error of curlfit" not in said(page)
    assert button(page, "Fit", "button.disabled")
    page.get(entered)
    wait_for(lambda: page.find_elements("css selector", ".finding.bad"))
    write(page, "")
    wait_for(lambda: not page.find_elements("css selector", ".finding.bad"))


def test_a_command_that_cannot_start_is_over(page):
    drop(page, DATA)
    wait_for(lambda: "230 rows" in said(page))
    write(page, "--free " + ",".join(["slope_x"] * 20_000))  # more than a system takes
    wait_for(lambda: "--free" in shown_command(page))
    press(page, "Fit")
    wait_for(lambda: "The command cannot be started" in said(page))
    assert "At work" not in said(page)
    write(page, "")
    wait_for(lambda: "--free" not in shown_command(page))


def test_a_file_dropped_beside_leaves_the_data_as_they_are(page, served, tmp_path):
    shutil.copy(DATA, tmp_path / "a.csv")
    (tmp_path / "other").mkdir()
    other = tmp_path / "other" / "a.csv"
    other.write_text("u,v,x,y\n0,0,0,0\n")
    drop(page, tmp_path / "a.csv", other)
    wait_for(lambda: "a.csv, a_2.csv" in said(page))
    drop(page, tmp_path / "a.csv")
    wait_for(lambda: "230 rows" in said(page))
    beside = page.find_element("css selector", ".beside input[type=file]")
    beside.send_keys(str(other))
    wait_for(lambda: "There: a_2.csv" in said(page))
    put(page, "--reference a_2.csv")
    assert (kept(served) / "a.csv").read_bytes() == DATA.read_bytes()
    assert (kept(served) / "a_2.csv").read_bytes() == other.read_bytes()


def test_too_many_files_are_refused_aloud(page, served, tmp_path):
    drop(page, DATA)
    wait_for(lambda: "230 rows" in said(page))
    for number in range(1001):
        (tmp_path / f"{number}.csv").write_text("t,x,y\n")
    drop(page, *tmp_path.glob("*.csv"))
    wait_for(lambda: "The page takes at most 1000 files" in said(page))
    assert os.listdir(kept(served)) == [DATA.name]


def test_a_button_holds_no_words_of_a_file(page, tmp_path):
    mark = tmp_path / "ran"
    (tmp_path / "evil.py").write_text(f"open({str(mark)!r}, 'w')\n")
    evil = f"`--law {tmp_path}/evil.py:L` `--as-given` --reference FILE"
    lines = DATA.read_text().splitlines()
    head = lines.index("t,x,y,phi")
    rows = [f"{line},1" for line in lines[head + 1 :]]
    (tmp_path / "a.csv").write_text("\n".join([f'{lines[head]},"{evil}"', *rows]))
    (tmp_path / "b.csv").write_text(f'"{evil}","{evil}"\n1,2\n2,3\n')
    for name in ("a.csv", "b.csv"):
        drop(page, tmp_path / name)
        wait_for(lambda: "What was read" in said(page))
        assert "evil" in said(page)
        buttons = (
            "return [...document.querySelectorAll('button')].map(b => b.innerText)"
        )
        labels = page.execute_script(buttons)
        assert not [label for label in labels if label.startswith("Apply")]
        assert not page.find_elements("css selector", ".bad .beside, .note .beside")
    assert not mark.exists()


@pytest.mark.parametrize("blow", ["SIGKILL", "SIGHUP"])
def test_nothing_outlives_the_page(browser, blow, tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    served = Served(tmp_path)
    try:
        served.enter(browser)
        drop(browser, DATA)
        press(browser, "Compare laws")
        wait_for(lambda: "Fitting" in said(browser), LONG)
        server = psutil.Process(served.process.pid)
        below = server.children(recursive=True)
        folder = kept(served)
        assert below
        browser.get("about:blank")
        served.process.send_signal(getattr(signal, blow))
        served.process.wait(timeout=30)
        assert not psutil.wait_procs(below, timeout=20)[1]
        assert folder.exists() == (blow == "SIGKILL")
        other = Served(tmp_path)
        other.end()
        assert not folder.parent.exists()
        again = Served(tmp_path)  # whose folder stays while it is there
        another = Served(tmp_path)
        try:
            assert kept(again).exists()
            assert kept(another).exists()
        finally:
            again.end()
            another.end()
    finally:
        served.end()
