"""`curlfit export`: tables, JSON, netCDF and LaTeX of saved results."""

from __future__ import annotations

import csv
import json
import re
import warnings
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from conftest import started
from scipy import stats

import curlfit
from curlfit.comparison.tables import candidates_csv, candidates_table
from curlfit.export.tables import (
    estimates_table,
    parameters_csv,
    path_csv,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, eq12, eq12_fit):
    """A fit, a joint fit of two throws, and a sampled one."""
    folder = tmp_path_factory.mktemp("export")
    throws = [replace(eq12, name=name, reference=None) for name in ("a.csv", "b.csv")]
    joint = curlfit.fit_together(throws).with_derived(["mu2_xi*g"])
    for name in ("plain", "joint", "joint/a", "joint/b", "sampled"):
        (folder / name).mkdir()
    joint.save(folder / "joint" / "joint.json")
    for name, throw_fit in zip("ab", joint.throws, strict=True):
        throw_fit.save(folder / "joint" / name / "fit.json")
    eq12_fit.with_derived(["mu2_xi - mu1_xi", "mu1_eta/mu2_eta"]).save(
        folder / "plain/fit.json"
    )
    fit, chain = curlfit.sample(eq12_fit, effective=300, seed=1)
    fit.save(folder / "sampled" / "fit.json")
    chain.save(folder / "sampled" / "chain.h5")
    return folder


def rows(text):
    return list(csv.DictReader(StringIO(text)))


def test_parameters_are_those_of_the_fit(eq12_fit):
    fit = eq12_fit.with_derived(["mu2_xi - mu1_xi"])
    row_of = {row["name"]: row for row in rows(parameters_csv(fit))}
    assert list(row_of)[:5] == [
        "mu1_xi",
        "mu2_xi",
        "mu1_eta",
        "mu2_eta",
        "mu1_eta + mu2_eta",
    ]
    for name in ("mu2_xi", "v0", "mu1_eta + mu2_eta", "mu2_xi - mu1_xi"):
        row = row_of[name]
        estimate = fit[name]
        assert float(row["value"]) == estimate.value
        assert float(row["stderr"]) == estimate.stderr
        assert (float(row["low_95"]), float(row["high_95"])) == estimate.interval()
    assert row_of["mu1_eta"] | {"unit": ""} == dict.fromkeys(row_of["mu1_eta"], "") | {
        "name": "mu1_eta",
        "verdict": "not identifiable",
    }
    assert float(row_of["mu2_xi"]["systematic"]) == fit.systematics.errors["mu2_xi"]
    assert float(row_of["curl"]["value"]) == fit.quantities["curl"].value


def test_the_path_has_its_residuals(eq12_fit):
    table = rows(path_csv([eq12_fit]))
    assert len(table) == 201
    for name in ("x", "y", "phi"):
        observed, fitted, left = (
            np.array([float(row[key]) for row in table])
            for key in (name, f"{name}_fitted", f"{name}_residual")
        )
        np.testing.assert_array_equal(observed, eq12_fit.observed[name])
        np.testing.assert_array_equal(fitted, eq12_fit.fitted[name])
        np.testing.assert_array_equal(left, eq12_fit.residuals[name])
    gap = eq12_fit.observed | {
        "x": np.where(np.arange(201) == 3, np.nan, eq12_fit.observed["x"])
    }
    assert rows(path_csv([replace(eq12_fit, observed=gap)]))[3]["x_residual"] == ""


def test_every_form_is_written(typed, folder):
    output = typed(
        "export",
        "plain",
        "--to",
        "csv",
        "--to",
        "json",
        "--to",
        "latex",
        "--out",
        "one",
    )
    names = ["parameters.csv", "path.csv", "fit.json", "table.tex"]
    assert output == "Written: " + ", ".join(f"one/{name}" for name in names) + "\n"
    shown = json.loads(typed("show", "plain", "--json"))
    assert json.loads((folder / "one/fit.json").read_text()) == shown
    typed("export", "joint", "--to", "csv", "--to", "latex", "--to", "json")
    table = rows((folder / "joint-export/parameters.csv").read_text())
    assert [row["throw"] for row in table if row["name"] == "mu2_xi"] == ["all"]
    assert [row["throw"] for row in table if row["name"] == "v0"] == ["a.csv", "b.csv"]
    shared = [row["name"] for row in table if row["throw"] == "all"]
    assert shared[-2:] == ["mu1_eta + mu2_eta", "mu2_xi*g"]
    path = rows((folder / "joint-export/path.csv").read_text())
    assert {row["throw"] for row in path} == {"a.csv", "b.csv"}


