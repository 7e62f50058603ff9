"""Results in a notebook: examples of docstrings, `repr`, HTML, tables, ArviZ, sliders.

All is about the results that the examples of the public names compute.
"""

from __future__ import annotations

import io
import pickle
import re
import shutil
import sys
import tomllib
import warnings
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from conftest import command
from docstring_examples import run_examples
from scipy import stats

import curlfit
from curlfit import Finding
from curlfit.errors import InputError
from curlfit.inference.model.problem import LEVEL_AND_STILL, Problem
from curlfit.inference.noise.whitening import Whitener
from curlfit.inference.sampling.arviz_export import (
    draw_noise,
    log_likelihoods,
    whitening_matrix,
)
from curlfit.losses import LOSSES
from curlfit.noises import Ar1
from curlfit.output import html
from curlfit.stone import Stone

pytestmark = pytest.mark.documentation

ROOT = Path(__file__).parents[2]
# a dictionary and a text have no docstring of their own
WITHOUT = {"LAWS", "__version__"}
# tests/paper, which has the computation at hand
ELSEWHERE = {"reproduce", "Reproduction"}
SHOWN = (
    "throw",
    "fit",
    "sampled",
    "posterior",
    "chain",
    "joint",
    "comparison",
    "prediction",
    "plan",
    "between",
    "profile",
    "pair",
    "flat",
    "path",
    "friction",
)


FIRST = (
    "load_throw",
    "fit",
    "sample",
    "fit_together",
    "compare",
    "predict",
    "design",
    "discriminate",
    "profile",
    "fit_friction",
)
"""Names whose examples define what those of others use."""


@pytest.fixture(scope="module")
def known(tmp_path_factory):
    """What the examples define, in the order of use, with the folder and
    what failed."""
    folder = tmp_path_factory.mktemp("examples")
    shutil.copytree(ROOT / "data", folder / "data")
    namespace = {"curlfit": curlfit, "np": np}
    failures = []
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for name in (*FIRST, *sorted({*curlfit.__all__} - {*FIRST})):
            if name in WITHOUT | ELSEWHERE:
                continue
            if name == "fit_season":
                words = [
                    "data/two_sheets.csv",
                    "--law",
                    "front-back",
                    "--out",
                    "season.csv",
                ]
                command("batch", *words, "--workers", 1, cwd=folder)
            if name == "load_joint":  # as `curlfit fit A B --out joint` leaves it
                joint = namespace["joint"]
                throw_folder = folder / "joint" / Path(joint.throws[0].data.file).stem
                throw_folder.mkdir(parents=True)
                joint.save(folder / "joint" / "joint.json")
                joint.throws[0].save(throw_folder / "fit.json")
            failures.append(run_examples(name, namespace))
        namespace["flat"] = curlfit.profile(namespace["fit"], "mu1_eta", points=5)
    namespace |= {"folder": folder, "failures": failures}
    return namespace | {"posterior": namespace["sampled"].posterior}


def test_examples_of_all_public_names_run(known):
    assert "".join(known["failures"]) == ""


def test_names_are_completed_and_imported():
    assert set(dir(curlfit)) == set(curlfit.__all__)
    exec("from curlfit import *", names := {})
    assert (names["fit"], names["Throw"]) == (curlfit.fit, curlfit.Throw)


# --- repr and HTML


class Page(HTMLParser):
    """The tags and the text of a page, which must close what it opens."""

    def __init__(self, page):
        super().__init__()
        self.open = []
        self.tags = []
        self.text = ""
        self.feed(page)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        if tag != "br":
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data + " "


@pytest.mark.parametrize("name", SHOWN)
def test_a_result_is_a_few_lines_of_text_and_a_small_page(known, name):
    result = known[name]
    lines = repr(result).splitlines()
    assert lines[0].startswith(f"{type(result).__name__}, ")
    assert len(lines) <= 6
    assert len(repr(result)) < 800
    page = Page(result._repr_html_())
    assert page.text.startswith(type(result).__name__)
    assert set(page.tags) <= {
        "div",
        "p",
        "span",
        "br",
        "table",
        "thead",
        "tbody",
        "tr",
        "th",
        "td",
    }
    assert ("table" in page.tags) == (name != "flat")  # which has no intervals
    assert len(page.text) < 4000


