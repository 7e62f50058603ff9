"""The pages of results: whole, self-contained, and of the numbers of the record."""

from __future__ import annotations

import html
import json
import math
import re
import shlex
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
import report_records
from conftest import python
from independent_motion import Reference, front_back

import curlfit
from curlfit import Finding
from curlfit.cli import app
from curlfit.html_report.direction import _curves
from curlfit.html_report.page import page_of
from curlfit.html_report.replay import replay_of_fit
from curlfit.inference.fit.curves import CurveModel
from curlfit.inference.information.verdict import Verdict
from curlfit.reports.fit import command_of
from curlfit.settings.choices import Fitting

KINDS = ("fit", "joint", "comparison", "profile", "prediction", "design")
HOSTILE = """</script>--><img src=x onerror="alert('1')">&<!--`\u2028'.csv"""
VOID = {"meta", "br", "input"}
MOST = 3_000_000  # characters


class Page(HTMLParser):
    """Elements of a page, which must close what it opens, with their
    attributes and texts."""

    def __init__(self, text):
        super().__init__()
        self.source = text
        self.open = []
        self.elements = []
        self.tables = []
        self.texts = {}
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        names = [name for name, _ in attrs]
        assert len(names) == len(set(names)), (tag, attrs)
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)
        if tag == "table":
            self.tables.append([])
        if tag == "tr":
            self.tables[-1].append([])
        if tag in ("th", "td"):
            self.tables[-1][-1].append("")

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        where = self.open[-1] if self.open else ""
        self.texts.setdefault(where, []).append(data)
        if {"th", "td"} & set(self.open):
            self.tables[-1][-1][-1] += data

    def of(self, tag):
        return [attributes for name, attributes in self.elements if name == tag]

    def values(self, name):
        return [
            attributes[name] for _, attributes in self.elements if name in attributes
        ]

    @property
    def data(self):
        embedded = re.search(r'id="data">(.*?)</script>', self.source, re.S)
        return json.loads(embedded[1])

    def table(self, head):
        """Rows of the table whose first heading is this."""
        (rows,) = [rows for rows in self.tables if rows[0][:1] == [head]]
        return rows


@pytest.fixture(scope="module")
def records(eq12):
    return report_records.of_all(eq12)


@pytest.fixture(scope="module")
def pages(records):
    chains = {"fit": records["chain"]}
    return {kind: Page(page_of(records[kind], chains.get(kind))) for kind in KINDS}