@pytest.mark.numerical  # on the newest Python, whose ArviZ is 1.x
def test_the_posterior_goes_to_arviz(typed, folder):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of ArviZ about its next version
        typed("export", "sampled", "--to", "netcdf")
        import arviz

        data = arviz.from_netcdf(
            str(folder / "sampled-export/posterior.nc"), engine="h5netcdf"
        )
    chain = curlfit.load_chain(folder / "sampled" / "chain.h5")
    assert float(data["posterior"]["mu2_xi"].mean()) == pytest.approx(
        chain.of({"mu2_xi": 1.0}).mean(), rel=1e-4
    )
    assert data["posterior"].sizes["chain"] == chain.ensembles
    for group in ("posterior_predictive", "observed_data", "constant_data"):
        assert {"x", "y", "phi"} & {
            name.removeprefix("sigma_") for name in data[group].data_vars
        }
    assert data.attrs["law"] == "front-back"
    data.close()


NETCDF = ("export", "sampled", "--to", "netcdf", "--out", "out")


@pytest.mark.parametrize(
    ("words", "file", "left"),
    [
        pytest.param(NETCDF, "out/posterior.nc", [], marks=pytest.mark.slow),
        (("example", "out"), "out/data/jensen_shegelski_2004.csv", ["camera_1.csv"]),
    ],
)
def test_on_a_full_disk_no_half_file_is_left(folder, words, file, left):
    run = started(*words, cwd=folder, room=6000)
    _, err = run.communicate(timeout=100)
    message = f"curlfit: {file}: cannot be written (File too large)\n"
    assert (run.returncode, err) == (2, message)
    names = [path.name for path in (folder / file).parent.iterdir()]
    assert set(names) >= set(left)
    assert not [name for name in names if name.startswith(".") or name in file]


@pytest.mark.numerical
def test_priors_and_likelihood_are_those_of_the_chain(eq12):
    """Their logarithms sum to that of the sampled density but for a constant."""
    priors = {"mu2_xi": "0.05563+-0.00002", "mu1_xi": "lognormal:0.0004,0.5"}
    fit, chain = curlfit.sample(curlfit.fit(eq12, priors=priors), effective=300)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        data = chain.to_arviz(draws=600)
        import arviz
    prior = data["log_prior"]
    assert set(prior.data_vars) == set(
        fit.parameter_set.names_where(fit.parameter_set.free)
    )
    assert not np.any(prior["v0"])
    total = sum(prior[name] for name in prior.data_vars)
    for name in ("x", "y", "phi"):
        total = total + data["log_likelihood"][name].sum("time")
    off = data["sample_stats"]["lp"] - total
    np.testing.assert_allclose(off, float(off.mean()), atol=1e-6)
    for name, density in (
        ("mu2_xi", stats.norm(0.05563, 0.00002)),
        ("mu1_xi", stats.lognorm(0.5, scale=0.0004)),
    ):
        expected = density.logpdf(data["posterior"][name])
        np.testing.assert_allclose(
            prior[name] - prior[name].mean(), expected - expected.mean(), atol=1e-9
        )
    sense = getattr(arviz, "psense", None) or arviz.psens
    sensitivity = sense(data)
    assert max(sensitivity, key=lambda name: float(sensitivity[name])) == "mu2_xi"


# --- LaTeX, read by a strict parser

_KNOWN = {
    "begin",
    "end",
    "centering",
    "caption",
    "toprule",
    "midrule",
    "bottomrule",
    "mu",
    "xi",
    "eta",
    "beta",
    "varphi",
    "omega",
    "rho",
    "mathrm",
    "texttt",
    "times",
    "pm",
    "Delta",
    "textbackslash",
    "textasciitilde",
    "textasciicircum",
}


def cells(text):
    """Rows of the table's cells; fails where TeX would."""
    body = re.sub(r"(?<!\\)%.*", "", text)
    depth = 0
    math = False
    opened = []
    tokens = re.findall(r"\\[a-zA-Z]+|\\.|\\\n|.|\n", body)
    for token in tokens:
        if token == "{":
            depth += 1
        elif token == "}":
            depth -= 1
        elif token == "$":
            math = not math
        elif token in ("_", "^"):
            assert math, f"{token} outside of mathematics"
        elif token == "#":
            raise AssertionError("a bare #")
        elif re.fullmatch(r"\\[a-zA-Z]+", token):
            assert token[1:] in _KNOWN, token
        elif token in ("&", "\\\\"):
            assert depth == 0
            assert not math, f"{token} within mathematics"
        elif token == "\n":
            assert not math, "mathematics does not end in its line"
        assert depth >= 0
    assert (depth, math) == (0, False)
    # no two subscripts of one symbol
    for formula in re.findall(r"(?<!\\)\$(.*?)(?<!\\)\$", body):
        assert not re.search(r"_\w+_|_\{[^}]*\}_", formula.replace(r"\_", "")), formula
    for kind, name in re.findall(r"\\(begin|end)\{(\w+)\}", body):
        if kind == "begin":
            opened.append(name)
        else:
            assert opened.pop() == name
    assert not opened
    (spec,) = re.findall(r"\\begin\{tabular\}\{@\{\}([lr ]+)@\{\}\}", body)
    inside = body[body.index(r"\toprule") + 8 : body.index(r"\bottomrule")].replace(
        r"\midrule", ""
    )
    table = [
        re.split(r"(?<!\\)&", row) for row in re.split(r"\\\\\n", inside) if row.strip()
    ]
    assert {len(row) for row in table} == {len(spec.split())}
    return [[cell.strip() for cell in row] for row in table]