def test_what_a_fit_finds_comes_first_and_nothing_undetermined_has_an_error(known):
    fit = known["fit"]
    text = repr(fit)
    page = Page(fit._repr_html_()).text
    for shown in (text, page):
        assert re.match(r"FitResult, +converged", shown)
        assert not re.search(r"mu1_eta (=|\d)|mu1_eta +[\d(]", shown)
        # as the README has it: 0.055627 +- 0.000025
        assert re.search(r"0\.055627(\(25\)| +0\.000025)", shown)
        assert re.search(
            r"mu1_eta \+ mu2_eta +(= )?0\.017573(\(16\)| +0\.000016)", shown
        )
    assert "not identifiable: mu1_eta, mu2_eta" in text
    assert "1 warning, see curlfit.print_fit" in text
    assert "Only mu1_eta + mu2_eta is determined" in page
    assert f"Warning: {fit.warnings[0]}." in page
    failed = replace(
        fit, converged=False, status="Did not converge: 200 steps were not enough"
    )
    assert repr(failed).startswith(
        "FitResult, did not converge: 200 steps were not enough:"
    )
    assert html.COLORS["red"] in failed._repr_html_().partition("<table")[0]
    assert "not identifiable" in repr(known["flat"]).splitlines()[0]


def test_pages_are_escaped(known):
    name = '<img src=x onerror="alert(1)">&[bold]'
    fit = known["fit"]
    throw = known["throw"]
    for result in (
        replace(
            fit,
            data=replace(fit.data, file=name),
            warnings=(Finding.warning("text", text=name),),
        ),
        replace(throw, name=name, notes=(Finding.note("text", text=name),)),
    ):
        page = result._repr_html_()
        assert "<img" not in page
        assert name in Page(page).text


def test_colours_are_readable_on_white_and_on_black():
    """Contrast of WCAG 2, which asks for 3 of large and bold text and 4.5
    of small text."""

    def luminance(color):
        channels = np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)]) / 255
        curved = ((channels + 0.055) / 1.055) ** 2.4
        return np.where(channels <= 0.04045, channels / 12.92, curved) @ [
            0.2126,
            0.7152,
            0.0722,
        ]

    for color in html.COLORS.values():
        light = luminance(color)
        for page in ("#ffffff", "#111111"):
            pair = sorted((light + 0.05, luminance(page) + 0.05))
            assert pair[1] / pair[0] > 4


def test_a_traced_path_can_be_shown():
    import jax

    texts = []

    def shown(x):
        texts.append(repr(curlfit.Trajectory(*[x] * 8)))
        return x

    jax.jit(shown)(np.zeros(3))
    assert texts == ["Trajectory, shape (3,): motion of a stone"]


# --- items and tables


def test_numbers_are_taken_by_name(known):
    # compared by identity
    assert known["fit"] != pickle.loads(pickle.dumps(known["fit"]))
    fit = known["fit"]
    joint = known["joint"]
    assert fit["mu2_xi"] is fit.parameters["mu2_xi"]
    assert fit["mu1_eta + mu2_eta"] is fit.combinations[0]
    assert joint["mu1_eta + mu2_eta"] is joint.combinations[0]
    assert "v0" in fit
    assert "v0" not in joint
    with pytest.raises(
        KeyError, match=r"no 'mu'; the names are mu1_xi, .*, omega0, mu1_eta \+ mu2_eta"
    ):
        fit["mu"]
    with pytest.raises(KeyError, match="no 'v0'; the names are mu1_xi"):
        joint["v0"]
    with pytest.raises(TypeError, match="not iterable"):
        iter(fit)


def test_a_fit_as_a_table(known):
    fit = known["fit"]
    table = fit.to_frame()
    assert [*table.index] == [*fit.parameters, "mu1_eta + mu2_eta"]
    row = table.loc["mu2_xi"]
    estimate = fit["mu2_xi"]
    reach = stats.t(estimate.dof).ppf(0.975) * estimate.stderr
    np.testing.assert_allclose(
        row[["value", "stderr", "low", "high"]].astype(float),
        [
            estimate.value,
            estimate.stderr,
            estimate.value - reach,
            estimate.value + reach,
        ],
    )
    shifts = fit.systematics.shifts["mu2_xi"].values()
    assert row["systematic"] == pytest.approx(
        np.sqrt(sum(shift**2 for shift in shifts))
    )
    hidden = table.loc["mu1_eta"]
    assert hidden[["value", "stderr", "systematic", "low", "high"]].isna().all()
    assert hidden["verdict"] == "not identifiable"
    assert table.loc["v0", "unit"] == "m/s"
    assert known["joint"].to_frame().index.tolist() == [
        *fit.coefficients,
        "mu1_eta + mu2_eta",
    ]


