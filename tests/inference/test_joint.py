"""Several throws together: against single fits, against scipy, coverage, and
what differs."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import command, shown
from scipy.optimize import brentq, least_squares

import curlfit
from curlfit import LAWS, InitialState, Stone, fit_together, simulate
from curlfit.errors import InputError
from curlfit.findings import Finding
from curlfit.inference.together.result import warnings_of
from curlfit.inference.together.variation import _variation
from curlfit.options.settings import load_fit_and_chain

LAW = LAWS["front-back"]
STONE = Stone()
SPINS = (1.0, 1.5, 2.2)


def sheet(count, law=None, seed=0, spread=0.0):
    """Throws of three spins and both senses on one sheet of ice."""
    random = np.random.default_rng(1000 + seed)
    law = law or LAW()
    throws = []
    for number in range(count):
        law_of_throw = replace(
            law, mu2_xi=law.mu2_xi + spread * random.standard_normal()
        )
        throws.append(
            curlfit.synthetic_throw(
                law_of_throw,
                STONE,
                v0=2 + 0.02 * number,
                omega0=SPINS[number % 3] * (-1) ** number,
                heading=0.01 * number,
                noise_xy=0.005,
                noise_phi=0.01,
                seed=100 * seed + number,
            )
        )
    return throws


@pytest.fixture(scope="module")
def three():
    return sheet(3)


def test_the_optimum_and_its_errors_are_scipy_s(three):
    sigma = {"x": 0.005, "y": 0.005, "phi": 0.01}
    throws = [throw.with_sigma(sigma) for throw in three]
    joint = fit_together(throws)

    def residuals(values):
        # mu1_xi, mu2_xi and the sum, then the start of each throw
        law = LAW(values[0], values[1], values[2] / 2, values[2] / 2)
        parts = []
        for throw, (x, y, b, v, phi, w) in zip(
            throws, values[3:].reshape(-1, 6), strict=True
        ):
            path = simulate(law, STONE, InitialState(x, y, b, v, phi, w), throw.t)
            for name, scale in sigma.items():
                parts.append(
                    (np.asarray(getattr(path, name)) - getattr(throw, name)) / scale
                )
        return np.concatenate(parts)

    first = np.concatenate(
        [
            [0.006, 0.045, 0.0175],
            *[
                [
                    fit.parameters[n].value + 1e-3
                    for n in ("x0", "y0", "heading", "v0", "phi0", "omega0")
                ]
                for fit in joint.throws
            ],
        ]
    )
    typical = np.concatenate([[0.01] * 3, [1.0] * 18])
    by_scipy = least_squares(
        residuals, first, x_scale=typical, jac="3-point", xtol=1e-12, ftol=1e-12
    )
    errors = np.sqrt(np.diag(np.linalg.inv(by_scipy.jac.T @ by_scipy.jac)))
    for index, name in enumerate(("mu1_xi", "mu2_xi")):
        estimate = joint.coefficients[name]
        assert abs(estimate.value - by_scipy.x[index]) < 1e-3 * errors[index]
        assert estimate.stderr == pytest.approx(errors[index], rel=1e-3)
    (total,) = joint.combinations
    assert total.expression == "mu1_eta + mu2_eta"
    assert abs(total.value - by_scipy.x[2]) < 1e-3 * errors[2]
    assert total.stderr == pytest.approx(errors[2], rel=1e-3)
    assert joint.identifiability.rank == joint.identifiability.parameters - 1
    # what a throw knows, the others included: predictions from it have these errors
    for index, fit in enumerate(joint.throws):
        typical = fit.parameter_set.typical
        information = typical[:, None] * fit.information.matrix * typical
        fit_errors = typical * np.sqrt(
            np.diag(np.linalg.pinv(information, rcond=1e-12))
        )
        for name, error in zip(fit.information.names, fit_errors, strict=True):
            column = {"mu1_xi": 0, "mu2_xi": 1, "heading": 5, "v0": 6, "omega0": 8}.get(
                name
            )
            if column is not None:
                expected = errors[column + 6 * index * (column > 2)]
                assert error == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(
    "loss", ["linear", pytest.param("student", marks=pytest.mark.slow)]
)
def test_copies_of_a_throw_have_its_errors_over_the_root_of_their_number(three, loss):
    """Exactly so: the information on shared coefficients adds up."""
    alone = curlfit.fit(three[0], "front-back", loss=loss)
    joint = fit_together([three[0]] * 3, loss=loss)
    for single, shared in zip(alone.combinations, joint.combinations, strict=True):
        assert shared.value == pytest.approx(single.value, abs=1e-3 * single.stderr)
        assert shared.stderr == pytest.approx(single.stderr / np.sqrt(3), rel=1e-3)
    for name in ("mu1_xi", "mu2_xi"):
        stderr = joint.coefficients[name].stderr
        assert stderr == pytest.approx(alone[name].stderr / np.sqrt(3), rel=1e-3)


def test_short_throws_together_have_the_degrees_of_freedom_of_all(three):
    short = [
        curlfit.Throw.from_arrays(
            *(getattr(throw, name)[::20] for name in ("t", "x", "y", "phi"))
        )
        for throw in three
    ]
    alone = [curlfit.fit(throw, "front-back") for throw in short]
    joint = fit_together(short)
    most = sum(fit.n_observations for fit in alone) - joint.identifiability.rank
    for name in ("mu1_xi", "mu2_xi"):
        assert max(fit[name].dof for fit in alone) < joint.coefficients[name].dof < most
        low, high = joint.coefficients[name].interval()
        assert high - low < min(
            fit[name].interval()[1] - fit[name].interval()[0] for fit in alone
        )
    (total,) = joint.combinations
    assert max(fit.combinations[0].dof for fit in alone) < total.dof < most
    with_sigma = fit_together(
        [throw.with_sigma({"x": 5e-3, "y": 5e-3, "phi": 0.01}) for throw in short]
    )
    assert (
        with_sigma.coefficients["mu1_xi"].dof is with_sigma.combinations[0].dof is None
    )


def test_a_bound_that_all_throws_press_on_is_said_once(three):
    joint = fit_together(three, bounds={"mu2_xi": (0.0, 0.04)})
    assert joint.coefficients["mu2_xi"].verdict == "at bound"
    (at_bound,) = (w for w in joint.warnings if w.code == "at-bound")
    assert at_bound.numbers["name"] == "mu2_xi"
    assert at_bound.about == ()
    assert str(at_bound) == (
        "mu2_xi is at its bound; the data favour values outside 0..0.04"
    )


def test_a_coefficient_that_varies_is_found_and_its_spread_measured():
    spread = 0.002
    joint = fit_together(sheet(4, spread=spread), share="all")
    varying = {variation.expression: variation for variation in joint.variation}
    assert varying["mu2_xi"].significant
    assert not varying["mu1_xi"].significant
    assert not varying["mu1_eta + mu2_eta"].significant
    assert varying["mu2_xi"].spread == pytest.approx(spread, rel=0.5)
    assert abs(varying["mu2_xi"].mean - LAW().mu2_xi) < 3 * varying["mu2_xi"].stderr
    (varies,) = (w for w in joint.warnings if w.code == "varies-between-throws")
    assert varies.numbers == {"expression": "mu2_xi", "p": varying["mu2_xi"].p_value}
    assert str(varies).startswith(
        "mu2_xi varies between throws by more than its errors (p < 0.001); "
    )
    assert "spins-differ" not in {warning.code for warning in joint.warnings}
    # what each throw says alone is what its own fit says, to first order
    alone = curlfit.fit(sheet(4, spread=spread)[0], details=False).parameters["mu2_xi"]
    estimate, error = varying["mu2_xi"].each[0]
    assert abs(estimate - alone.value) < 0.5 * alone.stderr
    assert error == pytest.approx(alone.stderr, rel=0.2)


@pytest.mark.slow
def test_a_coefficient_may_be_each_throw_s_own():
    throws = sheet(3, spread=0.003, seed=4)
    joint = fit_together(throws, share=["mu1_xi", "mu1_eta", "mu2_eta"])
    assert set(joint.coefficients) == {"mu1_xi", "mu1_eta", "mu2_eta"}
    for fit, throw in zip(joint.throws, throws, strict=True):
        estimate = fit.parameters["mu2_xi"]
        assert (
            abs(estimate.value - throw.reference.values["mu2_xi"]) < 4 * estimate.stderr
        )


def test_throws_of_different_lengths_and_channels_go_together(three):
    some = [
        three[0].select_rows(until=9.0),
        replace(three[1], phi=np.full(201, np.nan)),
        three[2],
    ]
    joint = fit_together(some)
    assert joint.converged
    estimate = joint.coefficients["mu2_xi"]
    assert abs(estimate.value - 0.05) < 4 * estimate.stderr


def test_what_cannot_be_fitted_together_is_refused(three):
    with pytest.raises(
        InputError, match="1 throw to fit together; expected two or more"
    ):
        fit_together(three[:1])
    with pytest.raises(InputError, match="no coefficient 'mu'; it has mu1_xi"):
        fit_together(three, share=["mu"])
    stated = three[0].with_defaults(load="consistent")
    with pytest.raises(
        InputError, match="state different values of load, consistent and uniform"
    ):
        fit_together([stated, three[1]])


def test_a_warning_of_several_throws_is_one():
    old, of_all, of_one = (
        Finding.warning("text", text=text) for text in ("old", "all", "own")
    )
    warnings_by_file = {
        "a": (old, of_all),
        "b": (old, of_all),
        "c": (old, of_all),
        "d": (old, of_all),
        "e": (of_all, of_one),
    }
    throws = [
        SimpleNamespace(data=SimpleNamespace(file=file), warnings=warnings)
        for file, warnings in warnings_by_file.items()
    ]
    assert warnings_of(throws) == [old.of("a", "b", "c", "d"), of_all, of_one.of("e")]
    assert [str(warning) for warning in warnings_of(throws)] == [
        "a, b and 2 more: old",
        "all",
        "e: own",
    ]


def test_on_the_command_line(three, tmp_path):
    from curlfit.throws.synthetic import write_table

    names = [f"throw{number}.csv" for number in range(3)]
    for name, throw in zip(names, three, strict=True):
        (tmp_path / name).write_text(write_table(throw))

    done = command("fit", *names, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "3 throws together" in done.stdout
    assert "a folder for each throw: throw0, throw1, throw2" in " ".join(
        done.stdout.split()
    )
    with pytest.raises(
        InputError, match=r"expected the fit of one throw, such as .*throw0"
    ):
        load_fit_and_chain(tmp_path / "joint-fit")
    assert (tmp_path / "joint-fit" / "joint.png").stat().st_size > 20_000
    again = command("show", "joint-fit", cwd=tmp_path)
    assert done.stdout.partition("Written")[0] in again.stdout, again.stderr
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "throw0.csv").write_text(
        (tmp_path / "throw1.csv").read_text()
    )
    words = "throw0.csv", "other/throw0.csv", "throw2.csv"
    done = command(
        "fit",
        *words,
        "--no-figures",
        "--derive",
        "mu2_xi*g",
        "--out",
        "alike",
        cwd=tmp_path,
    )
    assert "other-throw0, throw2" in " ".join(done.stdout.split()), done
    alike = curlfit.load_joint(tmp_path / "alike")
    record = tmp_path / "joint-fit" / "joint.json"
    entries = json.loads(record.read_text())
    entries["variation"][0]["each"] = []
    record.write_text(json.dumps(entries))
    with pytest.raises(InputError, match="variation: expected"):
        curlfit.load_joint(record)
    assert alike["mu2_xi*g"].stderr == pytest.approx(9.81 * alike["mu2_xi"].stderr)
    for words, message in (
        ((*names, "--share", "mu"), "law front-back has no such coefficient"),
        (("throw0.csv", "--share", "all"), "--share needs several throws"),
        (("throw0.csv", "throw0.csv"), "two files of the same name"),
        (("throw0.csv", "none.csv"), "no such file"),
    ):
        refused = command("fit", *words, cwd=tmp_path)
        assert refused.returncode == 2
        assert message in refused.stderr


@pytest.mark.parametrize(
    "load", ["uniform", pytest.param("consistent", marks=pytest.mark.slow)]
)
def test_throws_of_different_friction_do_not_hide_it_in_their_noise(load):
    """The error of the mean is the scatter of what single fits give, over the root of
    their number.

    In the joint fit a throw's misfit to the common value is part of its residuals.
    """
    random = np.random.default_rng(500)
    throws = []
    for number, factor in enumerate(1 + 0.008 * random.standard_normal(4)):
        law = LAW(mu1_eta=0.009 * factor, mu2_eta=0.009 * factor)
        throws.append(
            curlfit.synthetic_throw(
                law,
                STONE,
                load=load,
                v0=2 + 0.02 * number,
                noise_xy=0.005,
                noise_phi=0.01,
                omega0=SPINS[number % 3] * (-1) ** number,
                seed=number,
            ).with_defaults(load=load)
        )
    joint = fit_together(throws, share="all")
    assert joint.load == joint.throws[0].load == load
    (total,) = (
        combination
        for combination in joint.combinations
        if "mu1_eta" in combination.weights
    )
    (differs,) = (
        variation
        for variation in joint.variation
        if variation.expression == total.expression
    )
    weights = [total.weights["mu1_eta"], total.weights["mu2_eta"]]
    alone = [curlfit.fit(throw, details=False) for throw in throws]
    split = 1 if load == "uniform" else 0.98  # the path determines about this sum
    values = [fit.combinations[0].value * sum(weights) / (1 + split) for fit in alone]
    scatter = np.std(values, ddof=1)
    assert differs.stderr == pytest.approx(scatter / 2, rel=0.05)
    assert differs.spread == pytest.approx(scatter, rel=0.05)
    assert total.stderr == differs.shared_stderr
    assert differs.stderr <= total.stderr < 1.5 * differs.stderr
    assert total.dof == 3
    for (_, error), fit in zip(differs.each, alone, strict=True):
        assert error == pytest.approx(fit.combinations[0].stderr, rel=0.1)
    true = 0.009 * sum(weights)
    assert abs(total.value - true) < 3 * total.stderr
    varying = fit_together(throws)
    (mean,) = varying.combinations
    assert mean.value == pytest.approx(differs.mean, abs=0.1 * differs.stderr)
    assert mean.stderr == pytest.approx(differs.stderr, rel=0.05)
    assert mean.dof == 3
    assert not varying.warnings


def test_tracks_without_an_angle_tell_together_what_each_tells_alone():
    """Made by a simulation that shares no code with curlfit: 5 mm, a gap of 2.5 s,
    front-back with mu1_xi 0.004, mu2_xi 0.048 (the last 0.0432)."""
    folder = Path(__file__).parent / "no_angle_together"
    truth = {"t02_1": 0.01763, "t02_2": 0.01768, "t02_5": 0.01759, "t02_7": 0.01836}
    throws = curlfit.load_throws(*(folder / f"{name}.csv" for name in truth))
    joint = curlfit.fit_together(throws, law="front-back")
    assert joint.converged
    combinations = {
        combination.expression: combination for combination in joint.combinations
    }
    forward = combinations["mu1_xi + mu2_xi"]
    assert forward.value == pytest.approx(0.0508, abs=2 * forward.stderr)
    by_throw = {variation.expression: variation.each for variation in joint.variation}
    sums = by_throw["mu1_eta + mu2_eta"]
    for (value, stderr), right, throw in zip(sums, truth.values(), throws, strict=True):
        assert value == pytest.approx(right, abs=3 * stderr)
        alone = curlfit.fit(throw, "front-back", details=False)
        (same,) = [
            combination
            for combination in alone.combinations
            if combination.expression == "mu1_eta + mu2_eta"
        ]
        assert value == pytest.approx(same.value, abs=0.01 * stderr)
        assert stderr == pytest.approx(same.stderr, rel=1e-3)
    assert joint.coefficients["mu1_xi"].verdict in ("weak", "at bound")
    parameters = {effect.parameter for effect in joint.groups}
    assert not {"mu1_xi", "mu2_xi"} & parameters
    # at the angle and the coefficients of one point of the ridge
    (curl,) = [effect for effect in joint.groups if effect.parameter == "curl"]
    assert 0.5 < curl.value < 1.5


def test_the_spread_between_throws_is_that_of_paule_and_mandel():
    """Of eight results and their errors: their weighted sum of squares is then their
    number less one."""
    random = np.random.default_rng(8)
    error = np.array([1, 2, 1, 0.3, 4, 1, 2, 0.5])
    value = 10 + random.standard_normal(8) * np.hypot(error, 3.0)
    variation = _variation(
        "mu", list(zip(value, error, strict=True)), error**-2.0, np.zeros((8, 0))
    )

    def excess(variance):
        weight = 1 / (error**2 + variance)
        return weight @ (value - np.average(value, weights=weight)) ** 2 - 7

    assert variation.spread == pytest.approx(np.sqrt(brentq(excess, 0, 1e3)), rel=1e-6)
    weight = 1 / (error**2 + variation.spread**2)
    assert variation.mean == pytest.approx(np.average(value, weights=weight))
    assert variation.stderr == pytest.approx(weight.sum() ** -0.5)
    alike = _variation(
        "mu", [(10.0, stderr) for stderr in error], error**-2.0, np.zeros((8, 0))
    )
    assert (alike.spread, alike.p_value) == (0.0, 1.0)
    assert (
        alike.shared_stderr
        == pytest.approx(alike.stderr)
        == (error**-2.0).sum() ** -0.5
    )


def test_a_report_begins_with_what_the_warnings_are_about(eq12_fit):
    report = shown(eq12_fit)
    assert "Caution: the residuals are correlated from row to row. parameter" in report
    at_bound = Finding.warning("at-bound", name="mu2_xi", lower=0.0, upper=0.04)
    warned = replace(eq12_fit, warnings=(at_bound, at_bound))
    assert "Caution: mu2_xi is at its bound. parameter" in shown(warned)
    assert "No warnings. parameter" in shown(replace(eq12_fit, warnings=()))
    failed = shown(replace(eq12_fit, converged=False))
    assert "Caution" not in failed
    assert "No warnings" not in failed