def test_the_table_of_a_paper(eq12_fit):
    """Eq. 12 deviates to the left, by 0.84 m at its end."""
    text = estimates_table(eq12_fit.with_derived(["mu2_xi - mu1_xi", "sqrt(mu1_xi)"]))
    head, *body = cells(text)
    assert head == ["parameter", "estimate", "systematic", "unit"]
    row_of = {row[0]: row[1:] for row in body}
    assert row_of[r"$\mu_{2\xi}$"][:2] == ["$0.055627(25)$", "$0.0052$"]
    assert row_of[r"$\mu_{1\eta}$"] == ["not identifiable", "", ""]
    assert row_of[r"$\mu_{1\eta} + \mu_{2\eta}$"][0] == "$0.017573(16)$"
    assert row_of[r"$v_0$"][2] == r"$\mathrm{m}\,\mathrm{s}^{-1}$"
    assert r"$\mu_{2\xi}-\mu_{1\xi}$" in row_of
    assert r"\texttt{sqrt(mu1\_xi)}" in row_of
    curl = eq12_fit.quantities["curl"].value
    assert curl < 0
    (curl_text,) = (
        cell
        for name, (cell, *_) in row_of.items()
        if name.startswith("curl to the left")
    )
    assert curl_text.startswith(f"${-curl:.4f}")
    assert not any("to the right" in name for name in row_of)
    assert (
        r"the front-back law under uniform load, fitted to jensen\_shegelski\_2004.csv"
        in text
    )
    assert r"$R = 0.054$\,m" in text
    assert f"curlfit {curlfit.__version__}" in text


def test_names_that_tex_would_trip_over(eq12_fit):
    odd = replace(
        eq12_fit.parameters["mu1_xi"],
        symbol=r"\mathrm{a_b_c}",
        unit="1/m^2",
        value=3e12,
    )
    fit = replace(
        eq12_fit,
        law="50%_law#{",
        data=replace(eq12_fit.data, file="a/b & ~c^2$%_{.csv"),
        parameters={"a_b_c": odd} | eq12_fit.parameters,
    )
    row_of = {row[0]: row for row in cells(estimates_table(fit))}
    assert row_of[r"$\mathrm{a\_b\_c}$"][-1] == r"$\mathrm{m}^{-2}$"
    assert r"\times 10^{12}" in row_of[r"$\mathrm{a\_b\_c}$"][1]


def test_a_joint_fit_and_a_posterior_in_latex(folder):
    joint = curlfit.load_joint(folder / "joint")
    assert "2 throws together" in estimates_table(joint)
    assert r"$\mu_{1\xi}$" in [row[0] for row in cells(estimates_table(joint))]
    head, first, *_ = cells(estimates_table(curlfit.load_fit(folder / "sampled")))
    assert head[3] == r"68\,\% of posterior"
    assert re.fullmatch(r"\$0.00\d+\$ to \$0.00\d+\$", first[3])


def test_a_comparison(eq12_fit):
    from curlfit.comparison.result import Candidate, Comparison

    size = {"x": 0.001, "y": 0.02, "phi": 0.003}
    fitted = Candidate(
        "front-back",
        "uniform",
        False,
        False,
        "converged",
        True,
        coefficients={"mu1_xi": {"value": 0.0005}},
        n_parameters=11.0,
        rms=size,
        follows=True,
        bic=3.0,
        delta_bic=0.0,
        delta_aicc=-1.5,
        rank=1,
    )
    failed = Candidate("radial", "-", False, True, "no motion", follows=None)
    comparison = Comparison(
        data=replace(eq12_fit.data, file="a_b.csv"),
        stone=eq12_fit.stone,
        curl=0.1,
        side="left",
        candidates=(fitted, failed),
        observed={},
    )
    _, first, second = cells(candidates_table(comparison))
    assert first[:5] == ["front-back", "uniform", "11", "$0.0$", "$-1.5$"]
    assert first[5:] == ["$1$", "$20$", "$3$", "yes"]
    assert second == ["radial (any sign)", "--", *[""] * 6, "no fit"]
    fitted_row, failed_row = rows(candidates_csv(comparison))
    entries = fitted_row["law"], fitted_row["rms_y"], fitted_row["coefficients"]
    assert entries == ("front-back", "0.02", "mu1_xi = 0.0005")
    assert failed_row["rank"] == failed_row["rms_x"] == ""