def test_a_throw_as_a_table_and_back(known):
    t = np.linspace(0, 1, 5)
    throw = curlfit.Throw.from_arrays(
        t,
        x=np.where(t == 0.5, np.nan, t),
        y=2 * t,
        omega=1 + t,
        sigma={"x": 0.01, "omega": 0.1},
    )
    table = throw.to_frame()
    assert table.columns.tolist() == ["t", "x", "y", "omega", "sigma_x", "sigma_omega"]
    assert curlfit.Throw.from_frame(table) == throw


def test_a_chain_as_a_table(known):
    chain = known["chain"]
    table = chain.to_frame()
    assert len(table) == len(chain.flat)
    total = {"mu1_eta": 1.0, "mu2_eta": 1.0}
    assert table["mu1_eta + mu2_eta"].mean() == pytest.approx(chain.of(total).mean())
    # walkers are divided evenly among the ensembles, in their order
    ensemble = 2
    walker = 5
    step = 3
    row = table.loc[(ensemble, walker, step)]
    position = ensemble * chain.values.shape[1] // chain.ensembles + walker
    sample = chain.values[chain.discarded + step, position]
    np.testing.assert_array_equal(row[list(chain.names)], sample)
    assert row["log_posterior"] == chain.log_posterior[chain.discarded + step, position]


def test_other_results_as_tables(known):
    import pandas

    prediction = known["prediction"]
    written = pandas.read_csv(io.StringIO(prediction.table()), comment="#")
    pandas.testing.assert_frame_equal(
        prediction.to_frame(), written, rtol=1e-8, check_dtype=False
    )
    table = known["comparison"].to_frame()
    assert table["delta_bic"].tolist() == [
        candidate.delta_bic for candidate in known["comparison"].candidates
    ]
    profile = known["profile"]
    table = profile.to_frame()
    nearest = (table["mu1_xi"] - profile.best).abs().idxmin()
    assert table["v0"][nearest] == pytest.approx(known["fit"]["v0"].value, rel=1e-3)
    assert known["pair"].to_frame().columns.tolist() == [
        "mu1_xi",
        "mu2_xi",
        "delta_chi2",
    ]
    errors = known["plan"].to_frame()["mu1_eta + mu2_eta stderr"]
    assert errors.tolist() == [
        candidate.stderr["mu1_eta + mu2_eta"] for candidate in known["plan"].candidates
    ]
    path = known["path"].to_frame()
    np.testing.assert_allclose(path["speed"], np.hypot(path["vx"], path["vy"]))


def test_extras_have_a_kernel_and_no_upper_bounds():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    assert any(
        requirement.startswith("ipykernel") for requirement in extras["notebook"]
    )
    for requirements in (project["dependencies"], *extras.values()):
        assert not [requirement for requirement in requirements if "<" in requirement]


@pytest.mark.parametrize(
    ("package", "extra", "use"),
    [
        ("pandas", "notebook", lambda known: known["fit"].to_frame()),
        ("arviz", "arviz", lambda known: known["chain"].to_arviz()),
    ],
)
def test_a_package_that_is_missing_is_named(known, monkeypatch, package, extra, use):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(InputError) as caught:
        use(known)
    assert (
        str(caught.value)
        == f"{package} is not installed: pip install 'curlfit[{extra}]'"
    )


def test_throws_are_equal_by_content(known):
    throw = known["throw"]
    again = curlfit.load_throw(ROOT / "data" / "jensen_shegelski_2004.csv")
    assert throw == again
    note = Finding.note("text", text="a note")
    assert throw == replace(again, name="another file", notes=(note,), lines=None)
    gap = np.where(again.t == 1.0, np.nan, again.x)
    assert replace(throw, x=gap) == replace(again, x=gap.copy())
    for other in (
        replace(again, x=gap),
        replace(again, phi=again.phi + 1e-12),
        again.with_sigma({"x": 0.1}),
        again.with_defaults(until=3.0),
        replace(again, reference=None),
        again.select_rows(until=10),
        "a throw",
    ):
        assert throw != other
    assert throw.with_sigma({"x": 0.1}) != throw.with_sigma({"x": 0.2})
    with pytest.raises(TypeError, match="unhashable"):
        hash(throw)


# --- ArviZ


@pytest.fixture(scope="module")
def inference(known):
    return known["chain"].to_arviz(draws=1300)