@pytest.mark.parametrize("kind", KINDS)
def test_a_page_is_whole_and_loads_nothing(pages, kind):
    page = pages[kind]
    assert len(page.source.encode()) < MOST
    ids = page.values("id")
    assert len(ids) == len(set(ids))
    anchors = set(ids)
    for name in ("for", "aria-labelledby"):
        for value in page.values(name):
            assert set(value.split()) <= anchors, value
    links = page.values("href")
    assert links
    for url in links:
        assert url.startswith("data:image/png;base64,") or url[1:] in anchors, url[:80]
        assert url[0] in "#d"
    assert not page.values("src")
    assert not page.of("link")
    for address in re.findall(r"url\(([^)]*)\)", page.source):
        assert address.startswith("#")
        assert address[1:] in anchors
    assert "@import" not in page.source
    assert not re.search(r"https?:", page.source)
    policy = [meta for meta in page.of("meta") if "http-equiv" in meta]
    directives = "default-src 'none'; base-uri 'none'; form-action 'none';"
    assert directives in policy[0]["content"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_page_can_be_read_without_eyes(pages, kind):
    page = pages[kind]
    assert page.of("html") == [{"lang": "en"}]
    for tag in ("main", "nav", "header", "footer", "h1", "title"):
        assert page.of(tag), tag
    assert page.texts["h2"][0] == "Finding"
    tables = len(page.tables)
    assert page.source.count("<caption>") == tables > 0
    heads = page.of("th")
    assert heads
    assert all(head.get("scope") in ("col", "row") for head in heads)
    for element in page.of("svg"):
        assert element["role"] == "img"
        assert element["aria-labelledby"] in page.values("id")
    for tag in ("input", "select"):
        for element in page.of(tag):
            assert element["id"] in page.values("for")
    for element in page.of("button"):
        assert element["type"] == "button"


def test_the_numbers_of_the_table_are_those_of_the_record(pages, records):
    fit = records["fit"]
    rows = {
        row[0].partition(" (")[0]: row for row in pages["fit"].table("parameter")[1:]
    }
    sums = {combination.expression: combination for combination in fit.combinations}
    assert rows.keys() == fit.parameters.keys() | sums.keys()
    for name, (_, shown, error, *_) in rows.items():
        estimate = fit.parameters.get(name) or sums[name]
        if name in ("mu1_eta", "mu2_eta"):
            assert (shown, error) == ("-", "-")
            continue
        for text, value in ((shown, estimate.value), (error, estimate.stderr)):
            digits = len(text.partition(".")[2])
            assert abs(float(text) - value) <= 0.51 * 10**-digits, name
        assert len(error.lstrip("0.")) == 2
    paragraphs = " ".join(pages["fit"].texts["p"])
    assert "mu1_eta and mu2_eta are not identifiable" in paragraphs
    for warning in fit.warnings:
        assert str(warning)[5:] in html.unescape(pages["fit"].source)


def test_lengths_are_in_metres_and_in_feet(pages, records):
    rows = {row[0]: row[1] for row in pages["fit"].table("along the fitted path")[1:]}
    metres, feet = (
        float(rows[f"curl to the left, at the end of the record ({unit})"])
        for unit in ("m", "ft")
    )
    assert metres == pytest.approx(-records["fit"].quantities["curl"].value, abs=1e-5)
    assert feet == pytest.approx(metres / 0.3048, abs=1e-4)


def test_the_stone_moves_along_the_path_of_the_record(pages, records):
    fit = records["fit"]
    data = pages["fit"].data["replay-0"]
    assert data["t"] == fit.observed["t"].tolist()
    # the file does not say where y = 0 is: the throw is drawn from the near hog
    # line, 10.059 m
    shift = 10.059 - fit.parameters["y0"].value
    np.testing.assert_allclose(data["y"], fit.fitted["y"] + shift, atol=6e-6)
    np.testing.assert_allclose(data["phi"], fit.fitted["phi"], atol=6e-6)
    off = fit.observed["y"] - fit.fitted["y"]
    shown = data["residuals"]["y"]
    assert shown["unit"] == "mm"
    np.testing.assert_allclose(shown["values"], 1000 * off, rtol=0.01, atol=0.01)


def test_a_parameter_that_one_throw_holds_is_free_in_the_others(records):
    fit = records["fit"]
    held = curlfit.fit(fit.throw, fix={"x0": fit["x0"].value}, details=False)
    shifted = replace(fit.throw, x=fit.throw.x + 1.0)
    other = CurveModel(curlfit.fit(shifted, details=False))
    ((_, moved),) = _curves([CurveModel(held), other], ["mu1_eta"], np.zeros((1, 1)))
    assert moved.chi_squared == other.at(other.fit.values).chi_squared


def test_every_path_along_a_null_direction_is_that_of_its_own_values(pages, records):
    """Against an integration that shares nothing with the program."""
    fit = records["fit"]
    data = pages["fit"].data["direction-0"]
    values = np.array(data["values"])
    assert data["names"] == ["mu1_eta", "mu2_eta"]
    np.testing.assert_allclose(values.sum(1), fit.combinations[0].value, atol=2e-9)
    assert values.min() == 0  # as far as the bounds let it
    assert np.ptp(values[:, 0]) == pytest.approx(fit.combinations[0].value, rel=1e-6)
    start = curlfit.InitialState(
        *(
            fit.parameters[name].value
            for name in ("x0", "y0", "heading", "v0", "phi0", "omega0")
        )
    )
    fixed = [fit.parameters[name].value for name in ("mu1_xi", "mu2_xi")]
    times = np.array(data["t"])[::8]

    def reference(*eta):
        law = front_back(*fixed, *eta)
        return Reference(law, R=fit.stone.R, rho=fit.stone.rho).path(start, times)

    assert data["scale"][1] < 0  # left is up, as from above
    y, x = np.array(data["paths"][0])[:, ::8]
    np.testing.assert_allclose([x, y], reference(*values[0])[:2], atol=3e-7)
    last = fit.parameters["mu2_eta"].value
    y, x = np.array(data["alone"][4])[:, ::8]
    np.testing.assert_allclose([x, y], reference(values[4, 0], last)[:2], atol=1e-4)

    paths = np.array(data["paths"])
    moved = np.hypot(*(paths - paths[data["start"]]).swapaxes(0, 1)).max()
    assert moved < 1e-7
    assert data["changes"][0]["text"].startswith("less than 0.0001 mm in position")
    alone = np.array(data["alone"][0]) - paths[data["start"]]
    distance = float(re.match(r"([\d.]+) m in position", data["apart"][0]["text"])[1])
    # the page has fewer instants than it takes the largest change of
    assert distance == pytest.approx(np.hypot(*alone).max(), rel=0.06)


def test_draws_come_to_rest_where_the_prediction_has_them(pages, records):
    prediction = records["prediction"]
    data = pages["prediction"].data["rests"]
    ends = np.array([[row[-1] for row in data[name]] for name in "xy"])
    assert ends.shape == (2, 60)
    spread = np.sqrt(np.diag(prediction.rest["both"]) / 60)
    assert (np.abs(ends.mean(1) - prediction.rest["mean"]) < 5 * spread).all()
    times = np.array(data["t"])
    y = np.array(data["y"])
    for row, rest in zip(y, data["rest"], strict=True):
        assert np.ptp(row[times >= rest]) == 0
        assert row[0] < 11 < 30 < row[-1]
    in_house = np.hypot(ends[0], ends[1] - data["tee"]) < 1.829 + 0.145
    assert data["inside"] == in_house.tolist()


def test_a_prediction_without_draws_has_no_animation_of_them(records):
    page = Page(page_of(replace(records["prediction"], sample={})))
    assert page.data.keys() == {"replay-0"}
    assert "without draws of the posterior" in page.source


def test_hostile_names_stay_text(records):
    fit = records["fit"]
    hostile = Finding.warning("text", text=HOSTILE)
    gap = {"x": np.where(fit.observed["t"] == 3.0, np.nan, fit.observed["x"])}
    named = replace(
        fit,
        data=replace(fit.data, file=HOSTILE, notes=(hostile,)),
        warnings=(hostile,),
        observed=fit.observed | gap,
    )
    page = Page(page_of(named))
    assert not page.of("img")
    assert len(page.of("script")) == 2
    assert HOSTILE in "".join(page.texts["td"])
    assert HOSTILE.rpartition("/")[2] in "".join(page.texts["h1"])
    assert page.data.keys() == {"direction-0", "replay-0"}
    embedded = re.search(r'id="data">(.*?)</script>', page.source, re.S)[1]
    assert not set("<>&\u2028") & set(embedded)
    assert "null" in embedded
    assert "NaN" not in embedded
    alike = replace(
        named, identifiability=replace(named.identifiability, null_directions=())
    )
    page = Page(page_of(replace(records["joint"], throws=(alike, alike))))
    assert not page.of("img")
    assert HOSTILE.rpartition("/")[2] in "".join(page.texts["h3"])


def test_what_is_not_determined_is_not_shown_at_an_instant(records):
    """A throw without angles: its handle is drawn, but no number is given of it."""
    fit = records["fit"]
    unseen = {
        name: replace(fit.parameters[name], verdict=Verdict.FIXED, stderr=None)
        for name in ("phi0",)
    }
    without = replace(
        fit,
        parameters=fit.parameters | unseen,
        rms={name: value for name, value in fit.rms.items() if name != "phi"},
    )
    replay = replay_of_fit(without, "replay")
    assert [row.name for row in replay.rows] == ["x", "y", "speed", "omega"]
    assert replay.where.endswith("Not determined, and drawn as assumed: angle.")


@pytest.fixture(scope="module")
def folder(tmp_path_factory, records):
    folder = tmp_path_factory.mktemp("saved")
    names = {"comparison": "compare", "prediction": "predict"}
    for kind in KINDS:
        if kind != "joint":
            name = names.get(kind, kind)
            (folder / kind).mkdir()
            records[kind].save(folder / kind / f"{name}.json")
    return folder


def test_pages_that_integrate_nothing_load_no_jax(folder):
    code = (
        "import sys, curlfit\n"
        "for kind in ('comparison', 'prediction'):\n"
        "    result = getattr(curlfit, f'load_{kind}')(kind)\n"
        "    curlfit.write_report(result, f'{kind}/report.html')\n"
        "print('jax' in sys.modules)"
    )
    done = python("-c", code, cwd=folder)
    assert (done.returncode, done.stdout) == (0, "False\n"), done.stderr


def test_the_command_writes_the_page_beside_the_result(folder, typed, monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    output = typed("report", "comparison", "--open")
    assert output == "Written: comparison/report.html\n"
    assert opened == [(folder / "comparison" / "report.html").as_uri()]
    text = (folder / "comparison" / "report.html").read_text(encoding="utf-8")
    assert text == page_of(curlfit.load_comparison(folder / "comparison"))
    assert (
        typed("report", "profile/profile.json", "--out", "new/a.html")
        == "Written: new/a.html\n"
    )
    assert (folder / "new" / "a.html").read_text().startswith("<!doctype html>")


def test_verbs_write_the_page_on_request(folder, typed):
    output = typed(
        "profile", "fit", "--param", "mu1_xi", "--points", 5, "--no-figures", "--report"
    )
    assert output.endswith("Written: fit-profile-mu1_xi/report.html\n")
    page = folder / "fit-profile-mu1_xi" / "report.html"
    assert page.is_file()
    typed("profile", "fit", "--param", "mu1_xi", "--points", 5, "--no-figures")
    assert not page.exists()  # it was of the earlier result
    assert (
        typed("predict", "fit", "--draws", 100, "--quiet", "--report", "--out", "p")
        == ""
    )
    assert "rests" in Page((folder / "p" / "report.html").read_text()).data


def test_only_results_have_pages():
    with pytest.raises(
        curlfit.InputError, match="a Stone has no report; expected a fit"
    ):
        curlfit.write_report(curlfit.Stone(), "a.html")


def test_the_command_on_the_page_makes_the_fit_again(eq12, folder, typed):
    fit = curlfit.fit(
        eq12,
        "coulomb",
        stone=curlfit.Stone(R=0.06),
        until=15,
        exclude=[(3, 4)],
        fix={"heading": -0.001},
        bounds={"mu": (0, 0.5)},
        systematics={"drag": 0.4},
    )
    line = command_of(fit)
    assert line.replace(" ", "</span> <span>") in html.unescape(page_of(fit))
    typed(*shlex.split(line)[1:], "--no-figures", "--quiet", "--out", "again")
    again = curlfit.load_fit(folder / "again")
    assert again.parameters == fit.parameters
    assert again.systematics == fit.systematics
    assert (again.law, again.stone) == (fit.law, fit.stone)


def test_flags_of_a_fit_give_the_same_choices():
    chosen = Fitting.of(
        fix={"mu1_xi": 0.001},
        bounds={"mu2_xi": (0, 0.2), "v0": (1, math.inf)},
        free=["slope_x"],
        priors={"rho": "0.1+-0.0025", "mu1_eta": "uniform:0.001,0.02"},
        exclude=[(1, 2), (3, 4.5)],
        swept=(5, 7),
        sigma={"x": 0.005},
        derive=["hypot(mu1_xi, mu2_xi)"],
        noise="ar1",
        since=-1,
        unbounded=True,
        stone={"R": 0.06},
        systematics={"all": 0},
        start={"omega0": -1.5},
    )
    _, bound, _ = app.parse_args(["fit", "a.csv", *chosen.words()])
    assert Fitting.of(vars(bound.kwargs["flags"])) == chosen
