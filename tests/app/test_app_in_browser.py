"""The page of `curlfit app` in Chromium: files are dropped, mended, fitted,
compared and saved."""

from __future__ import annotations

import json
import os
import re
import signal
import urllib.error
import urllib.request

import h5py
import numpy as np
import psutil
import pytest
from conftest import DATA, process, wait_for
from page_in_browser import (
    LINE,
    LONG,
    button,
    drop,
    fitted,
    in_report,
    press,
    put,
    said,
    save,
    shown_command,
    status,
    write,
    written,
)

import curlfit

pytestmark = pytest.mark.browser


def contents(folder):
    """The files of a folder: JSON and pages as they are, and the samples of chains."""
    by_name = {}
    for file in sorted(folder.rglob("*")):
        name = str(file.relative_to(folder))
        if file.suffix == ".json":
            by_name[name] = json.loads(file.read_text())
        elif file.suffix == ".html":
            by_name[name] = file.read_text()
        elif file.suffix == ".h5":
            with h5py.File(file) as chain:
                by_name[name] = float(np.sum(chain["mcmc/chain"]))
        elif file.is_file():
            by_name[name] = file.read_bytes()
    return by_name


def test_only_who_knows_the_address_sees_the_page(served):
    address = served.address
    root = address.rsplit("/", 2)[0]
    port = root.rsplit(":")[-1]
    for path in (
        "/",
        "/wrong/",
        "/_nicegui_ws/socket.io/?EIO=4&transport=polling",
        "/results/",
    ):
        assert status(root + path) == 404
    listening = psutil.Process(served.process.pid).net_connections("inet")
    assert {
        connection.laddr.ip for connection in listening if connection.status == "LISTEN"
    } == {"127.0.0.1"}
    refused = process("app", "--no-browser", "--port", port, cwd=served.folder)
    assert refused.returncode == 2
    assert refused.stderr.startswith(f"curlfit: --port {port}: ")


def test_a_good_file_is_fitted_and_saved_as_the_command_would(page, served, tmp_path):
    name = DATA.name
    folder = served.folder
    drop(page, DATA)
    wait_for(lambda: "230 rows in 22.9 s" in said(page))
    assert len(page.find_elements("css selector", ".seen svg")) == 3
    put(page, "--effective=200")
    words = ["fit", name, "--effective=200", "--report"]
    assert shown_command(page) == " ".join(["curlfit", *words])
    fitted(page)
    wait_for(lambda: in_report(page, "return !!document.querySelector('#replay-0')"))
    wait_for(lambda: in_report(page, "return document.body.offsetHeight") > 3000)
    inner = in_report(page, "return document.body.offsetHeight")
    wait_for(
        lambda: page.find_element("css selector", "iframe").rect["height"] >= inner
    )
    save(page, "mine")
    wait_for(lambda: f"Written: {folder / 'mine'}" in said(page))
    save(page, "mine")
    wait_for(lambda: "exists already; give another name" in said(page))

    (tmp_path / name).write_bytes(DATA.read_bytes())
    done = process(*words, cwd=tmp_path)
    assert done.returncode == 0
    assert contents(folder / "mine") == contents(tmp_path / f"{DATA.stem}-fit")
    script = "return performance.getEntriesByType('resource').map(one => one.name)"
    assert {
        url.split("/")[2]
        for url in page.execute_script(script)
        if url.startswith("http")
    } == {served.address.split("/")[2]}


def test_wrong_units_are_refused_in_the_words_of_the_command_and_mended_by_a_button(
    page, tmp_path
):
    lines = DATA.read_text().splitlines()
    head = lines.index("t,x,y,phi")
    rows = [list(map(float, line.split(","))) for line in lines[head + 1 :]]
    file = tmp_path / "feet.csv"
    rows = [f"{t},{x / 0.3048:.6f},{y / 0.3048:.6f},{phi}" for t, x, y, phi in rows]
    file.write_text("\n".join(["# until = 20", lines[head], *rows]))
    refused = process("fit", file.name, cwd=tmp_path)
    assert refused.returncode == 2
    drop(page, file)
    sentence = refused.stderr.strip().removeprefix("curlfit: ").replace("`", "")
    wait_for(lambda: sentence in " ".join(said(page).split()))
    assert button(page, "Fit", "button.disabled")
    press(page, "Apply --units length=ft")
    wait_for(lambda: "a path of 25 m" in said(page))
    assert not page.find_elements("css selector", ".bad")
    assert written(page) == "--units length=ft"
    put(page, "--no-sample")
    write(page, "R=0.054", "Stone")
    wait_for(lambda: "--stone=R=0.054" in shown_command(page))
    fitted(page)
    save(page, "mended")
    wait_for(lambda: "Written: " in said(page))
    folder = re.search(r"Written: (\S+)", said(page))[1]
    assert curlfit.load_fit(folder)["mu2_xi"].value == pytest.approx(0.0556, abs=5e-4)


def test_pixels_ask_for_the_points_and_take_them(page, tmp_path):
    # a camera that looks straight down: 40 pixels to the metre, seen from the side
    t, x, y, phi = np.loadtxt(DATA, delimiter=",", comments=("#", "t")).T
    pixels = np.column_stack([t, 100 + 40 * y, 300 + 40 * x, phi])
    np.savetxt(
        tmp_path / "clip.csv", pixels, delimiter=",", header="t,u,v,phi", comments=""
    )
    corners = [(0, -2), (25, -2), (25, 2), (0, 2), (12, 0)]
    points = [(100 + 40 * b, 300 + 40 * a, a, b) for b, a in corners]
    np.savetxt(
        tmp_path / "points.csv", points, delimiter=",", header="u,v,x,y", comments=""
    )
    drop(page, tmp_path / "clip.csv")
    wait_for(lambda: "positions are in pixels" in said(page))
    drop(page, tmp_path / "points.csv", onto=".bad .beside")
    wait_for(lambda: "a path of 25 m" in said(page))
    assert "--reference points.csv" in shown_command(page)
    assert "5 points of points.csv" in said(page)