def test_arviz_has_the_chain(known, inference):
    chain = known["chain"]
    fit = known["fit"]
    posterior = inference.posterior
    thin = inference.attrs["thinning"]
    kept = chain.kept[:, :, ::thin]
    assert posterior.sizes == {"chain": 4, "draw": kept.shape[1] * kept.shape[2]}
    assert set(posterior) == {*chain.names, "mu1_eta + mu2_eta"}
    draws = posterior.isel(chain=1, draw=[7, kept.shape[2] + 1])
    walkers = draws["walker"].values
    steps = draws["step"].values
    rows = chain.discarded + steps, chain.values.shape[1] // 4 + walkers
    np.testing.assert_array_equal(
        draws["v0"], chain.values[(*rows, chain.names.index("v0"))]
    )
    np.testing.assert_array_equal(
        inference.sample_stats["lp"].isel(chain=1, draw=[7, kept.shape[2] + 1]),
        chain.log_posterior[rows],
    )
    np.testing.assert_allclose(
        posterior["mu1_eta + mu2_eta"], posterior["mu1_eta"] + posterior["mu2_eta"]
    )
    assert inference.observed_data["y"].dims == ("time",)
    np.testing.assert_array_equal(inference.observed_data["y"], fit.observed["y"])
    np.testing.assert_array_equal(inference.constant_data["t"], fit.observed["t"])


def test_replicated_data_scatter_as_the_noise_does(known, inference):
    fit = known["fit"]
    for name in ("x", "y", "phi"):
        off = (inference.posterior_predictive[name] - fit.fitted[name]) / fit.sigma[
            name
        ]
        # the posterior adds 10 of 603
        assert float(off.std()) == pytest.approx(1.0, abs=0.03)
        assert stats.kstest(off.values[:, ::5].ravel()[::50], "norm").pvalue > 1e-3


@pytest.mark.slow
@pytest.mark.filterwarnings(
    # ArviZ's own, with matplotlib 3.11
    "ignore:Passing a dict or None as alias_mapping"
)
def test_arviz_plots_compares_and_summarises(known, inference, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "agg")
    with warnings.catch_warnings():  # announced on its first import of a day
        warnings.simplefilter("ignore", FutureWarning)
        import arviz
    from matplotlib import pyplot

    names = ["mu1_xi", "mu2_xi", "mu1_eta + mu2_eta"]
    new = not arviz.__version__.startswith("0.")
    arviz.plot_pair(inference, var_names=names)
    (arviz.plot_ppc_dist if new else arviz.plot_ppc)(inference)
    pyplot.close("all")
    summary = arviz.summary(inference, round_to="none")
    assert (summary["r_hat"] < 1.03).all()
    # thinned by so many, of which the sampler's own estimate knows nothing
    for name, ess in known["sampled"].posterior.ess.items():
        assert (
            0.15 * ess
            < summary["ess_bulk"][name]
            < 1.2 * inference.posterior["v0"].size
        )
    mean = known["posterior"].mean["mu2_xi"]
    sd = known["posterior"].sd["mu2_xi"]
    assert summary["mean"]["mu2_xi"] == pytest.approx(mean, abs=0.15 * sd)
    leave_one_out = arviz.loo(inference, var_name="phi")
    assert not leave_one_out.warning
    elpd, effective = (
        (leave_one_out.elpd, leave_one_out.p)
        if new
        else (leave_one_out.elpd_loo, leave_one_out.p_loo)
    )
    # of a Gaussian: the log density at the fit, less some of the effective parameters
    fit = known["fit"]
    at_fit = stats.norm.logpdf(fit.residuals["phi"], scale=fit.sigma["phi"]).sum()
    assert at_fit - 12 < elpd < at_fit
    assert 1 < effective < 8


def test_a_channel_with_gaps_has_times_of_its_own(known):
    chain = known["chain"]
    gaps = chain.fit.observed["phi"].copy()
    gaps[5:9] = np.nan
    fit = replace(chain.fit, observed=chain.fit.observed | {"phi": gaps})
    exported = replace(chain, fit=fit).to_arviz(draws=4)
    assert exported.log_likelihood["phi"].dims == ("chain", "draw", "time_phi")
    times = np.delete(fit.observed["t"], range(5, 9))
    np.testing.assert_array_equal(exported.log_likelihood["time_phi"], times)
    assert exported.log_likelihood["x"].dims == ("chain", "draw", "time")
    assert all(np.isfinite(values).all() for values in exported.log_likelihood.values())


def test_a_chain_without_its_fit_is_refused(known):
    read = curlfit.load_chain(known["folder"] / "chain.h5")
    with pytest.raises(InputError, match=r"expected chain.to_arviz\(fit\)"):
        read.to_arviz()
    other = replace(known["fit"], stone=Stone(R=0.06))
    with pytest.raises(InputError, match="of another fit: stone was"):
        read.to_arviz(other)
    with pytest.raises(InputError, match="draws = 0"):
        read.to_arviz(known["fit"], draws=0)


