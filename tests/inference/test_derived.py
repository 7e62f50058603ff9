"""Derived quantities: expressions, their errors, and what is quoted of a path."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import approx_fprime

import curlfit
from curlfit.environment import Environment
from curlfit.errors import InputError
from curlfit.inference.derived.along_ridge import demanded_error
from curlfit.inference.derived.derive import derive
from curlfit.inference.derived.expression import parse
from curlfit.inference.derived.first_order import FirstOrder
from curlfit.inference.fit.estimates import Estimate, RidgePoint
from curlfit.inference.fit.products import products_of
from curlfit.inference.fit.quantities import quantities_of
from curlfit.inference.information.named_matrix import NamedMatrix
from curlfit.inference.information.verdict import Verdict
from curlfit.reports.fit import document
from curlfit.sheet import LINES, TEE
from curlfit.throws.synthetic import write_table
from curlfit.wording import compact

ROOT = Path(__file__).parents[2]
G = 9.81
MU = 0.0095
V0 = 2.45
Y0 = 9.5
T_END = 24.0
NAMES = ("a", "b", "c")
FROM_HACK = curlfit.Finding.note("y-from-the-hack", lines=[], far_tee=TEE)
AT = {"a": 0.7, "b": -1.3, "c": 2.1}


@pytest.fixture(scope="module")
def throw():
    """Friction of Coulomb without spin: constant deceleration, on the sheet,
    nearly to rest."""
    law = curlfit.law_with("coulomb", {"mu": MU})
    random = np.random.default_rng(8)
    t = np.linspace(0.0, T_END, 201)
    start = curlfit.InitialState(x=0.2, y=Y0, heading=0.01, v=V0, omega=0.0)
    path = curlfit.simulate(law, curlfit.Stone(), start, t).to_numpy()
    x, y, phi = (
        series + 0.004 * random.standard_normal(len(t))
        for series in (path.x, path.y, path.phi)
    )
    throw = curlfit.Throw.from_arrays(t, x, y, phi, name="draw.csv")
    return replace(throw, notes=(FROM_HACK,))


@pytest.fixture(scope="module")
def fit(throw):
    return curlfit.fit(throw, "coulomb")


@pytest.fixture(scope="module")
def sampled(fit):
    """The fit, and draws of the normal density of its covariance as a chain."""
    names = tuple(fit.parameters)
    random = np.random.default_rng(6)
    values = np.tile(fit.values, (50, 8, 1))
    free = [names.index(name) for name in fit.covariance.names]
    matrix = fit.covariance.matrix
    values[..., free] = random.multivariate_normal(
        fit.values[free], matrix, (50, 8), tol=1e-6
    )
    none = np.zeros((50, 8))
    chain = curlfit.Chain(names, values, none, 0, 4, 0)
    result = fit.with_derived(["v0**2 / (2*g*mu)"], chain)
    return replace(result, quantities=quantities_of(fit, chain)), chain


# --- expressions


@pytest.mark.parametrize(
    "text",
    [
        "a*b - c/a",
        "a**2 + c**0.5 * b**3",
        "sqrt(a) * exp(b) + log(c)",
        "abs(b) * max(a, c)",
        "hypot(a, b) / (1 + tan(a)**2)",
        "sin(a) * cos(b) - atan(c) + log10(c)",
        "-b ** 2 + min(a, c)",
        "2 a - .5 c",
        "a ** b",
    ],
)
def test_gradients_are_those_of_differences(text):
    expression = parse(text, NAMES, {})
    gradient = expression.gradient(AT)
    python = (
        expression.text.replace("2 a", "2*a")
        .replace(".5 c", ".5*c")
        .replace("log10", "lg")
    )
    functions = {
        name: getattr(np, name) for name in ("sqrt", "exp", "log", "sin", "cos", "tan")
    }
    functions |= {"lg": np.log10, "atan": np.arctan, "hypot": np.hypot, "abs": abs}

    def by_python(x):
        return eval(
            python,
            functions | {"min": min, "max": max},
            dict(zip(NAMES, x, strict=True)),
        )

    x = np.array(list(AT.values()))
    assert expression.of(AT) == pytest.approx(by_python(x), rel=1e-14)
    expected = approx_fprime(x, by_python, 1e-7)
    np.testing.assert_allclose(
        [gradient.get(n, 0.0) for n in NAMES], expected, atol=3e-6
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a +", "not an arithmetic expression"),
        ("d", "no parameter 'd'; the parameters are a, b, c"),
        ("__import__('os')", "no function '__import__'"),
        ("a.real", "only numbers, names"),
        ("a[0]", "only numbers, names"),
        ("'a'", "'a' is not a number"),
        ("", "empty"),
        ("True * a", "True is not a number"),
        ("log(a, b)", "log takes 1 argument"),
        ("3", "it contains no parameter"),
        ("a if b else c", "only numbers"),
        ("a" * 500, "500 chara"),
        ("(" * 300 + "a" + ")" * 90, "not an arithmetic"),
        ("1e999*a", "too large"),
        ("a; b", "not an"),
        ("[a for a in b]", "only numbers"),
        ("a := 3", "not an"),
        ("1j*a", "1j is not a number"),
    ],
)
def test_what_is_no_arithmetic_is_refused(text, said):
    with pytest.raises(InputError) as caught:
        parse(text, NAMES, {})
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


# --- errors


def test_errors_are_those_of_the_covariance(fit):
    names = fit.covariance.names
    matrix = fit.covariance.matrix
    distance = fit.derive("v0**2 / (2*g*mu)")
    mu = fit["mu"].value
    v0 = fit["v0"].value
    assert distance.value == pytest.approx(v0**2 / (2 * G * mu), rel=1e-13)
    row = np.zeros(len(names))
    row[names.index("v0")] = v0 / (G * mu)
    row[names.index("mu")] = -(v0**2) / (2 * G * mu**2)
    assert distance.stderr == pytest.approx(np.sqrt(row @ matrix @ row), rel=1e-10)
    assert distance.verdict == "determined"
    friction = fit.derive("mu")
    assert friction.stderr == pytest.approx(fit["mu"].stderr, rel=1e-12)
    assert friction.systematic == pytest.approx(fit.systematics.errors["mu"], rel=1e-12)
    assert friction.dof == fit["mu"].dof
    # a constant of the stone has a systematic error, which adds to that of
    # the parameter
    ratio = fit.derive("mu / R")
    shifts = fit.systematics.shifts["mu"]
    widths = fit.systematics.widths
    contributions = [
        by / fit.stone.R - (name == "R") * mu * widths["R"] / fit.stone.R**2
        for name, by in shifts.items()
    ]
    assert ratio.systematic == pytest.approx(np.hypot.reduce(contributions), rel=1e-9)


def test_quantiles_are_those_of_the_posterior(sampled):
    fit, chain = sampled
    distance = fit["v0**2 / (2*g*mu)"]
    mu, v0 = (chain.of({name: 1.0}) for name in ("mu", "v0"))
    draws = v0**2 / (2 * G * mu)
    assert distance.quantiles["16"] == pytest.approx(
        np.quantile(draws, 0.16), rel=1e-12
    )
    assert distance.stderr == pytest.approx(draws.std(), rel=0.1)
    assert curlfit.FitResult.from_json(
        json.loads(json.dumps(fit.to_json()))
    ).derived == (distance,)


@pytest.mark.parametrize(
    ("text", "seen"),
    [
        ("mu1_eta + mu2_eta", True),
        ("(mu1_eta + mu2_eta)**2 / mu2_xi", True),
        ("mu2_xi - mu1_xi", True),
        ("mu1_eta - mu2_eta", False),
        ("mu1_eta / mu2_eta", False),
        ("mu1_eta * mu2_eta", False),
        ("(mu1_eta - mu2_eta)**2", False),
        ("v0*mu1_eta", False),
    ],
)
def test_what_depends_on_the_ridge_is_not_identifiable(eq12_fit, text, seen):
    derived = eq12_fit.derive(text)
    assert (derived.verdict == "determined") == seen
    assert (derived.stderr is not None) == (derived.interval() is not None) == seen
    assert seen or derived.verdict == "not identifiable"
    assert seen or derived.systematic is None


def test_a_combination_has_its_own_errors(eq12_fit):
    (combination,) = eq12_fit.combinations
    derived = eq12_fit.derive(combination.expression)
    assert derived.value == pytest.approx(combination.value, rel=1e-13)
    assert derived.stderr == pytest.approx(combination.stderr, rel=1e-9)
    errors = eq12_fit.systematics.errors
    assert derived.systematic == pytest.approx(errors[combination.expression], rel=1e-6)
    assert derived.dof == combination.dof
    # one that is written with rounded weights is exact
    odd = replace(
        combination,
        expression="mu1_eta + 0.98 mu2_eta",
        weights={"mu1_eta": 1.0, "mu2_eta": 1.0},
    )
    other = replace(eq12_fit, combinations=(odd,)).derive("2*(mu1_eta + 0.98 mu2_eta)")
    assert other.value == pytest.approx(2 * combination.value, rel=1e-13)
    for overflowing in ("v0**1000", "v0**400"):  # its square too
        with pytest.raises(InputError, match="no finite value"):
            eq12_fit.derive(overflowing)
    with pytest.raises(InputError, match="no finite value"):
        eq12_fit.derive("log(mu1_xi - mu2_xi)")


def test_what_is_at_a_bound_or_fixed_has_no_error(throw, fit):
    held = curlfit.fit(throw, "coulomb", fix={"mu": MU})
    assert held.derive("2*mu").verdict == "fixed"
    assert held.derive("mu*v0").stderr == pytest.approx(MU * held["v0"].stderr)
    bound = fit["mu"].value - fit["mu"].stderr
    stuck = curlfit.fit(throw, "coulomb", bounds={"mu": (0.0, bound)})
    derived = stuck.derive("mu*v0")
    assert (derived.verdict, derived.stderr) == ("at bound", None)


# --- along the ridge


def known_of(residual, names, values, held, typical=1.0):
    """What a fit says of parameters whose residuals are a function of them, in closed
    form, with points of its ridge.

    `held` has, by name, values at which that parameter is held and the others there.
    """

    def slopes(at):
        return approx_fprime(np.array(at), residual, 1e-7)

    jacobian = slopes(values)
    squares, axes = np.linalg.eigh(jacobian.T @ jacobian * typical**2)
    determined = squares > 1e-6
    covariance = (
        (axes[:, determined] / squares[determined]) @ axes[:, determined].T * typical**2
    )
    null = [dict(zip(names, row, strict=True)) for row in axes[:, ~determined].T]
    ridge = []
    for name, points in held.items():
        for at in points:
            factor = np.linalg.qr(slopes(at), mode="r")
            rise = float(np.sum(residual(np.array(at)) ** 2))
            point = RidgePoint(name, rise, tuple(at), tuple(map(tuple, factor)))
            ridge.append(point)
    verdict = Verdict.NOT_IDENTIFIABLE if null else Verdict.WEAK
    estimates = {
        name: Estimate(value, None, verdict, "1", name, name, -1e3, 1e3, typical)
        for name, value in zip(names, values, strict=True)
    }
    return FirstOrder(
        parameters=estimates,
        covariance=NamedMatrix(tuple(names), covariance),
        null_directions=null,
        combinations=(),
        widths={},
        shifts={},
        stone={},
        ridge=tuple(ridge),
    )


SIGMA = 0.02


@pytest.fixture(scope="module")
def hyperbola():
    """Two parameters of which the data tell only the product, 1 +- 0.02."""
    sizes = [0.1, 0.25, 0.5, 2.0, 4.0, 10.0]
    return known_of(
        lambda p: np.array([(p[0] * p[1] - 1.0) / SIGMA, 0.0]),
        ("a", "b"),
        (1.25, 0.8),
        {"a": [(size, 1 / size) for size in sizes]},
    )


@pytest.mark.parametrize(
    ("text", "stderr"),
    [
        ("a*b", SIGMA),
        ("2*b*a", 2 * SIGMA),
        ("log(a*b)", SIGMA),
        ("(a*b)**2", 2 * SIGMA),
        ("1/(a*b)", SIGMA),
    ],
)
def test_what_is_constant_along_the_ridge_is_determined(hyperbola, text, stderr):
    derived = derive(hyperbola, text)
    assert derived.verdict == "determined"
    assert derived.stderr == pytest.approx(stderr, rel=1e-3)
    # without the ridge, its null direction is all that is known
    alone = derive(hyperbola._replace(ridge=()), text)
    assert (alone.verdict, alone.stderr) == ("not identifiable", None)


@pytest.mark.parametrize("text", ["a", "a/b", "a**2*b", "a + 1.5625*b", "a - b"])
def test_what_moves_along_the_ridge_is_not(hyperbola, text):
    """The fourth is constant along the tangent at the estimates."""
    derived = derive(hyperbola, text)
    assert derived.verdict in ("weak", "not identifiable")
    if text != "a":
        values = [
            parse(text, ("a", "b"), {}).of(point)
            for point in (hyperbola.values, *hyperbola.points)
        ]
        low, high = (f"{value:.3g}" for value in (min(values), max(values)))
        assert derived.reason == f"values from {low} to {high} fit nearly as well"


def test_the_error_is_the_largest_of_a_profile():
    """Of all intervals of the profile, from one standard error up."""
    random = np.random.default_rng(1)
    k = np.linspace(1.0, 60.0, 600_001)
    for moved, error, rise in random.exponential((0.5, 0.5, 1.0), (200, 3)):
        beyond = k[k**2 >= rise]
        ratios = (moved + error * np.sqrt(beyond**2 - rise)) / beyond
        assert demanded_error(moved, error, rise) == pytest.approx(
            ratios.max(), rel=1e-3
        )
    assert demanded_error(0.0, 0.3, 0.0) == 0.3
    assert demanded_error(0.2, 0.0, 4.0) == pytest.approx(0.1)
    assert math.isinf(demanded_error(0.0, math.inf, 1.0))


def test_a_ridge_that_drifts_widens_the_error():
    """The data tell a b + a/10 and, by a second value, little of a: the product moves
    along the ridge by a tenth of a."""
    sizes = np.array([0.6, 0.8, 1.2, 1.4])

    def residual(p):
        return np.array([(p[0] * p[1] + p[0] / 10 - 1.1) / 0.001, (p[0] - 1) / 0.3])

    points = [(size, 1.1 / size - 0.1) for size in sizes]
    first_order = known_of(residual, ("a", "b"), (1.0, 1.0), {"a": points})
    product = derive(first_order, "a*b")
    assert product.stderr == pytest.approx(0.03, rel=0.02)
    assert derive(first_order, "a*b + a/10").stderr == pytest.approx(0.001, rel=0.1)


def test_far_less_may_be_known_at_a_point_of_the_ridge():
    """Nothing of a force of the spin, where there is none."""
    spins = [1.5, 0.5, 0.0]

    def residual(p):
        return np.array([p[0] * p[1] / 0.1, (p[1] - 1.0) / 0.6])

    points = [(0.0, spin) for spin in spins]
    first_order = known_of(residual, ("a", "w"), (0.0, 1.0), {"w": points})
    derived = derive(first_order, "2*a")
    assert (derived.verdict, derived.stderr) == ("not identifiable", None)
    without = first_order._replace(ridge=first_order.ridge[:-1])
    assert derive(without, "2*a").stderr == pytest.approx(2 * 0.1 / 0.5, rel=1e-3)


# --- products


@pytest.mark.parametrize("power", [1, -1, 2, -2, 0.5])
def test_products_are_found_from_a_ridge(power):
    sizes = np.array([0.2, 0.5, 2.0, 5.0])
    points = [(size, size ** (-1 / power)) for size in sizes]
    first_order = known_of(
        lambda p: np.array([(p[0] * p[1] ** power - 1.0) / SIGMA, 0.0]),
        ("a", "b"),
        (1.0, 1.0),
        {"a": points},
    )
    (product,) = products_of(first_order)
    expected = {1: "a*b", -1: "a/b", 2: "a*b**2", -2: "a/b**2", 0.5: "a**2*b"}
    assert product.expression == expected[power]
    assert product.value == pytest.approx(1.0)
    assert product.stderr == pytest.approx(SIGMA * (2 if power == 0.5 else 1), rel=1e-3)
    words = "a falls as b grows" if power > 0 else "a grows with b"
    assert product.meaning == words


def test_a_product_of_a_difference_is_found():
    sizes = np.array([0.5, 0.7, 2.0, 4.0])
    points = [(0.2 + 1 / size, 0.2, size) for size in sizes]
    points += [(shift + 1.0, shift, 1.0) for shift in (0.1, 0.5, 1.0)]
    first_order = known_of(
        lambda p: np.array([((p[0] - p[1]) * p[2] - 1.0) / SIGMA, 0.0, 0.0]),
        ("a", "b", "omega0"),
        (1.2, 0.2, 1.0),
        {"omega0": points[:4], "b": points[4:]},
    )
    # two directions are free, of which one held parameter leaves one
    (product,) = products_of(first_order)
    assert product.expression == "(a - b)*omega0"
    assert product.stderr == pytest.approx(SIGMA, rel=1e-3)
    assert product.meaning == "a - b falls as omega0 grows"


def test_no_product_is_said_of_a_straight_ridge(hyperbola):
    points = [(3.0 - size, size) for size in (0.3, 0.7, 2.0, 2.5)]
    first_order = known_of(
        lambda p: np.array([(p[0] + p[1] - 3.0) / SIGMA, 0.0]),
        ("a", "b"),
        (1.5, 1.5),
        {"b": points},
    )
    assert products_of(first_order) == ()
    assert products_of(hyperbola._replace(ridge=())) == ()


def test_no_product_is_said_of_a_ridge_that_a_bound_makes_short():
    """The sums of the radial law are straight; over so short a way mu2^2/(mu3 - mu1)
    hardly moves."""
    throw = curlfit.synthetic_throw(
        curlfit.law_with("radial", {}),
        curlfit.Stone(),
        load="consistent",
        v0=2.1,
        omega0=1.2,
        until=18.0,
        noise_xy=0.005,
        noise_phi=0.01,
    )
    fit = curlfit.fit(throw, "radial", load="consistent", bounds={"mu1": (0.0, 0.0048)})
    assert fit.ridge
    assert fit.products == ()


@pytest.fixture(scope="module")
def on_a_curve():
    """A track without an angle, see `data/README.md`."""
    throw = curlfit.load_throw(ROOT / "data" / "without_angle.csv")
    return throw, curlfit.fit(throw, "power+transverse")


def test_the_product_has_the_error_of_its_profile(on_a_curve):
    """By fits at fixed spins, where nothing is undetermined: the profile of b omega0 is
    the least chi squared over all spins."""
    throw, fit = on_a_curve
    product = fit["b*omega0"]
    assert fit.products == (product,)
    assert product.verdict == "determined"
    assert abs(product.value - 0.055) < 2 * product.stderr
    sigma = dict(fit.sigma)
    values = []
    errors = []
    rises = []
    spins = np.array([0.1, 1.0, 3.0, 5.0, 7.0, 9.0, 11.0, 12.5])
    for spin in spins:
        held = curlfit.fit(
            throw, "power+transverse", fix={"omega0": spin}, sigma=sigma, details=False
        )
        values.append(spin * held["b"].value)
        errors.append(spin * held["b"].stderr)
        rises.append(held.chi_squared)
    between = np.linspace(0.1, 12.5, 500)
    value, error, rise = (
        np.interp(between, spins, series) for series in (values, errors, rises)
    )
    at = np.linspace(0.05, 0.065, 1501)
    profile = (rise + ((at[:, None] - value) / error) ** 2).min(1)
    profile -= profile.min()
    widths = [
        np.abs(at[profile <= k**2] - product.value).max() / k for k in (1.0, 1.5, 2.0)
    ]
    assert product.stderr == pytest.approx(max(widths), rel=0.1)
    # a twentieth of it would be the tangent's, if that were all
    assert min(errors) < 0.3 * product.stderr


def test_a_fit_says_the_same_of_a_parameter_and_of_an_expression(on_a_curve):
    _, fit = on_a_curve
    for name in ("c", "v0", "b"):
        derived = fit.derive(name)
        assert (derived.stderr, derived.verdict) == (
            fit[name].stderr,
            fit[name].verdict,
        )
    assert fit.derive("2*c").stderr == pytest.approx(2 * fit["c"].stderr, rel=0.01)
    ratio = fit["omega0"].value / fit["b"].value
    tangent = fit.derive(f"omega0 + {ratio!r}*b")
    assert tangent.verdict in ("weak", "not identifiable")
    assert "fit nearly as well" in tangent.reason


def test_the_systematic_error_of_a_product_is_that_of_a_fit(on_a_curve):
    """Of a path without noise on ice that slopes as assumed, fitted as if level."""
    _, fit = on_a_curve
    slope = 1e-4
    law = curlfit.law_with("power+transverse", {"c": 0.008, "k": -0.5, "b": 0.05})
    ice = Environment(slope_x=slope)
    throw = curlfit.synthetic_throw(
        law, curlfit.Stone(), v0=2.1, omega0=1.1, until=18, environment=ice
    )
    sigma = {"x": 0.005, "y": 0.005}
    track = curlfit.Throw.from_arrays(throw.t, throw.x, throw.y, sigma=sigma)
    sloping = curlfit.fit(track, "power+transverse", systematics={"slope_x": slope})
    off = 0.055 - sloping["b*omega0"].value
    shift = fit.systematics.shifts["b*omega0"]["slope_x"]
    assert shift == pytest.approx(off, rel=0.1)
    assert fit["b*omega0"].systematic == pytest.approx(abs(off), rel=0.1)
    twice = fit.derive("2*omega0*b").systematic
    assert twice == pytest.approx(2 * fit["b*omega0"].systematic, rel=1e-6)


def test_the_report_names_the_product(on_a_curve):
    _, fit = on_a_curve
    report = " ".join(str(document(fit)).split())
    product = fit["b*omega0"]
    assert "Only b*omega0 is determined: b falls as omega0 grows." in report
    value = compact(product.value, product.stderr)
    assert f"b*omega0 = {value} is determined" in str(fit.warnings[-1])
    again = curlfit.FitResult.from_json(json.loads(json.dumps(fit.to_json())))
    assert again.products == fit.products
    assert fit.to_frame().loc["b*omega0", "verdict"] == "determined"
    # one that is requested as well is not shown twice
    quantities = fit.with_derived(["b*omega0"]).all_derived
    assert [quantity.expression for quantity in quantities] == ["b*omega0"]


def test_the_track_of_the_page_is_made_by_its_lines(tmp_path, monkeypatch):
    page = (ROOT / "notebooks" / "book" / "ridge.md").read_text()
    (lines,) = re.findall(r"```python\n(.*?)```", page, re.S)
    monkeypatch.chdir(tmp_path)
    exec(lines, {})
    track = (tmp_path / "without_angle.csv").read_text()
    assert track == (ROOT / "data" / "without_angle.csv").read_text()


# --- what is quoted of the path


def passes(y, mu, v0, y0, heading=0.01):
    """When a stone under constant deceleration passes a line."""
    a = mu * G * np.cos(heading)
    v = v0 * np.cos(heading)
    gap = y - y0
    return (v - np.sqrt(v**2 - 2 * a * gap)) / a


def test_quantities_of_the_path_have_closed_forms_under_constant_deceleration(fit):
    quantities = fit.quantities
    # without spin there is no curl, and a law that cannot curl says nothing of it
    assert set(quantities) == {"friction", "turns", "hog_to_hog", "hog_to_tee"}
    assert quantities["friction"].value == pytest.approx(fit["mu"].value, rel=1e-9)
    assert quantities["friction"].stderr == pytest.approx(fit["mu"].stderr, rel=1e-4)
    names = fit.covariance.names
    order = [names.index(name) for name in ("mu", "v0", "y0", "heading")]
    matrix = fit.covariance.matrix[np.ix_(order, order)]
    at = np.array([fit[name].value for name in ("mu", "v0", "y0", "heading")])
    for name, line in (("hog_to_hog", LINES["far-hog"]), ("hog_to_tee", TEE)):

        def between(p, line=line):
            return passes(line, *p) - passes(LINES["hog"], *p)

        assert quantities[name].value == pytest.approx(between(at), abs=2e-6)
        row = approx_fprime(at, between, 1e-8)
        assert quantities[name].stderr == pytest.approx(
            np.sqrt(row @ matrix @ row), rel=2e-3
        )
    assert quantities["hog_to_tee"].unit == "s"


def assert_quantiles(item, chain, within):
    """Those of a time from hog line to hog line, of the draws of a chain, are right."""
    draws = [chain.of({name: 1.0}) for name in ("mu", "v0", "y0", "heading")]
    times = passes(LINES["far-hog"], *draws) - passes(LINES["hog"], *draws)
    ends = np.quantile(times, [0.16, 0.84])
    assert [item.quantiles[level] for level in ("16", "84")] == pytest.approx(
        ends, abs=within
    )
    return times


def test_quantities_agree_with_the_draws_of_the_posterior(sampled):
    fit, chain = sampled
    duration = fit.quantities["hog_to_hog"]
    times = assert_quantiles(duration, chain, 2e-6)
    assert duration.stderr == pytest.approx(times.std(), rel=0.1)


@pytest.mark.slow
def test_where_draws_are_too_wide_for_first_order_paths_are_followed(sampled, fit):
    narrow = sampled[1]
    wide = fit.values + 70 * (narrow.values - fit.values)
    chain = replace(narrow, values=wide)
    times = assert_quantiles(quantities_of(fit, chain)["hog_to_hog"], chain, 2e-5)
    near = quantities_of(fit, narrow)["hog_to_hog"]
    wide = near.value + 70 * (near.quantiles["84"] - near.value)
    assert abs(wide - np.quantile(times, 0.84)) > 1e-4


def test_only_what_the_record_determines_is_quoted(throw, fit, eq12_fit):
    # its zero of y is unknown
    assert {"hog_to_hog", "draw_time"}.isdisjoint(eq12_fit.quantities)
    assert eq12_fit.quantities["curl"].value < 0
    early = curlfit.fit(throw, "coulomb", until=10)
    assert set(early.quantities) == {"friction", "turns"}
    track = curlfit.Throw.from_arrays(throw.t, throw.x, throw.y)
    assert "turns" not in curlfit.fit(track, "coulomb").quantities
    systematic = fit.quantities["hog_to_hog"].systematic
    # the clock of the record, wrong by 0.1 %, at least
    assert systematic > 0.9e-3 * fit.quantities["hog_to_hog"].value


def test_a_draw_has_its_time_and_its_curl(eq12_fit):
    """By an independent simulation of the fitted stone."""
    law = eq12_fit.fitted_law
    t = np.linspace(0, 30, 201)
    start = curlfit.InitialState(y=9.9, v=2.25, omega=1.3)
    path = curlfit.simulate(law, curlfit.Stone(R=0.054), start, t).to_numpy()
    assert 0.1 < path.y[-1] - TEE < 1.5
    throw = curlfit.Throw.from_arrays(
        t, path.x, path.y, path.phi, sigma={"x": 0.003, "y": 0.003, "phi": 0.005}
    )
    throw = replace(throw, notes=(FROM_HACK,), defaults={"stone": {"R": 0.054}})
    quantities = curlfit.fit(throw).quantities
    hog = np.interp(LINES["hog"], path.y[:9], t[:9])
    assert quantities["draw_time"].value == pytest.approx(
        float(path.rest) - hog, abs=2e-3
    )
    assert quantities["turns"].value == pytest.approx(
        path.phi[-1] / 2 / np.pi, abs=1e-4
    )
    end = np.interp(TEE, path.y[:158], path.x[:158])
    assert quantities["curl"].value == pytest.approx(end, abs=3e-3)


def test_an_error_of_the_clock_scales_times_and_friction():
    """Against the fit of the same draw with all times longer: intervals are
    proportional to the unit of time, the mean deceleration to its inverse square."""
    width = 1e-3
    t = np.linspace(0.0, 30.0, 201)
    law = curlfit.law_with("coulomb", {"mu": 0.0085})
    start = curlfit.InitialState(y=9.9, v=2.2, omega=1.0)
    path = curlfit.simulate(law, curlfit.Stone(), start, t).to_numpy()
    sigma = dict.fromkeys(("x", "y", "phi"), 0.004)
    right, slow = (
        curlfit.fit(
            replace(
                curlfit.Throw.from_arrays(
                    rate * t, path.x, path.y, path.phi, sigma=sigma
                ),
                notes=(FROM_HACK,),
            ),
            "coulomb",
            systematics={"all": 0.0, "time_scale": width},
        ).quantities
        for rate in (1.0, 1 + width)
    )
    powers = {"friction": -2, "hog_to_hog": 1, "hog_to_tee": 1, "draw_time": 1}
    assert set(powers) < set(right)
    for name, power in powers.items():
        quantity = right[name]
        assert slow[name].value == pytest.approx(
            quantity.value * (1 + width) ** power, rel=1e-6
        ), name
        assert quantity.systematic == pytest.approx(
            abs(power) * width * quantity.value, rel=2e-3
        ), name


# --- the command line


@pytest.fixture
def folder(tmp_path):
    return tmp_path


def test_the_command_line_and_the_report(tmp_path, throw, typed):
    (tmp_path / "a.csv").write_text('# axes = "from-hack"\n' + write_table(throw))
    quick = ("--law", "coulomb", "--no-sample", "--no-figures")
    report = " ".join(
        typed("fit", "a.csv", *quick, "--derive", "v0**2/(2*g*mu)").split()
    )
    assert "derived estimate std. error systematic verdict v0**2/(2*g*mu) " in report
    assert "hog line to hog line (s)" in report
    assert "mean deceleration / g" in report
    saved = curlfit.load_fit("a-fit")
    assert "mu / v0" in typed("show", "a-fit", "--derive", "mu / v0")
    assert saved.to_frame().loc["v0**2/(2*g*mu)", "verdict"] == "determined"