def test_a_table_of_stopwatch_times_is_fitted_jointly(page, served):
    drop(page, DATA.parent / "two_sheets.csv")
    wait_for(lambda: "throws, which are fitted together" in said(page))
    rows = page.find_elements("css selector", ".seen tbody tr")
    assert len(rows) == len(curlfit.load_throws(DATA.parent / "two_sheets.csv"))
    put(page, "--by sheet --no-sample")
    fitted(page)
    save(page, "sheets")
    wait_for(lambda: "Written: " in said(page))
    joint = curlfit.load_joint(served.folder / "sheets")
    assert joint.groups
    assert len(joint.throws) == len(rows)


def test_laws_are_compared_for_a_table_of_friction(page):
    drop(page, DATA.parent / "sutor_1988_friction.csv")
    wait_for(lambda: "13 values of friction" in said(page))
    fitted(page, "Compare laws")
    wait_for(
        lambda: "stribeck" in (in_report(page, "return document.body.innerText") or "")
    )


def test_law_stone_and_options_are_those_of_the_command(page, served):
    drop(page, DATA)
    wait_for(lambda: "230 rows" in said(page))
    fields = page.find_elements("css selector", "section input[type=text]")
    labels = [field.get_attribute("aria-label") for field in fields]
    assert labels == ["Law", "Stone", LINE]
    assert not page.find_elements("css selector", "select, input[type=checkbox]")
    write(page, "coulomb", "Law")
    put(page, "--until 18 --derive 'mu*1'")
    line = f"curlfit fit {DATA.name} --law=coulomb --until 18 --derive 'mu*1' --report"
    assert shown_command(page) == line
    summaries = page.find_elements("css selector", "summary")
    (options,) = [
        summary for summary in summaries if summary.text.startswith("All options")
    ]
    assert "--max-steps" not in said(page)
    options.click()
    assert "--max-steps" in said(page)
    write(page, "--unti 18")
    wait_for(lambda: "Unknown option: --unti. Did you mean --until?" in said(page))
    assert button(page, "Fit", "button.disabled")
    assert "230 rows" in said(page)  # what was read stays
    write(page, "`--as-given`")
    wait_for(lambda: "`--as-given`: expected an option" in said(page))
    assert not button(page, "Apply --as-given", "!!button")
    write(page, "--no-sample")
    wait_for(lambda: "230 rows" in said(page))
    fitted(page)
    text = "return document.body.innerText"
    wait_for(lambda: "coulomb law" in (in_report(page, text) or ""))


def test_a_bad_file_is_refused_and_a_second_one_replaces_it(page, served, tmp_path):
    (tmp_path / "bad.csv").write_text("t,x,y\n0,0,0\n1,zero,2\n")
    refused = (
        process("fit", "bad.csv", cwd=tmp_path).stderr.strip().removeprefix("curlfit: ")
    )
    drop(page, tmp_path / "bad.csv")
    wait_for(lambda: refused in " ".join(said(page).split()))
    assert "Traceback" not in said(page)
    kept = psutil.Process(served.process.pid).cwd()
    assert "curlfit-app" in kept
    assert os.listdir(kept) == ["bad.csv"]
    drop(page, DATA)
    wait_for(lambda: "230 rows" in said(page))
    assert os.listdir(kept) == [DATA.name]
    assert not page.find_elements("css selector", ".bad")


@pytest.mark.parametrize("width", [1280, 390])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_page_fits_the_screen(page, width, scheme):
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    page.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    drop(page, DATA)
    wait_for(lambda: "230 rows" in said(page))
    page.execute_script(
        "document.querySelectorAll('details').forEach(one => one.open = true)"
    )
    scrolled = page.execute_script("return document.documentElement.scrollWidth")
    assert scrolled <= width
    script = (
        "return [document.body, document.querySelector('main p')].map((one, k) => "
        "getComputedStyle(one)[k ? 'color' : 'backgroundColor'].match(/[0-9]+/g)"
        ".slice(0, 3).reduce((sum, one) => sum + +one, 0) / 3)"
    )
    paper, ink = page.execute_script(script)
    assert (paper > ink + 100) == (scheme == "light")
    assert abs(paper - ink) > 100


def test_work_can_be_stopped_and_ctrl_c_leaves_nothing(page, served):
    process = served.process
    address = served.address
    server = psutil.Process(process.pid)
    kept = server.cwd()
    drop(page, DATA)
    wait_for(lambda: "230 rows" in said(page))
    for ending in ("stop", "end"):
        press(page, "Compare laws")
        wait_for(lambda: "At work" in said(page) and "Fitting" in said(page), LONG)
        assert server.children()
        if ending == "stop":
            press(page, "Stop")
            wait_for(lambda: "At work" not in said(page) and not server.children(), 60)
            assert not page.find_elements("css selector", ".result")
    below = server.children(recursive=True)
    page.get("about:blank")
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=30) == 0
    wait_for(lambda: not any(child.is_running() for child in below), 20)
    assert not os.path.exists(kept)
    with pytest.raises(urllib.error.URLError, match="refused"):
        urllib.request.urlopen(address)