def test_correlated_noise_is_that_of_the_covariance():
    """Against the covariance in closed form: densities of each value given the others
    by Schur's complement, and the covariance of what is drawn."""
    t = np.array([0.0, 0.1, 0.3, 0.4, 0.9, 1.0])
    memory = 0.4
    weight = np.zeros((3, 8))
    weight[0, :6] = 10.0
    times = np.append(t, [1.0, 1.0])
    noise = Ar1(memory={"x": memory}, white={"x": 0.0})
    whitener = Whitener.of(noise, times, weight, 0)
    problem = Problem(
        times, weight * 0, weight, Stone(), LEVEL_AND_STILL, whitener=whitener
    )
    whitening = whitening_matrix(problem)
    covariance = np.exp(-np.abs(t[:, None] - t) / memory)
    np.testing.assert_allclose(
        np.linalg.inv(whitening.T @ whitening), covariance, atol=1e-12
    )

    residual = np.random.default_rng(1).normal(size=(2, 6))
    expected = np.empty((2, 6))
    for k in range(6):
        rest = np.delete(np.arange(6), k)
        pull = np.linalg.solve(covariance[np.ix_(rest, rest)], covariance[rest, k])
        variance = 1 - covariance[rest, k] @ pull
        expected[:, k] = stats.norm.logpdf(
            residual[:, k], residual[:, rest] @ pull, variance**0.5
        )
    np.testing.assert_allclose(
        log_likelihoods(residual, whitening, LOSSES["linear"]), expected
    )

    drawn = draw_noise(
        np.random.default_rng(2), (40_000, 6), whitening, LOSSES["linear"]
    )
    np.testing.assert_allclose(np.cov(drawn.T), covariance, atol=0.03)


def test_noise_of_a_robust_loss_has_its_density():
    random = np.random.default_rng(3)
    drawn = draw_noise(random, (20_000, 1), None, LOSSES["student"])[:, 0]
    assert stats.kstest(drawn, stats.t(4).cdf).pvalue > 1e-3
    residual = np.array([[0.3, -4.0]])
    np.testing.assert_allclose(
        log_likelihoods(residual, None, LOSSES["student"]), stats.t(4).logpdf(residual)
    )


# --- sliders


def test_sliders_are_shown_without_a_kernel(known):
    """What they show is tested in tests/html_report/test_sliders.py."""
    explorer = curlfit.explore(known["fit"])
    shown = explorer._repr_html_()
    assert shown.startswith("<iframe srcdoc=")
    assert shown.count("<") == 2
    assert explorer.page.endswith("</html>")


NO_FIT = "fit: Throw .* found, expected a fit of one throw"
NO_THROW = "str 'a.csv' found, expected a Throw, as from curlfit"


@pytest.mark.parametrize(
    ("takes", "said"),
    [
        (lambda throw: curlfit.fit("a.csv"), NO_THROW),
        (lambda throw: curlfit.compare("a.csv"), NO_THROW),
        (lambda throw: curlfit.fit_together(["a.csv"]), NO_THROW),
        (
            lambda throw: curlfit.fit(throw, 3),
            "law: int '3' found, expected the name of a law",
        ),
        (
            lambda throw: curlfit.fit(throw, stone=7),
            "stone = 7; expected stone.NAME = a number",
        ),
        (
            lambda throw: curlfit.fit(throw, stone={"r": 1}),
            "the stone has no property 'r'",
        ),
        (
            lambda throw: curlfit.fit(throw, fix="mu1_xi=1"),
            "fix = 'mu1_xi=1'; expected fix.NAME",
        ),
        (
            lambda throw: curlfit.fit(throw, bounds={"mu1_xi": 3}),
            "bounds.mu1_xi = 3; expected",
        ),
        (
            lambda throw: curlfit.Throw.from_arrays([0, 1], sigma=1),
            "sigma: int '1' found",
        ),
        (curlfit.predict, NO_FIT),
        (curlfit.sample, NO_FIT),
        (curlfit.fit_figure, NO_FIT),
        (curlfit.explore, NO_FIT),
        (
            lambda throw: curlfit.profile(3, "mu1_xi"),
            "fit: int '3' found, expected a fit",
        ),
        (curlfit.fit_together, "throws: Throw .* found, expected a list of throws"),
        (lambda throw: curlfit.Stone(R="a"), "stone.R = 'a': expected a number in m"),
    ],
)
def test_an_argument_of_another_type_is_refused_in_a_sentence(known, takes, said):
    with pytest.raises(InputError, match=said):
        takes(known["throw"])
